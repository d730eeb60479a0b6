"""Gauss-Newton on the paper's functional F_motion (Calleja et al. 2018, Eq. 8-13)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.linalg import LinAlgError

from conflank_cli.geometry.kernels.banded import add_errors
from conflank_cli.geometry.kernels.motion_error import motion_errors
from conflank_cli.geometry.normal_equations import NormalEquations, basis_at, moved
from conflank_cli.geometry.workface import WorkFace
from conflank_cli.limits import Limits
from conflank_cli.motion import Motion
from conflank_cli.optimization.terms import AxisPath, Terms, Weights, way
from conflank_cli.tool import Tool

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class AxisErrorField:
    """Axis error on a grid (m, n): error in mm; on: 1 on the face, 0 off it, -1 without a footpoint; feet u, v."""

    error: Array
    on: Array
    u: Array
    v: Array


@dataclass(frozen=True, slots=True)
class Solution:
    """Result of the optimisation.

    Attributes
    ----------
    motion: the motion; field: its axis error.
    iterations: Gauss-Newton steps; status: a key of STATUS.
    start, end: the terms of the functional, before the first step and after the last.
    """

    motion: Motion
    field: AxisErrorField
    iterations: int
    status: str
    start: Terms
    end: Terms

    @property
    def failed(self) -> bool:
        """Whether the motion is of no use."""
        return self.status in ("lost", "singular")


STATUS = {
    "converged": "the last step changed the functional by less than the square of 0.01 µm",
    "iterations": "the last step still changed the functional; a nearer start or more control points would help",
    "lost": "the motion has left the face; start from a sequence that touches it",
    "singular": "the normal equations are not positive definite; raise mu3 or use fewer control points",
}

# A step that moves a control point by more is shortened to it, mm. One that promises less than STILL² from the
# functional, a mean square, is a standstill, mm: the soft modes may go on moving for ever.
LONGEST_STEP, STILL = 1.0, 1e-5
# With fewer samples on the face than this a motion has left it.
LEAST_SAMPLES = 4
# Of poses and heights one in so many will do while steps are to come, heights no fewer than the second figure: what is
# made small there is smooth. Poses stay three to a control point.
SPARSE, LEAST_HEIGHTS = 3, 8
# Of the weight of a sample on the face: what a sample off it keeps, to hold the motion steady there.
OFF_FACE = 0.01
# Overcut is weighed up from this share of the tolerance on, so that the optimum stays inside it.
BARRIER_FROM, BARRIER_GAIN = 0.5, 40.0


class Step(NamedTuple):
    """One Gauss-Newton step: factors on mu2 and mu5 (fade) and mu4 (stiff), scale of stock left in mm, barrier.

    sparse: whether part of the samples will do, since more steps are to come.
    """

    fade: float
    stiff: float
    scale: float
    barrier: bool
    sparse: bool = False


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
    """Weights of the axis error samples (m, n): those of `robust_weights`, next to nothing off the face."""
    weight = robust_weights(field.error, limits, scale, barrier)
    return np.where(field.on > 0.5, weight, np.where(field.on > -0.5, OFF_FACE * weight, 0.0))


def robust_weights(error: Array, limits: Limits, scale: float, barrier: bool) -> Array:
    """Weights of axis errors or swept gaps, mm.

    Stock left beyond `scale` fades (Geman and McClure): there another sweep does the work. Overcut counts in full and,
    with `barrier`, ever more as it nears its tolerance.
    """
    ratio = np.maximum(error, 0.0) / scale
    weight = 1.0 / (1.0 + ratio * ratio) ** 2
    if barrier:
        excess = np.maximum(-error / limits.over - BARRIER_FROM, 0.0)
        weight = weight * (1.0 + BARRIER_GAIN * excess * excess)
    return np.asarray(weight)


def minimise(
    face: WorkFace, tool: Tool, motion: Motion, limits: Limits, weights: Weights, samples: tuple[int, int],
    schedule: tuple[Step, ...],
) -> Solution:  # fmt: skip
    """Gauss-Newton over a schedule of steps.

    The residuals are the axis errors (their exact gradient is the surface normal at the footpoint), |pq| - L, the
    second derivatives of p and q by travel, and the cosine between velocity and axis; each term enters as its mean
    square (`terms`).
    """
    begin = motion
    field: AxisErrorField | None = None
    start: Terms | None = None
    t = np.linspace(0.0, 1.0, samples[0])
    every = basis_at(motion.knots, t)
    few = max(samples[0] // SPARSE, 3 * len(motion.p)), max(samples[1] // SPARSE, LEAST_HEIGHTS)
    grid, basis = samples, every
    status = "iterations"
    used = 0
    for fade, stiff, scale, barrier, sparse in schedule:
        used += 1
        if (few if sparse else samples) != grid:
            grid, field = (few, None) if sparse else (samples, None)
            basis = basis_at(motion.knots, np.linspace(0.0, 1.0, few[0])) if sparse else every
        path = AxisPath.of(motion, tool, basis)
        field, normal, fractions = error_field(face, tool, motion, limits.allowance, grid, field)
        there = field.on > 0.5
        if start is None:
            start = path.terms(_mean_square(field), 0.0)
        if there.sum() < LEAST_SAMPLES:
            status = "lost"
            break
        w = sample_weights(field, limits, scale, barrier) * (weights.mu1 / there.sum())
        equations = NormalEquations.of(len(motion.p))
        add_errors(
            equations.band, equations.right, basis.first, basis.value, fractions, normal, field.error, w
        )  # fmt: skip
        path.add(equations, weights, fade, stiff)
        try:
            step = equations.step()
        except LinAlgError:
            status = "singular"
            break
        motion = moved(motion, step, LONGEST_STEP)
        if float(step.ravel() @ equations.right) < STILL * STILL and used == len(schedule):
            status = "converged"
    field, _, _ = error_field(face, tool, motion, limits.allowance, samples, field if grid == samples else None)
    if np.sum(field.on > 0.5) < LEAST_SAMPLES:
        status = "lost"
    end = AxisPath.of(motion, tool, every).terms(_mean_square(field), way(motion, begin, t))
    return Solution(motion, field, used, status, start or end, end)


def with_motion(
    solution: Solution, face: WorkFace, tool: Tool, motion: Motion, allowance: float, samples: tuple[int, int]
) -> Solution:
    """The solution with its motion moved on by other means: axis error and terms are its own, but for proximity."""
    field, _, _ = error_field(face, tool, motion, allowance, samples)
    path = AxisPath.of(motion, tool, basis_at(motion.knots, np.linspace(0.0, 1.0, samples[0])))
    end = path.terms(_mean_square(field), solution.end.proximity)
    return replace(solution, motion=motion, field=field, end=end)


def _mean_square(field: AxisErrorField) -> float:
    on_face = field.error[field.on > 0.5]
    return float(np.mean(on_face**2)) if on_face.size else 0.0
