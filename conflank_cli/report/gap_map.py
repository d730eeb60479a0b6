"""The swept gap of a posted program, point by point on a parameter grid: what pictures and reports show.

Only the program's text and the trimmed faces go in; reading, kinematics and the search for the least distance are those
of the verification.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from conflank_cli.geometry.face import DesignFace
from conflank_cli.verification.sampling import evaluate_grid, inside_rows
from conflank_cli.verification.verify import PosedProgram, gaps_of

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class GapMap:
    """The swept gap on one face.

    Attributes
    ----------
    face: the face.
    u, v: parameters of the grid, (U,), (V,).
    points, normals: (U, V, 3) mm and unit, normals towards the cutter.
    inside: (U, V), whether a grid point is on the trimmed face.
    gap: (U, V) mm; the worse of both ways in which the axis may go between two blocks.
    by_cut: (cuts, U, V), the same for each cut of the program alone; inf where it does not come near.
    """

    face: DesignFace
    u: Array
    v: Array
    points: Array
    normals: Array
    inside: Flags
    gap: Array
    by_cut: Array

    def covered(self, over: float, under: float) -> Flags:
        """Where the gap is within tolerance (mm), on the trimmed face."""
        return np.asarray(self.inside & (self.gap >= -over) & (self.gap <= under))


def gap_map(posed: PosedProgram, face: DesignFace, shape: tuple[int, int], allowance: float = 0.0) -> GapMap:
    """Swept gap of a program on a grid of `shape` over the box of the face's trim loops; `allowance` mm are to stay."""
    corners = np.concatenate(face.loops)
    u, v = (np.linspace(corners[:, k].min(), corners[:, k].max(), shape[k]) for k in (0, 1))
    points, by_u, by_v = evaluate_grid(face.surface, u, v)
    normals = face.sense * np.cross(by_u, by_v)
    # At a pole of the surface the derivatives give no normal; there is nothing to see there either.
    normals /= np.maximum(np.linalg.norm(normals, axis=2, keepdims=True), 1e-300)
    # Grid points on the border belong to the face: the rule decides for points just inside of them.
    middle_u, middle_v = 0.5 * (u[0] + u[-1]), 0.5 * (v[0] + v[-1])
    inside = inside_rows(face.loops, middle_u + (u - middle_u) * (1.0 - 1e-6), middle_v + (v - middle_v) * (1.0 - 1e-6))
    gap, by_cut = gaps_of(posed, (points + allowance * normals).reshape(-1, 3))
    return GapMap(face, u, v, points, normals, inside, gap.reshape(shape), by_cut.reshape(-1, *shape))
