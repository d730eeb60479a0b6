"""The least worst gap: a sequence of linear programs on the swept gap.

The worst gap over many points is not smooth, so near its optimum Gauss-Newton on a norm crawls. The gap of each point
is, and its gradient is known; so each step minimises the worst of the linearised gaps within a box about the present
motion, and the box follows from how well the linear model told the outcome (Madsen 1975).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.optimize import linprog
from scipy.sparse import csr_matrix, hstack, vstack

from conflank_cli.geometry.gap import GapField, gap_field
from conflank_cli.geometry.normal_equations import Basis, basis_at
from conflank_cli.motion import Motion
from conflank_cli.optimization.terms import AxisPath
from conflank_cli.tool import Tool

Array = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]
IntArray = npt.NDArray[np.int64]

# Half the width of the box at first, as a share of the worst gap; it never grows beyond the second figure, mm, and
# below the third nothing moves.
BOX, WIDEST, NARROWEST = 0.5, 0.3, 1e-5
# A linear model that tells this share of what is gained is trusted further, one that tells less than the other not.
GOOD, POOR = 0.7, 0.25
WIDER, NARROWER = 2.0, 0.35
# Gains below this, mm, are not worth another program.
WORTH = 1e-5
# |pq| may differ from L by so much, mm; beyond it costs as much as that share of the worst gap.
RIGID, RIGID_COST = 5e-4, 0.1
# Poses at which rigidity is asked for, for every control point.
POSES = 3
# Of its velocity, the axis keeps this share at least in the direction in which it moved across itself at the start.
STEADY = 0.35
# Points whose gap is this many half widths of the box short of the worst do not become it in one step: an axis end
# moves by no more than sqrt(3) of them, and seldom the worst way.
NEAR = 1.5
# Linear programs at most.
PROGRAMS = 40
# Beyond the hard limit overcut costs so many times what stock costs.
HARD = 10.0
# Distances beyond this are only known roughly, mm: more than any gap that is worth lessening.
REACH = 4.0


@dataclass(frozen=True, slots=True)
class Aim:
    """What is made small, mm.

    Attributes
    ----------
    points: (N, 3) points of the face.
    served: (N,) where stock counts; overcut counts at every point.
    allowance: stock to leave.
    overcut: hard limit of the overcut; None to make the larger of overcut and stock small.
    """

    points: Array
    served: BoolArray
    allowance: float = 0.0
    overcut: float | None = None

    def worst(self, gap: Array) -> float:
        """The figure that is made small, of gaps (N,), mm."""
        stock = float(gap[self.served].max(initial=0.0))
        overcut = float(-gap.min(initial=0.0))
        if self.overcut is None:
            return max(stock, overcut)
        return stock + HARD * max(overcut - self.overcut, 0.0)


def least_worst(motion: Motion, tool: Tool, aim: Aim, programs: int = PROGRAMS) -> tuple[Motion, float]:
    """Move a motion to where the worst gap is least; returns it and that gap (`Aim.worst`), mm.

    Finds the optimum near the start, and never returns what is worse than the start. A motion that is steady stays so:
    its axis goes on the way across itself that it went at the start. `programs`: at most so many linear programs
    (HiGHS).
    """
    even = basis_at(motion.knots, np.linspace(0.0, 1.0, POSES * len(motion.p)))
    across = _across(motion, tool, even)
    field = gap_field(motion, tool, aim.points, aim.allowance, reach=REACH)
    best = aim.worst(field.gap)
    half = min(BOX * best, WIDEST)
    for _ in range(programs):
        step, promised = _program(motion, tool, aim, field, even, across, half)
        if step is None:
            half *= NARROWER
        elif best - promised < WORTH:
            break
        else:
            trial = Motion(motion.knots, motion.p + step[:, :3], motion.q + step[:, 3:])
            after = gap_field(trial, tool, aim.points, aim.allowance, reach=REACH)
            reached = aim.worst(after.gap)
            told = (best - reached) / (best - promised)
            if reached < best:
                motion, field, best = trial, after, reached
            if told > GOOD:
                half = min(half * WIDER, WIDEST)
            elif told < POOR:
                half *= NARROWER
        if half < NARROWEST:
            break
    return motion, best


def _across(motion: Motion, tool: Tool, even: Basis) -> Array:
    """Unit vectors (m, 3) along which the middle of the axis moves across it."""
    path = AxisPath.of(motion, tool, even)
    across = path.velocity - np.einsum("mk,mk->m", path.velocity, path.d)[:, None] * path.d
    return np.asarray(across / np.linalg.norm(across, axis=1)[:, None])


def _program(
    motion: Motion, tool: Tool, aim: Aim, field: GapField, even: Basis, across: Array, half: float
) -> tuple[Array | None, float]:
    """The step (n, 6) within the box that the linear model likes best, and the worst gap it promises; None for none.

    Unknowns: the step, the worst gap, and by how much rigidity is missed (or, with a hard limit, overcut exceeds it).
    """
    gap, rows, time = field.gap, field.rows, field.time
    size = 6 * len(motion.p)
    stock = gap[aim.served].max(initial=0.0)
    overcut = aim.overcut if aim.overcut is not None else max(float(stock), float(-gap.min(initial=0.0)))
    reach = NEAR * half
    above = aim.served & (gap > (stock if aim.overcut is not None else overcut) - reach)
    below = gap < -(overcut - reach)
    up = _spread(*basis_at(motion.knots, time[above])[:2], rows[above], size)
    down = _spread(*basis_at(motion.knots, time[below])[:2], -rows[below], size)
    path = AxisPath.of(motion, tool, even)
    rigid = _spread(even.first, even.value, np.hstack([-path.d, path.d]), size)
    # <v, across> >= STEADY |v| for the velocity v of the middle; where that is not so already it may not get worse.
    excess = np.einsum("mk,mk->m", path.velocity, across) - STEADY * path.speed
    ahead = 0.5 * (across - STEADY * path.velocity / path.speed[:, None])
    steady = _spread(even.first, even.slope, -np.hstack([ahead, ahead]), size)
    hard = aim.overcut is not None
    matrix = vstack(
        [
            hstack([up, _column(above.sum(), -1.0), _column(above.sum(), 0.0)]),
            hstack([down, _column(below.sum(), 0.0 if hard else -1.0), _column(below.sum(), -1.0 if hard else 0.0)]),
            hstack([rigid, _column(len(path.d), 0.0), _column(len(path.d), -1.0)]),
            hstack([-rigid, _column(len(path.d), 0.0), _column(len(path.d), -1.0)]),
            hstack([steady, _column(len(path.d), 0.0), _column(len(path.d), 0.0)]),
        ]
    ).tocsr()
    limit = np.concatenate(
        [
            -gap[above],
            gap[below] + (overcut if hard else 0.0),
            RIGID - path.excess,
            RIGID + path.excess,
            np.maximum(excess, 0.0),
        ]
    )
    cost = np.zeros(size + 2)
    cost[-2:] = 1.0, HARD if hard else RIGID_COST
    bounds = [(-half, half)] * size + [(0.0, None)] * 2
    result = linprog(cost, A_ub=matrix, b_ub=limit, bounds=bounds, method="highs")
    if result.x is None:
        return None, np.inf
    return result.x[:size].reshape(-1, 6), float(result.x[-2] + (HARD * result.x[-1] if hard else 0.0))


def _spread(first: IntArray, basis: Array, rows: Array, size: int) -> csr_matrix:
    """Rows (m, 6) by p(t) and q(t), or their slopes, as rows by the control points, (m, size)."""
    values = (basis[:, :, None] * rows[:, None, :]).ravel()
    columns = (6 * first[:, None] + np.arange(24)).ravel()
    return csr_matrix((values, (np.repeat(np.arange(len(rows)), 24), columns)), shape=(len(rows), size))


def _column(count: int, value: float) -> csr_matrix:
    return csr_matrix(np.full((count, 1), value))
