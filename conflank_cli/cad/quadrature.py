"""Points and weights for integrals over a trimmed face."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from conflank_cli.geometry.kernels.footpoint import evaluate
from conflank_cli.geometry.surface import BSplineSurface, Spans, to_spans

Array = npt.NDArray[np.float64]

# Five Gauss points a panel integrate the area of a cubic net to about 1e-8; where there are many panels, because there
# are many knots or trim points, three do.
PANELS_AT_LEAST = 8
MANY_PANELS = 40
FEW_POINTS, MANY_POINTS = 3, 5


class TrimNodes(NamedTuple):
    """Quadrature over a trimmed face: u, v, weight (N,), so that sum(weight * f(u, v)) is the integral of f du dv."""

    u: Array
    v: Array
    weight: Array


def surface_frames(spans: Spans, u: Array, v: Array) -> Array:
    """S, Su, Sv, Suu, Suv, Svv at parameters u, v (N,): shape (N, 6, 3)."""
    frames = np.empty((len(u), 6, 3))
    evaluate(
        spans.breaks_u, spans.breaks_v, spans.coefficients, np.ascontiguousarray(u), np.ascontiguousarray(v), frames
    )
    return frames


def trim_nodes(loops: Sequence[Array], breaks_u: Array, breaks_v: Array) -> TrimNodes:
    """Gauss points on scan lines v = const between the trim loops (even-odd rule).

    Scan lines are grouped in strips between vertices of the loops and knots, so that the length of a scan line is
    smooth within a strip; along it the stretches inside are split at knots.
    """
    points = np.concatenate(loops)
    low, high = points.min(axis=0), points.max(axis=0)
    stops_v = _panels(breaks_v, points[:, 1], low[1], high[1])
    stops_u = _panels(breaks_u, np.empty(0), low[0], high[0])
    scan, scan_weight = _gauss(stops_v[:-1], stops_v[1:], len(stops_v) - 1)
    line, crossing = _crossings(loops, scan.ravel())
    start, end, line = crossing[0::2], crossing[1::2], line[0::2]
    # Each stretch inside, split at the stops: (stretches, panels).
    left = np.maximum(start[:, None], stops_u[:-1])
    right = np.minimum(end[:, None], stops_u[1:])
    stretch, panel = np.nonzero(right > left)
    left, right = left[stretch, panel], right[stretch, panel]
    u, weight = _gauss(left, right, len(stops_u) - 1)
    weight *= scan_weight.ravel()[line[stretch]][:, None]
    v = np.broadcast_to(scan.ravel()[line[stretch]][:, None], u.shape)
    return TrimNodes(u.ravel(), v.ravel(), weight.ravel())


def _gauss(low: Array, high: Array, panels: int) -> tuple[Array, Array]:
    """Gauss points and weights of intervals (N,), each (N, points)."""
    nodes, weights = np.polynomial.legendre.leggauss(FEW_POINTS if panels > MANY_PANELS else MANY_POINTS)
    half = 0.5 * (high - low)
    return (low + half)[:, None] + half[:, None] * nodes, half[:, None] * weights


def _panels(breaks: Array, extra: Array, low: float, high: float) -> Array:
    """Stops from low to high: knots and extra ones, and never less than `PANELS_AT_LEAST` panels."""
    stops = np.concatenate([breaks, extra, np.linspace(low, high, PANELS_AT_LEAST + 1)])
    stops = np.unique(stops[(stops >= low) & (stops <= high)])
    kept = np.concatenate([[True], np.diff(stops) > 1.0e-9 * (high - low)])
    return np.asarray(stops[kept])


def _crossings(loops: Sequence[Array], scan: Array) -> tuple[npt.NDArray[np.int64], Array]:
    """Where scan lines v = const meet the loops: line index and u, in this order; an even number a line."""
    lines, places = [], []
    for loop in loops:
        start, end = loop, np.roll(loop, -1, axis=0)
        line, edge = np.nonzero((start[:, 1] <= scan[:, None]) != (end[:, 1] <= scan[:, None]))
        a, b = start[edge], end[edge]
        places.append(a[:, 0] + (scan[line] - a[:, 1]) / (b[:, 1] - a[:, 1]) * (b[:, 0] - a[:, 0]))
        lines.append(line)
    line, place = np.concatenate(lines), np.concatenate(places)
    order = np.lexsort((place, line))
    return line[order], place[order]


def trimmed_area(surface: BSplineSurface, loops: Sequence[Array]) -> float:
    """Area of the trimmed face, mm2."""
    if not loops:
        return 0.0
    spans = to_spans(surface)
    nodes = trim_nodes(loops, spans.breaks_u, spans.breaks_v)
    frames = surface_frames(spans, nodes.u, nodes.v)
    return float(nodes.weight @ np.linalg.norm(np.cross(frames[:, 1], frames[:, 2]), axis=1))
