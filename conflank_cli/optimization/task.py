"""Optimising one sweep: the paper's problem first, then finer knots and growth."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import numpy.typing as npt

from conflank_cli.geometry.gap import motion_gap, travel
from conflank_cli.geometry.growth import away_from, best_slide, lengthened, slid
from conflank_cli.geometry.screening import Screen
from conflank_cli.geometry.workface import FaceSamples, WorkFace
from conflank_cli.limits import Limits
from conflank_cli.motion import Motion
from conflank_cli.optimization.envelope_polish import Points, for_area, for_norm, within
from conflank_cli.optimization.gauss_newton import Solution, Step, minimise, with_motion
from conflank_cli.optimization.minimax import Aim, least_worst
from conflank_cli.optimization.terms import Weights
from conflank_cli.tool import Tool

Array = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]
Norm = int | Literal["max"]

# Steps with the paper's weights, then steps in which mu2 and mu5 fade by a decade each, then steps that settle.
PAPER_STEPS, FADE_STEPS, SETTLE_STEPS = 4, 8, 6
# Rigidity gains weight as the other terms fade, so that |pq| = L holds to well below a micrometre.
STIFFEST = 1.0e3
# Stock left counts in full up to about this many tolerances, at first and in the end.
SCALE_FIRST, SCALE_LAST = 3.0, 0.8
# Control points while settling: one every so many mm of travel, at most so many.
FINE_SPACING, FINE_MOST = 3.0, 64
# Factor on mu3 while settling: the soft modes have settled by then, and proximity would only slow what is left.
SETTLE_PROXIMITY = 0.01
# Rounds of growth, the length a sweep is continued by in one, mm, and the gain in area that makes one worth it.
ROUNDS, LENGTHEN, WORTH = 4, 4.0, 1.003
# Scales of the polish on the swept gap, in stock tolerances, and its factor on mu3.
POLISH_SCALES, POLISH_PROXIMITY = (3.0,) * 3 + (1.5,) * 3 + (1.0,) * 6, 0.1
# Norms of the gap that lead to the one asked for, each with so many steps; the last ones are near enough to the least
# maximum for linear programs to finish it.
NORM_STEPS: dict[int, int] = {2: 4, 4: 4, 8: 6, 16: 8, 32: 8}
# A flatter gap may cost this share of the area.
FLATTER = 0.002
# A sweep is continued where this share of its last axis is still on the face.
STILL_ON_FACE = 0.08


@dataclass(frozen=True, slots=True)
class Task:
    """What every sweep of one face and tool is optimised with.

    samples are the points its covered area is judged on, points those it is polished on; grid is m, n; polish, norm and
    grow as in the job.
    """

    face: WorkFace
    tool: Tool
    samples: FaceSamples
    points: Points
    screen: Screen
    limits: Limits
    weights: Weights
    grid: tuple[int, int]
    polish: bool
    norm: Norm
    grow: bool

    def first(self, motion: Motion) -> Solution:
        """The paper's problem from a detected motion."""
        return self._minimise(motion, self._schedule(), self.weights)

    def refined(self, solution: Solution) -> Solution:
        """Finer knots, then moves that cover more, as long as they do, then the polish on the swept gap."""
        count = int(np.clip(round(travel(solution.motion) / FINE_SPACING) + 3, len(solution.motion.p), FINE_MOST))
        best = self._settled(solution.motion.respaced(count))
        if best.failed:
            return solution
        if self.grow:
            best = self.grown(best)
        if self.polish:
            best = self.polished(best)
        return replace(best, start=solution.start)

    def grown(self, solution: Solution) -> Solution:
        """The solution after the moves that let it cover more: sliding, going on at either end."""
        best = solution
        area = self._covered_area(best.motion)
        for _ in range(ROUNDS):
            before = area
            # Each move starts from what those before it have gained.
            for move in (self._slid, self._continued_at_start, self._continued_at_end):
                moved = move(best)
                if moved is None:
                    continue
                trial = self._settled(moved)
                if not trial.failed and (grown := self._covered_area(trial.motion)) > WORTH * area:
                    best, area = trial, grown
            if area == before:
                break
        return best

    def polished(self, solution: Solution) -> Solution:
        """The solution polished on the swept gap; what the polish would make worse stays as it was."""
        motion = solution.motion
        points = self.points.near(motion, self.tool, self.limits)
        weights = replace(self.weights, mu3=self.weights.mu3 * POLISH_PROXIMITY)
        area = self._covered_area(motion)
        more = for_area(self.tool, motion, points, self.limits, weights, POLISH_SCALES)
        if more is not None and (served := self._covered_area(more)) > area:
            motion, area = more, served
        if self.norm != 2:
            flat = self._flattened(motion, points, weights)
            if self._covered_area(flat) >= (1.0 - FLATTER) * area:
                motion = flat
        if motion is solution.motion:
            return solution
        return with_motion(solution, self.face, self.tool, motion, self.limits.allowance, self._grid(motion))

    def _flattened(self, motion: Motion, points: Points, weights: Weights) -> Motion:
        norms = tuple(
            p for p, steps in NORM_STEPS.items() if self.norm == "max" or p <= self.norm for _ in range(steps)
        )
        flat = for_norm(self.tool, motion, points, self.limits, weights, norms)
        if self.norm != "max":
            return flat
        served = within(motion_gap(motion, self.tool, points.x, self.limits.allowance)[0], self.limits)
        return least_worst(flat, self.tool, Aim(points.x, served, self.limits.allowance))[0]

    def gaps(self, motion: Motion) -> Array:
        """Swept gap less allowance (N,), mm, at the samples, of what the screen leaves of a motion; inf for nothing."""
        allowed = self.screen.allowed(motion, self.tool)
        if allowed is None:
            return np.full(len(self.samples.areas), np.inf)
        return motion_gap(allowed, self.tool, self.samples.points, self.limits.allowance)[0]

    def covered(self, gaps: Array) -> BoolArray:
        """Which samples gaps leave within tolerance: none if there is overcut anywhere."""
        return np.asarray((gaps <= self.limits.under) & (gaps.min() >= -self.limits.over))

    def _covered_area(self, motion: Motion) -> float:
        return float(self.samples.areas[self.covered(self.gaps(motion))].sum())

    def _slid(self, solution: Solution) -> Motion | None:
        motion = solution.motion
        slides = best_slide(motion, self.tool, self.samples, self.limits)
        return slid(motion, self.tool, slides, away_from(self.face, motion)) if slides.any() else None

    def _continued_at_start(self, solution: Solution) -> Motion | None:
        there = np.mean(solution.field.on[0] > 0.5) > STILL_ON_FACE
        return lengthened(solution.motion, LENGTHEN, False) if there else None

    def _continued_at_end(self, solution: Solution) -> Motion | None:
        there = np.mean(solution.field.on[-1] > 0.5) > STILL_ON_FACE
        return lengthened(solution.motion, LENGTHEN, True) if there else None

    def _settled(self, motion: Motion) -> Solution:
        weights = replace(self.weights, mu3=self.weights.mu3 * SETTLE_PROXIMITY)
        return self._minimise(motion, (self._schedule()[-1],) * SETTLE_STEPS, weights)

    def _schedule(self) -> tuple[Step, ...]:
        """Steps of Gauss-Newton.

        The paper's functional with its weights comes first. Fairness and orthogonality pull an exact motion off its
        envelope by micrometres, so they fade. With `polish` the samples beyond tolerance fade as well and overcut
        meets a barrier, so that the last steps serve what is covered.
        """
        under = self.limits.under
        steps = [Step(1.0, 1.0, SCALE_FIRST * under, False)] * PAPER_STEPS
        for k in range(1, FADE_STEPS + 1):
            scale = SCALE_FIRST * (SCALE_LAST / SCALE_FIRST) ** (k / FADE_STEPS) if self.polish else SCALE_FIRST
            steps.append(Step(10.0**-k, min(10.0 ** (k / 2), STIFFEST), scale * under, self.polish))
        return tuple(steps)

    def _minimise(self, motion: Motion, steps: tuple[Step, ...], weights: Weights) -> Solution:
        return minimise(self.face, self.tool, motion, self.limits, weights, self._grid(motion), steps)

    def _grid(self, motion: Motion) -> tuple[int, int]:
        # Three samples to a knot span at least, or the finest wiggles of the spline go unseen.
        return max(self.grid[0], 3 * len(motion.p)), self.grid[1]
