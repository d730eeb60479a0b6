"""Why a plan leaves what it leaves, point by point: what candidates would have covered, what lines would fit."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from conflank_cli.coverage import Reason
from conflank_cli.detection.reachability import reachability
from conflank_cli.geometry.collision import Collider
from conflank_cli.geometry.workface import FaceSamples, WorkFace
from conflank_cli.scene import Scene
from conflank_cli.selection.choice import Candidate, least_gain
from conflank_cli.selection.obstruction import MACHINE, Obstruction, obstruction_at

Array = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]

# Points of a face on which lost sweeps are held against what is left, and those on which lines are looked for, about.
POINTS, LINE_POINTS = 1500, 400
# Lines are looked for at points that have something left this near, in spacings.
NEAR = 1.5
# A line that fits may still be moved by so much, mm, before it is cut: what is in its way by less is not.
SLACK = 0.02
PER_SAMPLE = ("uv", "points", "normals", "areas", "cell")


@dataclass(frozen=True, slots=True)
class Lost:
    """What a candidate would have covered, had nothing been taken off it.

    Attributes
    ----------
    reason: OVERCUT, COLLISION or MACHINE.
    obstruction: what is in the way; None for overcut.
    covered: (N,) of the points of its face.
    """

    reason: Reason
    obstruction: Obstruction | None
    covered: BoolArray

    @classmethod
    def to(cls, obstruction: Obstruction, covered: BoolArray) -> Lost:
        """Lost to what forbids the motion."""
        return cls(Reason.MACHINE if obstruction.component == MACHINE else Reason.COLLISION, obstruction, covered)


@dataclass(frozen=True, slots=True)
class Remainder:
    """Why points are left.

    Attributes
    ----------
    reason: (N,) a `Reason` for each point, COVERED where it is.
    obstructions: area in mm2 by what is in the way, the largest first; what several forbid counts for each of them.
    """

    reason: IntArray
    obstructions: dict[Obstruction, float]


def why_left(
    scene: Scene,
    index: int,
    fine: FaceSamples,
    covered: BoolArray,
    coarse: FaceSamples,
    candidates: Sequence[Candidate],
    sparse: FaceSamples,
    lost: Callable[[BoolArray], Sequence[Lost]],
    collider: Collider,
) -> Remainder:
    """The reason why each point of a face is left.

    The first of these that holds: a sweep that could be cut covers it (and adds enough, or too little, to be worth it);
    a sweep would cover it that collides, is out of reach, or cuts too deep; a line fits there within tolerance (that
    collides, is out of reach, or along which no sweep was found); no line fits.

    Parameters
    ----------
    index: of the face.
    fine, covered: points that the reason is asked for, and which of them the plan covers.
    coarse, candidates: points of the candidates' gaps, and the candidates.
    sparse, lost: points of what was lost, and that, at those of them that it is asked for.
    collider: what lines are held against.
    """
    reason = np.full(len(fine.areas), int(Reason.COVERED), dtype=np.int64)
    left = np.flatnonzero(~covered)
    obstructions: dict[Obstruction, float] = {}
    if not len(left):
        return Remainder(reason, obstructions)
    why = np.full(len(left), -1, dtype=np.int64)
    places, areas = fine.points[left], fine.areas[left]

    if candidates:
        near = cKDTree(coarse.points).query(places)[1]
        covers = np.array([item.covered for item in candidates])
        able = covers[:, near]
        enough = able @ areas >= least_gain(covers, coarse.areas) * fine.areas.sum()
        why[able.any(axis=0)] = Reason.SMALL
        why[able[enough].any(axis=0)] = Reason.NOT_CHOSEN

    if (why < 0).any():
        near = cKDTree(sparse.points).query(places)[1]
        asked = np.zeros(len(sparse.areas), dtype=np.bool_)
        asked[near[why < 0]] = True
        found = lost(asked)
        # Where several would have covered a point, what is in the way counts before what would be cut too deep.
        for kind in (Reason.COLLISION, Reason.MACHINE, Reason.OVERCUT):
            own = [item for item in found if item.reason == kind]
            if not own:
                continue
            there = np.any([item.covered for item in own], axis=0)[near] & (why < 0)
            why[there] = kind
            for obstruction in dict.fromkeys(item.obstruction for item in own if item.obstruction is not None):
                by_it = np.any([item.covered for item in own if item.obstruction == obstruction], axis=0)[near]
                area = float(areas[by_it & there].sum())
                if area:
                    obstructions[obstruction] = obstructions.get(obstruction, 0.0) + area

    open_ = np.flatnonzero(why < 0)
    if len(open_):
        why[open_] = _by_lines(scene, index, places[open_], areas[open_], obstructions, collider)
    reason[left] = why
    return Remainder(reason, dict(sorted(obstructions.items(), key=lambda item: (-item[1], item[0]))))


def _by_lines(
    scene: Scene,
    index: int,
    places: Array,
    areas: Array,
    obstructions: dict[Obstruction, float],
    collider: Collider,
) -> IntArray:
    """Reasons at places (M, 3) that no candidate covers: whether a line fits, and what is in its way."""
    tolerance = scene.job.tolerance
    limit = 0.5 * (tolerance.overcut + tolerance.undercut)
    best = np.full(len(places), int(Reason.NO_LINE), dtype=np.int64)
    by: list[Obstruction | None] = [None] * len(places)
    for tool in scene.tools:
        face = WorkFace.under(scene.faces[index], tool)
        spacing = face.spacing(LINE_POINTS)
        samples = face.samples(spacing)
        close = cKDTree(places).query(samples.points, distance_upper_bound=NEAR * spacing)[0] < np.inf
        samples = replace(samples, **{name: getattr(samples, name)[close] for name in PER_SAMPLE})
        if not len(samples.areas):
            continue
        found = reachability(face, tool, samples, tolerance.allowance)
        near = cKDTree(samples.points).query(places)[1]
        for n in np.unique(near[found.error[near] <= limit]):
            there = near == n
            what = obstruction_at(collider, found.p[n][None], found.d[n][None], tool, SLACK)
            if what is None:
                best[there] = Reason.NO_SWEEP
                continue
            hit = there & (best == Reason.NO_LINE)
            best[hit] = Lost.to(what, np.zeros(0, dtype=np.bool_)).reason
            for k in np.flatnonzero(hit):
                by[int(k)] = what
    for at, forbidding in enumerate(by):
        if forbidding is not None and best[at] != Reason.NO_SWEEP:
            obstructions[forbidding] = obstructions.get(forbidding, 0.0) + float(areas[at])
    return best
