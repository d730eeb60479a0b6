"""Optimising one sweep: the paper's problem first, then finer knots and growth."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import numpy.typing as npt

from conflank_cli.geometry.gap import motion_gap, travel
from conflank_cli.geometry.growth import NODES, away_from, best_slide, clear_slide, lengthened, slid, steadiness
from conflank_cli.geometry.screening import Screen
from conflank_cli.geometry.workface import FaceSamples, WorkFace
from conflank_cli.limits import Limits
from conflank_cli.motion import Motion
from conflank_cli.optimization.envelope_polish import Points, for_area, for_norm, within
from conflank_cli.optimization.gauss_newton import Solution, Step, minimise, with_motion
from conflank_cli.optimization.minimax import Aim, least_worst
from conflank_cli.optimization.terms import Weights, way
from conflank_cli.tool import Tool

Array = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]
Norm = int | Literal["max"]

# Steps with the paper's weights, then steps in which mu2 and mu5 fade by a decade each, then steps that settle.
PAPER_STEPS, FADE_STEPS, SETTLE_STEPS = 4, 8, 6
# Rigidity gains weight as the other terms fade, so that |pq| = L holds to well below a micrometre.
STIFFEST = 1.0e3
# Fairness and orthogonality do not fade below this: they no longer shift the envelope, and keep the soft modes quiet.
LEAST_FADE = 1.0e-3
# Stock left counts in full up to about this many tolerances, at first and in the end.
SCALE_FIRST, SCALE_LAST = 3.0, 0.8
# Control points while settling: one every so many mm of travel, but not fewer than the second figure, which the spline
# needs for the last tenth of a micrometre, nor more than the third.
FINE_SPACING, FINE_FEWEST, FINE_MOST = 3.0, 26, 64
# Factor on mu3 while settling: the soft modes have settled by then, and proximity would only slow what is left.
SETTLE_PROXIMITY = 0.01
# And where something is in the way: the axis then stays where it has been put along its contact. It is put there so
# many times, since what it slides past changes as it settles.
HELD_PROXIMITY, CLEARINGS = 100.0, 2
# Rounds of growth, the length a sweep is continued by in one, mm, and the gain in area that makes one worth it.
ROUNDS, LENGTHEN, WORTH = 8, 4.0, 1.003
# A sweep that keeps less than this share of its area when it is screened is tried again, slid along its axis by so
# much, mm: the tool then stands less or more deeply in the passage, and cuts with another part of its flute.
KEPT = 0.9
CLEARING = (0.5, -0.5, 1.0, -1.0, 2.0, -2.0, 4.0, -4.0, 8.0)
# Such slides are compared on one sample in so many.
FEW = 4
# Scales of the polish on the swept gap, in stock tolerances; those of a candidate that nothing else has worked on, for
# which one point in so many will do; and the factor on mu3.
POLISH_SCALES = (3.0,) * 3 + (1.5,) * 3 + (1.0,) * 4
ROUGH_SCALES, ROUGH_POINTS = (30.0,) * 4 + (6.0,) * 3 + (3.0,) * 3, 5
FINE_SCALES = (1.0,) * 4
POLISH_PROXIMITY = 0.03
# A sweep moves across its axis with this share of its velocity at least, or it is no steady cut.
STEADY = 0.3
# Norms of the gap that lead to the one asked for, each with so many steps; the last ones are near enough to the least
# maximum for linear programs to finish it.
NORM_STEPS: dict[int, int] = {2: 4, 4: 4, 8: 6, 16: 8, 32: 8}
# Areas that differ by no more than this share are alike: the smaller gap decides. A flatter gap may cost twice that.
ALIKE, FLATTER = 0.001, 0.002
# A sweep is continued where this share of its last axis is still on the face.
STILL_ON_FACE = 0.08


@dataclass(frozen=True, slots=True)
class _Judged:
    """A solution, the area in mm2 that it covers, the mean |g| over that in mm, and whether nothing is in its way."""

    solution: Solution
    area: float
    mean: float
    clear: bool


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
        return self.minimised(motion, self.schedule(), self.weights)

    def rescued(self, solution: Solution) -> Solution | None:
        """A sweep of which the screen takes off much, slid along its axis as a whole so that it keeps more.

        None where it keeps nearly all, or no slide helps. A cone slides along its contact without leaving the face, at
        first order, so slides of the whole are compared by what is left within tolerance, overcut elsewhere aside:
        settling takes that back. The best of them, settled, is then compared with the one that slides as far as it has
        to from time to time.
        """
        motion, points, areas = solution.motion, self.samples.points[::FEW], self.samples.areas[::FEW]

        def served(trial: Motion | None) -> float:
            if trial is None:
                return 0.0
            gaps = motion_gap(trial, self.tool, points, self.limits.allowance)[0]
            return float(areas[within(gaps, self.limits)].sum())

        def kept(trial: Motion) -> float:
            return served(self.screen.allowed(trial, self.tool))

        now = kept(motion)
        if now > KEPT * served(motion):
            return None
        away = away_from(self.face, motion)
        moved = [slid(motion, self.tool, np.full(NODES, distance), away) for distance in CLEARING]
        most = [kept(trial) for trial in moved]
        trials = [self._settled(moved[int(np.argmax(most))])] if max(most) > now else []
        put = self.refitted(motion)
        for _ in range(CLEARINGS):
            trials.append(self._settled(self._cleared(put), HELD_PROXIMITY))
            put = trials[-1].motion
        sound = [trial for trial in trials if not trial.failed and self._steady(trial.motion)]
        best = max(sound, key=lambda trial: kept(trial.motion), default=None)
        return best if best is not None and kept(best.motion) > now else None

    def refined(self, solution: Solution, candidate: Motion) -> Solution:
        """Finer knots and the polish on the swept gap.

        candidate: what `solution` was optimised from. It is polished on the swept gap directly as well, which finds an
        envelope that the paper's functional slides off along the axis; the one that covers more is returned.
        """
        settled = self._settled_clear(self.refitted(solution.motion))
        if settled is None:
            return solution
        best = settled.solution
        if self.polish:
            rough = self._polished(self.refitted(candidate), ROUGH_SCALES, self.points.thinned(ROUGH_POINTS))
            fine = None if rough is None else self._polished(rough, FINE_SCALES, self.points)
            best = self._better(settled, fine).solution
        return self._ended(best, solution, candidate)

    def grown(self, solution: Solution, candidate: Motion) -> Solution:
        """Moves that cover more, as long as they do, then the polish on the swept gap, of what `refined` returns."""
        judged = self._judged(solution)
        if self.grow:
            judged = self._grown(judged)
        if self.polish:
            judged = self._better(judged, self._polished(judged.solution.motion, POLISH_SCALES, self.points))
        best = self._flattened(judged) if self.polish else judged.solution
        return self._ended(best, solution, candidate) if best is not solution else solution

    def _ended(self, best: Solution, start: Solution, candidate: Motion) -> Solution:
        """The solution `best`, told from where the solver began with `start`."""
        proximity = way(best.motion, candidate, np.linspace(0.0, 1.0, self.grid[0]))
        return replace(
            best,
            start=start.start,
            iterations=start.iterations + best.iterations,
            end=replace(best.end, proximity=proximity),
        )

    def refitted(self, motion: Motion) -> Motion:
        """The motion with as many control points as it settles with."""
        count = int(np.clip(round(travel(motion) / FINE_SPACING) + 3, max(len(motion.p), FINE_FEWEST), FINE_MOST))
        return motion.respaced(count)

    def _grown(self, best: _Judged) -> _Judged:
        """The solution after the moves that let it cover more: sliding, going on at either end."""
        moves = (self._slid, self._continued_at_start, self._continued_at_end)
        tried: dict[int, _Judged] = {}
        for _ in range(ROUNDS):
            # Each move starts from what those before it have gained, and from nothing twice.
            for k, move in enumerate(moves):
                if tried.get(k) is best:
                    continue
                tried[k] = best
                moved = move(best)
                grown = None if moved is None else self._settled_clear(moved)
                if grown is not None and grown.area > WORTH * best.area and self._steady(grown.solution.motion):
                    best = grown
        return best

    def _polished(self, motion: Motion, scales: tuple[float, ...], points: Points) -> Motion | None:
        near = points.near(motion, self.tool, self.limits, scales[0])
        return for_area(self.tool, motion, near, self.limits, self.polish_weights, scales)

    def _better(self, best: _Judged, motion: Motion | None) -> _Judged:
        """The solution, or with `motion` in it if that is steady and covers more, or as much with a smaller gap."""
        if motion is None or not self._steady(motion):
            return best
        area, mean, clear = self._served(motion)
        more = area > (1.0 + ALIKE) * best.area
        finer = area > (1.0 - ALIKE) * best.area and mean < best.mean
        return _Judged(self._with(best.solution, motion), area, mean, clear) if more or finer else best

    def _judged(self, solution: Solution) -> _Judged:
        return _Judged(solution, *self._served(solution.motion))

    def _served(self, motion: Motion) -> tuple[float, float, bool]:
        """Covered area in mm2, the mean |g| over it in mm, and whether nothing is in the way of the motion."""
        allowed = self.screen.allowed(motion, self.tool)
        gaps = self.left_by(allowed)
        covered = self.covered(gaps)
        areas = self.samples.areas[covered]
        mean = float(np.abs(gaps[covered]) @ areas / max(float(areas.sum()), 1e-12))
        return float(areas.sum()), mean, allowed is motion

    def _flattened(self, best: _Judged) -> Solution:
        """The solution with the norm of its gap made small that the job asks for, unless that costs area."""
        if self.norm == 2:
            return best.solution
        motion = best.solution.motion
        points = self.points.near(motion, self.tool, self.limits, POLISH_SCALES[0])
        norms = tuple(
            p for p, steps in NORM_STEPS.items() if self.norm == "max" or p <= self.norm for _ in range(steps)
        )
        flat = for_norm(self.tool, motion, points, self.limits, self.polish_weights, norms)
        if self.norm == "max":
            served = within(motion_gap(motion, self.tool, points.x, self.limits.allowance)[0], self.limits)
            # Like the norms from the middle of the tolerance, or the side with less room would be left.
            flat = least_worst(flat, self.tool, Aim(points.x, served, self.limits.allowance + self.limits.middle))[0]
        keeps = self._served(flat)[0] >= (1.0 - FLATTER) * best.area
        return self._with(best.solution, flat) if keeps and self._steady(flat) else best.solution

    @property
    def polish_weights(self) -> Weights:
        """Weights of the polish on the swept gap."""
        return replace(self.weights, mu3=self.weights.mu3 * POLISH_PROXIMITY)

    def _steady(self, motion: Motion) -> bool:
        return steadiness(self.face, motion) >= STEADY

    def _with(self, solution: Solution, motion: Motion) -> Solution:
        return with_motion(solution, self.face, self.tool, motion, self.limits.allowance, self._grid(motion))

    def gaps(self, motion: Motion) -> Array:
        """Swept gap less allowance (N,), mm, at the samples, of what the screen leaves of a motion; inf for nothing."""
        return self.left_by(self.screen.allowed(motion, self.tool))

    def left_by(self, allowed: Motion | None) -> Array:
        """The same of what the screen allows of a motion."""
        return np.full(len(self.samples.areas), np.inf) if allowed is None else self.unscreened(allowed)

    def unscreened(self, motion: Motion) -> Array:
        """Swept gap less allowance (N,), mm, at the samples, whatever is in the way."""
        return motion_gap(motion, self.tool, self.samples.points, self.limits.allowance)[0]

    def covered(self, gaps: Array) -> BoolArray:
        """Which samples gaps leave within tolerance: none if there is overcut anywhere."""
        return np.asarray((gaps <= self.limits.under) & (gaps.min() >= -self.limits.over))

    def _slid(self, best: _Judged) -> Motion | None:
        motion = best.solution.motion
        if not best.clear:
            return self._cleared(motion)
        slides = best_slide(motion, self.tool, self.samples, self.limits)
        return slid(motion, self.tool, slides, away_from(self.face, motion)) if slides.any() else None

    def _continued_at_start(self, best: _Judged) -> Motion | None:
        there = np.mean(best.solution.field.on[0] > 0.5) > STILL_ON_FACE
        return self._continued(best.solution.motion, False) if there else None

    def _continued_at_end(self, best: _Judged) -> Motion | None:
        there = np.mean(best.solution.field.on[-1] > 0.5) > STILL_ON_FACE
        return self._continued(best.solution.motion, True) if there else None

    def _continued(self, motion: Motion, at_end: bool) -> Motion:
        longer = lengthened(motion, LENGTHEN, at_end)
        return longer if self.screen.allowed(longer, self.tool) is longer else self._cleared(longer)

    def _cleared(self, motion: Motion) -> Motion:
        """The motion slid from time to time so that what is around the face is not in its way."""
        away, around = away_from(self.face, motion), self.screen.around
        slides = clear_slide(
            motion, self.tool, self.samples, self.limits, away, lambda p, d: around.free_along(p, d, self.tool)
        )
        return slid(motion, self.tool, slides, away)

    def _settled_clear(self, motion: Motion) -> _Judged | None:
        """The motion settled, held along its contact where something would be in its way and more is covered like that.

        None where the solver failed.
        """
        settled = self._settled(motion)
        if settled.failed:
            return None
        free = self._judged(settled)
        if free.clear:
            return free
        settled = self._settled(motion, HELD_PROXIMITY)
        held = free if settled.failed else self._judged(settled)
        return held if held.area > free.area else free

    def _settled(self, motion: Motion, proximity: float = SETTLE_PROXIMITY) -> Solution:
        weights = replace(self.weights, mu3=self.weights.mu3 * proximity)
        last = self.schedule()[-1]
        return self.minimised(motion, (last,) * (SETTLE_STEPS - 1) + (last._replace(sparse=False),), weights)

    def schedule(self) -> tuple[Step, ...]:
        """Steps of Gauss-Newton.

        The paper's functional with its weights comes first. Fairness and orthogonality pull an exact motion off its
        envelope by micrometres, so they fade. With `polish` the samples beyond tolerance fade as well and overcut
        meets a barrier, so that the last steps serve what is covered.
        """
        under = self.limits.under
        steps = [Step(1.0, 1.0, SCALE_FIRST * under, False, sparse=True)] * PAPER_STEPS
        for k in range(1, FADE_STEPS + 1):
            scale = SCALE_FIRST * (SCALE_LAST / SCALE_FIRST) ** (k / FADE_STEPS) if self.polish else SCALE_FIRST
            fade, stiff = max(10.0**-k, LEAST_FADE), min(10.0 ** (k / 2), STIFFEST)
            steps.append(Step(fade, stiff, scale * under, self.polish, sparse=True))
        return tuple(steps)

    def minimised(self, motion: Motion, steps: tuple[Step, ...], weights: Weights) -> Solution:
        """The motion after steps of Gauss-Newton on the axis error."""
        return minimise(self.face, self.tool, motion, self.limits, weights, self._grid(motion), steps)

    def _grid(self, motion: Motion) -> tuple[int, int]:
        # Three samples to a knot span at least, or the finest wiggles of the spline go unseen.
        return max(self.grid[0], 3 * len(motion.p)), self.grid[1]
