"""The terms of the paper's functional that keep a motion a motion: fairness, proximity, rigidity, orthogonality."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from conflank_cli.geometry.kernels.banded import add_path, axis_path
from conflank_cli.geometry.normal_equations import Basis, NormalEquations
from conflank_cli.motion import Motion
from conflank_cli.tool import Tool

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Weights:
    """Weights, by default the paper's: mu1 distance, mu2 fairness, mu3 proximity, mu4 rigidity, mu5 orthogonality."""

    mu1: float = 1.0
    mu2: float = 0.1
    mu3: float = 0.001
    mu4: float = 0.1
    mu5: float = 0.1


@dataclass(frozen=True, slots=True)
class Terms:
    """Each term of F_motion as a mean square, without its weight (Calleja et al. 2018, Eq. 8-13).

    Attributes
    ----------
    distance: of the axis error over the samples on the face, mm2.
    fairness: of the second derivatives of p and q by travel, 1/mm2.
    proximity: of the way of the axis ends from where they were at the start at the same time, mm2.
    rigidity: of |pq| - L, mm2.
    orthogonality: of the cosine between the velocity of the axis and the axis.
    """

    distance: float
    fairness: float
    proximity: float
    rigidity: float
    orthogonality: float


def way(motion: Motion, start: Motion, t: Array) -> float:
    """Mean square of the way of the axis ends from `start` to `motion` at times t (m,), mm2."""
    gone = np.hstack(motion.ends(t)) - np.hstack(start.ends(t))
    return 0.5 * float(np.mean(np.sum(gone**2, axis=1)))


@dataclass(frozen=True, slots=True)
class AxisPath:
    """A motion at m times, and what its terms are made of.

    Attributes
    ----------
    basis: the basis at these times.
    bend: second derivatives of p and q by time, (m, 6).
    d: unit axis, (m, 3); excess: |pq| - L, (m,), mm.
    velocity: of the middle of the axis by time, (m, 3), mm; speed: its length, (m,); cosine: between it and the axis.
    """

    basis: Basis
    bend: Array
    d: Array
    excess: Array
    velocity: Array
    speed: Array
    cosine: Array

    @classmethod
    def of(cls, motion: Motion, tool: Tool, basis: Basis) -> AxisPath:
        """Evaluate a motion at the times of a basis."""
        m = len(basis.first)
        path = cls(basis, np.empty((m, 6)), np.empty((m, 3)), np.empty(m), np.empty((m, 3)), np.empty(m), np.empty(m))
        axis_path(
            *basis, np.hstack([motion.p, motion.q]), tool.length,
            path.bend, path.d, path.excess, path.velocity, path.speed, path.cosine,
        )  # fmt: skip
        return path

    @property
    def travel(self) -> float:
        """Way of the middle of the axis, mm."""
        return float(self.speed.mean())

    def terms(self, distance: float, proximity: float) -> Terms:
        """The mean squares of the residuals that `add` adds, with those of distance and proximity from elsewhere."""
        fairness = float(np.mean(self.bend**2)) * 3.0 / self.travel**4
        return Terms(distance, fairness, proximity, float(np.mean(self.excess**2)), float(np.mean(self.cosine**2)))

    def add(self, equations: NormalEquations, weights: Weights, fade: float = 1.0, stiff: float = 1.0) -> None:
        """Add the terms to normal equations; `fade` is a factor on mu2 and mu5, `stiff` one on mu4.

        F_prox is the mean square of the step itself (Levenberg), so it slows the soft modes without shifting the
        optimum.
        """
        m = len(self.speed)
        # The cosine is differentiated by the velocity only: the axis turns little while it is made orthogonal.
        add_path(
            equations.band, equations.right, *self.basis, self.bend, self.d, self.excess, self.speed, self.cosine,
            stiff * weights.mu4 / m, weights.mu3 / (2 * m),
            fade * weights.mu2 / (2 * m * self.travel**4), fade * weights.mu5 / m,
        )  # fmt: skip
