"""Growth: sliding the tool along its contact to where the flute covers most of the face."""

from __future__ import annotations

from dataclasses import replace
from math import cos, sin, tan

import numpy as np
import numpy.typing as npt

from conflank_cli.geometry.gap import motion_gap
from conflank_cli.geometry.workface import FaceSamples
from conflank_cli.motion import Motion
from conflank_cli.tool import Tool

Array = npt.NDArray[np.float64]

# The furthest slide looked at in one go, mm, and the step it is searched with.
FURTHEST, STEP = 6.0, 0.1
# A window this share of the present one better is worth sliding for.
WORTH = 1.003


def covered_area(
    motion: Motion, tool: Tool, samples: FaceSamples, over: float, under: float, allowance: float
) -> float:
    """Area in mm2 that a motion leaves within tolerance; less than nothing is left where it overcuts: then 0."""
    gap = motion_gap(motion, tool, samples.points)[0] - allowance
    if gap.min() < -over:
        return 0.0
    return float(samples.areas[gap <= under].sum())


def best_slide(motion: Motion, tool: Tool, samples: FaceSamples, over: float, under: float, allowance: float) -> float:
    """How far (mm, along the axis towards the spindle) to slide so that the flute covers most area.

    The cone is prolonged at both ends; every point of the face then has a height at which the prolonged cone touches it, and the
    flute is the window of length L over these heights that holds most of the area within tolerance. A window's worth is an
    estimate: what the prolonged cone touches is what the slid tool would, were sliding along the contact exact.
    """
    slope = tan(tool.half_angle)
    low = min(FURTHEST, 0.8 * tool.r_min / slope) if slope > 0.0 else FURTHEST
    long = replace(
        tool, r_min=tool.r_min - low * slope, r_max=tool.r_max + FURTHEST * slope, length=tool.length + low + FURTHEST
    )
    p, q = motion.p, motion.q
    d = (q - p) / tool.length
    prolonged = Motion(motion.knots, p - low * d, q + FURTHEST * d)
    gap, time = motion_gap(prolonged, long, samples.points)
    gap = gap - allowance
    inside = (gap >= -over) & (gap <= under)
    if not inside.any():
        return 0.0
    start, end = motion.ends(time[inside])
    axis = (end - start) / tool.length
    offset = samples.points[inside] - start
    along = np.einsum("ni,ni->n", offset, axis)
    across = np.linalg.norm(offset - along[:, None] * axis, axis=1)
    alpha = tool.half_angle
    # Height of the contact on the generator, as axial distance from the plane of r_min.
    height = (along * cos(alpha) + (across - tool.r_min) * sin(alpha)) * cos(alpha)
    order = np.argsort(height)
    height, area = height[order], np.concatenate([[0.0], np.cumsum(samples.areas[inside][order])])
    slides = np.arange(-low, FURTHEST + 0.5 * STEP, STEP)
    worth = area[np.searchsorted(height, slides + tool.length)] - area[np.searchsorted(height, slides)]
    here = area[np.searchsorted(height, tool.length)] - area[np.searchsorted(height, 0.0)]
    if worth.max() <= WORTH * here:
        return 0.0
    # Of equally good windows the middle one leaves room at both ends.
    best = slides[worth >= worth.max() * (1.0 - 1e-9)]
    return float(best[len(best) // 2])


def slid(motion: Motion, tool: Tool, distance: float, away: Array) -> Motion:
    """The motion with the tool slid `distance` mm along its contact line.

    away: unit vectors (n, 3) across the contact at the control points, from the face to the axis. Along the contact
    a cone of half angle α moves by δ (d - tan α · away), so that its flank stays where it was.
    """
    d = (motion.q - motion.p) / np.linalg.norm(motion.q - motion.p, axis=1)[:, None]
    across = away - np.einsum("ni,ni->n", away, d)[:, None] * d
    across /= np.linalg.norm(across, axis=1)[:, None]
    shift = distance * (d - tan(tool.half_angle) * across)
    return Motion(motion.knots, motion.p + shift, motion.q + shift)
