"""The swept gap of a motion on points of a face, for the stages that make paths (verification has its own)."""

from __future__ import annotations

from math import cos, factorial, sin

import numpy as np
import numpy.typing as npt
from scipy.interpolate import BSpline

from conflank_cli.geometry.kernels.swept_gap import swept_gap
from conflank_cli.motion import DEGREE, Motion
from conflank_cli.tool import Tool

Array = npt.NDArray[np.float64]

# The first look steps along the sweep by this much, mm: below the radius of any cutter, so that the distance has one
# minimum between neighbours.
STEP = 1.0
# Distances beyond this are reported as the first look found them, mm.
REACH = 0.25


def motion_gap(
    motion: Motion, tool: Tool, points: Array, allowance: float = 0.0, reach: float = REACH, step: float = STEP
) -> tuple[Array, Array]:
    """Swept gap g less `allowance` (N,) in mm of points (N, 3), and the time t (N,) of the pose that gives it.

    Where it is above `reach` it is only bounded from above, by the sampled poses. `step` is that of the first look, mm:
    a motion that slows down and turns at an end has minima closer together than the usual one can tell.
    """
    breaks = np.unique(motion.knots)
    spline = BSpline(motion.knots, np.hstack([motion.p, motion.q]), DEGREE)
    width = np.diff(breaks)[:, None]
    polynomials = np.stack(
        [spline(breaks[:-1], nu=order) * width**order / factorial(order) for order in range(DEGREE + 1)], axis=1
    )
    samples = max(int(np.ceil(travel(motion) / step)), 8)
    alpha = tool.half_angle
    cutter = np.array([tool.r_min, sin(alpha), cos(alpha), tool.length, tool.ball_centre_height, tool.ball_radius])
    gap, time = np.empty(len(points)), np.empty(len(points))
    swept_gap(polynomials, breaks, samples, np.ascontiguousarray(points), allowance + reach, cutter, gap, time)
    return gap - allowance, time


def travel(motion: Motion) -> float:
    """Length of the longer of the two paths of the axis ends, mm."""
    p, q = motion.ends(np.linspace(0.0, 1.0, 65))
    return float(max(np.linalg.norm(np.diff(x, axis=0), axis=1).sum() for x in (p, q)))
