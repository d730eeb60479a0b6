"""Ordered sequences of lines: every seed followed over the face in both directions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from conflank_cli.cores import spread
from conflank_cli.detection.line_field import SeedLines
from conflank_cli.geometry.kernels.axis import refine_all, trace_all
from conflank_cli.geometry.kernels.cells import mark_cells
from conflank_cli.geometry.screening import Screen, longest_run
from conflank_cli.geometry.workface import FaceSamples, WorkFace
from conflank_cli.limits import Limits
from conflank_cli.once import Once
from conflank_cli.tool import Tool

Array = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]

# Spheres along the flute: their spacing, 1.2-1.6 mm, is small against the lengths over which a blade bends.
SPHERES = 20
# Step along the sweep, mm, and the most steps to either side: 240 mm each way is longer than any blade here.
STEP = 1.5
STEPS = 160
# Cells along each side of the raster that coverage is estimated on while candidates are sorted.
CELLS = 72
# Lines traced together. Seeds whose line has been met on the way of those before are not followed again.
WAVE = 192
# Lines whose ends are this near are met, root mean square, mm: a fifth of a step.
MET = 0.3
# Places between traced lines at which others may meet them.
BETWEEN = 4
GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)
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
    cells: BoolArray
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
    screen: Once[Screen],
    limits: Limits,
) -> Traced:
    """Follow the lines of seeds over the face.

    A seed that no line within tolerance comes of leaves no sequence, and one whose line lies on the way of sequences
    before it leaves none of its own: it would go the same way again.

    Parameters
    ----------
    screen: what the tool must not hit; a sequence keeps its longest free stretch. It is asked for when the first lines
        have been followed: triangles take longer to come than faces.
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
    cells: list[BoolArray] = []
    rows = 2 * STEPS + 1
    p, d = np.empty((WAVE, rows, 3)), np.empty((WAVE, rows, 3))
    error, u, v, on = (np.empty((WAVE, rows, SPHERES)) for _ in range(4))
    lines_p, lines_d, foot_u, foot_v = seeds.p.copy(), seeds.d.copy(), seeds.uv[:, 0].copy(), seeds.uv[:, 1].copy()
    start = np.argmin(np.abs(seeds.height[:, None] - heights), axis=1)
    found = np.zeros(len(lines_p), dtype=np.bool_)

    def refine(part: slice) -> None:
        refine_all(
            *spans, face.sense, face.raster, lines_p[part], lines_d[part], heights, radii, start[part],
            foot_u[part], foot_v[part], over, under, FADED, found[part],
        )  # fmt: skip

    def follow(wave: IntArray) -> IntArray:
        extent = np.zeros((len(wave), 2), dtype=np.int64)

        def run(part: slice) -> None:
            lines = wave[part]
            trace_all(
                *spans, face.sense, face.raster, lines_p[lines], lines_d[lines], heights, radii, start[lines],
                foot_u[lines], foot_v[lines], STEP, over, under, FADED,
                p[part], d[part], error[part], u[part], v[part], on[part], extent[part],
            )  # fmt: skip

        spread(run, len(wave))
        return extent

    def mark(extent: IntArray) -> BoolArray:
        marks = np.zeros((len(extent), CELLS, CELLS), dtype=np.bool_)

        def run(part: slice) -> None:
            mark_cells(
                spans.breaks_u, spans.breaks_v, error[part], u[part], v[part], on[part], extent[part],
                over, under, marks[part],
            )  # fmt: skip

        spread(run, len(extent))
        return marks

    spread(refine, len(found))
    left = _spread(np.flatnonzero(found))
    while len(left):
        wave, left = left[:WAVE], left[WAVE:]
        extent = follow(wave)
        ways = [(p[k, low:high], d[k, low:high]) for k, (low, high) in enumerate(extent)]
        left = left[~_met(lines_p[left], lines_d[left], ways, tool)]
        _keep_free(screen(), tool, p, d, extent)
        marks = mark(extent)
        for k in np.flatnonzero(extent[:, 1] - extent[:, 0] >= 4):
            covered = marks[k].ravel()[used]
            if covered.any():
                row = slice(extent[k, 0], extent[k, 1])
                sequences.append(Sequence(p[k, row].copy(), d[k, row].copy(), error[k, row].copy(), on[k, row].copy()))
                cells.append(covered)
    table = np.array(cells) if cells else np.zeros((0, int(used.sum())), dtype=np.bool_)
    return Traced(tuple(sequences), table, cell_areas[used])


def _spread(index: IntArray) -> IntArray:
    """The same numbers in an order of which every beginning is spread evenly over the whole (golden section)."""
    return np.asarray(index[np.argsort(np.arange(len(index)) * GOLDEN % 1.0, kind="stable")])


def _met(p: Array, d: Array, ways: list[tuple[Array, Array]], tool: Tool) -> BoolArray:
    """Which lines p, d (N, 3) lie on the ways of sequences, lines (K, 3) each."""
    ends = [np.hstack([way_p, way_p + tool.length * way_d]) for way_p, way_d in ways if len(way_p)]
    if not ends or not len(p):
        return np.zeros(len(p), dtype=np.bool_)
    between = [part[:-1] + share * np.diff(part, axis=0) for part in ends for share in np.arange(BETWEEN) / BETWEEN]
    tree = KDTree(np.concatenate([*between, *(part[-1:] for part in ends)]))
    reach = MET * np.sqrt(2.0)
    return np.asarray(tree.query(np.hstack([p, p + tool.length * d]), distance_upper_bound=reach)[0] < reach)


def _keep_free(screen: Screen, tool: Tool, p: Array, d: Array, extent: IntArray) -> None:
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
