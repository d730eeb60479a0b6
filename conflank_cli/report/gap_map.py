"""The swept gap of a posted program, point by point on a parameter grid: what pictures and reports show.

Only the program's text and the trimmed faces go in; reading, kinematics and the search for the least distance are those
of the verification.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from conflank_cli.geometry.face import DesignFace
from conflank_cli.verification.evaluation import evaluate_grid, inside_rows
from conflank_cli.verification.posed import PosedProgram
from conflank_cli.verification.swept import gaps_of

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

SPACING = 0.15
"""mm between the values of the gap on a face: finer than a screen shows of a whole blade."""

LEAST, MOST = 24, 320
"""Values of the gap along either direction of a face."""


@dataclass(frozen=True, slots=True)
class FaceGrid:
    """A grid over the box of a face's trim loops.

    Attributes
    ----------
    face: the face.
    u, v: parameters of the grid, (U,), (V,).
    points, normals: (U, V, 3) mm and unit, normals towards the cutter.
    inside: (U, V), whether a grid point is on the trimmed face.
    """

    face: DesignFace
    u: Array
    v: Array
    points: Array
    normals: Array
    inside: Flags

    @property
    def about(self) -> Flags:
        """The points that tell where the face is: those inside, or all if it is too narrow for any to be."""
        return self.inside if self.inside.any() else np.ones_like(self.inside)


@dataclass(frozen=True, slots=True)
class GapMap(FaceGrid):
    """The swept gap on one face.

    Attributes
    ----------
    gap: (U, V) mm; the worse of both ways in which the axis may go between two blocks.
    by_cut: (cuts, U, V), the same for each cut of the program alone; inf where it does not come near.
    """

    gap: Array
    by_cut: Array

    def covered(self, over: float, under: float) -> Flags:
        """Where the gap is within tolerance (mm), on the trimmed face."""
        return np.asarray(self.inside & (self.gap >= -over) & (self.gap <= under))


def face_grid(face: DesignFace, shape: tuple[int, int]) -> FaceGrid:
    """A grid of `shape` over a face."""
    corners = np.concatenate(face.loops)
    u, v = (np.linspace(corners[:, k].min(), corners[:, k].max(), shape[k]) for k in (0, 1))
    points, by_u, by_v = evaluate_grid(face.surface, u, v)
    normals = face.sense * np.cross(by_u, by_v)
    # At a pole of the surface the derivatives give no normal; there is nothing to see there either.
    normals /= np.maximum(np.linalg.norm(normals, axis=2, keepdims=True), 1e-300)
    # Grid points on the border belong to the face: the rule decides for points just inside of them.
    middle_u, middle_v = 0.5 * (u[0] + u[-1]), 0.5 * (v[0] + v[-1])
    inside = inside_rows(face.loops, middle_u + (u - middle_u) * (1.0 - 1e-6), middle_v + (v - middle_v) * (1.0 - 1e-6))
    return FaceGrid(face, u, v, points, normals, inside)


def gap_map(posed: PosedProgram, face: DesignFace, shape: tuple[int, int], allowance: float = 0.0) -> GapMap:
    """Swept gap of a program on a grid of `shape` over a face; `allowance` mm are to stay."""
    grid = face_grid(face, shape)
    gap, by_cut = gaps_of(posed, (grid.points + allowance * grid.normals).reshape(-1, 3))
    return GapMap(
        face, grid.u, grid.v, grid.points, grid.normals, grid.inside, gap.reshape(shape), by_cut.reshape(-1, *shape)
    )


def grid_shape(face: DesignFace, spacing: float = SPACING, least: int = LEAST, most: int = MOST) -> tuple[int, int]:
    """Grid over the box of a face's trim whose points are about `spacing` mm apart."""
    points = face_grid(face, (least, least)).points
    lengths = (np.linalg.norm(np.diff(points, axis=k), axis=2).sum(axis=k).mean() for k in (0, 1))
    along, across = (int(np.clip(np.ceil(length / spacing), least, most)) for length in lengths)
    return along, across
