"""Trim loops: closed polylines in (u, v); a point is inside where the even-odd rule over all loops says so."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Box = tuple[float, float, float, float]

# Points nearer than this share of the parameter box are one point: pcurves meet at edges to about 1e-9.
SAME_POINT = 1.0e-9


def bounds(loops: Sequence[Array]) -> Box:
    """Parameter box (u0, u1, v0, v1) of the loops."""
    points = np.concatenate(loops)
    low, high = points.min(axis=0), points.max(axis=0)
    return float(low[0]), float(high[0]), float(low[1]), float(high[1])


def rectangle(box: Box) -> Array:
    """The box as a loop, (4, 2)."""
    u0, u1, v0, v1 = box
    return np.array([[u0, v0], [u1, v0], [u1, v1], [u0, v1]])


def inside(loops: Sequence[Array], points: Array) -> npt.NDArray[np.bool_]:
    """Even-odd test of points (N, 2)."""
    result = np.zeros(len(points), dtype=np.bool_)
    for loop in loops:
        start, end = loop, np.roll(loop, -1, axis=0)
        for (au, av), (bu, bv) in zip(start, end, strict=True):
            if av == bv:
                continue
            crosses = (av <= points[:, 1]) != (bv <= points[:, 1])
            result ^= crosses & (points[:, 0] < au + (points[:, 1] - av) / (bv - av) * (bu - au))
    return result


def clip(loops: Iterable[Array], box: Box) -> list[Array]:
    """The loops within a box: each one clipped by itself, which keeps the even-odd rule right.

    A loop that leaves the box and comes back leaves double lines on its border; `merge` takes them away.
    Source: Sutherland and Hodgman, "Reentrant polygon clipping", CACM 17 (1974).
    """
    clipped = []
    for loop in loops:
        points = loop
        for axis, border, sign in ((0, box[0], 1.0), (0, box[1], -1.0), (1, box[2], 1.0), (1, box[3], -1.0)):
            points = _clip_half(points, axis, border, sign)
        if len(points) >= 3:
            clipped.append(points)
    return clipped


def _clip_half(loop: Array, axis: int, border: float, sign: float) -> Array:
    """The part of a loop where sign * (coordinate - border) >= 0."""
    if len(loop) == 0:
        return loop
    depth = sign * (loop[:, axis] - border)
    if np.all(depth >= 0.0):
        return loop
    kept: list[Array] = []
    for i in range(len(loop)):
        before = i - 1
        if (depth[i] >= 0.0) != (depth[before] >= 0.0):
            share = depth[before] / (depth[before] - depth[i])
            crossing = loop[before] + share * (loop[i] - loop[before])
            crossing[axis] = border
            kept.append(crossing)
        if depth[i] >= 0.0:
            kept.append(loop[i])
    return np.array(kept).reshape(-1, 2)


def snap(loops: Iterable[Array], axis: int, lines: Iterable[float], tolerance: float) -> list[Array]:
    """Points within the tolerance of one of the lines u = x (axis 0) or v = x (axis 1), put on it."""
    result = []
    for loop in loops:
        moved = loop.copy()
        for line in lines:
            moved[np.abs(moved[:, axis] - line) <= tolerance, axis] = line
        result.append(moved)
    return result


def merge(loops: Sequence[Array], lines: Iterable[tuple[int, float]], tolerance: float) -> list[Array]:
    """Loops without the stretches that lie twice on one of the lines (axis, value).

    Two copies of a face that meet at a seam become one face. The even-odd sense stays; the direction of loops does not.
    """
    segments = [(loop[i - 1], loop[i]) for loop in loops for i in range(len(loop)) if np.any(loop[i - 1] != loop[i])]
    for axis, line in lines:
        on_line = [s for s in segments if s[0][axis] == line and s[1][axis] == line]
        if not on_line:
            continue
        rest = [s for s in segments if not (s[0][axis] == line and s[1][axis] == line)]
        other = 1 - axis
        stops = np.unique([end[other] for s in on_line for end in s])
        stops = stops[np.concatenate([[True], np.diff(stops) > tolerance])]
        middle = 0.5 * (stops[1:] + stops[:-1])
        parity = np.zeros(len(middle), dtype=np.int64)
        for a, b in on_line:
            low, high = min(a[other], b[other]), max(a[other], b[other])
            parity += (low < middle) & (middle < high)
        for k in np.flatnonzero(parity % 2):
            ends = np.full((2, 2), line)
            ends[:, other] = stops[k : k + 2]
            rest.append((ends[0], ends[1]))
        segments = rest
    chained = _chain(segments, tolerance)
    return list(loops) if chained is None else chained


def _chain(segments: Sequence[tuple[Array, Array]], tolerance: float) -> list[Array] | None:
    """Closed loops out of loose segments, or None where an end finds no partner."""
    ends = np.array([end for s in segments for end in s]).reshape(-1, 2)
    if len(ends) == 0:
        return []
    label = _labels(ends, tolerance)
    at: dict[int, list[int]] = {}
    for k in range(len(segments)):
        at.setdefault(label[2 * k], []).append(k)
        at.setdefault(label[2 * k + 1], []).append(k)
    free = [label[2 * k] != label[2 * k + 1] for k in range(len(segments))]
    loops = []
    for first in range(len(segments)):
        if not free[first]:
            continue
        free[first] = False
        goal, here = label[2 * first], label[2 * first + 1]
        path = [ends[2 * first]]
        where = ends[2 * first + 1]
        while here != goal:
            step = next((k for k in at[here] if free[k]), None)
            if step is None:
                return None
            free[step] = False
            path.append(where)
            forward = label[2 * step] == here
            here, where = label[2 * step + forward], ends[2 * step + forward]
        if len(path) >= 3:
            loops.append(np.array(path))
    return loops


def _labels(points: Array, tolerance: float) -> list[int]:
    """One number for all points within the tolerance of one another (single linkage along u, then v)."""
    label = np.zeros(len(points), dtype=np.int64)
    for axis in (0, 1):
        order = np.lexsort((points[:, axis], label))
        new_group = np.concatenate([[0], (np.diff(points[order, axis]) > tolerance) | (np.diff(label[order]) != 0)])
        label[order] = np.cumsum(new_group)
    return [int(k) for k in label]


def tidy(loop: Array, tolerance: float) -> Array:
    """A loop without repeated points."""
    kept = np.linalg.norm(loop - np.roll(loop, 1, axis=0), axis=1) > tolerance
    return np.ascontiguousarray(loop[kept])
