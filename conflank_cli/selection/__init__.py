"""Selection: the few sweeps that cover the faces without overcut and without collision."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from conflank_cli.cover import fewest_cover, mean_errors
from conflank_cli.geometry.certificate import Certificate, certify
from conflank_cli.geometry.collision import Collider
from conflank_cli.geometry.gap import motion_gap, travel
from conflank_cli.geometry.screening import Screen, longest_between
from conflank_cli.geometry.workface import WorkFace
from conflank_cli.limits import Limits
from conflank_cli.progress import Progress
from conflank_cli.scene import Scene
from conflank_cli.sweep import Sweep

Array = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]

# Points on a face: their spacing, under a millimetre on a blade, is a fifth of the narrowest patch worth a sweep.
POINTS = 6000
# A sweep that adds less than this share of the area is not worth its time.
LEAST_GAIN = 0.005
# What posting may change of the swept gap, mm: so much of the tolerance is left to it.
POSTING = 0.0005


@dataclass(frozen=True, slots=True)
class _Judged:
    """A sweep as the screen leaves it, its swept gap less allowance (N,) on the points of its face, what it covers."""

    sweep: Sweep
    gap: Array
    covered: BoolArray


def select(scene: Scene, sweeps: list[Sweep], progress: Progress) -> tuple[list[Sweep], dict[str, Any]]:
    """Choose sweeps for every face in turn; returns them in cutting order, and a summary.

    A sweep is trimmed to its longest stretch without overcut or collision, then judged by its swept gap on points of
    its face; what is chosen is held against whole triangles, between its poses too, and trimmed again where it must be,
    and has a certificate that it overcuts nowhere, not only at points. The summary holds coverage
    by face and in total, the number of sweeps screened and rejected, and the mean |g| in µm over what is covered.
    """
    job = scene.job
    tolerance = job.tolerance
    over, under = tolerance.overcut - POSTING, tolerance.undercut - POSTING
    limits = Limits.of(tolerance)
    aim = limits.allowance - tolerance.allowance
    tools = {tool.name: tool for tool in scene.tools}
    faces = [WorkFace.of(design, 0.0) for design in scene.faces]
    samples = [face.samples(face.spacing(POINTS)) for face in faces]
    screen = Screen.of(scene)
    collider = Collider.of(scene)

    def judge(sweep: Sweep) -> _Judged | None:
        tool = tools[sweep.tool]
        motion = screen.allowed(sweep.motion, tool)
        if motion is None:
            return None
        points = samples[sweep.face].points
        gap, time = motion_gap(motion, tool, points, tolerance.allowance)
        # Between the poses and points of the screen a sweep may still cut deeper; its swept gap has the last word.
        if gap.min() < -over:
            motion = longest_between(motion, time[gap < -over])
            if motion is None:
                return None
            gap = motion_gap(motion, tool, points, tolerance.allowance)[0]
            if gap.min() < -over:
                return None
        return _Judged(replace(sweep, motion=motion), gap, gap <= under)

    def without_collision(item: _Judged) -> _Judged | None:
        """The same item where nothing is hit, else what is left of it."""
        motion = collider.allowed(item.sweep.motion, tools[item.sweep.tool])
        if motion is None or motion is item.sweep.motion:
            return item if motion is not None else None
        gap = motion_gap(motion, tools[item.sweep.tool], samples[item.sweep.face].points, tolerance.allowance)[0]
        return _Judged(replace(item.sweep, motion=motion), gap, gap <= under)

    with progress.stage("select", len(sweeps)) as stage, ThreadPoolExecutor(os.cpu_count()) as pool:
        judged = []
        for outcome in pool.map(judge, sweeps):
            stage.advance()
            if outcome is not None:
                judged.append(outcome)

        plan: list[Sweep] = []
        reports: list[_FaceReport] = []
        for index, (face, sample) in enumerate(zip(faces, samples, strict=True)):
            own = [item for item in judged if item.sweep.face == index]
            certificates: dict[int, Certificate] = {}
            cleared: set[int] = set()

            def certificate(item: _Judged, face: WorkFace = face) -> Certificate:
                # A certificate is about the face that is aimed at, which lies off the design face by `aim`.
                room = replace(limits, over=over + aim, under=under - aim)
                found = certify(item.sweep.motion, tools[item.sweep.tool], face, room)
                return replace(found, overcut=found.overcut - aim, gap=found.gap + abs(aim))

            chosen = _cover(own, sample.areas, job.selection.coverage)
            # A spot of overcut can hide between the points of the choice, but not from the certificate.
            while True:
                new = [item for item in chosen if id(item) not in cleared]
                left = {id(item): rest for item, rest in zip(new, pool.map(without_collision, new), strict=True)}
                cleared |= {id(rest) for rest in left.values() if rest is not None}
                if any(left[id(item)] is not item for item in new):
                    own = [rest for rest in (left.get(id(item), item) for item in own) if rest is not None]
                    judged = [rest for rest in (left.get(id(item), item) for item in judged) if rest is not None]
                    chosen = _cover(own, sample.areas, job.selection.coverage)
                    continue
                new = [item for item in chosen if id(item) not in certificates]
                certificates |= {id(item): found for item, found in zip(new, pool.map(certificate, new), strict=True)}
                gouging = {id(item) for item in chosen if certificates[id(item)].overcut > over}
                if not gouging:
                    break
                own = [item for item in own if id(item) not in gouging]
                judged = [item for item in judged if id(item) not in gouging]
                chosen = _cover(own, sample.areas, job.selection.coverage)
            plan.extend(_described(item, sample.areas, certificates[id(item)]) for item in chosen)
            reports.append(_report(scene.faces[index].number, chosen, sample.areas))
    covered_area = sum(report.covered for report in reports)
    summary: dict[str, Any] = {
        "coverage": covered_area / sum(report.area for report in reports),
        "gap_mean_abs_um": 1e3 * sum(report.gap_sum for report in reports) / covered_area if covered_area else None,
        "faces": [
            {"face": report.face, "coverage": report.covered / report.area, "sweeps": report.sweeps}
            for report in reports
        ],
        "screened": len(sweeps),
        "rejected": len(sweeps) - len(judged),
        "sweeps": len(plan),
    }
    return plan, summary


@dataclass(frozen=True, slots=True)
class _FaceReport:
    """What is covered of one face: areas in mm2, integral of |g| over the covered area in mm3, number of sweeps."""

    face: int
    area: float
    covered: float
    gap_sum: float
    sweeps: int


def _cover(items: list[_Judged], areas: Array, target: float) -> list[_Judged]:
    if not items:
        return []
    covers = np.array([item.covered for item in items])
    gaps = np.array([item.gap for item in items])
    errors = mean_errors(covers, gaps, areas)
    return [items[k] for k in fewest_cover(covers, areas, errors, target, LEAST_GAIN)]


def _report(face: int, chosen: list[_Judged], areas: Array) -> _FaceReport:
    if not chosen:
        return _FaceReport(face, float(areas.sum()), 0.0, 0.0, 0)
    inside = np.any([item.covered for item in chosen], axis=0)
    deepest = np.abs(np.min([item.gap for item in chosen], axis=0)[inside])
    return _FaceReport(
        face, float(areas.sum()), float(areas[inside].sum()), float(deepest @ areas[inside]), len(chosen)
    )


def _described(item: _Judged, areas: Array, certificate: Certificate) -> Sweep:
    inside = item.gap[item.covered]
    weight = areas[item.covered]
    facts = {
        **item.sweep.facts,
        "length_mm": travel(item.sweep.motion),
        "covered_area_mm2": float(weight.sum()),
        "gap_min_um": 1e3 * float(inside.min()),
        "gap_mean_abs_um": 1e3 * float(np.abs(inside) @ weight / weight.sum()),
        "gap_max_um": 1e3 * float(inside.max()),
        "certified_overcut_um": 1e3 * max(certificate.overcut, 0.0),
        "certified_gap_um": 1e3 * certificate.gap,
        "certified_area_mm2": certificate.area,
    }
    return replace(item.sweep, facts=facts)
