"""What each stage is timed on: a usual amount of work, and the same growing in what it may grow with.

``python -m benchmarks.speed_stages measured|cold STAGE FOLDER`` prints the figures of one stage; FOLDER is what
`conflank run` wrote for the sample blade's pressure side (JOB). `benchmarks.speed` runs it.
"""

from __future__ import annotations

import json
import os
import resource
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import numpy.typing as npt
from scipy.interpolate import BSpline, make_interp_spline

from benchmarks.process import MEMORY_UNIT
from benchmarks.run import REPOSITORY, SEED
from benchmarks.shapes import clamped_knots, greville, smooth_surface
from conflank_cli.artifacts import read_artifact
from conflank_cli.cores import threads
from conflank_cli.geometry.gap import motion_gap, travel
from conflank_cli.geometry.surface import BSplineSurface
from conflank_cli.geometry.workface import WorkFace
from conflank_cli.progress import SilentProgress
from conflank_cli.scene import Scene
from conflank_cli.sweep import Sweep

Array = npt.NDArray[np.float64]

JOB = REPOSITORY / "sample_parts" / "blisk_blade" / "pressure.toml"
PROGRAM = "PRESSURE.H"
NETS = ((4, 4), (8, 6), (20, 10), (100, 12), (500, 15))
USUAL_NET = (20, 10)
RUNS = 3
# A load that takes longer than this is timed once.
LONG = 3.0  # s
# One core and all of them take turns for so long: the shorter the runs, the likelier some that nothing disturbs.
TURNS = 5.0  # s


@dataclass(frozen=True, slots=True)
class Load:
    """Some work: how large it is, in what it grows with; the units that the stage is counted in; what is to be run."""

    size: float
    units: float
    run: Callable[[], object]


@dataclass(frozen=True, slots=True)
class Stage:
    """What a stage is counted in, its usual load, and loads that grow, by what they grow with."""

    unit: str
    usual: Callable[[], Load]
    growth: Mapping[str, Callable[[], Iterator[Load]]]


# -- surfaces --------------------------------------------------------------------------------------------------------


def net(count_u: int, count_v: int) -> BSplineSurface:
    """A blade-sized bicubic face with a net of so many control points: the same points in space for every net.

    The face is that of a single span each way, to which knots are added, so that nothing but the net differs.
    """
    plain = smooth_surface(np.random.default_rng(SEED), (3, 3), (1, 1))
    poles, knots = plain.poles, []
    for axis, (count, coarse) in enumerate(((count_u, plain.knots_u), (count_v, plain.knots_v))):
        finer = clamped_knots(3, count - 3)
        at = greville(finer, 3)
        values = BSpline(coarse, np.moveaxis(poles, axis, 0), 3)(at)
        poles = np.moveaxis(make_interp_spline(at, values, k=3, t=finer).c, 0, axis)
        knots.append(finer)
    return BSplineSurface(3, 3, knots[0], knots[1], np.ascontiguousarray(poles))


# -- what the stages work on -----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Material:
    """The folder of a run of JOB."""

    folder: Path

    @cached_property
    def candidates(self) -> tuple[Scene, tuple[Sweep, ...]]:
        """Scene and candidates."""
        return read_artifact(str(self.folder / "candidates.npz"), "candidates")[:2]

    @cached_property
    def plan(self) -> tuple[Scene, tuple[Sweep, ...]]:
        """Scene and plan."""
        return read_artifact(str(self.folder / "plan.npz"), "plan")[:2]


def _faces(scene: Scene, count: int) -> Scene:
    """A scene with its first face so many times."""
    return replace(scene, faces=scene.faces[:1] * count)


def footpoints(material: Material) -> Stage:
    """Warm projection of points near a face."""
    from benchmarks.footpoints import Query
    from conflank_cli.geometry.footpoint import Projector

    def load(shape: tuple[int, int], count: int, size: float) -> Load:
        projector = Projector.of(net(*shape))
        query = Query.random(np.random.default_rng(SEED), projector, count)
        found = projector.project(query.points, *query.start)

        def run() -> None:
            found.u[:], found.v[:] = query.start
            projector.project_into(query.points, found)

        return Load(size, count, run)

    def prepared(shape: tuple[int, int]) -> Load:
        surface = net(*shape)
        return Load(shape[0] * shape[1], 1, lambda: Projector.of(surface))

    return Stage(
        "points",
        lambda: load(USUAL_NET, 250_000, 250_000),
        {
            "points": lambda: (load(USUAL_NET, count, count) for count in (20_000, 80_000, 320_000)),
            "control points of the net": lambda: (load(shape, 100_000, shape[0] * shape[1]) for shape in NETS),
            "control points, face prepared": lambda: map(prepared, NETS),
        },
    )


