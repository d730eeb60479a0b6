"""Least signed distance from points to a moving body of revolution: the swept gap g, and clearances."""

from __future__ import annotations

from dataclasses import dataclass
from math import atan2, cos, hypot, sin

import numpy as np
import numpy.typing as npt

from conflank_cli.cores import spread
from conflank_cli.geometry.kernels.verified_gap import least_distance
from conflank_cli.tool import Section, Tool
from conflank_cli.verification.poses import GROUP, Cells, group_cells, unbroken, with_slack

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

# Fewer points than this are not worth a thread.
WORTH_A_THREAD = 64


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
    begin = np.full(count, start, dtype=np.float64)
    if len(cells.cells) == 0 or count == 0:
        return Nearest(begin, np.full(count, -1, dtype=np.int64), np.zeros(count))
    cells = unbroken(cells)
    table = with_slack(cells.cells, hypot(max(abs(body.low), abs(body.high)), body.radius))
    poses, reaches, wide_poses, wide_reaches = group_cells(table, body.low, body.high, body.radius)
    points = np.ascontiguousarray(points, dtype=np.float64)
    distance, where, tau = np.empty(count), np.empty(count, np.int64), np.empty(count)

    def run(part: slice) -> None:
        least_distance(
            points[part], begin[part], table, poses, reaches, GROUP, wide_poses, wide_reaches, GROUP, body.numbers,
            distance[part], where[part], tau[part],
        )  # fmt: skip

    spread(run, count, WORTH_A_THREAD)
    found = where >= 0
    move = np.where(found, cells.move[where], -1)
    share = np.where(found, cells.begin[where] + tau * cells.width[where], 0.0)
    return Nearest(distance, move, share)


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
