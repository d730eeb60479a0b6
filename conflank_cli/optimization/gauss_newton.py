"""Gauss-Newton on the paper's functional F_motion (Calleja et al. 2018, Eq. 8-13)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from conflank_cli.geometry.kernels.gauss_newton import LEAST_SAMPLES, LOST, TAKEN, gauss_newton_step
from conflank_cli.geometry.kernels.motion_error import motion_errors
from conflank_cli.geometry.normal_equations import basis_at
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

    def copy(self) -> AxisErrorField:
        """The same, to be filled for another motion."""
        return AxisErrorField(self.error.copy(), self.on.copy(), self.u.copy(), self.v.copy())


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

# A step that promises less than STILL² from the functional, a mean square, is a standstill, mm: the soft modes may go
# on moving for ever.
STILL = 1e-5
# Of poses and heights one in so many will do while steps are to come, heights no fewer than the second figure: what is
# made small there is smooth. Poses stay three to a control point.
SPARSE, LEAST_HEIGHTS = 3, 8


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
    fractions, radii = _spheres(tool, n, allowance)
    field = _seeded(face, motion, m, fractions) if start is None else start.copy()
    normal = np.empty((m, n, 3))
    motion_errors(
        *face.projector.spans, face.sense, face.raster, p, q, fractions, radii,
        field.u, field.v, field.error, normal, field.on, start is not None,
    )  # fmt: skip
    return field, normal, fractions


def _spheres(tool: Tool, count: int, allowance: float) -> tuple[Array, Array]:
    """Fractions of pq and radii, allowance added, of spheres (n,) along the flute."""
    heights = np.linspace(*tool.centre_range, count)
    return heights / tool.length, tool.sphere_radius(heights) + allowance


def _seeded(face: WorkFace, motion: Motion, count: int, fractions: Array) -> AxisErrorField:
    """A field yet to be filled, at `count` times, with the foot that the kernel begins at.

    That of the first pose's middle sphere; it takes every other foot from its neighbour's.
    """
    shape = count, len(fractions)
    u, v = np.empty(shape), np.empty(shape)
    middle = len(fractions) // 2
    p, q = motion.ends([0.0])
    foot = face.projector.project(p + fractions[middle] * (q - p))
    u[0, middle], v[0, middle] = foot.u[0], foot.v[0]
    return AxisErrorField(np.empty(shape), np.empty(shape), u, v)


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
    control = np.hstack([motion.p, motion.q])
    mu = np.array([weights.mu1, weights.mu2, weights.mu3, weights.mu4, weights.mu5])
    status = "iterations"
    used = 0
    for fade, stiff, scale, barrier, sparse in schedule:
        used += 1
        if (few if sparse else samples) != grid:
            grid, field = (few, None) if sparse else (samples, None)
            basis = basis_at(motion.knots, np.linspace(0.0, 1.0, few[0])) if sparse else every
        warm = field is not None
        if field is None:
            fractions, radii = _spheres(tool, grid[1], limits.allowance)
            field = _seeded(face, motion, grid[0], fractions)
        outcome, promised = gauss_newton_step(
            *face.projector.spans, face.sense, face.raster, *basis, control, tool.length, fractions, radii,
            field.u, field.v, warm, field.error, field.on, mu, fade, stiff, limits.over, scale, barrier,
        )  # fmt: skip
        if start is None:
            start = AxisPath.of(begin, tool, basis).terms(_mean_square(field), 0.0)
        if outcome != TAKEN:
            status = "lost" if outcome == LOST else "singular"
            break
        motion = Motion(motion.knots, control[:, :3].copy(), control[:, 3:].copy())
        if promised < STILL * STILL and used == len(schedule):
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
