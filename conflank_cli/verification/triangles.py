"""Triangles over trimmed CAD faces in their parameter plane, so that every point of them can be put on the face itself.

They conform to the trim: each stretch of its loops is an edge, so that no triangle lies on both sides of one.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.spatial import Delaunay

from conflank_cli.geometry.face import DesignFace
from conflank_cli.verification.evaluation import evaluate_grid, inside_loops

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

DEVIATION = 0.02
"""Triangles are off the face by about this at most to begin with, mm; what is near a cutter is halved."""

_PROBES = 49
"""Rows and columns of points by which it is told how a face bends."""

_LINES = (3, 150)
"""Fewest and most cells of the grid in either direction."""

_ROUNDS = 12
"""Rounds in which stretches of a loop that are no edges yet are halved."""

_SAME = 1e-9
"""Points nearer than this are one, in cells of the grid."""

_CHUNK = 4_000_000
"""Points times stretches of loops that are looked at together, so that memory stays small."""


def triangles_over(face: DesignFace) -> tuple[Array, Integers]:
    """Points (V, 2) in the parameter plane of a trimmed face, and triangles (M, 3) that fill its trim.

    A face without area has none.
    """
    loops = [np.asarray(loop) for loop in face.loops]
    corners = np.concatenate(loops)
    u0, u1, v0, v1 = face.surface.domain
    low, high = np.maximum(corners.min(axis=0), [u0, v0]), np.minimum(corners.max(axis=0), [u1, v1])
    if not (high > low).all():
        return np.zeros((0, 2)), np.zeros((0, 3), dtype=np.int64)
    lines = _grid_lines(face, low, high)
    cells = [np.arange(float(len(line))) for line in lines]

    def even(uv: Array) -> Array:
        """In cells of the grid, where triangles are as wide as they are high."""
        return np.stack([np.interp(uv[:, k], lines[k], cells[k]) for k in (0, 1)], axis=1)

    border, first, last = _border(loops, even)
    flat = even(border)
    grid = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 2)
    grid = grid[inside_loops(face.loops, grid, _CHUNK)]
    grid = grid[_away(even(grid), flat)]
    uv = np.concatenate([border, grid])
    for _ in range(_ROUNDS):
        flat = even(uv)
        triangles = Delaunay(flat).simplices.astype(np.int64)
        missing = ~_are_edges(triangles, first, last, len(uv))
        if not missing.any():
            break
        middle = len(uv) + np.arange(int(missing.sum()))
        uv = np.concatenate([uv, 0.5 * (uv[first[missing]] + uv[last[missing]])])
        first, last = (
            np.concatenate([first[~missing], first[missing], middle]),
            np.concatenate([last[~missing], middle, last[missing]]),
        )
    a, b, c = (flat[triangles[:, k]] for k in range(3))
    size = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    triangles = triangles[np.abs(size) > _SAME]
    return uv, triangles[inside_loops(face.loops, uv[triangles].mean(axis=1), _CHUNK)]


def _grid_lines(face: DesignFace, low: Array, high: Array) -> list[Array]:
    """Parameters of grid lines in either direction: between two of them an arc rises by `DEVIATION` at most, about."""
    probe = [np.linspace(low[k], high[k], _PROBES) for k in (0, 1)]
    points = evaluate_grid(face.surface, *probe)[0]
    lines = []
    for axis in (0, 1):
        own = np.moveaxis(points, axis, 0)
        rise = np.linalg.norm(own[2:] - 2.0 * own[1:-1] + own[:-2], axis=2).max(axis=1)
        # A chord over n steps rises by n^2 / 8 of the second difference; half of it is left to either direction.
        steps = np.sqrt(np.concatenate([rise[:1], rise, rise[-1:]]) / (4.0 * DEVIATION))
        load = np.concatenate([[0.0], np.cumsum(0.5 * (steps[1:] + steps[:-1]) + _LINES[0] / _PROBES)])
        count = int(np.clip(np.ceil(load[-1]), *_LINES))
        lines.append(np.interp(np.linspace(0.0, load[-1], count + 1), load, probe[axis]))
    return lines


def _border(loops: list[Array], even) -> tuple[Array, Integers, Integers]:  # type: ignore[no-untyped-def]
    """Points (B, 2) along loops, no further apart than a cell, each once; the stretches from `first` to `last` (S,)."""
    points, first, last, count = [], [], [], 0
    for loop in loops:
        ends = np.roll(loop, -1, axis=0)
        parts = np.maximum(np.ceil(np.abs(even(ends) - even(loop)).max(axis=1)).astype(np.int64), 1)
        owner = np.repeat(np.arange(len(loop)), parts)
        share = (np.arange(len(owner)) - np.repeat(np.cumsum(parts) - parts, parts)) / parts[owner]
        points.append(loop[owner] + share[:, None] * (ends - loop)[owner])
        number = count + np.arange(len(owner))
        first.append(number)
        last.append(np.roll(number, -1))
        count += len(owner)
    every = np.concatenate(points)
    _, kept, number = np.unique(np.round(even(every) / _SAME), axis=0, return_index=True, return_inverse=True)
    number = number.ravel()
    start, end = number[np.concatenate(first)], number[np.concatenate(last)]
    return every[kept], start[start != end], end[start != end]


def _away(flat: Array, border: Array) -> npt.NDArray[np.bool_]:
    """Which points (G, 2) of the grid are not right beside the border, where they would make needles."""
    size = np.concatenate([flat, border]).max(axis=0, initial=0.0).astype(np.int64) + 2
    taken = np.zeros(2 * size, dtype=np.bool_)
    taken[tuple((2.0 * border + 0.5).astype(np.int64).T)] = True
    return np.asarray(~taken[tuple((2.0 * flat + 0.5).astype(np.int64).T)])


def _are_edges(triangles: Integers, first: Integers, last: Integers, count: int) -> npt.NDArray[np.bool_]:
    """Which pairs of points (S,) are edges of triangles."""

    def key(a: Integers, b: Integers) -> Integers:
        return np.asarray(np.minimum(a, b) * count + np.maximum(a, b))

    edges = np.concatenate([key(triangles[:, k], triangles[:, (k + 1) % 3]) for k in range(3)])
    return np.isin(key(first, last), edges)