def detection(material: Material) -> Stage:
    """The search for lines; seeds are contact points times heights on the flute."""
    from benchmarks.detection import scene as free_scene
    from benchmarks.detection import whole
    from conflank_cli.detection import DENSITIES, detect

    def load(scene: Scene, density: str, size: float | None = None) -> Load:
        wished = msgspec.structs.replace(
            scene.job, detection=msgspec.structs.replace(scene.job.detection, density=density)
        )
        seeds = DENSITIES[density].contacts * len(DENSITIES[density].heights)
        scene = replace(scene, job=wished)
        return Load(seeds if size is None else size, seeds, lambda: detect(scene, SilentProgress()))

    scene = material.candidates[0]
    return Stage(
        "seeds",
        lambda: load(scene, "normal"),
        {
            "seeds": lambda: (load(scene, density) for density in DENSITIES),
            "faces": lambda: (load(_faces(scene, count), "quick", count) for count in (1, 2, 4)),
            "control points of the net": lambda: (
                load(free_scene(whole(net(*shape), 1), scene.tools, free=True), "quick", shape[0] * shape[1])
                for shape in NETS
            ),
        },
    )


def optimisation(material: Material) -> Stage:
    """Gauss-Newton on the axis error, polish and growth: all that a sweep goes through that may be chosen."""
    from benchmarks.optimization import ITERATIONS
    from conflank_cli.optimization import prepare
    from conflank_cli.optimization.gauss_newton import Step, minimise
    from conflank_cli.optimization.task import SCALE_FIRST

    scene, sweeps = material.candidates
    (task,) = prepare(scene, [(sweeps[0].face, sweeps[0].tool)]).values()
    steps = (Step(1.0, 1.0, SCALE_FIRST * task.limits.under, False),) * ITERATIONS
    longest = max((sweep.motion for sweep in sweeps), key=travel)

    def usual() -> Load:
        chosen = [sweep.motion for sweep in sweeps[:: max(len(sweeps) // 8, 1)][:8]]

        def run() -> None:
            with threads() as pool:
                list(pool.map(lambda motion: task.grown(task.refined(task.first(motion), motion), motion), chosen))

        return Load(len(chosen), len(chosen), run)

    def load(poses: int, heights: int) -> Load:
        grid = poses, heights
        return Load(
            poses * heights, 1, lambda: minimise(task.face, task.tool, longest, task.limits, task.weights, grid, steps)
        )

    return Stage(
        "sweeps",
        usual,
        {
            "samples, by poses": lambda: (load(count, 30) for count in (50, 100, 200, 400, 800)),
            "samples, by heights": lambda: (load(100, count) for count in (15, 30, 60, 120)),
        },
    )


def coverage(material: Material) -> Stage:
    """The swept gap of sweeps on points of their face."""
    scene, plan = material.plan
    face = WorkFace.of(scene.faces[0], 0.0)
    tools = {tool.name: tool for tool in scene.tools}
    longest = max(plan, key=lambda sweep: travel(sweep.motion))
    tool = tools[longest.tool]

    def points_of(count: int) -> Array:
        return face.samples(face.spacing(count)).points

    def usual() -> Load:
        points = points_of(24_000)
        parts = np.array_split(points, 16)

        def run() -> None:
            with threads() as pool:
                list(pool.map(lambda part: motion_gap(longest.motion, tool, part), parts))

        return Load(len(points), len(points), run)

    def by_points(count: int) -> Load:
        points = points_of(count)
        return Load(len(points), len(points), lambda: motion_gap(longest.motion, tool, points))

    def by_length(share: float) -> Load:
        # About its middle: at its ends a sweep is half off the face, and touches less for each millimetre.
        points, motion = points_of(12_000), longest.motion.restricted(0.5 - 0.5 * share, 0.5 + 0.5 * share)
        return Load(travel(motion), len(points), lambda: motion_gap(motion, tool, points))

    return Stage(
        "points",
        usual,
        {
            "points": lambda: map(by_points, (6_000, 24_000, 96_000)),
            "length of the sweep": lambda: map(by_length, (0.125, 0.25, 0.5, 1.0)),
        },
    )


def collision(material: Material) -> Stage:
    """Clearances of cutter, shank and holder at poses near the sample blade as a mesh."""
    from benchmarks.collision import TRIANGLES, collider_of, part_scene, random_poses
    from conflank_cli.tool import CATALOGUE

    tool = CATALOGUE["T1"]

    def load(triangles: int, poses: int, size: float) -> Load:
        scene, mesh = part_scene(triangles)
        collider = collider_of(scene, mesh)
        p, d = random_poses(np.random.default_rng(SEED), mesh, tool, poses)
        return Load(size, poses, lambda: collider.poses(p, d, tool))

    def by_poses() -> Iterator[Load]:
        scene, mesh = part_scene(TRIANGLES)
        collider = collider_of(scene, mesh)
        p, d = random_poses(np.random.default_rng(SEED), mesh, tool, 4000)
        for count in (250, 1000, 4000):
            yield Load(count, count, lambda count=count: collider.poses(p[:count], d[:count], tool))  # type: ignore[misc]

    return Stage(
        "poses",
        lambda: load(TRIANGLES, 4000, 4000),
        {
            "poses": by_poses,
            "triangles": lambda: (load(count, 1000, count) for count in (75_000, 150_000, 300_000, 600_000)),
        },
    )


def posting(material: Material) -> Stage:
    """From a plan to the text: blocks, feeds, approaches that hit nothing."""
    from conflank_cli.posting import post_program

    scene, plan = material.plan

    def load(times: int) -> Load:
        sweeps = plan * times
        blocks = len(post_program(scene, sweeps)[0].splitlines())
        return Load(blocks, blocks, lambda: post_program(scene, sweeps))

    # From two plans on: the way from one sweep to the next is posted too, and one plan has few.
    return Stage("blocks", lambda: load(4), {"blocks": lambda: map(load, (2, 4, 8, 16))})


def verification(material: Material) -> Stage:
    """From the text to what it cuts: gap on all points, clearance of everything."""
    from conflank_cli.posting import post_program
    from conflank_cli.verification.judge import verify_program
    from conflank_cli.verification.sampling import POINTS_PER_FACE

    scene, plan = material.plan
    text = (material.folder / PROGRAM).read_text(encoding="ascii")
    blocks = len(text.splitlines())

    def load(scene: Scene, text: str, points: int, size: float) -> Load:
        units = len(text.splitlines())
        return Load(size, units, lambda: verify_program(text, scene, points_per_face=points))

    def by_blocks() -> Iterator[Load]:
        for times in (1, 2, 4):
            more = post_program(scene, plan * times)[0]
            yield load(scene, more, POINTS_PER_FACE, len(more.splitlines()))

    return Stage(
        "blocks",
        lambda: load(scene, text, POINTS_PER_FACE, blocks),
        {
            "blocks": by_blocks,
            "points": lambda: (load(scene, text, count, count) for count in (7_500, 30_000, 120_000)),
            "faces": lambda: (load(_faces(scene, count), text, POINTS_PER_FACE, count) for count in (1, 2, 4)),
        },
    )


STAGES: dict[str, Callable[[Material], Stage]] = {
    "footpoints": footpoints,
    "detection": detection,
    "optimisation": optimisation,
    "coverage": coverage,
    "collision": collision,
    "posting": posting,
    "verification": verification,
}


# -- times -----------------------------------------------------------------------------------------------------------


@contextmanager
def one_core() -> Iterator[None]:
    """This thread, and those that it starts, on one core; on all where the system knows no affinity."""
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    every = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(every)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, every)


def timed(run: Callable[[], object]) -> tuple[float, float]:
    """Seconds on the clock and of all processors."""
    start = time.perf_counter(), time.process_time()
    run()
    return time.perf_counter() - start[0], time.process_time() - start[1]


def grown(loads: Iterator[Load]) -> tuple[list[float], list[float]]:
    """Sizes of loads, and the processor's seconds that each takes on one core: the least of some runs."""
    sizes, seconds = [], []
    with one_core():
        for load in loads:
            taken = [timed(load.run)[1]]
            while len(taken) < RUNS and sum(taken) < LONG:
                taken.append(timed(load.run)[1])
            sizes.append(load.size)
            seconds.append(min(taken))
    return sizes, seconds


def peak_memory() -> float:
    """Most resident memory of this process so far, MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * MEMORY_UNIT / 1e6


def measured(name: str, folder: Path) -> dict[str, Any]:
    """The figures of one stage: seconds warm on one core and on all, taking turns, and how they grow.

    The least of the runs, of which there are RUNS or as many as TURNS holds: what else the machine does only adds.
    """
    stage = STAGES[name](Material(folder))
    usual = stage.usual()
    usual.run()
    runs: dict[str, list[tuple[float, float]]] = {"one": [], "all": []}
    begun = time.perf_counter()
    while len(runs["all"]) < RUNS or time.perf_counter() - begun < TURNS:
        with one_core():
            runs["one"].append(timed(usual.run))
        runs["all"].append(timed(usual.run))
    wall, cpu = ({key: min(run[k] for run in some) for key, some in runs.items()} for k in (0, 1))
    growth = {}
    for against, loads in stage.growth.items():
        sizes, seconds = grown(loads())
        growth[against] = {"sizes": sizes, "seconds": [round(value, 6) for value in seconds]}
    return {
        "unit": stage.unit,
        "units": usual.units,
        "wall_s": {key: round(value, 5) for key, value in wall.items()},
        "cpu_s": {key: round(value, 5) for key, value in cpu.items()},
        "growth": growth,
    }


def cold(name: str, folder: Path) -> dict[str, Any]:
    """The usual load in a process that has done nothing else: its time, and the most memory that the process takes."""
    wall, cpu = timed(STAGES[name](Material(folder)).usual().run)
    return {"cold_s": round(wall, 4), "cold_cpu_s": round(cpu, 4), "memory_mb": round(peak_memory(), 1)}


if __name__ == "__main__":
    what, name, folder = sys.argv[1:]
    print(json.dumps({"measured": measured, "cold": cold}[what](name, Path(folder))))
