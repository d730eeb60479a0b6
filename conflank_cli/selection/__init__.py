"""Selection: the few sweeps that cover the faces without overcut and without collision."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from conflank_cli.cores import threads
from conflank_cli.coverage import FaceCoverage, Reason
from conflank_cli.geometry.certificate import Certificate, certify
from conflank_cli.geometry.collision import Collider
from conflank_cli.geometry.gap import motion_gap, travel
from conflank_cli.geometry.screening import Screen, longest_between
from conflank_cli.geometry.workface import FaceSamples, WorkFace
from conflank_cli.limits import Limits
from conflank_cli.motion import DEGREE, Motion
from conflank_cli.progress import Progress
from conflank_cli.scene import Scene
from conflank_cli.selection.choice import Candidate, Chosen, choose
from conflank_cli.selection.obstruction import obstruction_of
from conflank_cli.selection.order import Cut, in_order
from conflank_cli.selection.remainder import POINTS as SPARSE_POINTS
from conflank_cli.selection.remainder import Lost, Remainder, why_left
from conflank_cli.sweep import Sweep

Array = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]

# Points on a face from which sweeps are chosen: their spacing, under a millimetre on a blade, is a fifth of the
# narrowest patch worth a sweep. A choice makes the most of where they lie, which flatters its coverage by up to 0.2 %.
POINTS = 6000
# Points on a face on which a choice is measured: with four times as many no coverage changes by more than 0.05 %.
FINE_POINTS = 24000
# What posting may change of the swept gap, mm: so much of the tolerance is left to it.
POSTING = 0.0005
# How often the coverage asked for is raised by what the fine points find missing.
RAISES = 3
# A sweep that overcuts by at most this share of the band too much is moved off the face rather than cut short, by so
# much more than what is missing, so many times.
MOST_LIFT, LIFT_MORE, LIFTS = 0.3, 1.1, 3


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


def lifted(motion: Motion, samples: FaceSamples, amount: float) -> Motion:
    """The motion moved off the face by about `amount` mm: across its axis, away from the metal."""
    knots = motion.knots
    p, q = motion.ends(np.mean([knots[k : len(knots) - DEGREE - 1 + k] for k in (1, 2, 3)], axis=0))
    normal = samples.normals[cKDTree(samples.points).query(0.5 * (p + q))[1]]
    axis = (q - p) / np.linalg.norm(q - p, axis=1)[:, None]
    away = normal - np.einsum("ij,ij->i", normal, axis)[:, None] * axis
    away *= amount / np.linalg.norm(away, axis=1)[:, None]
    return replace(motion, p=motion.p + away, q=motion.q + away)


@dataclass(frozen=True, slots=True)
class _Face:
    """A design face with the points it is judged on, from few to many."""

    work: WorkFace
    sparse: FaceSamples
    coarse: FaceSamples
    fine: FaceSamples

    @classmethod
    def of(cls, work: WorkFace) -> _Face:
        return cls(work, *(work.samples(work.spacing(count)) for count in (SPARSE_POINTS, POINTS, FINE_POINTS)))


def select(scene: Scene, sweeps: list[Sweep], progress: Progress) -> Choice:
    """Choose sweeps for every face in turn, and put them in cutting order.

    A sweep is trimmed to its longest stretch without overcut or collision, then judged by its swept gap on points of
    its face. What is chosen is held against whole triangles, between its poses too, and trimmed again where it must be,
    and has a certificate that it overcuts nowhere, not only at points.
    """
    job = scene.job
    tolerance = job.tolerance
    over, under = tolerance.overcut - POSTING, tolerance.undercut - POSTING
    limits = Limits.of(tolerance)
    aim = limits.allowance - tolerance.allowance
    tools = {tool.name: tool for tool in scene.tools}
    faces = [_Face.of(WorkFace.of(design, 0.0)) for design in scene.faces]
    screen = Screen.of(scene)
    collider = Collider.of(scene)

    def within(sweep: Sweep, samples: FaceSamples) -> BoolArray:
        gap = motion_gap(sweep.motion, tools[sweep.tool], samples.points, tolerance.allowance)[0]
        return np.asarray((gap >= -over) & (gap <= under))

    def judged(sweep: Sweep) -> tuple[Candidate, float]:
        """A sweep as a candidate, and by how much it overcuts beyond the tolerance at the points of the choice."""
        tool, points = tools[sweep.tool], faces[sweep.face].coarse.points
        gap = motion_gap(sweep.motion, tool, points, tolerance.allowance)[0]
        candidate = Candidate.of(sweep, tool, gap, (gap >= -over) & (gap <= under), job.program.safe.clearance)
        return candidate, float(-over - gap.min())

    def raised(sweep: Sweep, excess: float) -> Candidate | None:
        """The sweep moved off the face by what it overcuts too much, None where that is too much or does not help."""
        for _ in range(LIFTS):
            if excess > MOST_LIFT * (over + under):
                return None
            motion = lifted(sweep.motion, faces[sweep.face].sparse, LIFT_MORE * excess)
            sweep = replace(sweep, motion=motion)
            candidate, excess = judged(sweep)
            if excess <= 0.0:
                return candidate
        return None

    def trimmed(sweep: Sweep) -> tuple[Candidate | None, list[Sweep]]:
        """What of a sweep may be cut, and what it was before something was taken off."""
        able, before = free_part(sweep)
        if before:
            # What overcuts a little all along is no longer hit once it is moved off the face.
            excess = judged(sweep)[1]
            if excess > 0.0 and (up := raised(sweep, excess)) is not None:
                able += free_part(up.sweep)[0]
        areas = faces[sweep.face].coarse.areas
        return max(able, key=lambda item: float(areas[item.covered].sum()), default=None), before

    def free_part(sweep: Sweep) -> tuple[list[Candidate], list[Sweep]]:
        """Its longest stretch without collision or overcut, and what it was before each time that it was cut short."""
        tool, before = tools[sweep.tool], []
        motion = screen.allowed(sweep.motion, tool)
        if motion is not sweep.motion:
            before.append(sweep)
            if motion is None:
                return [], before
        own = replace(sweep, motion=motion)
        candidate, excess = judged(own)
        if excess <= 0.0:
            return [candidate], before
        # Between the poses and points of the screen a sweep may still cut deeper; its swept gap has the last word.
        before.append(own)
        time_ = motion_gap(motion, tool, faces[sweep.face].coarse.points, tolerance.allowance)[1]
        motion = longest_between(motion, time_[candidate.gap < -over])
        if motion is None:
            return [], before
        candidate, excess = judged(replace(sweep, motion=motion))
        return [candidate] if excess <= 0.0 else [], before

    def without_collision(item: Candidate) -> Candidate | None:
        """The same item where nothing is hit, else what is left of it."""
        motion = collider.allowed(item.sweep.motion, tools[item.sweep.tool])
        if motion is None or motion is item.sweep.motion:
            return item if motion is not None else None
        return judged(replace(item.sweep, motion=motion))[0]

    def losses(sweep: Sweep, kept: Candidate | None, before: list[Sweep]) -> list[Lost]:
        sparse = faces[sweep.face].sparse
        rest = np.zeros(len(sparse.areas), dtype=np.bool_) if kept is None else within(kept.sweep, sparse)
        found = []
        for more in reversed(before):
            covered = within(more, sparse)
            if np.any(covered & ~rest):
                what = obstruction_of(collider, more.motion, tools[sweep.tool]) if more is sweep else None
                found.append(Lost(Reason.OVERCUT, None, covered) if what is None else Lost.to(what, covered))
            rest |= covered
        return found

    with progress.stage("select", len(sweeps)) as stage, threads() as pool:
        kept: list[Candidate] = []
        cut_off: list[tuple[Sweep, Candidate | None, list[Sweep]]] = []
        for sweep, (candidate, before) in zip(sweeps, pool.map(trimmed, sweeps), strict=True):
            stage.advance()
            if candidate is not None:
                kept.append(candidate)
            if before:
                cut_off.append((sweep, candidate, before))

        results: list[_Result] = []
        able: list[list[Candidate]] = []
        for index, face in enumerate(faces):

            def certificate(item: Candidate, face: _Face = face) -> Certificate:
                # A certificate is about the face that is aimed at, which lies off the design face by `aim`.
                room = replace(limits, over=over + aim, under=under - aim)
                found = certify(item.sweep.motion, tools[item.sweep.tool], face.work, room)
                return replace(found, overcut=found.overcut - aim, gap=found.gap + abs(aim))

            def fine_gap(item: Candidate, face: _Face = face) -> Array:
                return motion_gap(item.sweep.motion, tools[item.sweep.tool], face.fine.points, tolerance.allowance)[0]

            own = [item for item in kept if item.sweep.face == index]
            at_hand = {item.sweep.tool for result in results for item in result.chosen.items}
            target = job.selection.coverage
            certificates: dict[Candidate, Certificate] = {}
            cleared: set[Candidate] = set()
            lifts: dict[Candidate, int] = {}
            gaps: dict[Candidate, Array] = {}
            raises, exact = 0, False
            while True:
                chosen = choose(own, face.coarse.areas, face.coarse.cell, job, at_hand, target, exact=exact)
                new = [item for item in chosen.items if item not in cleared]
                rest = dict(zip(new, pool.map(without_collision, new), strict=True))
                cleared |= {item for item in rest.values() if item is not None}
                hit = [item for item in new if rest[item] is not item]
                if hit:
                    cut_off.extend((item.sweep, rest[item], [item.sweep]) for item in hit)
                    own = [item for item in (rest.get(item, item) for item in own) if item is not None]
                    continue
                # A spot of overcut can hide between the points of the choice, but not from the certificate.
                new = [item for item in chosen.items if item not in certificates]
                certificates |= {item: found for item, found in zip(new, pool.map(certificate, new), strict=True)}
                gaps |= {item: found for item, found in zip(new, pool.map(fine_gap, new), strict=True)}
                gouging = [item for item in chosen.items if certificates[item].overcut > over]
                if gouging:
                    own = [item for item in own if item not in gouging]
                    for item in gouging:
                        instead = None
                        if lifts.get(item, 0) < LIFTS:
                            instead = raised(item.sweep, certificates[item].overcut - over)
                        if instead is None:
                            cut_off.append((item.sweep, None, [replace(item.sweep)]))
                        else:
                            lifts[instead] = lifts.get(item, 0) + 1
                            own.append(instead)
                    continue
                if not exact:
                    # Most of what gouges shows itself while choosing is quick.
                    exact = True
                    continue
                result = _Result.of(face, chosen, [gaps[item] for item in chosen.items], under)
                short = job.selection.coverage - result.share
                if chosen.goal < target or short <= 0.0 or raises == RAISES:
                    break
                raises += 1
                target = min(target + 1.05 * short, 1.0)
            able.append(own)
            results.append(replace(result, certificates=[certificates[item] for item in chosen.items]))

        lost: list[list[Lost]] = []
        for index, result in enumerate(results):
            lost.append([])
            if (result.sweep < 0).any():
                of_face = [item for item in cut_off if item[0].face == index]
                for found in pool.map(lambda item: losses(*item), of_face):
                    lost[-1].extend(found)
        remainders = [
            why_left(
                scene, index, face.fine, result.sweep >= 0, face.coarse,
                able[index], face.sparse, lost[index], collider,
            )
            for index, (face, result) in enumerate(zip(faces, results, strict=True))
        ]  # fmt: skip
    return _finished(scene, faces, results, remainders, len(sweeps), sum(map(len, able)))


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
    def of(cls, face: _Face, chosen: Chosen, gaps: list[Array], under: float) -> _Result:
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
    scene: Scene, faces: list[_Face], results: list[_Result], remainders: list[Remainder], screened: int, kept: int
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
