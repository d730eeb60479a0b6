"""Ways to and from a sweep: which way is off the face, where tools come from, and what is hit on the way."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from conflank_cli.geometry.collision import Collider
from conflank_cli.geometry.footpoint import Projector
from conflank_cli.geometry.screening import Screen
from conflank_cli.posting.ride import PassRide, Ride
from conflank_cli.scene import Scene

Array = npt.NDArray[np.float64]

AWAY_SAMPLES = 9
"""Places along a sweep where the direction away from the face is taken."""
HULL_SAMPLES = 65
"""Rows and columns of points that stand for a face when its size is taken; they also give its border."""
LINK_SHARES = (1.0, 0.5, 0.25, 0.1)
"""Shares of the clearance by which a link stands off the face, tried in this order."""
LINK_LIFTS_DEG = (0.0, 30.0, 60.0, 80.0)
"""Angles by which the shift off the face leans up the tool axis."""
LINK_STEP = 1.0
"""Poses of a link are held against the part this far apart, mm."""


def away_directions(ride: Ride | PassRide, projector: Projector, sense: int) -> Array:
    """Unit directions away from the face and across the axis, at `AWAY_SAMPLES` places along the sweep, (M, 3).

    From the face's nearest point to the axis at mid flute, of a pass to the ball's centre; where the axis runs through
    the surface there (no face is so thin that a sweep does), the surface's normal on the cutter's side.
    """
    tip, axis = ride.poses(np.linspace(0.0, 1.0, AWAY_SAMPLES))
    middle = tip + (ride.tool.ball_radius if isinstance(ride, PassRide) else 0.5 * ride.reach) * axis
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
class SafePlane:
    """Where tools come from: `height` from the centre of all geometry along whatever tool axis."""

    centre: Array
    height: float
    clearance: float

    def links(self, tip: Array, axis: Array, away: Array) -> Iterator[Array]:
        """Ways from the safe plane down beside a pose and to the pose, tip points (3, 3) each, the plainest first.

        Beside the pose means shifted off the face by the clearance. On the way down whatever part of the cutter passes
        a place is thinner than the part that stands there in the end, so it stays clear of what the pose is clear of.
        Where another part of the workpiece is near, a shorter shift that also lifts may still be free.
        """
        for share in LINK_SHARES:
            for lift in np.radians(LINK_LIFTS_DEG):
                beside = tip + share * self.clearance * (np.cos(lift) * away + np.sin(lift) * axis)
                height = max(self.height - float((beside - self.centre) @ axis), self.clearance)
                yield np.stack([beside + height * axis, beside, tip])


def clearest(links: Iterable[Array], axis: Array, ride: Ride | PassRide, screen: Screen, collider: Collider) -> Array:
    """The first link on which nothing is hit, or the one with the fewest hits: verification then names them.

    The screen counts hits at points and poses; a link without any is then held against whole triangles, all the way.
    """
    best, fewest = np.zeros((3, 3)), np.inf
    for link in links:
        down = _points_between(link[1], link[0], LINK_STEP)
        tips = np.concatenate([_points_between(link[2], link[1], LINK_STEP), down])
        axes = np.broadcast_to(axis, tips.shape)
        p = (tips - ride.tool.tip_height * axes - ride.frame.translation) @ ride.frame.rotation
        d = axes @ ride.frame.rotation
        hits = int(np.sum(~screen.free(p, d, ride.tool)))
        if hits == 0:
            corners = [0, len(tips) - len(down), -1]
            hits = int(not collider.path(p[corners], d[corners], ride.tool).clear)
        if hits < fewest:
            best, fewest = link, hits
        if hits == 0:
            break
    return best


def _points_between(start: Array, end: Array, step: float) -> Array:
    """Points on a straight line, at most `step` mm apart, both ends included, (N, 3)."""
    count = int(np.ceil(np.linalg.norm(end - start) / step)) + 1
    return np.asarray(start + np.linspace(0.0, 1.0, max(count, 2))[:, None] * (end - start))


def hull_points(scene: Scene, projectors: Sequence[Projector]) -> Array:
    """Points that stand for all geometry of the scene, CAD frame, (N, 3)."""
    points = [scene.check.vertices.reshape(-1, 3)]
    for face, projector in zip(scene.faces, projectors, strict=True):
        border = np.vstack(face.loops)
        u = np.linspace(border[:, 0].min(), border[:, 0].max(), HULL_SAMPLES)
        v = np.linspace(border[:, 1].min(), border[:, 1].max(), HULL_SAMPLES)
        grid = np.stack(np.meshgrid(u, v, indexing="ij"), axis=-1).reshape(-1, 2)
        places = np.vstack([border, grid])
        points.append(projector.evaluate(places[:, 0], places[:, 1])[:, 0])
    return np.vstack(points)
