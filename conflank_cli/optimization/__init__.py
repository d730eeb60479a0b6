"""Optimisation: every candidate sweep to the best motion near it, side by side."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from conflank_cli.errors import NumericalError
from conflank_cli.geometry.gap import travel
from conflank_cli.geometry.workface import FaceSamples, WorkFace
from conflank_cli.motion import DEGREE, Motion
from conflank_cli.optimization.gauss_newton import STATUS, AxisErrorField, Limits, Solution, Weights, minimise
from conflank_cli.optimization.growth import best_slide, covered_area, slid
from conflank_cli.progress import Progress
from conflank_cli.scene import Scene
from conflank_cli.sweep import Sweep
from conflank_cli.tool import Tool

Array = npt.NDArray[np.float64]
Step = tuple[float, float, float, bool]

# How far the surface is continued past the face, as a share of the flute; as in detection.
MARGIN = 0.7
# Steps with the paper's weights, then steps in which mu2 and mu5 fade by a decade each, then steps that settle.
PAPER_STEPS, FADE_STEPS, SETTLE_STEPS = 4, 8, 6
# Control points while settling: one every so many mm of travel, at most so many.
FINE_SPACING, FINE_MOST = 3.0, 64
# Factor on mu3 while settling.
SETTLE_PROXIMITY = 0.01
# How often a sweep may slide along its contact for more area.
SLIDES = 3
# Points that the covered area of one sweep is judged on.
POINTS = 2500
# Rigidity gains weight as the other terms fade, so that |pq| = L holds to well below a micrometre.
STIFFEST = 1.0e3
# Stock left counts in full up to about this many tolerances, at first and in the end.
SCALE_FIRST, SCALE_LAST = 3.0, 0.8


def schedule(under: float, polish: bool) -> tuple[Step, ...]:
    """Steps of Gauss-Newton: (fading of mu2 and mu5, factor on mu4, scale in mm, barrier).

    The paper's functional with its weights comes first. Fairness and orthogonality pull an exact motion off its envelope
    by micrometres, so they fade. With `polish` the samples beyond tolerance fade as well and overcut meets a barrier, so that the
    last steps serve what is covered.
    """
    steps: list[Step] = [(1.0, 1.0, SCALE_FIRST * under, False)] * PAPER_STEPS
    for k in range(1, FADE_STEPS + 1):
        scale = SCALE_FIRST * (SCALE_LAST / SCALE_FIRST) ** (k / FADE_STEPS) if polish else SCALE_FIRST
        steps.append((10.0**-k, min(10.0 ** (k / 2), STIFFEST), scale * under, polish))
    return tuple(steps)


@dataclass(frozen=True, slots=True)
class Task:
    """What every sweep of one face and tool is optimised with."""

    face: WorkFace
    tool: Tool
    samples: FaceSamples
    limits: Limits
    weights: Weights
    grid: tuple[int, int]
    polish: bool
    grow: bool

    def run(self, motion: Motion) -> Solution:
        """Optimise one motion: the paper's problem, then finer knots, then growth."""
        first = self._minimise(motion, schedule(self.limits.under, self.polish), self.weights)
        if first.failed:
            return first
        # The soft modes have settled on the coarse knots; from here on proximity would only slow what is left.
        settle = (schedule(self.limits.under, self.polish)[-1],) * SETTLE_STEPS
        weights = replace(self.weights, mu3=self.weights.mu3 * SETTLE_PROXIMITY)
        fine = int(np.clip(round(travel(first.motion) / FINE_SPACING) + 3, len(first.motion.p), FINE_MOST))
        best = self._minimise(first.motion.respaced(fine), settle, weights)
        if best.failed:
            return first
        if not self.grow:
            return best
        limits = self.limits
        area = covered_area(best.motion, self.tool, self.samples, limits.over, limits.under, limits.allowance)
        for _ in range(SLIDES):
            slide = best_slide(best.motion, self.tool, self.samples, limits.over, limits.under, limits.allowance)
            if slide == 0.0:
                break
            moved = slid(best.motion, self.tool, slide, self._away(best))
            trial = self._minimise(moved, settle, weights)
            grown = covered_area(trial.motion, self.tool, self.samples, limits.over, limits.under, limits.allowance)
            if trial.failed or grown <= area:
                break
            best, area = trial, grown
        return best

    def _minimise(self, motion: Motion, steps: tuple[Step, ...], weights: Weights) -> Solution:
        # Three samples to a knot span at least, or the finest wiggles of the spline go unseen.
        grid = (max(self.grid[0], 3 * len(motion.p)), self.grid[1])
        return minimise(self.face, self.tool, motion, self.limits, weights, grid, steps)

    def _away(self, solution: Solution) -> Array:
        """Surface normals towards the cutter at the middle of the flute, one for every control point."""
        count = len(solution.motion.p)
        knots = solution.motion.knots
        greville = np.array([knots[k + 1 : k + 1 + DEGREE].mean() for k in range(count)])
        p, q = solution.motion.ends(greville)
        feet = self.face.projector.project(0.5 * (p + q))
        return self.face.sense * feet.normal


