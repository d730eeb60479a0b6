"""Collision: clearances against FCL on random poses, and poses a second against a part of 300 000 triangles.

    python -m benchmarks.collision [--only truth|time|between] [--json FILE]

The part is the sample blisk blade between its neighbours; its mesh is made finer where there are fewer triangles.
"""

from __future__ import annotations

import json
import os
import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import click
import numpy as np
import numpy.typing as npt
from rich.console import Console

from benchmarks.clearance_truth import Truth
from benchmarks.run import REPOSITORY
from benchmarks.verdicts import Verdict, kept, measured, table, table_console
from conflank_cli.cad.scene import load_scene
from conflank_cli.geometry.collision import COMPONENTS, Body, Collider
from conflank_cli.geometry.face import CheckMesh
from conflank_cli.geometry.gap import polynomials_of
from conflank_cli.geometry.outline import Margins
from conflank_cli.job import load_job
from conflank_cli.motion import fitted
from conflank_cli.scene import Scene
from conflank_cli.tool import CATALOGUE, Tool

Array = npt.NDArray[np.float64]

JOB = REPOSITORY / "sample_parts" / "blisk_blade" / "job.toml"
TRIANGLES = 300_000
TRUTH_POSES, TIMED_POSES, MOTIONS, DENSE = 1000, 20_000, 100, 2000
SEED = 5
# What is asked: clearances within so much of the truth, mm, and so many poses a second.
WITHIN, RATE = 0.010, 1000.0


def part_scene(triangles: int = TRIANGLES) -> tuple[Scene, CheckMesh]:
    """The sample scene, and the whole part as a mesh of at least so many triangles."""
    job = load_job(JOB)
    scene = load_scene(job, JOB.parent)
    whole = Collider.of(scene)
    corners = np.concatenate([body.tree.corners for body in whole.bodies])
    while len(corners) < triangles:
        sides = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2)
        order = np.argsort(-sides.max(axis=1))
        halved, others = order[: triangles - len(corners)], order[triangles - len(corners) :]
        rows, side = np.arange(len(halved)), sides[halved].argmax(axis=1)
        a, b, c = (corners[halved][rows, (side + k) % 3] for k in range(3))
        middle = 0.5 * (a + b)
        pieces = [np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)]
        corners = np.concatenate([corners[others], *pieces])
    numbers = np.arange(3 * len(corners), dtype=np.int32).reshape(-1, 3)
    return scene, CheckMesh(corners.reshape(-1, 3), numbers, np.zeros(len(corners), dtype=np.int32))


def collider_of(scene: Scene, mesh: CheckMesh) -> Collider:
    """A collider with one mesh, no margins and no sag."""
    return Collider(scene, (Body.of("part", mesh, Margins(0.0, 0.0, 0.0), np.zeros(len(mesh.triangles))),))


def random_poses(rng: np.random.Generator, mesh: CheckMesh, tool: Tool, count: int) -> tuple[Array, Array]:
    """Poses with one place of the tool, from the tip to the top, near a vertex of the part; axis points, directions."""
    top = tool.length + sum(section.length for section in (*tool.shank, *tool.holder))
    d = rng.normal(size=(count, 3))
    d /= np.linalg.norm(d, axis=1)[:, None]
    vertices = mesh.vertices[rng.integers(len(mesh.vertices), size=count)]
    offset = rng.normal(size=(count, 3))
    offset *= (rng.uniform(0.0, 1.0, count) * rng.choice([3.0, 10.0, 40.0], count) / np.linalg.norm(offset, axis=1))[
        :, None
    ]
    return vertices + offset - rng.uniform(0.0, top, (count, 1)) * d, d


def compared(collider: Collider, truth: Truth, p: Array, d: Array) -> tuple[int, int, float, int]:
    """Misses, false alarms, the largest error (mm) of a clearance, and how many meet, over components at poses."""
    found = collider.poses(p, d, truth.tool, reach=1000.0).clearance
    misses = false = meeting = 0
    worst = 0.0
    for k in range(len(p)):
        for c, component in enumerate(COMPONENTS):
            expected = truth.clearance(component, p[k], d[k])
            value = float(found[k, c])
            if expected > 0.0:
                false += value < -WITHIN
                worst = max(worst, abs(value - expected))
                continue
            meeting += 1
            misses += value > WITHIN
            # No deeper than we say, and as deep as we say, both within what is asked.
            if truth.reaches(component, p[k], d[k], -value + WITHIN):
                worst = max(worst, 2.0 * WITHIN)
            if -value > WITHIN and not truth.reaches(component, p[k], d[k], -value - WITHIN):
                worst = max(worst, 2.0 * WITHIN)
    return misses, false, worst, meeting


def truth_part(console: Console, made: tuple[Scene, CheckMesh]) -> tuple[list[Verdict], dict[str, Any]]:
    """Clearances of random poses against FCL."""
    scene, mesh = made
    tool = CATALOGUE["T1"]
    p, d = random_poses(np.random.default_rng(SEED), mesh, tool, TRUTH_POSES)
    truth = Truth.of(mesh.vertices, mesh.triangles, tool)
    misses, false, worst, meeting = compared(collider_of(scene, mesh), truth, p, d)
    printed = table(
        "Clearances of four components against FCL", "poses", "meeting", "missed", "false", "largest error um"
    )
    printed.add_row(str(len(p)), str(meeting), str(misses), str(false), f"{1e3 * worst:.2f}")
    console.print(printed)
    figures = {"poses": len(p), "meeting": meeting, "missed": misses, "false": false, "error_um": round(1e3 * worst, 3)}
    return [
        Verdict("collisions missed", "0", str(misses), misses == 0),
        Verdict("false collisions", "0", str(false), false == 0),
        Verdict("largest error of a clearance, um", f"<= {1e3 * WITHIN:g}", f"{1e3 * worst:.2f}", worst <= WITHIN),
    ], figures


