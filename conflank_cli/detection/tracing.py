"""Ordered sequences of lines: every seed followed over the face in both directions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from conflank_cli.detection.line_field import SeedLines
from conflank_cli.geometry.kernels.axis import trace_all
from conflank_cli.geometry.kernels.cells import mark_cells
from conflank_cli.geometry.screening import Screen, longest_run
from conflank_cli.geometry.workface import FaceSamples, WorkFace
from conflank_cli.limits import Limits
from conflank_cli.tool import Tool

Array = npt.NDArray[np.float64]

# Spheres along the flute: their spacing, 1.2-1.6 mm, is small against the lengths over which a blade bends.
SPHERES = 20
# Step along the sweep, mm, and the most steps to either side: 240 mm each way is longer than any blade here.
STEP = 1.5
STEPS = 160
# Cells along each side of the raster that coverage is estimated on while candidates are sorted.
CELLS = 72
# Seeds traced together: bounds the memory of the tables below.
BATCH = 512
# Stock left counts in full up to about so many tolerances; beyond, another sweep has to take it.
FADED = 1.5
# Lines are still to be moved by the optimisation: so much violation is let pass, mm.
SLACK = 0.03


@dataclass(frozen=True, slots=True)
class Sequence:
    """Lines in order along a sweep: p, d (K, 3), and the axis errors (K, SPHERES) in mm with flags `on` as traced."""

    p: Array
    d: Array
    error: Array
    on: Array


@dataclass(frozen=True, slots=True)
class Traced:
    """All sequences found from a set of seeds.

    Attributes
    ----------
    sequences: N sequences.
    cells: (N, C) bool, which cells of the face each covers within tolerance.
    cell_areas: (C,) mm2 of trimmed face in each cell.
    """

    sequences: tuple[Sequence, ...]
    cells: npt.NDArray[np.bool_]
    cell_areas: Array


def sphere_heights(tool: Tool, count: int = SPHERES) -> Array:
    """Heights of the sphere centres that a line is judged at, shape (count,), mm."""
    low, high = tool.centre_range
    return np.linspace(low, high, count)


def trace(
    face: WorkFace,
    tool: Tool,
    seeds: SeedLines,
    samples: FaceSamples,
    screen: Screen,
    limits: Limits,
) -> Traced:
    """Follow every seed. Seeds that no line within tolerance comes of leave no sequence.

    Parameters
    ----------
    screen: what the tool must not hit; a sequence keeps its longest free stretch.
    samples: points of the face, dense against the cells; they give the cells their areas.
    limits: tolerances and allowance.
    """
    spans = face.projector.spans
    heights = sphere_heights(tool)
    over, under = limits.over, limits.under
    radii = tool.sphere_radius(heights) + limits.allowance
    cell_areas = _cell_areas(face, samples)
    used = cell_areas > 0.0
    sequences: list[Sequence] = []
    cells: list[npt.NDArray[np.bool_]] = []
    rows = 2 * STEPS + 1
    size = min(BATCH, len(seeds.p))
    p, d = np.empty((size, rows, 3)), np.empty((size, rows, 3))
    error, u, v, on = (np.empty((size, rows, SPHERES)) for _ in range(4))
    for begin in range(0, len(seeds.p), BATCH):
        part = slice(begin, min(begin + BATCH, len(seeds.p)))
        count = part.stop - part.start
        start = np.argmin(np.abs(seeds.height[part, None] - heights), axis=1)
        extent = np.zeros((count, 2), dtype=np.int64)
        trace_all(
            *spans, face.sense, face.raster, seeds.p[part], seeds.d[part], heights, radii, start,
            seeds.uv[part, 0].copy(), seeds.uv[part, 1].copy(), STEP, over, under, FADED, p, d, error, u, v, on, extent,
        )  # fmt: skip
        _keep_free(screen, tool, p, d, extent)
        marks = np.zeros((count, CELLS, CELLS), dtype=np.bool_)
        mark_cells(spans.breaks_u, spans.breaks_v, error[:count], u, v, on, extent, over, under, marks)
        for k in np.flatnonzero(extent[:, 1] - extent[:, 0] >= 4):
            covered = marks[k].ravel()[used]
            if covered.any():
                row = slice(extent[k, 0], extent[k, 1])
                sequences.append(Sequence(p[k, row].copy(), d[k, row].copy(), error[k, row].copy(), on[k, row].copy()))
                cells.append(covered)
    table = np.array(cells) if cells else np.zeros((0, int(used.sum())), dtype=np.bool_)
    return Traced(tuple(sequences), table, cell_areas[used])


def _keep_free(screen: Screen, tool: Tool, p: Array, d: Array, extent: npt.NDArray[np.int64]) -> None:
    """Shorten the rows in use (N, 2) of every sequence to its longest run of lines that hit nothing, in place."""
    used = [(k, slice(low, high)) for k, (low, high) in enumerate(extent) if high > low]
    if not used:
        return
    free = screen.free(
        np.concatenate([p[k, row] for k, row in used]),
        np.concatenate([d[k, row] for k, row in used]),
        tool,
        SLACK,
        True,
    )
    begin = 0
    for k, row in used:
        run = longest_run(free[begin : begin + row.stop - row.start])
        begin += row.stop - row.start
        extent[k] = (row.start, row.start) if run is None else (row.start + run[0], row.start + run[1] + 1)


def _cell_areas(face: WorkFace, samples: FaceSamples) -> Array:
    spans = face.projector.spans
    index = np.zeros(len(samples.uv), dtype=np.int64)
    for k, breaks in enumerate((spans.breaks_u, spans.breaks_v)):
        place = ((samples.uv[:, k] - breaks[0]) / (breaks[-1] - breaks[0]) * CELLS).astype(np.int64)
        index = index * CELLS + np.clip(place, 0, CELLS - 1)
    return np.asarray(np.bincount(index, samples.areas, minlength=CELLS * CELLS), dtype=np.float64)
