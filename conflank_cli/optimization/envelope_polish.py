"""Polishing a motion on the swept gap itself, at points of the face.

The axis error is a proxy: it has no footpoint beyond the face, does not know the ball, and weighs the flute evenly
rather than the area. The swept gap g(x) = min over t of the distance from x to the cutter at t is what is counted. Its
gradient by the motion is that of the pose that gives the minimum (Danskin 1967), so Gauss-Newton on it costs what it
costs on the axis error.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.linalg import LinAlgError

from conflank_cli.geometry.gap import GapField, gap_field, motion_gap
from conflank_cli.geometry.kernels.gauss_newton import robust_weights
from conflank_cli.geometry.normal_equations import NormalEquations, basis_at, moved
from conflank_cli.geometry.workface import WorkFace
from conflank_cli.limits import Limits
from conflank_cli.motion import Motion
from conflank_cli.optimization.terms import AxisPath, Weights
from conflank_cli.tool import Tool

Array = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]

# Rigidity counts so much more than in the paper's functional: nothing else holds |pq| = L to well below a micrometre.
STIFF = 1.0e4
# Of the paper's weights of fairness and orthogonality: so much is kept that control points that no point of the face
# holds stay quiet.
FAIR = 1.0e-4
# Poses at which rigidity is asked for, for every control point.
POSES = 6
# The control points move by no more than this in one step, mm: beyond it the poses that count are others.
LONGEST_STEP = 0.3
# Points whose gap is beyond this many scales have no say, and are not looked at again.
FAR = 4.0
# Of the area of a point inside, what a point on the border stands for.
BORDER = 0.5
# A Levenberg term that is too weak is raised by the one factor, one that is strong enough lowered by the other; so
# often it is raised for one step, and never lowered below the last.
STIFFER, LOOSER, TRIALS, LEAST_DAMPING = 8.0, 4.0, 8, 1e-8


@dataclass(frozen=True, slots=True)
class Points:
    """Points of a face that a motion is polished on: x (N, 3), mm, and the area each stands for (N,), mm2."""

    x: Array
    areas: Array

    @classmethod
    def of(cls, face: WorkFace, spacing: float) -> Points:
        """Points all over a trimmed face and along its border, where a motion ends and nothing else would hold it."""
        samples, border = face.samples(spacing), face.border(spacing)
        along = np.full(len(border), BORDER * float(samples.areas.mean()))
        return cls(np.concatenate([samples.points, border]), np.concatenate([samples.areas, along]))

    def thinned(self, share: int) -> Points:
        """One in `share` of them, evenly spread, for all."""
        return Points(self.x[::share], self.areas[::share] * share)

    def near(self, motion: Motion, tool: Tool, limits: Limits, scale: float) -> Points:
        """Those that a motion comes near, for a polish whose first scale is `scale`."""
        reach = FAR * scale * max(limits.under, limits.over)
        near = motion_gap(motion, tool, self.x, limits.allowance, reach)[0] < reach
        return Points(self.x[near], self.areas[near])


def for_area(
    tool: Tool, motion: Motion, points: Points, limits: Limits, weights: Weights, scales: tuple[float, ...]
) -> Motion | None:
    """Serve as much area as the tolerance allows: one Gauss-Newton step for each of `scales`, in stock tolerances.

    Stock left beyond the scale fades, overcut meets a barrier, as in the optimisation of the axis error. None where the
    normal equations cannot be solved or nothing is near.
    """
    field: GapField | None = None
    for scale in scales:
        start = None if field is None else field.time
        field = gap_field(motion, tool, points.x, limits.allowance, start, np.inf)
        say = np.empty(len(points.x))
        robust_weights(field.gap, limits.over, scale * limits.under, True, say)
        say *= points.areas
        step = _step(tool, motion, field, field.gap, say, weights)
        if step is None:
            return None
        motion = moved(motion, step, LONGEST_STEP)
    return motion


def _step(tool: Tool, motion: Motion, field: GapField, residuals: Array, say: Array, weights: Weights) -> Array | None:
    """The Gauss-Newton step (n, 6) of residuals (N,) with weights `say`; None where there is none."""
    total = say.sum()
    if total <= 0.0:
        return None
    keep = say > 1e-9 * say.max()
    own = basis_at(motion.knots, field.time[keep])
    equations = NormalEquations.of(len(motion.p))
    equations.add(own.first, own.value, field.rows[keep, None, :], residuals[keep, None], (say[keep] / total)[:, None])
    even = basis_at(motion.knots, np.linspace(0.0, 1.0, POSES * len(motion.p)))
    AxisPath.of(motion, tool, even).add(equations, weights, FAIR, STIFF)
    try:
        return equations.step()
    except LinAlgError:
        return None


def for_norm(
    tool: Tool, motion: Motion, points: Points, limits: Limits, weights: Weights, norms: tuple[int, ...]
) -> Motion:
    """Make the worst of what is covered better: Newton steps on the p-norm of the gap, one for each of `norms`.

    What counts is every point within tolerance at the start, and overcut anywhere. The gap is measured from the middle
    of the tolerance, as a share of it. The Hessian of the p-norm is that of the squares with weights
    (p - 1) |g|^(p - 2) (the gap's own curvature left out). Far from the optimum that step is short by up to p - 1, so
    it is stretched while that helps; one that does not lessen the norm is shortened by a Levenberg term, and where that
    is of no use the norm is as small as it gets.
    """
    if not len(points.x):
        return motion
    middle, half = limits.middle, 0.5 * (limits.under + limits.over)
    field = gap_field(motion, tool, points.x, limits.allowance)
    served = within(field.gap, limits)
    damping, stretch, settled = weights.mu3, 1.0, 0
    for p in norms:
        if p == settled:
            continue
        share = _shares(field.gap, served, middle, half)
        worst = max(float(np.abs(share).max()), 1e-9)
        height = np.abs(share) / worst
        before = float(points.areas @ height**p)
        say = points.areas * height ** (p - 2)
        for _ in range(TRIALS):
            step = _step(tool, motion, field, share * half / (p - 1), say, replace(weights, mu3=damping))
            if step is None:
                return motion
            longest = float(np.abs(step).max())
            if longest > LONGEST_STEP:
                # Control points that next to nothing holds are on their way out, and would shorten the step of all.
                damping *= STIFFER
                continue
            trial = moved(motion, stretch * step, LONGEST_STEP)
            after = gap_field(trial, tool, points.x, limits.allowance, field.time)
            if points.areas @ (np.abs(_shares(after.gap, served, middle, half)) / worst) ** p < before:
                motion, field = trial, after
                damping, stretch = max(damping / LOOSER, LEAST_DAMPING), min(2.0 * stretch, p - 1.0)
                break
            damping, stretch = (damping * STIFFER, 1.0) if stretch == 1.0 else (damping, max(0.25 * stretch, 1.0))
        else:
            settled, damping, stretch = p, weights.mu3, 1.0
    return motion


def within(gap: Array, limits: Limits) -> BoolArray:
    """Which gaps are within tolerance."""
    return np.asarray((gap >= -limits.over) & (gap <= limits.under))


def _shares(gap: Array, served: BoolArray, middle: float, half: float) -> Array:
    """Gaps as shares of half the tolerance from its middle; of what is not served, overcut only."""
    share = (gap - middle) / half
    return np.where(served, share, np.minimum(share, 0.0))
