"""The normal equations of a motion: banded, for a cubic control point shares its spans with three neighbours only."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.linalg import solveh_banded

from conflank_cli.geometry.kernels.banded import add_rows
from conflank_cli.geometry.kernels.cubic import basis_rows
from conflank_cli.motion import DEGREE, Motion

Array = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]


class Basis(NamedTuple):
    """The four cubic basis functions that are not zero at m times.

    first (m,): index of the first of them. value, slope, bend (m, 4): values, first and second derivatives.
    """

    first: IntArray
    value: Array
    slope: Array
    bend: Array


def basis_at(knots: Array, t: Array) -> Basis:
    """The basis of clamped cubic knots (n + 4,) at times t (m,)."""
    basis = Basis(np.empty(len(t), dtype=np.int64), *(np.empty((len(t), DEGREE + 1)) for _ in range(3)))
    basis_rows(knots, t, *basis)
    return basis


@dataclass(frozen=True, slots=True)
class NormalEquations:
    """Sum of w rowᵀ row and -w rowᵀ residual over the rows added so far.

    Attributes
    ----------
    band: lower band of the matrix, shape (24, 6 n), band[r, c] = M[c + r, c].
    right: minus the gradient, shape (6 n,).
    """

    band: Array
    right: Array

    @classmethod
    def of(cls, count: int) -> NormalEquations:
        """No rows yet, for the control points of a motion (p then q of each)."""
        size = 6 * count
        return cls(np.zeros((6 * (DEGREE + 1), size)), np.zeros(size))

    def add(self, first: IntArray, basis: Array, rows: Array, residuals: Array, weights: Array) -> None:
        """Add k residuals at each of m times: rows (m, k, 6) by p(t) and q(t) times basis (m, 4), weights (m, k)."""
        add_rows(self.band, self.right, first, basis, np.ascontiguousarray(rows), residuals, weights)

    def copy(self) -> NormalEquations:
        """The same rows, to add others to."""
        return NormalEquations(self.band.copy(), self.right.copy())

    def step(self) -> Array:
        """The control points (n, 6), or their change where rows hold residuals, that solve them.

        Raises
        ------
        LinAlgError: the matrix is not positive definite.
        """
        return np.asarray(solveh_banded(self.band, self.right, lower=True)).reshape(-1, 6)


def moved(motion: Motion, step: Array, most: float) -> Motion:
    """The motion with its control points changed by step (n, 6), shortened so that none moves by more than `most` mm
    along a coordinate."""
    longest = float(np.abs(step).max())
    change = step * min(1.0, most / longest) if longest > 0.0 else step
    return Motion(motion.knots, motion.p + change[:, :3], motion.q + change[:, 3:])
