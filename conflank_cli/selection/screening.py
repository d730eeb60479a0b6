"""What a sweep may not do: cut into a face, or hit something with cutter, shank or holder. What violates is trimmed off."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from conflank_cli.geometry.face import CheckMesh
from conflank_cli.geometry.gap import travel
from conflank_cli.geometry.kernels.clearance import assembly_slack
from conflank_cli.job import Margin
from conflank_cli.motion import Motion
from conflank_cli.tool import Section, Tool

Array = npt.NDArray[np.float64]

# Poses are judged this far apart along the sweep, mm.
STEP = 1.0
# Points of the check geometry are at most this far apart, mm: on a surface of radius 10 mm a cutter can pass 12 µm deeper
# between two of them; verification samples on its own.
POINT_SPACING = 1.0
# The ball is followed by this many truncated cones, inscribed at most 2 % of its radius deep.
BALL_SECTIONS = 8
# Shorter stretches than this are not worth a cut, mm of travel.
SHORTEST = 3.0


@dataclass(frozen=True, slots=True)
class Assembly:
    """A tool as truncated cones: sections (S, 4) of two heights and two radii, with the component of each."""

    sections: Array
    component: tuple[str, ...]


def assembly(tool: Tool) -> Assembly:
    """Ball, cone, shank and holder of a tool as truncated cones, heights from the plane of r_min."""
    rows: list[tuple[float, float, float, float]] = []
    names: list[str] = []
    # From the tip up to where the ball meets the cone, tangentially, at height 0.
    cosines = np.linspace(-1.0, -tool.ball_centre_height / tool.ball_radius, BALL_SECTIONS + 1)
    heights = tool.ball_centre_height + tool.ball_radius * cosines
    radii = tool.ball_radius * np.sqrt(np.maximum(1.0 - cosines**2, 0.0))
    for k in range(BALL_SECTIONS):
        rows.append((heights[k], heights[k + 1], radii[k], radii[k + 1]))
        names.append("ball")
    rows.append((0.0, tool.length, tool.r_min, tool.r_max))
    names.append("cone")
    top = tool.length

    def stack(sections: tuple[Section, ...], name: str) -> None:
        nonlocal top
        for section in sections:
            rows.append((top, top + section.length, 0.5 * section.diameter_low, 0.5 * section.diameter_high))
            names.append(name)
            top += section.length

    stack(tool.shank, "shank")
    stack(tool.holder, "holder")
    return Assembly(np.array(rows), tuple(names))


def check_points(mesh: CheckMesh) -> Array:
    """Points on a mesh at most POINT_SPACING apart, shape (N, 3)."""
    if not len(mesh.triangles):
        return np.zeros((0, 3))
    corners = mesh.vertices[mesh.triangles]
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    counts = np.ceil(edges / POINT_SPACING).astype(int)
    parts = [mesh.vertices[np.unique(mesh.triangles)]]
    for count in np.unique(counts[counts > 1]):
        weights = np.array(
            [(i, j, count - i - j) for i in range(count + 1) for j in range(count + 1 - i)], dtype=np.float64
        ) / count  # fmt: skip
        inner = weights[np.all(weights < 1.0, axis=1)]
        parts.append(np.einsum("wc,tcx->twx", inner, corners[counts == count]).reshape(-1, 3))
    return np.unique(np.concatenate(parts).round(6), axis=0)


@dataclass(frozen=True, slots=True)
class Screen:
    """What every sweep is held against.

    faces: points of all design faces (N, 3). check: points of the check geometry (M, 3). over: overcut tolerance less
    allowance, mm. margin: distances to keep from check geometry.
    """

    faces: Array
    check: Array
    over: float
    margin: Margin

    def allowed(self, motion: Motion, tool: Tool) -> tuple[float, float] | None:
        """The longest stretch (start, end) of times at which nothing is violated, or None where it is too short.

        The design body may not be overcut by cutter or shank, and the holder keeps its margin; from the check
        geometry, which is the same part, the same holds with the shank's margin added.
        """
        length = travel(motion)
        count = max(int(np.ceil(length / STEP)), 8) + 1
        times = np.linspace(0.0, 1.0, count)
        p, q = motion.ends(times)
        d = q - p
        d /= np.linalg.norm(d, axis=1)[:, None]
        body = assembly(tool)
        cutter = {"ball": -self.over, "cone": -self.over}
        against = (
            (self.faces, {**cutter, "shank": -self.over, "holder": self.margin.holder}),
            (self.check, {**cutter, "shank": self.margin.shank, "holder": self.margin.holder}),
        )
        free = np.ones(count, dtype=np.bool_)
        for points, margins in against:
            near = points[_within(points, p, d, body.sections)]
            if len(near):
                slack = np.full(count, 1e-9)
                nearest = np.empty(count, dtype=np.int64)
                limits = np.array([margins[name] for name in body.component])
                assembly_slack(p, d, near, body.sections, limits, slack, nearest)
                free &= slack >= 0.0
        stretch = _longest(free)
        if stretch is None:
            return None
        start, end = times[stretch[0]], times[stretch[1]]
        return (float(start), float(end)) if (end - start) * length >= SHORTEST else None


def _within(points: Array, p: Array, d: Array, sections: Array) -> npt.NDArray[np.bool_]:
    """Points inside the box that the assembly sweeps through, with its greatest radius and margin around."""
    ends = np.concatenate([p + sections[:, 0].min() * d, p + sections[:, 1].max() * d])
    around = sections[:, 2:].max() + 2.0
    inside = (points > ends.min(axis=0) - around) & (points < ends.max(axis=0) + around)
    return np.asarray(inside.all(axis=1))


def _longest(free: npt.NDArray[np.bool_]) -> tuple[int, int] | None:
    """First and last index of the longest run of True, or None."""
    padded = np.concatenate([[False], free, [False]]).astype(np.int8)
    change = np.diff(padded)
    starts, ends = np.flatnonzero(change == 1), np.flatnonzero(change == -1) - 1
    if not len(starts):
        return None
    best = int(np.argmax(ends - starts))
    return int(starts[best]), int(ends[best])
