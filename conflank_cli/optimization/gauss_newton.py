"""Gauss-Newton on the paper's functional F_motion (Calleja et al. 2018, Eq. 8-13)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.interpolate import BSpline
from scipy.linalg import LinAlgError, solveh_banded

from conflank_cli.geometry.kernels.motion_error import add_rows, motion_errors
from conflank_cli.geometry.workface import WorkFace
from conflank_cli.limits import Limits
from conflank_cli.motion import DEGREE, Motion
from conflank_cli.tool import Tool

Array = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Weights:
    """Weights, by default the paper's: mu1 distance, mu2 fairness, mu3 proximity, mu4 rigidity, mu5 orthogonality."""

    mu1: float = 1.0
    mu2: float = 0.1
    mu3: float = 0.001
    mu4: float = 0.1
    mu5: float = 0.1


@dataclass(frozen=True, slots=True)
class AxisErrorField:
    """Axis error on a grid (m, n): error in mm; on: 1 on the face, 0 off it, -1 without a footpoint; feet u, v."""

    error: Array
    on: Array
    u: Array
    v: Array


@dataclass(frozen=True, slots=True)
class Solution:
    """Result of the optimisation: the motion, its axis error field, iterations used, and the result code."""

    motion: Motion
    field: AxisErrorField
    iterations: int
    status: str

    @property
    def failed(self) -> bool:
        """Whether the motion is of no use."""
        return self.status in ("lost", "singular")


STATUS = {
    "converged": "the control points moved less than the tolerance",
    "iterations": "still moving at the last iteration; more control points or a nearer start would help",
    "lost": "the motion has left the face; start from a sequence that touches it",
    "singular": "the normal equations are not positive definite; raise mu3 or use fewer control points",
}

# Of the weight of a sample on the face: what a sample off it keeps, to hold the motion steady there.
OFF_FACE = 0.01
# Overcut is weighed up from this share of the tolerance on, so that the optimum stays inside it.
BARRIER_FROM, BARRIER_GAIN = 0.5, 40.0


class Step(NamedTuple):
    """One Gauss-Newton step: factors on mu2 and mu5 (fade) and mu4 (stiff), scale of stock left in mm, barrier."""

    fade: float
    stiff: float
    scale: float
    barrier: bool


class _Basis(NamedTuple):
    first: IntArray
    value: Array
    slope: Array
    bend: Array


@lru_cache(maxsize=64)
def _basis(count: int, samples: int) -> _Basis:
    """Nonzero cubic basis functions, first and second derivatives at `samples` equal times: (m,), (m, 4) each."""
    knots = np.concatenate([np.zeros(DEGREE), np.linspace(0.0, 1.0, count - DEGREE + 1), np.ones(DEGREE)])
    t = np.linspace(0.0, 1.0, samples)
    first = np.clip(np.searchsorted(knots, t, side="right") - 1, DEGREE, count - 1) - DEGREE
    spline = BSpline(knots, np.eye(count), DEGREE)
    pick = first[:, None] + np.arange(4)
    rows = [np.take_along_axis(spline(t, nu=order), pick, axis=1) for order in range(3)]
    return _Basis(first.astype(np.int64), *(np.ascontiguousarray(row) for row in rows))


