"""Least signed distance from points to a moving body of revolution: the swept gap g, and clearances."""

from __future__ import annotations

from dataclasses import dataclass
from math import atan2, cos, hypot, sin

import numpy as np
import numpy.typing as npt

from conflank_cli.cores import spread
from conflank_cli.geometry.kernels.verified_gap import least_distance
from conflank_cli.tool import Section, Tool
from conflank_cli.verification.poses import GROUP, Cells, cell_ways, group_cells, unbroken, with_slack

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

# Points that are held against a motion together before each is by itself; and blocks that are worth a thread.
BLOCK, WORTH_A_THREAD = 32, 8
# Points are sorted by which of so many cubes along each axis they are in; a power of two.
CUBES = 1024


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

    @classmethod
    def of(cls, cells: Cells, body: Body) -> BodyMotion:
        """Prepare a motion, of at least one cell."""
        cells = unbroken(cells)
        table = with_slack(cells.cells, hypot(max(abs(body.low), abs(body.high)), body.radius))
        size = body.low, body.high, body.radius
        return cls(body, cells, table, *cell_ways(table, *size), group_cells(table, *size))

    def nearest(self, points: Array, start: Array | float = np.inf) -> Nearest:
        """As `nearest`."""
        count = len(points)
        order = spatial_order(points)
        ordered = np.ascontiguousarray(points[order])
        begin = np.full(count, start, dtype=np.float64)[order]
        distance, where, tau = np.empty(count), np.empty(count, np.int64), np.empty(count)

        def run(blocks: slice) -> None:
            part = slice(blocks.start * BLOCK, blocks.stop * BLOCK)
            least_distance(
                ordered[part], begin[part], BLOCK, self.table, self.ways, self.joined, *self.groups, GROUP,
                self.body.numbers, distance[part], where[part], tau[part],
            )  # fmt: skip

        spread(run, -(-count // BLOCK), WORTH_A_THREAD)
        found = where >= 0
        result = Nearest(np.empty(count), np.empty(count, np.int64), np.empty(count))
        result.distance[order] = distance
        result.move[order] = np.where(found, self.cells.move[where], -1)
        result.share[order] = np.where(found, self.cells.begin[where] + tau * self.cells.width[where], 0.0)
        return result


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
    return BodyMotion.of(cells, body).nearest(np.asarray(points, dtype=np.float64), start)


def spatial_order(points: Array) -> Integers:
    """Indices (N,) that put points (N, 3) in an order in which successive ones are close together.

    Source: Morton (1966): by the digits of their coordinates' cubes, taken in turn.
    """
    low = points.min(axis=0)
    size = float((points.max(axis=0) - low).max())
    cube = ((points - low) * ((CUBES - 1) / max(size, 1e-300))).astype(np.int64)
    code = np.zeros(len(points), dtype=np.int64)
    for digit in range(CUBES.bit_length() - 1):
        for axis in range(3):
            code |= ((cube[:, axis] >> digit) & 1) << (3 * digit + axis)
    return np.argsort(code, kind="stable")


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
