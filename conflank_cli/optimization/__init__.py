"""Optimisation: every candidate sweep to the best motion near it, side by side."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from conflank_cli.errors import NumericalError
from conflank_cli.geometry.workface import WorkFace
from conflank_cli.optimization.gauss_newton import STATUS, AxisErrorField, Limits, Solution, Weights, minimise
from conflank_cli.progress import Progress
from conflank_cli.scene import Scene
from conflank_cli.sweep import Sweep

Step = tuple[float, float, float, bool]

# How far the surface is continued past the face, as a share of the flute; as in detection.
MARGIN = 0.7
# Steps with the paper's weights, then steps in which mu2 and mu5 fade by a decade each, then steps that settle.
PAPER_STEPS, FADE_STEPS, SETTLE_STEPS = 4, 8, 6
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
    return (*steps, *[(10.0**-FADE_STEPS, STIFFEST, steps[-1][2], polish)] * SETTLE_STEPS)


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
    faces = {
        key: WorkFace.of(scene.faces[key[0]], MARGIN * tools[key[1]].length)
        for key in sorted({(sweep.face, sweep.tool) for sweep in sweeps})
    }
    steps = schedule(limits.under, keys.polish)

    def work(sweep: Sweep) -> Solution:
        face = faces[sweep.face, sweep.tool]
        return minimise(face, tools[sweep.tool], sweep.motion, limits, weights, keys.samples, steps)

    done: list[Sweep] = []
    failed: dict[str, int] = {}
    with progress.stage("optimize", len(sweeps)) as stage, ThreadPoolExecutor(os.cpu_count()) as pool:
        for sweep, solution in zip(sweeps, pool.map(work, sweeps), strict=True):
            stage.advance()
            if solution.status in ("lost", "singular"):
                failed[solution.status] = failed.get(solution.status, 0) + 1
                continue
            facts = {**sweep.facts, **axis_error_facts(solution.field, limits), "iterations": float(solution.iterations)}
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
