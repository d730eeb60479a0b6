"""Selection: the few sweeps that cover the faces without overcut and without collision."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import numpy.typing as npt

from conflank_cli.cover import greedy_cover
from conflank_cli.geometry.gap import motion_gap, travel
from conflank_cli.geometry.screening import Screen
from conflank_cli.geometry.workface import WorkFace
from conflank_cli.progress import Progress
from conflank_cli.scene import Scene
from conflank_cli.sweep import Sweep

Array = npt.NDArray[np.float64]

# Points on a face: their spacing, under a millimetre on a blade, is a fifth of the narrowest patch worth a sweep.
POINTS = 6000
# A sweep that adds less than this share of the area is not worth its time.
LEAST_GAIN = 0.005


def select(scene: Scene, sweeps: list[Sweep], progress: Progress) -> tuple[list[Sweep], dict[str, Any]]:
    """Choose sweeps for every face in turn; returns them in cutting order, and a summary.

    A sweep is trimmed to its longest stretch without overcut or collision, then judged by its swept gap on points of
    its face. The summary holds coverage by face and in total, the number of sweeps screened and rejected, and the mean
    |g| in µm over what is covered.
    """
    job = scene.job
    tolerance = job.tolerance
    tools = {tool.name: tool for tool in scene.tools}
    faces = [WorkFace.of(design, 0.0) for design in scene.faces]
    samples = [face.samples(face.spacing(POINTS)) for face in faces]
    screen = Screen.of(scene)

    def judge(sweep: Sweep) -> tuple[Sweep, Array] | None:
        tool = tools[sweep.tool]
        motion = screen.allowed(sweep.motion, tool)
        if motion is None:
            return None
        gap, _ = motion_gap(motion, tool, samples[sweep.face].points)
        return Sweep(sweep.face, sweep.tool, motion, sweep.facts), gap - tolerance.allowance

    judged: list[tuple[Sweep, Array]] = []
    with progress.stage("select", len(sweeps)) as stage, ThreadPoolExecutor(os.cpu_count()) as pool:
        for outcome in pool.map(judge, sweeps):
            stage.advance()
            # Between the poses that were screened a sweep may still cut deeper; its swept gap has the last word.
            if outcome is not None and outcome[1].min() >= -tolerance.overcut:
                judged.append(outcome)

    plan: list[Sweep] = []
    covered_area = gap_sum = whole = 0.0
    by_face: list[dict[str, float]] = []
    for index, sample in enumerate(samples):
        own = [(sweep, gap) for sweep, gap in judged if sweep.face == index]
        gaps = np.array([gap for _, gap in own]) if own else np.zeros((0, len(sample.areas)))
        covers = (gaps >= -tolerance.overcut) & (gaps <= tolerance.undercut)
        inside_area = np.maximum(covers @ sample.areas, 1e-12)
        errors = np.where(covers, np.abs(gaps), 0.0) @ sample.areas / inside_area
        chosen = greedy_cover(covers, sample.areas, errors, job.selection.coverage, LEAST_GAIN)
        for k in chosen:
            plan.append(_described(own[k][0], gaps[k], covers[k], sample.areas))
        total = float(sample.areas.sum())
        deepest = gaps[chosen].min(axis=0) if chosen else np.full(len(sample.areas), np.inf)
        inside = (deepest >= -tolerance.overcut) & (deepest <= tolerance.undercut)
        area = float(sample.areas[inside].sum())
        by_face.append({"face": scene.faces[index].number, "coverage": area / total, "sweeps": len(chosen)})
        covered_area += area
        whole += total
        gap_sum += float(np.abs(deepest[inside]) @ sample.areas[inside])
    summary: dict[str, Any] = {
        "coverage": covered_area / whole,
        "gap_mean_abs_um": 1e3 * gap_sum / covered_area if covered_area else None,
        "faces": by_face,
        "screened": len(sweeps),
        "rejected": len(sweeps) - len(judged),
        "sweeps": len(plan),
    }
    return plan, summary


def _described(sweep: Sweep, gap: Array, covered: npt.NDArray[np.bool_], areas: Array) -> Sweep:
    inside = gap[covered]
    weight = areas[covered]
    facts = {
        **sweep.facts,
        "length_mm": travel(sweep.motion),
        "covered_area_mm2": float(weight.sum()),
        "gap_min_um": 1e3 * float(inside.min()),
        "gap_mean_abs_um": 1e3 * float(np.abs(inside) @ weight / weight.sum()),
        "gap_max_um": 1e3 * float(inside.max()),
    }
    return Sweep(sweep.face, sweep.tool, sweep.motion, facts)
