"""Faces: a surface, the part of it that is the face, and the side the cutter works on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from conflank_cli.geometry.surface import BSplineSurface

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class DesignFace:
    """A trimmed NURBS face to be machined, resolved against the job (region cut out, seam unwrapped, side chosen).

    Attributes
    ----------
    number: face number as `conflank inspect` prints it.
    name: name or colour in the file, or "".
    surface: the surface, at least as large as the face; in the frame and units (mm) of the CAD file.
    loops: closed polylines in (u, v), each (N, 2) without repeating the first point; a point is on the face where the
        even-odd rule says so.
    sense: +1 where S_u x S_v points out of the metal towards the cutter, -1 where it points into it.
    """

    number: int
    name: str
    surface: BSplineSurface
    loops: tuple[Array, ...]
    sense: int


@dataclass(frozen=True, slots=True)
class CheckMesh:
    """Triangulated faces that nothing may touch.

    Attributes
    ----------
    vertices: (N, 3) mm, CAD frame.
    triangles: (M, 3) int32, counter-clockwise seen from outside where the file knows outside.
    face: (M,) int32, the CAD face each triangle belongs to; obstacles, meshes from elsewhere, count down from -1.
    """

    vertices: Array
    triangles: npt.NDArray[np.int32]
    face: npt.NDArray[np.int32]

    @classmethod
    def joined(cls, meshes: Sequence[CheckMesh]) -> CheckMesh:
        """One mesh of several."""
        offsets = np.cumsum([0] + [len(mesh.vertices) for mesh in meshes[:-1]])
        return cls(
            np.concatenate([mesh.vertices for mesh in meshes]),
            np.concatenate([mesh.triangles + np.int32(k) for mesh, k in zip(meshes, offsets, strict=True)]),
            np.concatenate([mesh.face for mesh in meshes]),
        )

    def only(self, chosen: npt.NDArray[np.bool_]) -> CheckMesh:
        """The chosen triangles (M,), and the vertices they use."""
        used, triangles = np.unique(self.triangles[chosen], return_inverse=True)
        return CheckMesh(self.vertices[used], triangles.reshape(-1, 3).astype(np.int32), self.face[chosen])
