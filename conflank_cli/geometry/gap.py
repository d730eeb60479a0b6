"""The swept gap of a motion on points of a face, for the stages that make paths (verification has its own)."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, sin

import numpy as np
import numpy.typing as npt

from conflank_cli.geometry.kernels.cubic import longer_path, span_polynomials
from conflank_cli.geometry.kernels.swept_gap import gap_gradients, swept_gap, swept_gap_near
from conflank_cli.motion import DEGREE, Motion
from conflank_cli.tool import Tool

Array = npt.NDArray[np.float64]

# The first look steps along the sweep by this much, mm: below the radius of any cutter, so that the distance has one
# minimum between neighbours.
STEP = 1.0
# Distances beyond this are reported as the first look found them, mm.
REACH = 0.25
# Chords that the length of a motion is taken from.
CHORDS = 64


@dataclass(frozen=True, slots=True)
class GapField:
    """The swept gap of a motion on points, and how it changes with the motion.

    Attributes
    ----------
    gap: g less allowance, shape (N,), mm.
    time: t of the pose that gives it, shape (N,).
    rows: gradient of g by p(t) and q(t), shape (N, 6); zero on the axis itself, where there is none.
    """

    gap: Array
    time: Array
    rows: Array


def motion_gap(
    motion: Motion, tool: Tool, points: Array, allowance: float = 0.0, reach: float = REACH, step: float = STEP
) -> tuple[Array, Array]:
    """Swept gap g less `allowance` (N,) in mm of points (N, 3), and the time t (N,) of the pose that gives it.

    Where it is above `reach` it is only bounded from above, by the sampled poses. `step` is that of the first look, mm:
    a motion that slows down and turns at an end has minima closer together than the usual one can tell.
    """
    return _whole(*polynomials_of(motion), cutter_of(tool), np.ascontiguousarray(points), allowance, reach, step)


def _whole(
    polynomials: Array, breaks: Array, cutter: Array, points: Array, allowance: float, reach: float, step: float
) -> tuple[Array, Array]:
    gap, time = np.empty(len(points)), np.empty(len(points))
    looks = _looks(polynomials, breaks, step)
    swept_gap(polynomials, breaks, looks, points, allowance + reach, cutter, gap, time)
    return gap - allowance, time


def gap_field(
    motion: Motion, tool: Tool, points: Array, allowance: float = 0.0, start: Array | None = None, reach: float = REACH
) -> GapField:
    """The swept gap with its gradient by the motion (Danskin's theorem: that of the pose that gives it).

    start: times (N,) near which the poses are looked for, from a field of nearly the same motion; without it, or to be
    sure of the least gap, the whole motion is looked at.
    """
    polynomials, breaks = polynomials_of(motion)
    cutter, points = cutter_of(tool), np.ascontiguousarray(points)
    rows = np.empty((len(points), 6))
    if start is None:
        gap, time = _whole(polynomials, breaks, cutter, points, allowance, reach, STEP)
    else:
        gap, time = np.empty(len(points)), start.copy()
        swept_gap_near(polynomials, breaks, 1.0 / _looks(polynomials, breaks, STEP), points, cutter, gap, time)
        gap -= allowance
    gap_gradients(polynomials, breaks, points, time, cutter, rows)
    return GapField(gap, time, rows)


def polynomials_of(motion: Motion) -> tuple[Array, Array]:
    """The motion as the kernels read it: polynomials (spans, 4, 6) in each span's local parameter, breaks."""
    breaks = np.unique(motion.knots)
    polynomials = np.empty((len(breaks) - 1, DEGREE + 1, 6))
    span_polynomials(motion.knots, np.hstack([motion.p, motion.q]), breaks, polynomials)
    return polynomials, breaks


def cutter_of(tool: Tool) -> Array:
    """The cutter as the kernels read it, (6,): r_min, sin α, cos α, length, height and radius of the ball."""
    alpha = tool.half_angle
    return np.array([tool.r_min, sin(alpha), cos(alpha), tool.length, tool.ball_centre_height, tool.ball_radius])


def _looks(polynomials: Array, breaks: Array, step: float) -> int:
    return max(int(np.ceil(longer_path(polynomials, breaks, CHORDS) / step)), 8)


def travel(motion: Motion) -> float:
    """Length of the longer of the two paths of the axis ends, mm."""
    return float(longer_path(*polynomials_of(motion), CHORDS))
