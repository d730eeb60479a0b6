"""Ways to and from a sweep: which way is off the face, where tools come from, and what is hit on the way."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from math import asin

import numpy as np
import numpy.typing as npt
from scipy.spatial import ConvexHull, QhullError

from conflank_cli.geometry.collision import REACH, Collider
from conflank_cli.geometry.footpoint import Projector
from conflank_cli.geometry.screening import Screen
from conflank_cli.geometry.workface import COARSE, WorkFace
from conflank_cli.machine_frame import copy_rotation
from conflank_cli.posting.ride import PassRide, Ride, great_circle
from conflank_cli.scene import Scene
from conflank_cli.tool import Tool

Array = npt.NDArray[np.float64]

AWAY_SAMPLES = 9
"""Places along a sweep where the direction away from the face is taken."""
MOST_COPIES = 360
"""Copies that stand for a pattern of more where its size is taken: it is short by 4e-5 of its radius at most."""
HULL_SAMPLES = 65
"""Rows and columns of points that stand for a face when its size is taken; they also give its border."""
LINK_SHARES = (1.0, 0.5, 0.25, 0.1)
"""Shares of the clearance that are tried, in this order, as the radius of an arc or the distance off the face."""
LINK_LIFTS_DEG = (0.0, 30.0, 60.0, 80.0)
"""Angles by which the shift off the face leans up the tool axis."""
ARC_BLOCKS = 12
"""Blocks of an approach or retract arc of 90 degrees: it leaves the circle by 0.2 % of its radius, to the inside."""
LINK_TURN = np.radians(2.0)
"""Largest turn of the axis in one block of a link between two cuts."""
LINK_CHECKS = 4
"""Poses within such a block that are looked at where its rotary axes move evenly."""
HOPS = (0.0, 1.0, 2.0, 4.0, 8.0)
"""Times the clearance by which a link between two cuts lifts along the tool axis, in the order they are tried."""
KEPT = 0.5
"""Share of the distance off everything at the nearer end of a link that the cutter keeps on all of it: stock that the
collision check knows nothing of is left there."""
LINK_STEP = 1.0
"""Poses of a link are held against the part this far apart, mm."""


def away_directions(ride: Ride | PassRide, projector: Projector, sense: int) -> Array:
    """Unit directions away from the face and across the axis, at `AWAY_SAMPLES` places along the sweep, (M, 3).

    From the face's nearest point to the axis at the middle of what cuts; where the axis runs through the surface there
    (no face is so thin that a sweep does), the surface's normal on the cutter's side.
    """
    tip, axis = ride.poses(np.linspace(0.0, 1.0, AWAY_SAMPLES))
    middle = tip + ride.contact[0] * axis
    # Projection happens in the CAD frame, where the surface is.
    foot = projector.project((middle - ride.frame.translation) @ ride.frame.rotation)
    normal = sense * ride.frame.directions(foot.normal)
    away = middle - ride.frame.points(foot.foot)
    away = np.where(np.linalg.norm(away, axis=1, keepdims=True) > 0.1 * ride.tool.r_min, away, normal)
    away -= np.einsum("ij,ij->i", away, axis)[:, None] * axis
    return np.asarray(away / np.linalg.norm(away, axis=1, keepdims=True))


def is_climb(ride: Ride, away: Array) -> bool:
    """Whether the sweep climb-mills with a spindle that turns clockwise seen from above (M3).

    The spindle turns about -d (d from tip to spindle), so the edge at the contact, -a from the axis (a away from the
    face), runs along (-d) x (-a) = d x a. Climb milling means that it runs against the feed f there: f . (a x d) > 0.
    With d up, feed north and the face to the east (a = west), a x d is north: the material lies to the right.
    """
    tip, axis = ride.poses(np.linspace(0.0, 1.0, len(away)))
    middle = tip + 0.5 * ride.reach * axis
    step = np.diff(middle, axis=0)
    forth = np.cross(away, axis)
    return float(np.einsum("ij,ij->", step, 0.5 * (forth[1:] + forth[:-1]))) > 0.0


@dataclass(frozen=True, slots=True)
class Link:
    """A way from the safe plane to the first pose of a cut, or from its last pose back when read from the end.

    tip, axis: poses, each (N, 3); the first two are the safe plane and the place beside the face.
    """

    tip: Array
    axis: Array


@dataclass(frozen=True, slots=True)
class SafePlane:
    """Where tools come from: `height` from the centre of all geometry along whatever tool axis."""

    centre: Array
    height: float
    clearance: float

    def links(self, ride: Ride | PassRide, after: bool, away: Array) -> Iterator[Sequence[Link]]:
        """Ways from the safe plane down beside the first (or last) pose of a cut and to it, the best first.

        They come in groups that are worth looking at together.

        The way to the pose is a quarter circle: the cut is taken up as if it had begun earlier, so that feed and swing
        are those of the cut, and the tool comes off the face by a radius. On the way down to it, along the axis,
        whatever part of the cutter passes a place is thinner than the part that stands there in the end. Where another
        part of the workpiece is near, a smaller arc or one that also lifts may still be free; in the last place come
        straight ways off the face.
        """
        for share in LINK_SHARES:
            arcs = self._arcs(ride, after, away, share * self.clearance)
            # Mostly the first of all is free.
            if share == LINK_SHARES[0]:
                yield arcs[:1]
                arcs = arcs[1:]
            yield arcs
        yield from self.straight(ride, after, away)

    def straight(self, ride: Ride | PassRide, after: bool, away: Array) -> Iterator[Sequence[Link]]:
        """The last of these: straight off the face, and the axis stands still."""
        tip, axis = ride.beyond(np.zeros(2), after)
        for share in LINK_SHARES:
            way = np.array([[share * self.clearance], [0.0]])
            yield [self._from_above(tip + way * off, axis) for off in _leaning(away, axis[0])]

    def _arcs(self, ride: Ride | PassRide, after: bool, away: Array, radius: float) -> list[Link]:
        angle = np.linspace(0.5 * np.pi, 0.0, ARC_BLOCKS + 1)
        tip, axis = ride.beyond(radius * np.sin(angle), after)
        way = radius * (1.0 - np.cos(angle))[:, None]
        return [self._from_above(tip + way * off, axis) for off in _leaning(away, axis[-1])]

    def _from_above(self, tip: Array, axis: Array) -> Link:
        height = max(self.height - float((tip[0] - self.centre) @ axis[0]), self.clearance)
        return Link(np.vstack([tip[:1] + height * axis[:1], tip]), np.vstack([axis[:1], axis]))


def _leaning(away: Array, axis: Array) -> list[Array]:
    """Directions off the face, (3,), from the one across the axis on more and more up the axis."""
    return [np.cos(lift) * away + np.sin(lift) * axis for lift in np.radians(LINK_LIFTS_DEG)]


def clearest(groups: Iterable[Sequence[Link]], ride: Ride | PassRide, screen: Screen, collider: Collider) -> Link:
    """The first link on which nothing is hit, or the one with the fewest hits: verification then names them.

    The screen counts hits at points and poses; a link without any is then held against whole triangles, all the way.
    """
    best, fewest = None, np.inf
    for links in groups:
        poses = [_along(link) for link in links]
        tips, axes = (np.concatenate(part) for part in zip(*poses, strict=True))
        hit = ~screen.free(*_in_cad(ride, tips, axes), ride.tool)
        borders = np.cumsum([len(tip) for tip, _ in poses])[:-1]
        for link, own in zip(links, np.split(hit, borders), strict=True):
            hits = int(np.sum(own))
            if hits == 0:
                hits = int(not collider.path(*_in_cad(ride, link.tip, link.axis), ride.tool).clear)
            if hits == 0:
                return link
            if hits < fewest:
                best, fewest = link, hits
    assert best is not None
    return best


def near_links(start: Link, end: Link, lift: float) -> Iterator[Link]:
    """Ways from beside the face after one cut to beside the face before the next, the shortest first.

    Straight over, or up along the axis, over and down. `start` is read from the end, as ways out are; `lift` is the
    least lift, mm. Only those that are shorter than up to the safe plane and down again.
    """
    full = sum(float(np.linalg.norm(link.tip[1] - link.tip[0])) for link in (start, end))
    ends = np.vstack([start.tip[1], end.tip[1]])
    axes = np.vstack([start.axis[1], end.axis[1]])
    for hop in HOPS:
        corners = ends + hop * lift * axes
        tip = corners if hop == 0.0 else np.vstack([ends[:1], corners, ends[1:]])
        axis = axes if hop == 0.0 else np.repeat(axes, 2, axis=0)
        if float(np.linalg.norm(np.diff(tip, axis=0), axis=1).sum()) >= full:
            return
        yield _in_blocks(Link(tip, axis))


def _in_blocks(link: Link) -> Link:
    """The same way with the axis on great circles, in blocks that turn it by `LINK_TURN` at most."""
    tips, axes = [link.tip[:1]], [link.axis[:1]]
    for index in range(len(link.tip) - 1):
        # Twice the arc sine of half the chord is the angle.
        turn = 2.0 * asin(min(0.5 * float(np.linalg.norm(link.axis[index + 1] - link.axis[index])), 1.0))
        share = np.linspace(0.0, 1.0, int(np.ceil(turn / LINK_TURN)) + 1 if turn > LINK_TURN else 2)[1:, None]
        tips.append(link.tip[index] + share * (link.tip[index + 1] - link.tip[index]))
        axes.append(great_circle(link.axis[index], link.axis[index + 1], share))
    return Link(np.vstack(tips), np.vstack(axes))


def is_free(link: Link, ride: Ride | PassRide, screen: Screen, collider: Collider) -> bool:
    """Whether nothing is hit on a link between two cuts, and the cutter stays off everything on all of it."""
    p, d = _in_cad(ride, *_along(link))
    if not screen.free(p, d, ride.tool).all():
        return False
    kept = KEPT * float(_off(collider, p[[0, -1]], d[[0, -1]], ride.tool, np.inf).min())
    if float(_off(collider, p, d, ride.tool, kept).min()) < kept:
        return False
    return collider.path(*_in_cad(ride, link.tip, link.axis), ride.tool).clear


def _off(collider: Collider, p: Array, d: Array, tool: Tool, most: float) -> Array:
    """How far the cutter is off everything at poses (N, 3), mm, where that is less than `most`; else it may be inf."""
    if not collider.bodies:
        return np.full(len(p), np.inf)
    # What is looked for is slack: so much more than the least that a body allows.
    least = min(body.margins.cutter for body in collider.bodies)
    found = collider.poses(p, d, tool, min(most - least, REACH))
    # The first two components are what cuts: ball and cone.
    return np.asarray(found.clearance[:, :2].min(axis=1))


def _in_cad(ride: Ride | PassRide, tip: Array, axis: Array) -> tuple[Array, Array]:
    """Axis points at height 0 and directions in the CAD frame, of poses (N, 3) in that of the program."""
    p = (tip - ride.tool.tip_height * axis - ride.frame.translation) @ ride.frame.rotation
    return p, axis @ ride.frame.rotation


def _along(link: Link) -> tuple[Array, Array]:
    """Poses of a link, at most `LINK_STEP` mm apart at the tip, those at both ends of every block among them."""
    way = np.diff(link.tip, axis=0)
    steps = np.maximum(np.ceil(np.linalg.norm(way, axis=1) / LINK_STEP).astype(np.int64), 1)
    block = np.repeat(np.arange(len(way)), steps + 1)
    number = np.arange(len(block)) - np.repeat(np.cumsum(steps + 1) - steps - 1, steps + 1)
    share = (number / steps[block])[:, None]
    axes = (1.0 - share) * link.axis[block] + share * link.axis[block + 1]
    return link.tip[block] + share * way[block], np.asarray(axes / np.linalg.norm(axes, axis=1, keepdims=True))


def hull_points(scene: Scene, projectors: Sequence[Projector]) -> Array:
    """Points whose convex hull holds all geometry of the scene, CAD frame, (N, 3).

    The part in all its copies, whether they are cut or not, and the obstacles, which stay where they are.
    """
    foreign = np.zeros(len(scene.check.vertices), dtype=np.bool_)
    foreign[scene.check.triangles[scene.check.face < 0]] = True
    points = [scene.check.vertices[~foreign]]
    points += [WorkFace.of(face, 0.0).samples(COARSE).points for face in scene.rest]
    for face, projector in zip(scene.faces, projectors, strict=True):
        border = np.vstack(face.loops)
        u = np.linspace(border[:, 0].min(), border[:, 0].max(), HULL_SAMPLES)
        v = np.linspace(border[:, 1].min(), border[:, 1].max(), HULL_SAMPLES)
        grid = np.stack(np.meshgrid(u, v, indexing="ij"), axis=-1).reshape(-1, 2)
        places = np.vstack([border, grid])
        points.append(projector.evaluate(places[:, 0], places[:, 1])[:, 0])
    part = _corners(np.vstack(points))
    copies = scene.job.setup.copies
    # Copies closer together than this leave no gap that matters between their hulls.
    numbers = {*range(0, copies.count, max(1, copies.count // MOST_COPIES)), *copies.order}
    turned = [part @ copy_rotation(copies, number).T for number in sorted(numbers)]
    return _corners(np.vstack([*turned, scene.check.vertices[foreign]]))


def _corners(points: Array) -> Array:
    """Corners of the convex hull of points (N, 3); all of them where they lie in a plane."""
    try:
        return np.ascontiguousarray(points[ConvexHull(points).vertices])
    except QhullError:
        return points
