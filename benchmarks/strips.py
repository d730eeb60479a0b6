"""A whole face by strips, each cut by one sweep of a method that follows rulings: what sweeps by the dozen reach.

A face is divided into equal strips across the lines that the flute lies along, and where a strip is wider than the
flute only its middle is asked of the method. Which isoparametric lines serve as rulings, and which way the tool points,
is chosen for the method by what covers most, as someone who programs by hand would after trying all. Nothing around
the face is looked at, so the methods may cut with tools that would not get there.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
import numpy.typing as npt

from benchmarks.positioning import Rails, three_points, two_points
from benchmarks.ruling_following import Band, ruling_following
from conflank_cli.geometry.gap import motion_gap
from conflank_cli.geometry.workface import FaceSamples, WorkFace
from conflank_cli.motion import Motion
from conflank_cli.tool import Tool

Array = npt.NDArray[np.float64]
Method = Callable[[WorkFace, Tool, Band], Motion]
Way = tuple[Literal["u", "v"], bool]

METHODS: dict[str, Method] = {
    "following the rulings": ruling_following,
    "two points": two_points,
    "triple tangent": three_points,
}
WAYS: tuple[Way, ...] = (("u", True), ("u", False), ("v", True), ("v", False))
FLUTE = 0.95  # of the flute is what a strip may be wide
# Gaps are exact up to this, mm: a sweep that follows rulings cuts as deep.
REACH = 1.0
# Poses looked at first, mm apart.
LOOK = 0.5
TIMES = 400  # along a motion, where its length is taken


@dataclass(frozen=True, slots=True)
class Strips:
    """A face cut by strips: how they run, their motions, and the swept gap of all of them at samples (N,), mm."""

    way: Way
    motions: tuple[Motion, ...]
    gap: Array

    def coverage(self, samples: FaceSamples, tolerance: float) -> float:
        """Share of the area that is within tolerance."""
        return float(samples.areas[np.abs(self.gap) <= tolerance].sum() / samples.areas.sum())


def bands(face: WorkFace, tool: Tool, way: Way, count: int) -> list[Band]:
    """Equal strips of a face, the flute along lines of constant way[0]."""
    corners = np.concatenate(face.face.loops)
    low, high = corners.min(axis=0), corners.max(axis=0)
    k = 1 if way[0] == "u" else 0
    edges = np.linspace(low[k], high[k], count + 1)
    found = []
    for start, end in pairwise(edges.tolist()):
        whole = _band(low, high, k, start, end, way)
        share = min(FLUTE * tool.length / Rails(face, whole).height(), 1.0)
        middle, half = 0.5 * (start + end), 0.5 * share * (end - start)
        found.append(_band(low, high, k, middle - half, middle + half, way))
    return found


def _band(low: Array, high: Array, k: int, start: float, end: float, way: Way) -> Band:
    box = [float(low[0]), float(high[0]), float(low[1]), float(high[1])]
    box[2 * k : 2 * k + 2] = [start, end]
    return Band((box[0], box[1], box[2], box[3]), *way)


def by_strips(
    face: WorkFace,
    tool: Tool,
    method: Method,
    count: int,
    samples: FaceSamples,
    tolerance: float,
    ways: Sequence[Way] = WAYS,
) -> Strips:
    """The best of a method with `count` sweeps."""
    found = []
    for way in ways:
        motions = tuple(method(face, tool, band) for band in bands(face, tool, way, count))
        found.append(Strips(way, motions, gap_of(motions, tool, samples)))
    return max(found, key=lambda strips: strips.coverage(samples, tolerance))


def gap_of(motions: Sequence[Motion], tool: Tool, samples: FaceSamples) -> Array:
    """Swept gap (N,) of all motions together, mm."""
    gap = np.full(len(samples.points), np.inf)
    for motion in motions:
        gap = np.minimum(gap, motion_gap(motion, tool, samples.points, reach=REACH, step=LOOK)[0])
    return gap


def cutting_seconds(motion: Motion, tool: Tool) -> float:
    """Time of a sweep without the ways to and from it, s: the faster end of the axis moves at the tool's feed."""
    p, q = motion.ends(np.linspace(0.0, 1.0, TIMES))
    steps = np.maximum(*(np.linalg.norm(np.diff(end, axis=0), axis=1) for end in (p, q)))
    return float(60.0 * steps.sum() / tool.feed_mm_min)