def optimize(scene: Scene, sweeps: list[Sweep], progress: Progress) -> list[Sweep]:
    """Optimise every sweep; those that fail are left out.

    Raises
    ------
    NumericalError: not one sweep came through.
    """
    job = scene.job
    keys = job.optimization
    weights = Weights(keys.mu1, keys.mu2, keys.mu3, keys.mu4, keys.mu5)
    limits = Limits(job.tolerance.overcut, job.tolerance.undercut, job.tolerance.allowance)
    tools = {tool.name: tool for tool in scene.tools}
    tasks: dict[tuple[int, str], Task] = {}
    for key in sorted({(sweep.face, sweep.tool) for sweep in sweeps}):
        tool = tools[key[1]]
        face = WorkFace.of(scene.faces[key[0]], MARGIN * tool.length)
        samples = face.samples(face.spacing(POINTS))
        tasks[key] = Task(face, tool, samples, limits, weights, keys.samples, keys.polish, keys.grow)

    def work(sweep: Sweep) -> Solution:
        return tasks[sweep.face, sweep.tool].run(sweep.motion)

    done: list[Sweep] = []
    failed: dict[str, int] = {}
    with progress.stage("optimize", len(sweeps)) as stage, ThreadPoolExecutor(os.cpu_count()) as pool:
        for sweep, solution in zip(sweeps, pool.map(work, sweeps), strict=True):
            stage.advance()
            if solution.failed:
                failed[solution.status] = failed.get(solution.status, 0) + 1
                continue
            facts = {
                **sweep.facts,
                **axis_error_facts(solution.field, limits),
                "iterations": float(solution.iterations),
            }
            done.append(Sweep(sweep.face, sweep.tool, solution.motion, facts))
    if not done:
        reasons = "; ".join(f"{count} x {STATUS[status]}" for status, count in sorted(failed.items()))
        raise NumericalError(
            scene.part_name, f"no sweep that could be optimised ({reasons or 'no candidates'})", "at least one",
            "Detect again with the same job, or with a wider tolerance.",
        )  # fmt: skip
    return done


def axis_error_facts(field: AxisErrorField, limits: Limits) -> dict[str, float]:
    """Axis error over the samples on the face: mean of |ε| and share within tolerance, worst overcut and stock left."""
    error = 1e3 * field.error[field.on > 0.5]
    if not error.size:
        return {}
    inside = (error >= -1e3 * limits.over) & (error <= 1e3 * limits.under)
    engaged = error[inside]
    return {
        "axis_error_mean_um": float(np.abs(engaged).mean()) if engaged.size else float("inf"),
        "axis_error_engaged": float(inside.mean()),
        "axis_error_min_um": float(error.min()),
        "axis_error_max_um": float(error.max()),
    }
