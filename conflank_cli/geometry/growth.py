"""Growth: moves that let a sweep cover more: sliding along the contact, past obstacles too, and going on at an end."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import cos, sin, tan

import numpy as np
import numpy.typing as npt

from conflank_cli.geometry.gap import motion_gap
from conflank_cli.geometry.workface import FaceSamples, WorkFace
from conflank_cli.limits import Limits
from conflank_cli.motion import DEGREE, Motion, fitted
from conflank_cli.tool import Tool

Array = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]

# The furthest slide looked at in one go, mm, and the step it is searched with.
FURTHEST, STEP = 6.0, 0.1
# A window this share of the present one better is worth sliding for.
WORTH = 1.003
# The slide is found at so many times along the sweep, each from the contacts within this much time about it.
NODES, ABOUT = 5, 0.15
# Where a range of slides is equally good, stay so far from its ends if it is wide enough, mm.
INSET = 0.3
# Past what is in the way the slide is found at times so far apart, mm of travel, but at so many at most, in steps of so
# many mm; it stays a step away from what hits.
APART, MOST_TIMES, CLEAR_STEP = 2.0, 41, 0.15
# It changes by no more than this from time to time, as a share of the way in between, so that the cut stays steady; and
# a change by a share x costs so many mm2 x² for each mm of way: a hundredth of what a flute covers there, or two.
STEEPEST, UNEVEN = 0.6, 5.0
# What a millimetre of slide has to bring at each time at least, mm2: what brings nothing is left.
NEEDLESS = 0.01
# Times at which the steadiness of a motion is looked at.
LOOKS = 121


def best_slide(motion: Motion, tool: Tool, samples: FaceSamples, limits: Limits) -> Array:
    """How far (mm, along the axis towards the spindle) to slide so that the flute covers most area, at NODES equal
    times.

    The cone is prolonged at both ends; every point of the face then has a time and a height at which the prolonged cone
    touches it, and the flute is the window of length L over these heights that holds most of the area within tolerance.
    A window's worth is an estimate: what the prolonged cone touches is what the slid tool would, were sliding along the
    contact exact.
    """
    time, height, areas, low = _prolonged_contacts(motion, tool, samples, limits)
    slides = np.arange(-low, FURTHEST + 0.5 * STEP, STEP)
    found = np.zeros(NODES)
    for node, t in enumerate(np.linspace(0.0, 1.0, NODES)):
        near = np.abs(time - t) <= ABOUT
        found[node] = _best_window(height[near], areas[near], tool.length, slides)
    return found


def clear_slide(
    motion: Motion,
    tool: Tool,
    samples: FaceSamples,
    limits: Limits,
    away: Array,
    free: Callable[[Array, Array], BoolArray],
) -> Array:
    """How far (mm, towards the spindle) to slide at equal times so that the flute covers most with nothing in the way.

    Of all ways through the slides that are free at each of the times the one along which the windows of length L hold
    most area in sum, steep changes aside (dynamic programming, Bellman). Where no slide is free at a time, none holds
    anything.

    Parameters
    ----------
    away: as `slid` has it.
    free: which poses hit nothing, (K, S): axis points at height 0 (K, S, 3), S for each of the unit directions (K, 3).
    """
    time, height, areas, low = _prolonged_contacts(motion, tool, samples, limits)
    middle = np.mean(motion.ends(np.linspace(0.0, 1.0, 65)), axis=0)
    length = float(np.linalg.norm(np.diff(middle, axis=0), axis=1).sum())
    count = int(np.clip(np.ceil(length / APART), NODES, MOST_TIMES - 1)) + 1
    times, way = np.linspace(0.0, 1.0, count), length / (count - 1)
    slides = CLEAR_STEP * np.arange(-int(low / CLEAR_STEP), int(FURTHEST / CLEAR_STEP) + 1)

    p, q = motion.ends(times)
    d = (q - p) / np.linalg.norm(q - p, axis=1)[:, None]
    normal = np.stack([np.interp(times, greville(motion), away[:, k]) for k in range(3)], axis=1)
    along = _along_contact(d, normal, tool)
    able = free(p[:, None] + slides[:, None] * along[:, None], d)
    able[:, 1:-1] &= able[:, :-2] & able[:, 2:]

    worth = np.zeros((count, len(slides)))
    for k, t in enumerate(times):
        near = np.flatnonzero(np.abs(time - t) <= 1.0 / (count - 1))
        held = np.sort(height[near])
        total = np.concatenate([[0.0], np.cumsum(areas[near][np.argsort(height[near])])])
        worth[k] = total[np.searchsorted(held, slides + tool.length)] - total[np.searchsorted(held, slides)]
    return np.asarray(slides[_best_way(np.where(able, worth, 0.0) - NEEDLESS * np.abs(slides), way)])


def _best_way(worth: Array, way: float) -> IntArray:
    """Column for each row of a table (K, S) of worths, so that their sum less what changes cost is largest."""
    columns = np.arange(worth.shape[1])
    change = CLEAR_STEP * (columns[:, None] - columns)
    cost = np.where(np.abs(change) <= STEEPEST * way, UNEVEN * change**2 / way, np.inf)
    best, came = worth[0].copy(), np.zeros(worth.shape, dtype=np.int64)
    for k in range(1, len(worth)):
        gain = best[None] - cost
        came[k] = gain.argmax(axis=1)
        best = gain[columns, came[k]] + worth[k]
    path = np.empty(len(worth), dtype=np.int64)
    path[-1] = best.argmax()
    for k in range(len(worth) - 1, 0, -1):
        path[k - 1] = came[k, path[k]]
    return path


def _prolonged_contacts(
    motion: Motion, tool: Tool, samples: FaceSamples, limits: Limits
) -> tuple[Array, Array, Array, float]:
    """Time, height on the flute and area (N,) of the samples that the prolonged cone touches within tolerance.

    And by how much it is prolonged at its low end, mm.
    """
    slope = tan(tool.half_angle)
    low = min(FURTHEST, 0.8 * tool.r_min / slope) if slope > 0.0 else FURTHEST
    long = replace(
        tool, r_min=tool.r_min - low * slope, r_max=tool.r_max + FURTHEST * slope, length=tool.length + low + FURTHEST
    )
    p, q = motion.p, motion.q
    d = (q - p) / tool.length
    prolonged = Motion(motion.knots, p - low * d, q + FURTHEST * d)
    gap, time = motion_gap(prolonged, long, samples.points, limits.allowance)
    inside = (gap >= -limits.over) & (gap <= limits.under)
    time, areas = time[inside], samples.areas[inside]
    start, end = motion.ends(time)
    axis = (end - start) / tool.length
    offset = samples.points[inside] - start
    along = np.einsum("ni,ni->n", offset, axis)
    across = np.linalg.norm(offset - along[:, None] * axis, axis=1)
    alpha = tool.half_angle
    # Height of the contact on the generator, as axial distance from the plane of r_min.
    height = (along * cos(alpha) + (across - tool.r_min) * sin(alpha)) * cos(alpha)
    return time, height, areas, low


def _best_window(height: Array, areas: Array, length: float, slides: Array) -> float:
    """Of the windows [slide, slide + length] over heights that hold most area, the slide nearest to 0."""
    if not len(height):
        return 0.0
    order = np.argsort(height)
    height, total = height[order], np.concatenate([[0.0], np.cumsum(areas[order])])
    worth = total[np.searchsorted(height, slides + length)] - total[np.searchsorted(height, slides)]
    here = total[np.searchsorted(height, length)] - total[np.searchsorted(height, 0.0)]
    if worth.max() <= WORTH * here:
        return 0.0
    best = slides[worth >= worth.max() * (1.0 - 1e-9)]
    inset = min(INSET, 0.5 * (best[-1] - best[0]))
    return float(np.clip(0.0, best[0] + inset, best[-1] - inset))


def slid(motion: Motion, tool: Tool, slides: Array, away: Array) -> Motion:
    """The motion with the tool slid along its contact line.

    slides: mm at equal times, as `best_slide` finds them. away: unit vectors (n, 3) across the contact at the Greville
    times of the control points, from the face to the axis. Along the contact a cone of half angle α moves by
    δ (d - tan α away), so that its flank stays where it was.
    """
    distance = np.interp(greville(motion), np.linspace(0.0, 1.0, len(slides)), slides)[:, None]
    d = (motion.q - motion.p) / np.linalg.norm(motion.q - motion.p, axis=1)[:, None]
    shift = distance * _along_contact(d, away, tool)
    return Motion(motion.knots, motion.p + shift, motion.q + shift)


def _along_contact(d: Array, away: Array, tool: Tool) -> Array:
    """Where a cone goes that slides along its contact by 1 mm of its axis: directions d, normals away, all (N, 3)."""
    across = away - np.einsum("ni,ni->n", away, d)[:, None] * d
    across /= np.linalg.norm(across, axis=1)[:, None]
    return np.asarray(d - tan(tool.half_angle) * across)


def away_from(face: WorkFace, motion: Motion) -> Array:
    """Surface normals towards the cutter at the middle of the flute, one for every control point, (n, 3)."""
    p, q = motion.ends(greville(motion))
    return face.sense * face.projector.project(0.5 * (p + q)).normal


def greville(motion: Motion) -> Array:
    """Times at which the control points of a motion act most, shape (n,)."""
    return np.asarray(np.mean([motion.knots[k : k + len(motion.p)] for k in range(1, DEGREE + 1)], axis=0))


def lengthened(motion: Motion, distance: float, at_end: bool) -> Motion:
    """The motion continued by about `distance` mm of travel at its start or end, with the curvature it has there."""
    t = np.linspace(0.0, 1.0, 8 * len(motion.p))
    place = 1.0 if at_end else 0.0
    value, slope, bend = (np.hstack(motion.ends([place], order)) for order in range(3))
    speed = max(float(np.linalg.norm(slope[0, :3])), float(np.linalg.norm(slope[0, 3:])))
    more = distance / speed
    beyond = np.linspace(0.0, more, max(int(8 * len(motion.p) * more), 4) + 1)[1:, None]
    if not at_end:
        beyond = -beyond[::-1]
    added = value + slope * beyond + 0.5 * bend * beyond**2
    inner = np.hstack(motion.ends(t))
    times = np.concatenate([t, 1.0 + beyond[:, 0]] if at_end else [beyond[:, 0], t])
    both = np.concatenate([inner, added] if at_end else [added, inner])
    return fitted((times - times[0]) / (times[-1] - times[0]), both, round(len(motion.p) * (1.0 + more)))


def steadiness(face: WorkFace, motion: Motion) -> float:
    """How steadily the axis moves across itself: the least share of its velocity that goes across, along the face.

    1 for a motion that is orthogonal to its axis throughout; what slides along its axis has less, and below 0 it swings
    back for a while.
    """
    t = np.linspace(0.0, 1.0, LOOKS)
    (p, q), (slope_p, slope_q) = motion.ends(t), motion.ends(t, 1)
    velocity = 0.5 * (slope_p + slope_q)
    forward = np.cross(q - p, face.projector.project(0.5 * (p + q)).normal)
    share = np.einsum("ni,ni->n", velocity, forward)
    share /= np.linalg.norm(velocity, axis=1) * np.linalg.norm(forward, axis=1)
    return float((share * np.sign(share.sum())).min())