def time_part(console: Console, made: tuple[Scene, CheckMesh]) -> tuple[list[Verdict], dict[str, Any]]:
    """Poses a second, all four clearances with their places, on all cores."""
    scene, mesh = made
    tool = CATALOGUE["T1"]
    collider = collider_of(scene, mesh)
    rng = np.random.default_rng(SEED)
    p, d = random_poses(rng, mesh, tool, TIMED_POSES)
    collider.poses(p[:10], d[:10], tool)
    wall, busy = time.perf_counter(), time.process_time()
    collider.poses(p, d, tool)
    wall, busy = time.perf_counter() - wall, time.process_time() - busy
    free = collider.free(p[:10], d[:10], tool)
    quick = time.perf_counter()
    free = collider.free(p, d, tool)
    quick = time.perf_counter() - quick
    rate, rate_free = len(p) / wall, len(p) / quick
    load = os.getloadavg()[0]
    printed = table("Time", "triangles", "poses", "wall s", "core s", "poses a second", "free or not, a second", "load")
    printed.add_row(
        str(len(mesh.triangles)),
        str(len(p)),
        f"{wall:.2f}",
        f"{busy:.2f}",
        f"{rate:.0f}",
        f"{rate_free:.0f}",
        f"{load:.1f}",
    )
    console.print(printed)
    figures = {
        "triangles": len(mesh.triangles),
        "poses_per_second": round(rate),
        "poses_per_core_second": round(len(p) / busy),
        "free_or_not_per_second": round(rate_free),
        "share_free": round(float(free.mean()), 3),
        "load": round(load, 1),
    }
    return [Verdict("poses a second", f">= {RATE:g}", f"{rate:.0f}", rate >= RATE)], figures


def between_part(console: Console, made: tuple[Scene, CheckMesh]) -> tuple[list[Verdict], dict[str, Any]]:
    """Random motions: what is called free stays free at poses looked at densely, and how much is called free."""
    scene, mesh = made
    tool = CATALOGUE["T1"]
    limits = Margins(0.0, 0.0, 0.0)
    collider = replace(collider_of(scene, mesh), bodies=(Body.of("part", mesh, limits, np.zeros(len(mesh.triangles))),))
    rng = np.random.default_rng(SEED)
    missed, agreed, busy, worst = 0, 0, 0.0, 0.0
    for _ in range(MOTIONS):
        p, d = random_poses(rng, mesh, tool, 1)
        t = np.linspace(0.0, 1.0, 9)[:, None]
        ends = p + t * rng.normal(size=3) * 20.0 + t**2 * rng.normal(size=3) * 10.0
        axes = d + t * rng.normal(size=3) * 0.4
        axes /= np.linalg.norm(axes, axis=1)[:, None]
        motion = fitted(t[:, 0], np.hstack([ends, ends + tool.length * axes]), 6)
        start = time.process_time()
        course = collider.motion(motion, tool)
        busy += time.process_time() - start
        times = np.linspace(0.0, 1.0, DENSE)
        low, high = motion.ends(times)
        dense = collider.poses(low, (high - low) / np.linalg.norm(high - low, axis=1)[:, None], tool).slack.min(axis=1)
        said = np.any([(times >= a) & (times <= b) for a, b in course.free], axis=0) if len(course.free) else times < 0
        missed += int(np.sum(said & (dense < -1e-4)))
        agreed += int(np.sum(said == (dense >= 0.0)))
        spans = polynomials_of(motion)[1]
        assert spans[-1] == course.length
        # The least along the motion is no more than the least of the dense poses.
        least = min((reason.slack for reason in collider.least(motion, tool)), default=np.inf)
        if np.isfinite(dense.min()):
            worst = max(worst, least - float(dense.min()))
    share = agreed / (MOTIONS * DENSE)
    printed = table(
        "Motions against dense poses", "motions", "poses", "missed", "agreeing %", "least above um", "core s each"
    )
    printed.add_row(
        str(MOTIONS),
        str(MOTIONS * DENSE),
        str(missed),
        f"{100 * share:.2f}",
        f"{1e3 * worst:.2f}",
        f"{busy / MOTIONS:.2f}",
    )
    console.print(printed)
    figures = {
        "motions": MOTIONS,
        "missed": missed,
        "agreeing": round(share, 5),
        "least_above_um": round(1e3 * worst, 2),
    }
    return [
        Verdict("hits between poses missed", "0", str(missed), missed == 0),
        Verdict(
            "least along a motion above that of dense poses, um",
            f"<= {1e3 * WITHIN:g}",
            f"{1e3 * worst:.2f}",
            worst <= WITHIN,
        ),
    ], figures


@click.command()
@click.option("--only", type=click.Choice(["truth", "time", "between"]), help="One part alone.")
@click.option("--json", "as_json", metavar="FILE", help="Write the figures to FILE too.")
def main(only: str | None, as_json: str | None) -> None:
    """Print what is asked of collision and what was found; exit code 1 where a figure is missed."""
    console = table_console()
    made = part_scene()
    parts = {
        "truth": partial(truth_part, console, made),
        "time": partial(time_part, console, made),
        "between": partial(between_part, console, made),
    }
    verdicts, figures = measured(console, "Collision", parts, only)
    if as_json is not None:
        document = {"cores": os.cpu_count(), "figures": figures, "verdicts": kept(verdicts)}
        Path(as_json).write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    raise SystemExit(0 if all(verdict.reached for verdict in verdicts) else 1)


if __name__ == "__main__":
    main()
