"""Least signed distance from points to a moving body of revolution: the swept gap g, and clearances."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import atan2, cos, hypot, sin, sqrt

import numpy as np
import numpy.typing as npt

from conflank_cli.cores import spread
from conflank_cli.geometry.kernels.verified_gap import least_distance
from conflank_cli.tool import Section, Tool
from conflank_cli.verification.poses import GROUP, Cells, cell_ways, group_cells, unbroken, with_slack

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

# Points that are held against a motion together before each is by itself; and blocks that are worth a thread.
BLOCK, WORTH_A_THREAD = 32, 32
# A parabola through three values at even times goes beyond the largest of them by a quarter at most.
_OF_THREE = 1.25
# What a distance may be off by the kernel's own tolerance and by floating-point noise, mm.
_ROUNDING = 1e-6
# Points are sorted by which of so many cubes along each axis they are in; the numbers of three axes make one.
CUBES = 2**20
# Shifts and masks that move the digits of a number apart, to every third place.
_APART = (
    (32, 0x1F00000000FFFF),
    (16, 0x1F0000FF0000FF),
    (8, 0x100F00F00F00F00F),
    (4, 0x10C30C30C30C30C3),
    (2, 0x1249249249249249),
)


@dataclass(frozen=True, slots=True)
class Body:
    """A convex body of revolution on the tool axis; heights from the tip point, mm.

    Attributes
    ----------
    name: what it is, for messages.
    numbers: (9,), as the kernel reads it.
    low, high, radius: bounds.
    """

    name: str
    numbers: Array
    low: float
    high: float
    radius: float


def cutting_body(tool: Tool) -> Body:
    """Ball and cone as one, closed by the disc of r_max."""
    base = -tool.tip_height
    alpha = tool.half_angle
    numbers = np.array(
        [
            0.0,
            tool.ball_radius,
            tool.ball_radius,
            tool.r_min,
            base,
            sin(alpha),
            cos(alpha),
            tool.r_max,
            base + tool.length,
        ]
    )
    return Body("cutter", numbers, 0.0, base + tool.length, max(tool.r_max, tool.ball_radius))


def ball_body(tool: Tool) -> Body:
    """The ball alone."""
    numbers = np.zeros(9)
    numbers[:3] = 2.0, tool.ball_radius, tool.ball_radius
    return Body("ball", numbers, 0.0, 2.0 * tool.ball_radius, tool.ball_radius)


def frustum_body(name: str, low: float, r_low: float, high: float, r_high: float) -> Body:
    """A solid frustum between two heights."""
    slope = atan2(r_high - r_low, high - low)
    numbers = np.array([1.0, low, r_low, high, r_high, sin(slope), cos(slope), 0.0, 0.0])
    return Body(name, numbers, low, high, max(r_low, r_high))


def cone_body(tool: Tool) -> Body:
    """The cone alone, with the disc of r_min at its low end."""
    base = -tool.tip_height
    return frustum_body("cone", base, tool.r_min, base + tool.length, tool.r_max)


def section_bodies(tool: Tool) -> tuple[tuple[Body, ...], tuple[Body, ...]]:
    """Bodies of the shank and of the holder."""

    def stack(name: str, sections: tuple[Section, ...], low: float) -> tuple[tuple[Body, ...], float]:
        bodies = []
        for section in sections:
            high = low + section.length
            bodies.append(frustum_body(name, low, section.diameter_low / 2, high, section.diameter_high / 2))
            low = high
        return tuple(bodies), low

    shank, top = stack("shank", tool.shank, tool.length - tool.tip_height)
    holder, _ = stack("holder", tool.holder, top)
    return shank, holder


@dataclass(frozen=True, slots=True)
class Nearest:
    """Least distances, N points.

    Attributes
    ----------
    distance: (N,) mm.
    move: (N,) the move in which it occurs, -1 where the start value was not beaten.
    share: (N,) at which share of that move.
    """

    distance: Array
    move: Integers
    share: Array


@dataclass(frozen=True, slots=True)
class Below:
    """Those K of N points that a body comes near to.

    Attributes
    ----------
    chosen: (K,) which they are, ascending.
    distance: (K,) mm.
    move, share: (K,) the move in which it occurs, and at which share of it.
    """

    chosen: Integers
    distance: Array
    move: Integers
    share: Array

    def only(self, kept: npt.NDArray[np.bool_]) -> Below:
        """Those of them (K,) that are kept."""
        return Below(self.chosen[kept], self.distance[kept], self.move[kept], self.share[kept])


@dataclass(frozen=True, slots=True)
class BodyMotion:
    """A continuous motion as a body feels it, made ready for the kernel.

    Attributes
    ----------
    body: the body.
    cells: the motion, every unbroken run filled up to whole wide groups.
    table: the same with the slack of the body.
    ways, joined, groups: what the kernel asks of cells and of groups of them.
    """

    body: Body
    cells: Cells
    table: Array
    ways: Array
    joined: npt.NDArray[np.bool_]
    groups: tuple[Array, Array, Array, Array]
    box: tuple[Array, Array]

    @classmethod
    def of(cls, cells: Cells, body: Body) -> BodyMotion:
        """Prepare a motion, of at least one cell."""
        cells = unbroken(cells)
        table = with_slack(cells.cells, hypot(max(abs(body.low), abs(body.high)), body.radius))
        size = body.low, body.high, body.radius
        return cls(body, cells, table, *cell_ways(table, *size), group_cells(table, *size), _box_of(table, *size))

    def below(self, points: Array, start: Array) -> Below:
        """The points (N, 3) that the body comes nearer to than `start` (N,), exactly, and where.

        It is quick where points next to each other in the array are close together: see `spatial_order`.
        """
        low, high = self.box
        # What lies outside of the box around the whole motion is as far from the body as from that at least.
        outside = np.maximum(np.maximum(low - points, points - high), 0.0)
        away = np.einsum("ij,ij->i", outside, outside)
        within = np.flatnonzero((away == 0.0) | (away < np.square(np.maximum(start, 0.0))))
        if not len(within):
            return Below(within, np.zeros(0), within, np.zeros(0))
        points, start = np.ascontiguousarray(points[within]), np.ascontiguousarray(start[within])
        count = len(points)
        distance, where, tau = np.empty(count), np.empty(count, np.int64), np.empty(count)

        def run(blocks: slice) -> None:
            part = slice(blocks.start * BLOCK, blocks.stop * BLOCK)
            least_distance(
                points[part], start[part], BLOCK, self.table, self.ways, self.joined, *self.groups, GROUP,
                self.body.numbers, distance[part], where[part], tau[part],
            )  # fmt: skip

        spread(run, -(-count // BLOCK), WORTH_A_THREAD)
        chosen = np.flatnonzero(where >= 0)
        cell, at = where[chosen], tau[chosen]
        # Where a move begins the one before ends: that one is said to be it.
        back = (at == 0.0) & (cell > 0) & self.joined[cell - 1]
        cell, at = np.where(back, cell - 1, cell), np.where(back, 1.0, at)
        share = self.cells.begin[cell] + at * self.cells.width[cell]
        return Below(within[chosen], distance[chosen], self.cells.move[cell], share)


def _box_of(table: Array, low: float, high: float, radius: float) -> tuple[Array, Array]:
    """Corners of a box that holds a body (heights low .. high, radius) all along its cells (M, 16)."""
    tips, axes = table[:, 0:3], table[:, 6:9]
    ends = [
        tip + height * axis
        for tip, axis in ((tips, axes), (tips + table[:, 3:6], axes + table[:, 9:12]))
        for height in (low, high)
    ]
    bow = float(np.linalg.norm(table[:, 12:15], axis=1).max()) * max(abs(low), abs(high))
    rim = radius + bow + _ROUNDING
    return np.min([end.min(axis=0) for end in ends], axis=0) - rim, np.max(
        [end.max(axis=0) for end in ends], axis=0
    ) + rim


def nearest(points: Array, cells: Cells, body: Body, start: Array | float = np.inf) -> Nearest:
    """Least signed distance from points to a body over a continuous motion, and where on the program it occurs.

    Parameters
    ----------
    points: (N, 3) mm, in the frame of the cells.
    cells: the motion.
    body: the body.
    start: distances from which on a point does not matter, (N,) or one for all; what is not below it stays at it.

    Returns
    -------
    Exact to 0.001 um over the poses of the cells (golden tests: a dense search of poses).
    """
    count = len(points)
    if len(cells.cells) == 0 or count == 0:
        return Nearest(np.full(count, start, dtype=np.float64), np.full(count, -1, dtype=np.int64), np.zeros(count))
    points = np.asarray(points, dtype=np.float64)
    result = Nearest(np.full(count, start, dtype=np.float64), np.full(count, -1, dtype=np.int64), np.zeros(count))
    order = spatial_order(points)
    found = BodyMotion.of(cells, body).below(points[order], result.distance[order])
    chosen = order[found.chosen]
    result.distance[chosen], result.move[chosen], result.share[chosen] = found.distance, found.move, found.share
    return result


@dataclass(frozen=True, slots=True)
class EitherMotion:
    """The motions of a body that a program may mean, whose cells have the same tips, made ready for the kernel.

    Attributes
    ----------
    motions: each of them.
    turn: the most that their axes are apart, as the length of a vector.
    """

    motions: tuple[BodyMotion, ...]
    turn: float

    @classmethod
    def of(cls, ways: Sequence[Cells], body: Body) -> EitherMotion:
        """Prepare motions."""
        # Not nothing: that times no limit would be no number.
        turn = max((_turn_between(ways[0], other) for other in ways[1:]), default=0.0)
        return cls(tuple(BodyMotion.of(cells, body) for cells in ways), max(turn, float(np.finfo(np.float64).tiny)))

    def below(self, points: Array, start: Array) -> list[Below]:
        """As `BodyMotion.below`, for each of the motions.

        The axis of the body in the second is turned by little against that in the first. A point y from the tip is, for
        a turn by at most w, nearer or further by at most w |y|: so the first tells which points matter to the second at
        all, and what is to be beaten there.
        """
        if len(self.motions) < 2:
            return [motion.below(points, start) for motion in self.motions]
        body = self.motions[0].body
        reach = hypot(max(abs(body.low), abs(body.high)), body.radius)

        def with_turn(distance: Array) -> Array:
            return np.asarray(distance + self.turn * (reach + np.maximum(distance, 0.0)) + _ROUNDING)

        first = self.motions[0].below(points, with_turn(start))
        near, limit = points[first.chosen], start[first.chosen]
        begin = np.minimum(limit, with_turn(first.distance))
        result = [first.only(first.distance < limit)]
        for motion in self.motions[1:]:
            own = motion.below(near, begin)
            result.append(replace(own, chosen=first.chosen[own.chosen]))
        return result


def _turn_between(one: Cells, other: Cells) -> float:
    """The most that the axes of two motions with the same tips, cell by cell, are apart, as the length of a vector."""
    differ = one.cells - other.cells
    begin, end = differ[:, 6:9], differ[:, 6:9] + differ[:, 9:12]
    middle = 0.5 * (begin + end) + differ[:, 12:15]
    most = max(float(np.einsum("ij,ij->i", at, at).max(initial=0.0)) for at in (begin, middle, end))
    return _OF_THREE * sqrt(most)


def spatial_order(points: Array) -> Integers:
    """Indices (N,) that put points (N, 3) in an order in which successive ones are close together.

    Source: Morton (1966): by the digits of their coordinates' cubes, taken in turn.
    """
    low = points.min(axis=0, initial=np.inf)
    size = float((points.max(axis=0, initial=-np.inf) - low).max()) if len(points) else 0.0
    digits = ((points - low) * ((CUBES - 1) / max(size, 1e-300))).astype(np.int64)
    for shift, mask in _APART:
        digits = (digits | digits << shift) & mask
    return np.argsort(digits[:, 0] | digits[:, 1] << 1 | digits[:, 2] << 2, kind="stable")


def distance_to_cutter(tool: Tool, points: Array, tip: Array, axis: Array) -> Array:
    """Signed distance from points (..., 3) to ball and cone at poses tip, axis (..., 3): the kernel's plain twin."""
    offset = points - tip
    height = np.sum(offset * axis, axis=-1) + tool.tip_height
    radius = np.linalg.norm(offset - np.sum(offset * axis, axis=-1)[..., None] * axis, axis=-1)
    alpha = tool.half_angle
    along = (radius - tool.r_min) * sin(alpha) + height * cos(alpha)
    across = (radius - tool.r_min) * cos(alpha) - height * sin(alpha)
    ball = np.hypot(radius, height - tool.ball_centre_height) - tool.ball_radius
    side = np.where(along < 0.0, ball, across)
    rim = np.hypot(radius - tool.r_max, height - tool.length)
    within = np.maximum(side, height - tool.length)
    beyond = along > hypot(tool.length, tool.r_max - tool.r_min)
    above = (height > tool.length) & (radius <= tool.r_max)
    return np.asarray(np.where(above, height - tool.length, np.where(beyond, rim, within)))