def error_field(
    face: WorkFace,
    tool: Tool,
    motion: Motion,
    allowance: float,
    samples: tuple[int, int],
    start: AxisErrorField | None = None,
) -> tuple[AxisErrorField, Array, Array]:
    """Axis error of a motion on an m x n grid; also the normals (m, n, 3) and the sphere fractions s (n,)."""
    m, n = samples
    p, q = motion.ends(np.linspace(0.0, 1.0, m))
    low, high = tool.centre_range
    heights = np.linspace(low, high, n)
    fractions = heights / tool.length
    error, on, normal = np.empty((m, n)), np.empty((m, n)), np.empty((m, n, 3))
    if start is None:
        u, v = np.empty((m, n)), np.empty((m, n))
        # The kernel takes the first pose's middle sphere from here, and every other foot from its neighbour's.
        cold = face.projector.project((p + fractions[n // 2] * (q - p))[:1])
        u[0, n // 2], v[0, n // 2] = cold.u[0], cold.v[0]
    else:
        u, v = start.u.copy(), start.v.copy()
    motion_errors(
        *face.projector.spans, face.sense, face.raster, p, q, fractions, tool.sphere_radius(heights) + allowance,
        u, v, error, normal, on, start is not None,
    )  # fmt: skip
    return AxisErrorField(error, on, u, v), normal, fractions


def sample_weights(field: AxisErrorField, limits: Limits, scale: float, barrier: bool) -> Array:
    """Weights of the axis error samples (m, n).

    Stock left beyond `scale` fades (Geman and McClure): there another sweep does the work. Overcut counts in full and,
    with `barrier`, ever more as it nears its tolerance.
    """
    error = field.error
    ratio = np.maximum(error, 0.0) / scale
    weight = 1.0 / (1.0 + ratio * ratio) ** 2
    if barrier:
        excess = np.maximum(-error / limits.over - BARRIER_FROM, 0.0)
        weight = weight * (1.0 + BARRIER_GAIN * excess * excess)
    return np.where(field.on > 0.5, weight, np.where(field.on > -0.5, OFF_FACE * weight, 0.0))


def minimise(
    face: WorkFace, tool: Tool, motion: Motion, limits: Limits, weights: Weights, samples: tuple[int, int],
    schedule: tuple[Step, ...],
) -> Solution:  # fmt: skip
    """Gauss-Newton over a schedule of steps.

    The residuals are the axis errors (their exact gradient is the surface normal at the footpoint), |pq| - L, the
    second derivatives of p and q by travel, and the cosine between velocity and axis; each term enters as its mean
    square. F_prox is the mean square of the step itself (Levenberg), so it slows the soft modes without shifting the
    optimum.
    """
    count = len(motion.p)
    m, _ = samples
    basis = _basis(count, m)
    unit = np.broadcast_to(np.eye(6), (m, 6, 6))
    field: AxisErrorField | None = None
    status = "iterations"
    used = 0
    for fade, stiff, scale, barrier in schedule:
        used += 1
        field, normal, fractions = error_field(face, tool, motion, limits.allowance, samples, field)
        w = sample_weights(field, limits, scale, barrier)
        there = float(np.sum(field.on > 0.5))
        if there < 4:
            return Solution(motion, field, used, "lost")
        band, right = np.zeros((24, 6 * count)), np.zeros(6 * count)
        rows = np.concatenate([(1.0 - fractions)[None, :, None] * normal, fractions[None, :, None] * normal], axis=2)
        add_rows(band, right, basis.first, basis.value, rows, field.error, weights.mu1 / there * w)

        control = np.hstack([motion.p, motion.q])
        pick = basis.first[:, None] + np.arange(4)
        ends = np.einsum("mk,mkc->mc", basis.value, control[pick])
        slope = np.einsum("mk,mkc->mc", basis.slope, control[pick])
        bend = np.einsum("mk,mkc->mc", basis.bend, control[pick])
        axis = ends[:, 3:] - ends[:, :3]
        span = np.linalg.norm(axis, axis=1)
        d = axis / span[:, None]
        velocity = 0.5 * (slope[:, :3] + slope[:, 3:])
        speed = np.linalg.norm(velocity, axis=1)
        travel = float(speed.mean())

        rigid = np.concatenate([-d, d], axis=1)[:, None, :]
        add_rows(
            band, right, basis.first, basis.value, rigid, (span - tool.length)[:, None],
            np.full((m, 1), stiff * weights.mu4 / m),
        )  # fmt: skip
        add_rows(
            band, right, basis.first, basis.bend, unit, bend,
            np.full((m, 6), fade * weights.mu2 / (2 * m * travel**4)),
        )  # fmt: skip
        across = np.concatenate([d, d], axis=1)[:, None, :] * (0.5 / speed)[:, None, None]
        add_rows(
            band, right, basis.first, basis.slope, across, (np.einsum("mk,mk->m", velocity, d) / speed)[:, None],
            np.full((m, 1), fade * weights.mu5 / m),
        )  # fmt: skip
        add_rows(band, right, basis.first, basis.value, unit, np.zeros((m, 6)), np.full((m, 6), weights.mu3 / (2 * m)))
        try:
            step = solveh_banded(band, right, lower=True).reshape(count, 6)
        except LinAlgError:
            return Solution(motion, field, used, "singular")
        longest = float(np.abs(step).max())
        if longest > 1.0:
            step *= 1.0 / longest
        motion = Motion(motion.knots, motion.p + step[:, :3], motion.q + step[:, 3:])
        if longest < 1e-6 and used == len(schedule):
            status = "converged"
    field, _, _ = error_field(face, tool, motion, limits.allowance, samples, field)
    return Solution(motion, field, used, status)
