"""Selection: the few sweeps that cover the faces without overcut and without collision."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from itertools import pairwise, repeat
from typing import Any

import numpy as np
import numpy.typing as npt

from conflank_cli.cores import threads
from conflank_cli.coverage import FaceCoverage, Reason
from conflank_cli.geometry.certificate import Certificate
from conflank_cli.geometry.gap import travel
from conflank_cli.progress import Progress
from conflank_cli.scene import Scene
from conflank_cli.selection.choice import Candidate, Chosen, choose
from conflank_cli.selection.judging import LIFTS, CutOff, Face, Judge
from conflank_cli.selection.order import Cut, in_order
from conflank_cli.selection.remainder import Lost, Remainder, why_left
from conflank_cli.sweep import Sweep

Array = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]

# How often the coverage asked for is raised by what the fine points find missing.
RAISES = 3


@dataclass(frozen=True, slots=True)
class Choice:
    """What selection gives.

    Attributes
    ----------
    plan: the sweeps in the order they are cut, each in its direction.
    summary: coverage by face and in total, and why the rest is left, for artifacts.
    coverage: the same of each face point by point.
    """

    plan: list[Sweep]
    summary: dict[str, Any]
    coverage: list[FaceCoverage]


def select(scene: Scene, sweeps: list[Sweep], progress: Progress) -> Choice:
    """Choose sweeps for every face in turn, and put them in cutting order.

    A sweep is trimmed to its longest stretch without overcut or collision, then judged by its swept gap on points of
    its face. What is chosen is held against whole triangles, between its poses too, and trimmed again where it must be,
    and has a certificate that it overcuts nowhere, not only at points.
    """
    judge = Judge.of(scene)
    with progress.stage("select", len(sweeps)) as stage, threads() as pool:
        kept: list[Candidate] = []
        cut_off: list[CutOff] = []
        for candidate, cut in pool.map(judge.trimmed, sweeps):
            stage.advance()
            if candidate is not None:
                kept.append(candidate)
            if cut is not None:
                cut_off.append(cut)

        results: list[_Result] = []
        remainders: list[Remainder] = []
        able = 0
        for index, face in enumerate(judge.faces):
            at_hand = {item.sweep.tool for result in results for item in result.chosen.items}
            own = [item for item in kept if item.sweep.face == index]
            result, own, cuts = _chosen(judge, face, own, at_hand, pool)
            results.append(result)
            able += len(own)
            of_face = [*(cut for cut in cut_off if cut.face == index), *cuts]

            def lost(asked: BoolArray, of_face: list[CutOff] = of_face) -> list[Lost]:
                return [item for found in pool.map(judge.lost, of_face, repeat(asked)) for item in found]

            covered = result.sweep >= 0
            remainders.append(
                why_left(scene, index, face.fine, covered, face.coarse, own, face.sparse, lost, judge.collider)
            )
    return _finished(scene, judge.faces, results, remainders, len(sweeps), able)


def _chosen(
    judge: Judge, face: Face, own: list[Candidate], at_hand: Collection[str], pool: Executor
) -> tuple[_Result, list[Candidate], list[CutOff]]:
    """The choice for a face, the candidates that are left, and what was taken off others on the way.

    First quick choices, until none of their sweeps hits or overcuts anything that can be seen at points; then exact
    ones, until each sweep has a certificate too, and until their coverage holds where it is measured.
    """
    job = judge.scene.job
    target = job.selection.coverage
    cuts: list[CutOff] = []
    cleared: set[Candidate] = set()
    gaps: dict[Candidate, Array] = {}
    certificates: dict[Candidate, Certificate] = {}
    lifts: dict[Candidate, int] = {}
    raises, exact = 0, False
    while True:
        chosen = choose(own, face.coarse.areas, face.coarse.cell, job, at_hand, target, exact=exact)
        new = [item for item in chosen.items if item not in cleared]
        instead = dict(zip(new, pool.map(judge.without_collision, new), strict=True))
        cleared |= {item for item in instead.values() if item is not None}
        hit = [item for item in new if instead[item] is not item]
        if hit:
            cuts += [CutOff(((item.sweep, True),), instead[item]) for item in hit]
            own = [item for item in (instead.get(item, item) for item in own) if item is not None]
            continue
        # A spot of overcut can hide between the points of the choice, and between finer ones, but not from the
        # certificate, which takes longer.
        new = [item for item in chosen.items if item not in gaps]
        fine = pool.map(lambda item: judge.gap(item.sweep, face.fine.points)[0], new)
        gaps |= dict(zip(new, fine, strict=True))
        if exact:
            new = [item for item in chosen.items if item not in certificates]
            certificates |= dict(zip(new, pool.map(judge.certificate, new), strict=True))
        overcut = {item: certificates[item].overcut if exact else -float(gaps[item].min()) for item in chosen.items}
        gouging = [item for item in chosen.items if overcut[item] > judge.over]
        if gouging:
            own = [item for item in own if item not in gouging]
            for item in gouging:
                up = judge.raised(item, overcut[item] - judge.over) if lifts.get(item, 0) < LIFTS else None
                if up is None:
                    cuts.append(CutOff(((item.sweep, False),), None))
                else:
                    lifts[up] = lifts.get(item, 0) + 1
                    own.append(up)
            continue
        if not exact:
            exact = True
            continue
        result = _Result.of(face, chosen, [gaps[item] for item in chosen.items], judge.under)
        short = job.selection.coverage - result.share
        if chosen.goal < target or short <= 0.0 or raises == RAISES:
            return replace(result, certificates=[certificates[item] for item in chosen.items]), own, cuts
        raises += 1
        target = min(target + 1.05 * short, 1.0)


@dataclass(frozen=True, slots=True)
class _Result:
    """The choice for one face on its fine points.

    Attributes
    ----------
    chosen: the choice, K sweeps.
    gaps: (K, N) swept gap less allowance, mm.
    covered: (K, N) whether that is within tolerance.
    sweep: (N,) number of the sweep that leaves least among those that cover a point, -1 for none.
    share: of the area that is covered.
    certificates: one for each sweep.
    """

    chosen: Chosen
    gaps: Array
    covered: BoolArray
    sweep: npt.NDArray[np.int64]
    share: float
    certificates: list[Certificate]

    @classmethod
    def of(cls, face: Face, chosen: Chosen, gaps: list[Array], under: float) -> _Result:
        areas = face.fine.areas
        every = np.array(gaps).reshape(len(gaps), len(areas))
        covered = every <= under
        if not gaps:
            return cls(chosen, every, covered, np.full(len(areas), -1, dtype=np.int64), 0.0, [])
        deepest = np.argmin(every, axis=0)
        inside = covered.any(axis=0)
        share = float(areas[inside].sum() / areas.sum())
        return cls(chosen, every, covered, np.where(inside, deepest, -1).astype(np.int64), share, [])

    def gap_sum(self, areas: Array) -> float:
        """Integral of |g| over what is covered, mm3."""
        inside = self.sweep >= 0
        return float(np.abs(self.gaps.min(axis=0)[inside]) @ areas[inside]) if inside.any() else 0.0


def _finished(
    scene: Scene, faces: Sequence[Face], results: list[_Result], remainders: list[Remainder], screened: int, kept: int
) -> Choice:
    """Sweeps in cutting order with their facts, the summary, and the coverage point by point."""
    described: list[Sweep] = []
    cuts: list[Cut] = []
    first: list[int] = []
    for face, result in zip(faces, results, strict=True):
        first.append(len(cuts))
        for k, item in enumerate(result.chosen.items):
            described.append(_described(item, result, k, face.fine.areas))
            cuts.append(Cut(described[-1], item.covered))
    order, plan, why = in_order(scene, [face.coarse for face in faces], cuts)
    rank = np.empty(len(order) + 1, dtype=np.int64)
    rank[order] = np.arange(len(order))
    rank[-1] = -1
    coverage = [
        FaceCoverage(
            face.fine.uv, face.fine.points, face.fine.areas,
            rank[np.where(result.sweep >= 0, result.sweep + start, -1)], remainder.reason,
        )
        for face, result, remainder, start in zip(faces, results, remainders, first, strict=True)
    ]  # fmt: skip
    areas = [float(face.fine.areas.sum()) for face in faces]
    covered_area = sum(result.share * area for result, area in zip(results, areas, strict=True))
    gap_sum = sum(result.gap_sum(face.fine.areas) for face, result in zip(faces, results, strict=True))
    summary: dict[str, Any] = {
        "coverage": covered_area / sum(areas),
        "gap_mean_abs_um": 1e3 * gap_sum / covered_area if covered_area else None,
        "faces": [
            {
                "face": design.number,
                "area_mm2": area,
                "coverage": result.share,
                "sweeps": len(result.chosen.items),
                "objective": scene.job.selection.objective,
                "price": result.chosen.price,
                "greedy": result.chosen.greedy,
                "greedy_coverage": result.chosen.greedy_share,
                "bound": result.chosen.bound,
                "gap": result.chosen.gap,
                "left_mm2": {
                    reason.name.lower(): points.area(reason)
                    for reason in Reason
                    if reason != Reason.COVERED and points.area(reason)
                },
                "in_the_way_mm2": {what.text: size for what, size in remainder.obstructions.items()},
            }
            for design, area, result, points, remainder in zip(
                scene.faces, areas, results, coverage, remainders, strict=True
            )
        ],
        "order": why,
        "screened": screened,
        "rejected": screened - kept,
        "sweeps": len(plan),
        "tool_changes": sum(a.tool != b.tool for a, b in pairwise(plan)),
    }
    return Choice(plan, summary, coverage)


def _described(item: Candidate, result: _Result, k: int, areas: Array) -> Sweep:
    covered, certificate = result.covered[k], result.certificates[k]
    inside, weight = result.gaps[k][covered], areas[covered]
    others = np.delete(result.covered, k, axis=0).any(axis=0)
    facts = {
        **item.sweep.facts,
        "length_mm": travel(item.sweep.motion),
        "covered_area_mm2": float(weight.sum()),
        "covered_alone_mm2": float(areas[covered & ~others].sum()),
        "gap_min_um": 1e3 * float(inside.min()),
        "gap_mean_abs_um": 1e3 * float(np.abs(inside) @ weight / weight.sum()),
        "gap_max_um": 1e3 * float(inside.max()),
        "certified_overcut_um": 1e3 * max(certificate.overcut, 0.0),
        "certified_gap_um": 1e3 * certificate.gap,
        "certified_area_mm2": certificate.area,
    }
    return replace(item.sweep, facts=facts)
