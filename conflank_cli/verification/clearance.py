"""How near each component of the cutter comes to what it must not touch.

Every figure is the least over points that are on the faces themselves, where these are known: triangles are halved
where a cutter may be near, each new point is put on the face, and the nearest places of all are looked at ever more
closely.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from conflank_cli.cores import beside
from conflank_cli.geometry.face import CheckMesh, DesignFace
from conflank_cli.once import Once
from conflank_cli.scene import Scene
from conflank_cli.tool import Tool
from conflank_cli.verification.figures import ROUNDING, of_program, place_of, triple
from conflank_cli.verification.findings import Finding
from conflank_cli.verification.gap import (
    Body,
    BodyMotion,
    ball_body,
    cone_body,
    frustum_body,
    section_bodies,
    spatial_order,
)
from conflank_cli.verification.poses import Poses, join_cells
from conflank_cli.verification.result import (
    ClearanceFigures,
    Clearances,
    Place,
)
from conflank_cli.verification.surroundings import MeshSample, Surroundings, largest
from conflank_cli.verification.swept import CutMoves, by_tool

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

_NEAR = 5.0
"""What stands around is looked at this far from what the tool passes through, mm; beyond it nothing is near."""

FINEST = 0.15
"""Pieces are halved to this size where something may be too near, mm: between their corners a cutter of radius r comes
nearer by 0.0038 mm^2 / r at most, 2.5 um at 1.5 mm."""

CLOSEST = 2e-4
"""The nearest of them are halved on to this size, mm: what is left is far below 0.05 um, at the edge of a disc too."""

_NEAREST = 128
"""How many pieces are looked at so closely, of each kind of target and component."""

_ROUND = 8.0
"""Between the corners of a piece of size h something may come nearer by h^2 over this, mm: by which the nearest are
told, for radii of half a millimetre and more."""

_COVER = 0.58
"""No place on a triangle is further from its nearest corner than this share of its longest side."""

_BEND = 1.0
"""What is smooth and of radius r comes nearer between the corners of a piece of size h by h^2 times half the square of
`_COVER` times 1 / r + this, 1/mm: what a face itself bends is the sag of its pieces, and this is to spare. What has an
edge may come nearer by as much as it is away from the corners."""

_EDGE = 1.0
"""So much of a body beside an edge is looked at as what has one, mm: more than a piece that is smooth reaches."""

_SAME_RADIUS = 1e-3
"""An edge that stands out by less than this over what the tool goes on with is none, mm."""

_FEW = 64
"""One point in so many is measured first, to tell how near the nearest of all is at most."""

CUTTING = ("ball", "cone")
"""Components that are meant to touch the part."""

_TOO_NEAR = {"ball": "CF301", "cone": "CF302", "shank": "CF303", "holder": "CF304"}


@dataclass(frozen=True, slots=True)
class Target:
    """What components keep a distance from.

    Attributes
    ----------
    name: "obstacle", "neighbour" (faces of the part beside the design faces), "rest" (of design faces, outside of their
        regions) or "design".
    stands: where it is.
    """

    name: str
    stands: Surroundings


@lru_cache(maxsize=1)
def _neighbours(surfaces: Once[tuple[DesignFace, ...]], mesh: Once[CheckMesh]) -> Surroundings:
    """Faces of the part that nothing may touch; kept, since the copies of a pattern have the same."""
    every = mesh()
    return Surroundings.of(every.only(every.face >= 0), surfaces())


def targets_of(scene: Scene) -> tuple[Target, ...]:
    """All targets of a scene that there are."""
    nothing, every = scene.check.only(np.zeros(len(scene.check.face), dtype=np.bool_)), scene.check
    found = (
        Target("neighbour", _neighbours(scene.surfaces, scene.mesh)),
        Target("rest", Surroundings.of(nothing, scene.rest)),
        Target("design", Surroundings.of(nothing, scene.faces)),
        Target("obstacle", Surroundings.of(every.only(every.face < 0))),
    )
    return tuple(target for target in found if len(target.stands.corners.pieces))


def limit_of(component: str, target: str, scene: Scene) -> float | None:
    """The least distance that a component has to keep from a target, mm; None where there is none.

    Beside the design faces, and in what is left of them, the cutter may cut as deep as in the design faces. Right above
    the cone a shank of the same radius runs out of the cut tangentially: it may graze what the cone has just finished,
    but not cut it.
    """
    margin, tolerance = scene.job.obstacles.margin, scene.job.tolerance
    # What an allowance is left on is the same distance further away.
    own = tolerance.allowance - tolerance.overcut
    if component == "holder":
        return margin.holder
    if target == "obstacle":
        return margin.cutter if component in CUTTING else margin.shank
    if target == "neighbour":
        return -tolerance.overcut if component in CUTTING else margin.shank
    # What the cutter leaves on a design face is its swept gap.
    return own if component == "shank" or target == "rest" else None


class _Nearest(NamedTuple):
    """The nearest place of a target: distance, mm, the point, its face, the move and share of it at which that is.

    beyond: at how many of the points looked at the limit is not kept.
    """

    distance: float
    point: Array
    face: int
    move: int
    share: float
    beyond: int


class _Measured(NamedTuple):
    """Distances of N points, inf where they were not below what was asked, and the moves and shares."""

    distance: Array
    move: Integers
    share: Array

    def then(self, other: _Measured) -> _Measured:
        """These and then others."""
        return _Measured(
            np.concatenate([self.distance, other.distance]),
            np.concatenate([self.move, other.move]),
            np.concatenate([self.share, other.share]),
        )

    def ordered(self, order: Integers) -> _Measured:
        """The same in another order."""
        return _Measured(self.distance[order], self.move[order], self.share[order])


def _measured(motions: Sequence[BodyMotion], points: Array, sag: Array, mark: Array) -> _Measured:
    """Distance of points (N, 3) to bodies in motion, where it is below a mark (N,).

    The true face may be nearer than a point by its sag (N,), which is taken off.
    """
    count = len(points)
    distance, move, share = np.full(count, np.inf), np.full(count, -1, dtype=np.int64), np.zeros(count)
    for motion in motions if count else ():
        found = motion.below(points, np.minimum(mark, distance) + sag)
        where = found.chosen
        distance[where] = found.distance - sag[where]
        move[where], share[where] = found.move, found.share
    return _Measured(distance, move, share)


class _Search(NamedTuple):
    """One way of looking for what is near.

    by: motions of the bodies by which it is looked for; to: of those by which the nearest places are measured.
    bend: how the bodies bend towards a face at most, 1/mm; infinite where they have an edge.
    """

    by: Sequence[BodyMotion]
    to: Sequence[BodyMotion]
    bend: float


def _searches(stretches: list[CutMoves], component: str) -> list[_Search]:
    """How a component is looked for: by its smooth sides and by edges that stand out."""

    # What the axis does between blocks does not matter here: both ways are one motion.
    def moving(bodies: Callable[[Tool], Sequence[Body]]) -> list[BodyMotion]:
        return [
            BodyMotion.of(join_cells(list(stretch.cells)), body)
            for stretch in stretches
            for body in bodies(stretch.tool)
        ]

    own = moving(partial(_component, name=component))
    edges = moving(partial(_edges, component=component))
    radius = min((_least_radius(motion.body) for motion in own), default=0.0)
    found = [_Search(own, own, 1.0 / radius + _BEND if radius > 0.0 else np.inf)] if own else []
    return [*found, _Search(edges, own, np.inf)] if edges else found


def _least_radius(body: Body) -> float:
    """Radius of a ball, and of the narrower end of a frustum, mm: its numbers are those that the kernel reads."""
    return float(body.numbers[1] if body.name == "ball" else min(body.numbers[2], body.numbers[4]))


def _unseen(sample: MeshSample, bend: float) -> Array:
    """By how much what bends so (1/mm) may come nearer within a piece than at its corners, (K,) mm."""
    away = _COVER * sample.longest
    return np.asarray((away if np.isinf(bend) else np.minimum(away, 0.5 * bend * away**2)) + sample.piece_sag)


def _nearest(search: _Search, sample: MeshSample, limit: float, least: float) -> _Nearest | None:
    """The nearest place of a target to a component; None where nothing is below the limit or `least`, mm."""
    motions = search.by
    some = np.arange(len(sample.points))[::_FEW]
    few = _measured(motions, sample.points[some], sample.sag[some], np.full(len(some), np.inf))
    mark = max(limit, min(least, few.distance.min(initial=np.inf)))
    # Between its corners a piece may come nearer. Where that could matter it is halved.
    blind = np.zeros(len(sample.points))
    np.maximum.at(blind, sample.pieces, _unseen(sample, search.bend)[:, None])
    found = _measured(motions, sample.points, sample.sag, mark + blind)
    closest: list[Integers] = []
    sags: list[Array] = []
    while True:
        mark = max(limit, min(least, found.distance.min(initial=np.inf)))
        bound = -largest(-found.distance[sample.pieces]) - _unseen(sample, search.bend)
        long, matters = sample.longest > FINEST, bound < mark
        closest.append(sample.pieces[~long & matters])
        sags.append(sample.piece_sag[~long & matters])
        chosen = long & matters
        if not chosen.any():
            break
        old, reach = len(sample.points), mark + _unseen(sample, search.bend)[chosen]
        sample = sample.halved(chosen)
        order = spatial_order(sample.points[old:])
        back = np.argsort(order)
        new = _measured(motions, sample.points[old:][order], sample.sag[old:][order], reach[order])
        found = found.then(new.ordered(back))
    beyond = int((found.distance < limit - ROUNDING).sum())
    at = int(found.distance.argmin()) if len(found.distance) else -1
    if at < 0 or found.move[at] < 0:
        return None
    place = _Nearest(
        float(found.distance[at]), sample.points[at], int(sample.face[at]), int(found.move[at]),
        float(found.share[at]), beyond,
    )  # fmt: skip
    return _closer(search.to, sample.with_pieces(np.concatenate(closest), np.concatenate(sags)), found.distance, place)


def _closer(motions: Sequence[BodyMotion], sample: MeshSample, distance: Array, place: _Nearest) -> _Nearest:
    """The nearest place, found by halving the nearest pieces on and on; distance: at the points of the sample, (N,)."""

    def nearest_of(sample: MeshSample, distance: Array) -> Integers:
        score = -largest(-distance[sample.pieces]) - sample.longest**2 / _ROUND
        return np.argsort(score, kind="stable")[:_NEAREST]

    chosen, kept = sample.only(nearest_of(sample, distance))
    distance = distance[kept]
    while len(chosen.pieces) and chosen.longest.max() > CLOSEST:
        # Nowhere is it further than from the nearest corner of all, and from there to the place.
        reach = -largest(-distance[chosen.pieces]) + chosen.longest + chosen.piece_sag
        old, chosen = len(chosen.points), chosen.halved(np.ones(len(chosen.pieces), dtype=np.bool_))
        new = _measured(motions, chosen.points[old:], chosen.sag[old:], reach)
        at = int(new.distance.argmin())
        if new.distance[at] < place.distance:
            place = place._replace(
                distance=float(new.distance[at]), point=chosen.points[old + at], face=int(chosen.face[old + at]),
                move=int(new.move[at]), share=float(new.share[at]),
            )  # fmt: skip
        distance = np.concatenate([distance, new.distance])
        chosen, kept = chosen.only(nearest_of(chosen, distance))
        distance = distance[kept]
    return place


def _component(tool: Tool, name: str) -> tuple[Body, ...]:
    if name == "ball":
        return (ball_body(tool),)
    if name == "cone":
        return (cone_body(tool),)
    shank, holder = section_bodies(tool)
    return shank if name == "shank" else holder


def _edges(tool: Tool, component: str) -> tuple[Body, ...]:
    """What lies beside those edges of a component that stand out over what the tool goes on with below or above."""
    cone = ("cone", tool.r_min, tool.r_max, tool.length)
    sections = [
        (name, part.diameter_low / 2.0, part.diameter_high / 2.0, part.length)
        for name, parts in (("shank", tool.shank), ("holder", tool.holder))
        for part in parts
    ]
    parts = [cone, *sections]
    # The ball goes on below the cone, and nothing above the last section.
    below = [tool.r_min, *(part[2] for part in parts[:-1])]
    above = [*(part[1] for part in parts[1:]), 0.0]
    found, low = [], -tool.tip_height
    for (name, r_low, r_high, length), before, after in zip(parts, below, above, strict=True):
        slope, size = (r_high - r_low) / length, min(_EDGE, length)
        if name == component and r_low > before + _SAME_RADIUS:
            found.append(frustum_body("edge", low, r_low, low + size, r_low + slope * size))
        if name == component and r_high > after + _SAME_RADIUS:
            high = low + length
            found.append(frustum_body("edge", high - size, r_high - slope * size, high, r_high))
        low += length
    return tuple(found)


def _reach_box(poses: Poses, tools: list[Tool]) -> tuple[Array, Array]:
    """Box around everything the tools pass through, with a rim."""
    high = max(tool.top - tool.tip_height for tool in tools)
    radius = max(
        max([tool.r_max, *(max(s.diameter_low, s.diameter_high) / 2 for s in (*tool.shank, *tool.holder))])
        for tool in tools
    )
    ends = np.concatenate([poses.tip, poses.tip + high * poses.axis])
    return ends.min(axis=0) - radius - _NEAR, ends.max(axis=0) + radius + _NEAR


@dataclass(frozen=True, slots=True)
class _Judged:
    """What there is to say of a component: how near it comes, the findings, and the deepest cut beside the faces."""

    figures: ClearanceFigures
    findings: tuple[Finding, ...]
    overcut: tuple[float, Place] | None


def _judged(
    scene: Scene, poses: Poses, stretches: list[CutMoves], targets: Sequence[tuple[str, MeshSample]], component: str
) -> _Judged:
    """Check a component against all targets."""
    searches = _searches(stretches, component)
    least, figures = np.inf, ClearanceFigures(None, None)
    findings: list[Finding] = []
    overcut: tuple[float, Place] | None = None
    for target, sample in targets:
        limit = limit_of(component, target, scene)
        found: _Nearest | None = None
        if limit is None:
            continue
        for search in searches:
            near = _nearest(search, sample, limit, least if found is None else min(least, found.distance))
            found = near if found is None or (near is not None and near.distance < found.distance) else found
        if found is None:
            continue
        place = place_of(poses, found.point, found.face, found.move, found.share)
        if found.distance < least:
            least, figures = found.distance, ClearanceFigures(round(found.distance, 6), place)
        if found.distance < limit - ROUNDING:
            findings.append(_finding(poses, component, target, limit, found))
        # Of a design face with an allowance what counts is the face it is left on.
        deep = -found.distance + (scene.job.tolerance.allowance if target == "rest" else 0.0)
        if component in CUTTING and target != "obstacle" and deep > (0.0 if overcut is None else overcut[0]):
            overcut = deep, place
    return _Judged(figures, tuple(findings), overcut)


def _finding(poses: Poses, component: str, target: str, limit: float, found: _Nearest) -> Finding:
    block = int(poses.moves.block[found.move])
    name = f"face {found.face}" if found.face >= 0 else "an obstacle"
    return Finding(
        "CF203" if component in CUTTING and target != "obstacle" else _TOO_NEAR[component],
        f"{component} {found.distance:.3f} mm from {name}, {limit:.3f} mm is the least allowed, block {block}"
        + of_program(poses, found.move),
        block,
        triple(np.round(found.point, 6)),
        round(found.distance, 6),
        round(limit, 6),
        "mm",
        max(found.beyond, 1),
    )


def clearances_of(
    scene: Scene, poses: Poses, stretches: list[CutMoves], targets: Sequence[Target]
) -> tuple[Clearances, list[Finding], tuple[float, Place] | None]:
    """Clearance of every component, its findings, and the deepest overcut into faces that are no design faces."""
    low, high = _reach_box(poses, [stretch.tool for stretch in stretches])
    near = [(target.name, target.stands.near(low, high)) for target in targets]
    stretches = by_tool(stretches)
    # The longest task comes first.
    cone, ball, shank, holder = beside(
        [partial(_judged, scene, poses, stretches, near, name) for name in ("cone", "ball", "shank", "holder")]
    )
    every = (ball, cone, shank, holder)
    cuts = [each.overcut for each in (ball, cone) if each.overcut is not None]
    return (
        Clearances(*(each.figures for each in every)),
        [finding for each in every for finding in each.findings],
        max(cuts, key=lambda cut: cut[0], default=None),
    )


def no_clearances() -> tuple[Clearances, list[Finding], tuple[float, Place] | None]:
    """The same where no pose is known."""
    nothing = ClearanceFigures(None, None)
    return Clearances(nothing, nothing, nothing, nothing), [], None
