"""Parts: what a CAD file holds, as far as this program looks at it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from conflank_cli.cad.sheet import Box, Sheet
from conflank_cli.errors import InputError
from conflank_cli.geometry.surface import BSplineSurface

Array = npt.NDArray[np.float64]
Triangles = npt.NDArray[np.int32]
Piece = tuple[Array, Triangles]
"""Triangles of one face: vertices (N, 3) in mm, and their numbers (M, 3)."""


@dataclass(frozen=True, slots=True)
class FaceGeometry:
    """The geometry of one face as B-spline surface and trim loops.

    Attributes
    ----------
    sheet: the surface as it is, period and all.
    surface: the clamped surface round the face (`Sheet.unwrapped`), mm.
    loops: trim loops in (u, v), each (N, 2) without repeating the first point; even-odd rule.
    box: parameter box (u0, u1, v0, v1) of the loops.
    edges: number of trim edges in the file.
    """

    sheet: Sheet
    surface: BSplineSurface
    loops: tuple[Array, ...]
    box: Box
    edges: int


@dataclass(frozen=True, slots=True)
class PartFace:
    """One face of a part.

    Attributes
    ----------
    number: counts from 0 in the order of TopExp_Explorer(shape, TopAbs_FACE).
    name: the face's own name in the file, or "".
    colour: "#rrggbb" of the face or of its body, or "".
    kind: "plane", "cylinder", "cone", "sphere", "torus", "revolution", "extrusion", "offset", "bezier" or "bspline".
    outside_known: whether the face belongs to a solid, so that its oriented normal points out of the metal.
    orientation: +1 where the oriented normal is along S_u x S_v, -1 where it is against it.
    load: the geometry, converted when first asked for. Raises InputError for a face without sound geometry.
    """

    number: int
    name: str
    colour: str
    kind: str
    outside_known: bool
    orientation: int
    load: Callable[[], FaceGeometry]


@dataclass(frozen=True, slots=True)
class Part:
    """A CAD file.

    Attributes
    ----------
    name: the file's stem.
    file: the file's name, for messages and as the key of its hash.
    faces: all faces in the order of their numbers.
    sha256: of the file, hexadecimal.
    scale: factor on top of the file's own unit; it is in every face's geometry.
    triangulate: (numbers of faces, deflection in mm) -> the triangles of each of them, counter-clockwise about its
        oriented normal, made by the CAD kernel; None for a file that has no use for it. Raises InputError for a face
        that cannot be triangulated.
    """

    name: str
    file: str
    faces: tuple[PartFace, ...]
    sha256: str
    scale: float
    triangulate: Callable[[Sequence[int], float], list[Piece]] | None = None

    def face(self, wanted: int | str, place: str) -> PartFace:
        """The face of this number, name or colour.

        Raises
        ------
        InputError: no such face, or more than one; `place` says who asked.
        """
        if isinstance(wanted, int):
            if 0 <= wanted < len(self.faces):
                return self.faces[wanted]
            raise InputError(
                f"{self.file}: {place}",
                f"face number {wanted}",
                f"a number from 0 to {len(self.faces) - 1}",
                f"List the faces with `conflank inspect {self.file}`.",
            )
        for attribute in ("name", "colour"):
            found = [face for face in self.faces if getattr(face, attribute) == wanted]
            if len(found) == 1:
                return found[0]
            if found:
                raise InputError(
                    f"{self.file}: {place}",
                    f"{len(found)} faces called {wanted!r}: {_listing([str(face.number) for face in found])}",
                    "a name that only one face has",
                    "Give the number instead of the name.",
                )
        names = sorted({text for face in self.faces for text in (face.name, face.colour) if text})
        there = f"one of the names {_listing(names)}" if names else "a number, because no face of this file has a name"
        raise InputError(
            f"{self.file}: {place}",
            f"face name {wanted!r}, which no face has",
            f"{there}, or a number from 0 to {len(self.faces) - 1}",
            f"List the faces with `conflank inspect {self.file}`.",
        )

    def to_check(self, design: Sequence[int | str], check: str | Sequence[int | str]) -> list[PartFace]:
        """The faces that nothing may touch.

        Parameters
        ----------
        design: number, name or colour of each design face.
        check: "rest" for all faces but those, "none", or their own numbers, names or colours.

        Raises
        ------
        InputError: as `face`.
        """
        if isinstance(check, str):
            if check == "none":
                return []
            machined = {self.face(word, f"[[part.design]] {k} face").number for k, word in enumerate(design)}
            return [face for face in self.faces if face.number not in machined]
        chosen = [self.face(word, "[part] check_faces") for word in check]
        return list({face.number: face for face in chosen}.values())


def turned(triangles: Triangles, orientation: int) -> Triangles:
    """Triangles of a face that are counter-clockwise about S_u x S_v, made so about its oriented normal."""
    return triangles if orientation > 0 else np.ascontiguousarray(triangles[:, ::-1])


def _listing(words: list[str]) -> str:
    """A list for a message, cut short where it gets long."""
    return ", ".join(words) if len(words) <= 20 else ", ".join(words[:20]) + f" and {len(words) - 20} more"
