"""The certificate beside dense sampling: bounds, what the densest look found, certified area, time.

Run with ``python -m benchmarks.certificate``. Cases: exact envelopes, the same with control points micrometres off,
and, where ../shared/parts is there, the largest sweep on a flank of a real blade. Dense sampling is the gap of
verification on random points: on the whole face, and in the cells whose bounds are the largest.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from benchmarks.detection import Flank, load, scene, whole
from benchmarks.envelopes import cylinder, random_envelopes
from benchmarks.run import PARTS, SEED
from conflank_cli.commands.tables import text_table
from conflank_cli.detection import detect
from conflank_cli.geometry.certificate import GapCells, certify, gap_cells
from conflank_cli.geometry.gap import travel
from conflank_cli.geometry.kernels.gap_bound import WITHIN
from conflank_cli.geometry.workface import WorkFace, on_face
from conflank_cli.limits import Limits
from conflank_cli.motion import Motion, fitted
from conflank_cli.optimization import optimize
from conflank_cli.progress import SilentProgress
from conflank_cli.selection import select
from conflank_cli.tool import CATALOGUE, Tool
from conflank_cli.verification.gap import cutting_body, nearest
from conflank_cli.verification.poses import Cells

Array = npt.NDArray[np.float64]

LIMITS = Limits(0.010, 0.010)
POINTS = 100_000
# Verification takes the tip for straight within one of its cells: so short, mm, that a motion is so to 1e-6 mm.
CELL = 0.01
SHAKEN = 0.002  # mm
TIMED = 5


@dataclass(frozen=True, slots=True)
class Case:
    """A sweep on a face."""

    name: str
    motion: Motion
    tool: Tool
    face: WorkFace


def motion_cells(motion: Motion, tool: Tool) -> Cells:
    """A motion as verification's cells: straight tips, a parabola of axes."""
    count = int(np.ceil(travel(motion) / CELL))
    p, q = motion.ends(np.linspace(0.0, 1.0, 2 * count + 1))
    axis = (q - p) / np.linalg.norm(q - p, axis=1)[:, None]
    tip = p + tool.tip_height * axis
    first, middle, last = slice(0, -1, 2), slice(1, None, 2), slice(2, None, 2)
    table = np.zeros((count, 16))
    table[:, 0:3] = tip[first]
    table[:, 3:6] = tip[last] - tip[first]
    table[:, 6:9] = axis[first]
    table[:, 9:12] = axis[last] - axis[first]
    table[:, 12:15] = axis[middle] - 0.5 * (axis[first] + axis[last])
    begin = np.arange(count) / count
    return Cells(table, np.zeros(count, dtype=np.int64), begin, np.full(count, 1.0 / count))


def dense_gap(motion: Motion, tool: Tool, face: WorkFace, uv: Array) -> Array:
    """Swept gap (N,) in mm at parameters (N, 2), by verification's kernel."""
    points = np.ascontiguousarray(face.projector.evaluate(uv[:, 0], uv[:, 1])[:, 0])
    return nearest(points, motion_cells(motion, tool), cutting_body(tool)).distance


def points_in(cells: GapCells, chosen: npt.NDArray[np.int64], count: int, rng: np.random.Generator) -> Array:
    """Random parameters (count, 2) in the chosen cells."""
    box = cells.box[rng.choice(chosen, count)]
    share = rng.random((count, 2))
    return np.asarray(box[:, [0, 2]] + share * (box[:, [1, 3]] - box[:, [0, 2]]))


def row(case: Case, points: int) -> tuple[object, ...]:
    """Bounds and densest samples in µm, areas in mm2, nodes, CPU seconds."""
    rng = np.random.default_rng(SEED)
    cells = gap_cells(case.motion, case.tool, case.face, LIMITS)
    start = time.process_time()
    for _ in range(TIMED):
        found = certify(case.motion, case.tool, case.face, LIMITS)
    seconds = (time.process_time() - start) / TIMED
    within = np.flatnonzero(cells.state == WITHIN)
    worst = np.maximum(cells.upper, -cells.lower)[within]
    tight = within[np.argsort(worst)[-200:]]
    deep = np.argsort(cells.lower)[:200]
    overcut, gap = 0.0, 0.0
    for chosen in (np.arange(len(cells.state)), deep, tight, within):
        if not len(chosen):
            continue
        uv = points_in(cells, chosen, points // 4, rng)
        uv = uv[on_face(case.face.face, uv)]
        g = dense_gap(case.motion, case.tool, case.face, uv)
        overcut = max(overcut, float(-g.min()))
        if chosen is tight or chosen is within:
            gap = max(gap, float(np.abs(g).max()))
    bounds = (found.overcut, overcut, found.overcut - overcut, found.gap, gap, found.gap - gap)
    return (case.name, *(1e3 * x for x in bounds), found.area, found.doubt, found.nodes, seconds)


def cases() -> Iterator[Case]:
    """Exact envelopes, shaken ones, a real blade."""
    rng = np.random.default_rng(SEED)
    for tool in (*CATALOGUE.values(), cylinder()):
        (envelope,) = random_envelopes(tool, 1, SEED)
        t = np.linspace(0.0, 1.0, 400)
        motion = fitted(t, np.hstack(envelope.motion.ends(t)), 32)
        face = WorkFace.of(whole(envelope.surface, envelope.sense), 0.0)
        yield Case(f"envelope {tool.name}", motion, tool, face)
        off = SHAKEN * rng.normal(size=(2, *motion.p.shape))
        yield Case(
            f"envelope {tool.name}, shaken", replace(motion, p=motion.p + off[0], q=motion.q + off[1]), tool, face
        )
    flank = Flank("rotor37.step", 0)
    if (PARTS / flank.file).exists():
        tool = CATALOGUE["T1"]
        design = load(flank)
        job = scene(design, (tool,))
        progress = SilentProgress()
        plan = select(job, optimize(job, detect(job, progress), progress)[0], progress).plan
        best = max(plan, key=lambda sweep: sweep.facts["certified_area_mm2"])
        yield Case("rotor37 face 0, T1", best.motion, tool, WorkFace.of(design, 0.0))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--points", type=int, default=POINTS, help="random points a case")
    points = parser.parse_args().points
    columns = ["<case", "overcut bound µm", "dense", "above", "|g| bound µm", "dense", "above",
               "area mm²", "in doubt", "nodes", "CPU s"]  # fmt: skip
    print(text_table(columns, [row(case, points) for case in cases()]), end="")


if __name__ == "__main__":
    main()
