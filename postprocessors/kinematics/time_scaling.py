"""Times of blocks within the speed, acceleration and jerk of every axis, as short as they can be.

Block k takes t_k and moves an axis by dq_k at the speed v_k = dq_k / t_k. Between blocks k and k + 1 the axis has the
acceleration a_k = (v_{k+1} - v_k) / ((t_k + t_{k+1}) / 2), and over three blocks the jerk
j_k = (a_{k+1} - a_k) / ((t_k + t_{k+1} + t_{k+2}) / 3). These are the second and third divided differences of the
axis' position over the times at which the blocks begin and end, so they are exact for a parabola and a cubic, however
uneven the blocks are. What an axis does before the first and after the last block of a run is not in them: there the
control speeds up and brakes by itself.

A program states feeds F_k = 60 way_k / t_k as whole numbers. Rounding them changes v_k by up to
c_k = |dq_k| / (2 * 60 way_k), whatever F_k is, hence a_k by up to n_k = (c_k + c_{k+1}) / ((t_k + t_{k+1}) / 2) and j_k
by up to (n_k + n_{k+1}) / ((t_k + t_{k+1} + t_{k+2}) / 3). This much of each limit is kept back.

Wanted are the least times, none below those given. In y = log t every limit is a smooth function of two or three
neighbours, and slowing down everything alike keeps any of them. So an interior point method starts there and goes on to

    minimize  sum t_k - mu sum least_k (log(y_k - log least_k) + sum of log(1 - |share of each limit|))

for ever smaller mu, by Newton steps with the Gauss-Newton matrix of the barrier, which is banded; each run of blocks
takes steps of its own length.

Source: Boyd and Vandenberghe, Convex Optimization (2004), 11.3 (barrier method). The problem is not convex, so what is
found is a local least; it keeps the limits whatever it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.linalg import solveh_banded
from scipy.ndimage import maximum_filter1d, uniform_filter1d

from postprocessors.machines.machine import Limits

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

RESERVE = 0.98
"""Share of each limit that is used: what second-order effects of rounding feeds may take stays below the rest."""
START = 0.9
"""Share of the limits at which the search starts."""
LEAST_ROOM = 1e-2
"""Log of the ratio to its least time with which each block starts."""
WIDTH, WIDER, SPREADS = 5.0, 1.3, 40
"""Blocks over which a start that asks too much is slowed down, from one round to the next by how much more, and rounds
before a run is slowed down as a whole."""
MORE = 1.05
"""Times that a start is slowed down more than is asked for."""
WEIGHTS = (1.0, 0.3, 0.1, 0.03, 0.01, 0.003, 0.001)
"""Weights mu of the barrier, one after the other: the first are so large that the search leaves the limits before it
goes along them. In the end a block that nothing but its least time holds takes the last mu of it longer."""
NEAR = 3.0 * WEIGHTS[-1]
"""Log of the ratio to its least time below which a block is given that time in the end."""
SHIFTS = (1e-12, 1e-9, 1e-6, 1e-3)
"""Shares that are added to the diagonal of a matrix, one after the other, until it can be solved: where limits are all
but reached it is positive definite up to rounding only."""
STEPS = 3
"""Newton steps for each weight."""
LONGEST = 0.7
"""Largest change of y in a step: by how much the limits change is then still about what their slopes say."""
CLOSER = 0.8
"""Share of the room to a limit that a step may use up."""
SHORTER = 0.4
"""of a step that leaves the limits or makes a run no better is tried next."""
TRIALS = 8
"""of a step; after that the run stays where it is."""
TINY = float(np.finfo(np.float64).tiny)


class Run(NamedTuple):
    """N blocks that are run one after the other.

    axes: positions of the five axes, (N + 1, 5), mm and degrees; least: seconds that each block takes at least, (N,);
    way: of the tip in each block, (N,) mm, of which the feed is counted. Least times and ways are positive.
    """

    axes: Array
    least: Array
    way: Array


def scaled_seconds(runs: Sequence[Run], limits: Limits) -> list[Array]:
    """Times (N,) of the blocks of each run, seconds, within the limits of all axes even once feeds are whole numbers.

    Parameters
    ----------
    runs: what is run in one go each.
    limits: of the axes.
    """
    blocks = [len(run.least) for run in runs]
    if sum(blocks) == 0:
        return [np.zeros(0) for _ in runs]
    problem = _Problem.of([run for run in runs if len(run.least)], limits)
    y = problem.start()
    for weight in WEIGHTS:
        for _ in range(STEPS):
            y = problem.step(y, weight)
    return np.split(problem.at_least(y), np.cumsum(blocks)[:-1])


class _Stencils(NamedTuple):
    """Shares of a limit that are asked for in K places, by each of five axes.

    share, kept: (5, K), what is asked for (signed) and what is kept back for rounding.
    """

    share: Array
    kept: Array


class _Problem(NamedTuple):
    """All runs one after the other, B blocks in all; axes come first, so that NumPy runs along blocks.

    dq (5, B): steps of the axes; least (B,); rounding (5, B): speed that rounding a feed changes; first (R,): index of
    the first block of each run; pairs (B - 1,), triples (B - 2,): 1 where neighbours belong to one run, else 0.
    acceleration, jerk: (5, 1), as much as is used.
    """

    dq: Array
    least: Array
    rounding: Array
    first: Integers
    pairs: Array
    triples: Array
    acceleration: Array
    jerk: Array

    @classmethod
    def of(cls, runs: Sequence[Run], limits: Limits) -> _Problem:
        dq = np.ascontiguousarray(np.concatenate([np.diff(run.axes, axis=0) for run in runs]).T)
        least = np.concatenate([run.least for run in runs])
        way = np.concatenate([run.way for run in runs])
        owner = np.repeat(np.arange(len(runs)), [len(run.least) for run in runs])
        return cls(
            dq,
            least,
            np.abs(dq) / (120.0 * way),
            np.flatnonzero(np.diff(owner, prepend=-1)),
            (owner[1:] == owner[:-1]).astype(np.float64),
            (owner[2:] == owner[:-2]).astype(np.float64),
            RESERVE * limits.acceleration[:, None],
            RESERVE * limits.jerk[:, None],
        )

    def stencils(self, y: Array) -> tuple[_Stencils, ...]:
        """Shares of acceleration, and of jerk as it is taken over either time, at log times y (B,)."""
        t = np.exp(y)
        v = self.dq / t
        h = 2.0 * self.pairs / (t[1:] + t[:-1])
        a, n = (v[:, 1:] - v[:, :-1]) * h, (self.rounding[:, 1:] + self.rounding[:, :-1]) * h
        change, kept = a[:, 1:] - a[:, :-1], n[:, 1:] + n[:, :-1]
        return (
            _Stencils(a / self.acceleration, n / self.acceleration),
            *(_Stencils(change * g / self.jerk, kept * g / self.jerk) for g, _ in self.over(t)),
        )

    def over(self, t: Array) -> list[tuple[Array, list[Array]]]:
        """One over the times (B - 2,) that jerk is taken over, and how their logs grow with that of each time around.

        The mean of three blocks, which is exact, and the middle one, as many take it.
        """
        middle, three = t[1:-1], t[2:] + t[1:-1] + t[:-2]
        none = np.zeros(len(middle))
        return [
            (3.0 * self.triples / three, [t[k : len(t) - 2 + k] / three for k in range(3)]),
            (self.triples / middle, [none, none + 1.0, none]),
        ]

    def slopes(self, y: Array, found: tuple[_Stencils, ...]) -> list[list[_Stencils]]:
        """Derivatives of the shares by the log of each of the two or three times around, in the same order."""
        t = np.exp(y)
        v = self.dq / t / self.acceleration
        h = 2.0 * self.pairs / (t[1:] + t[:-1])
        a, n = found[0]
        # 1 / h falls by its share of the time that grows.
        low, high = 0.5 * h * t[:-1], 0.5 * h * t[1:]
        by_low = _Stencils(v[:, :-1] * h - a * low, -n * low)
        by_high = _Stencils(-v[:, 1:] * h - a * high, -n * high)
        # Acceleration at the end of the middle block less that at its beginning.
        change = [-by_low.share[:, :-1], by_low.share[:, 1:] - by_high.share[:, :-1], by_high.share[:, 1:]]
        kept = [by_low.kept[:, :-1], by_low.kept[:, 1:] + by_high.kept[:, :-1], by_high.kept[:, 1:]]
        slopes = [[by_low, by_high]]
        for (j, m), (g, leans) in zip(found[1:], self.over(t), strict=True):
            scale = self.acceleration / self.jerk * g
            slopes.append(
                [
                    _Stencils(more * scale - j * lean, keep * scale - m * lean)
                    for more, keep, lean in zip(change, kept, leans, strict=True)
                ]
            )
        return slopes

    def start(self) -> Array:
        """Log times inside of all limits: slowed down around the places that ask too much."""
        y = np.log(self.least) + LEAST_ROOM
        width, borders = WIDTH, [*self.first.tolist(), len(y)]
        for _ in range(SPREADS):
            slower = self.too_fast(y)
            if not slower.any():
                break
            size = 2 * int(0.5 * width) + 1
            for begin, end in pairwise(borders):
                widened = maximum_filter1d(slower[begin:end], size, mode="nearest")
                y[begin:end] += MORE * uniform_filter1d(widened, size, mode="nearest")
            width *= WIDER
        while (slower := self.too_fast(y)).any():
            most = np.maximum.reduceat(slower, self.first)
            # A little more than that, or rounding could ask for nothing but itself for ever.
            y += self.spread(np.where(most > 0.0, most + LEAST_ROOM, 0.0))
        return y

    def too_fast(self, y: Array) -> Array:
        """Log of how much slower each block would have to be with all around it to keep the share `START`, (B,)."""
        slower = np.zeros(len(y))
        for order, stencils in zip((2, 3, 3), self.stencils(y), strict=True):
            share = (np.abs(stencils.share) + stencils.kept).max(axis=0)
            # Speed falls with the time, acceleration with its square, jerk with its third power; what is kept of them
            # for rounding falls with one power less.
            wanted = np.log(np.maximum(share / START, 1.0)) / (order - 0.5)
            for k in range(order):
                np.maximum(slower[k : k + len(wanted)], wanted, out=slower[k : k + len(wanted)])
        return slower

    def at_least(self, y: Array) -> Array:
        """Times (B,) at log times y; a block next to its least time has that, where the limits hold all the same."""
        least = np.log(self.least)
        near = y - least < NEAR
        for _ in range(SPREADS):
            there = np.where(near, least, y)
            over = np.zeros(len(y), dtype=np.bool_)
            for order, (share, kept) in zip((2, 3, 3), self.stencils(there), strict=True):
                too_much = np.asarray((np.abs(share) + kept > 1.0).any(axis=0))
                for k in range(order):
                    over[k : k + len(too_much)] |= too_much
            if not (over & near).any():
                return np.asarray(np.where(near, self.least, np.exp(y)))
            near &= ~over
        return np.asarray(np.exp(y))

    def spread(self, by_run: Array) -> Array:
        """A value of each run (R,) for all of its blocks, (B,)."""
        return np.repeat(by_run, np.diff(np.append(self.first, len(self.least))))

    def merit(self, y: Array, weight: float) -> Array:
        """What is minimized, by run (R,); infinite outside of the limits."""
        room = y - np.log(self.least)
        inside = room > 0.0
        value = np.exp(y) - weight * self.least * np.log(np.where(inside, room, 1.0))
        for share, kept in self.stencils(y):
            free = 1.0 - kept
            slack = free**2 - share**2
            count = share.shape[1]
            inside[:count] &= ((slack > 0.0) & (free > 0.0)).all(axis=0)
            # The product of five at a time spares logarithms.
            value[:count] -= weight * self.least[:count] * np.log(np.maximum(slack, 1e-50).prod(axis=0))
        return np.asarray(np.add.reduceat(np.where(inside, value, np.inf), self.first))

    def step(self, y: Array, weight: float) -> Array:
        """One Newton step of every run, shortened where it must be."""
        t = np.exp(y)
        room = y - np.log(self.least)
        gradient = t - weight * self.least / room
        matrix = np.zeros((3, len(y)))
        matrix[0] = t + weight * self.least / room**2
        found = self.stencils(y)
        barriers = []
        for (share, kept), by in zip(found, self.slopes(y, found), strict=True):
            count = share.shape[1]
            up, down = 1.0 / (1.0 - kept - share), 1.0 / (1.0 - kept + share)
            scale = weight * self.least[:count]
            ups = [up * (slope.kept + slope.share) for slope in by]
            downs = [down * (slope.kept - slope.share) for slope in by]
            barriers += [ups, downs]
            for i, (rise, fall) in enumerate(zip(ups, downs, strict=True)):
                gradient[i : i + count] += scale * (rise + fall).sum(axis=0)
                for k in range(i, len(by)):
                    matrix[k - i, i : i + count] += scale * (rise * ups[k] + fall * downs[k]).sum(axis=0)
        towards = -_solved(matrix, gradient)
        # Share of the room to each limit that the step would use up if the limits were linear.
        used = np.maximum(np.abs(towards) / LONGEST, -towards / (CLOSER * room))
        for slopes in barriers:
            count = slopes[0].shape[1]
            moved = np.add.reduce([slope * towards[k : k + count] for k, slope in enumerate(slopes)]).max(axis=0)
            used[:count] = np.maximum(used[:count], moved / CLOSER)
        length = np.minimum(1.0, 1.0 / np.maximum(np.maximum.reduceat(used, self.first), TINY))
        before = self.merit(y, weight)
        for _ in range(TRIALS):
            worse = ~(self.merit(y + self.spread(length) * towards, weight) <= before)
            if not worse.any():
                break
            length = np.where(worse, SHORTER * length, length)
        else:
            length = np.where(worse, 0.0, length)
        return np.asarray(y + self.spread(length) * towards)


def _solved(matrix: Array, right: Array) -> Array:
    """Solution (B,) of a positive definite system in banded form (3, B); zeros where rounding leaves none."""
    for shift in SHIFTS:
        shifted = matrix.copy()
        shifted[0] *= 1.0 + shift
        try:
            return np.asarray(solveh_banded(shifted, right, lower=True, check_finite=False))
        except np.linalg.LinAlgError:
            continue
    return np.zeros_like(right)
