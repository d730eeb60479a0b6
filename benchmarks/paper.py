"""The experiments of the paper's section 5, on this project's sample parts and on real blades: ``make paper``.

Run with ``python -m benchmarks.paper``; ``--only sample`` leaves the real blades out, which are looked for in
``../shared/parts`` beside the repository and left out where that folder is missing. Each side of a blade goes through
detection and optimisation with T1, T2, T3 and a cylinder as thick as T1 in its middle; sweeps are chosen as the paper
does it, the one that adds most first, and with all tools at hand eight besides that no exchange betters, and posted.
Coverage, errors and times of these sweeps are those of the posted text, by the gap of the verification. Beside them
stand sweeps that follow rulings or touch them in two and three points (`benchmarks.strips`), and a finish with the ball
alone.

Figures go to benchmarks/results/paper.json, from which ``python -m benchmarks.readme`` makes the tables of
docs/paper.md, and pictures to docs/pictures. ``--keep DIR`` keeps optimised candidates for another run.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from itertools import repeat
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import click
import msgspec
import numpy as np
import numpy.typing as npt
from rich.console import Console

from benchmarks.optimization import default_sweep, patch_box
from benchmarks.paper_pictures import draw
from benchmarks.run import PARTS, REPOSITORY
from benchmarks.selection import FACES, Case, free_scene, optimised, reachable
from benchmarks.strips import METHODS, WAYS, Strips, Way, by_strips, cutting_seconds
from benchmarks.tables import RESULTS
from benchmarks.verdicts import Verdict, kept, measured, table, table_console
from conflank_cli.cad.scene import load_scene
from conflank_cli.cores import threads
from conflank_cli.geometry.collision import Collider
from conflank_cli.geometry.gap import motion_gap
from conflank_cli.geometry.screening import Screen, longest_between
from conflank_cli.geometry.workface import FaceSamples, WorkFace
from conflank_cli.job import BallPasses, Selection, Tools, load_job
from conflank_cli.optimization.gauss_newton import error_field
from conflank_cli.passes import ball_passes
from conflank_cli.posting import post_program
from conflank_cli.progress import SilentProgress
from conflank_cli.scene import Scene
from conflank_cli.selection.exact import widened
from conflank_cli.selection.judging import MOST_LIFT, POSTING, lifted
from conflank_cli.sweep import Sweep
from conflank_cli.tool import CATALOGUE, Section, Tool
from conflank_cli.verification.axes import drive
from conflank_cli.verification.posed import pose_program
from conflank_cli.verification.swept import gaps_of

Array = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]
Choice = Callable[[BoolArray, Array, int], list[int]]
"""A way to choose so many rows of covers (K, N) at most, with areas (N,)."""

TOLERANCE = 0.010  # mm
LIMIT = TOLERANCE - POSTING  # mm, before posting
SAMPLES = (100, 30)  # of the axis error, as in the paper
LARGEST = 3  # sweeps of each side that are looked at closely
MOST = 10  # sweeps of one tool
LEAST_GAIN = 0.002  # of the face, that one more sweep must add
LIFT_MORE = 1.2  # times what a sweep overcuts too much it is moved off the face, as it turns on the way
POINTS = 6000  # of a face, about
ASKED = 0.90  # what the paper covers, with
PAPER_SWEEPS = 8
PAPER_EPSILON_UM, PAPER_REFERENCE_UM = 2.7, 34.1
FIGURE_15 = (1, 2, 4, 20)  # sweeps that follow rulings
STRIPS = (1, 2, 4, 8, 20, 40)  # of each method
SAMPLE_PARTS = (("blisk_blade", "blisk blade"), ("impeller", "impeller"))
SIDES = ("pressure", "suction")
CONES = tuple(CATALOGUE)
COMPARED = CATALOGUE["T1"]  # the tool that other methods are compared with


def mean_cylinder(tool: Tool) -> Tool:
    """A cylinder as thick as a tool in the middle of its cone, and as long; its shank is as thick."""
    radius = 0.5 * (tool.r_min + tool.r_max)
    shank = tuple(Section(2.0 * radius, 2.0 * radius, section.length) for section in tool.shank)
    return replace(tool, name=f"C{tool.name}", r_min=radius, r_max=radius, shank=shank, number=tool.number + 20)


CYLINDER = mean_cylinder(COMPARED)


def sample_cases() -> list[Case]:
    """Both sides of the sample parts, between what stands round them."""
    found = []
    for folder, title in SAMPLE_PARTS:
        place = REPOSITORY / "sample_parts" / folder
        job = load_job(place / "job.toml")
        for side in SIDES:
            designs = tuple(design for design in job.part.design if design.face == side)
            own = msgspec.structs.replace(
                job,
                part=msgspec.structs.replace(job.part, design=designs),
                tools=Tools(CONES),
                selection=Selection(ASKED),
                program=msgspec.structs.replace(job.program, name="PAPER"),
            )
            found.append(_with_cylinder(Case(f"{title}, {side}", load_scene(own, place), PAPER_SWEEPS)))
    return found


def shared_cases() -> list[Case]:
    """Faces of real blades with nothing else in the way, as far as they are there."""
    found = []
    for flank in FACES:
        if (PARTS / flank.file).exists():
            side = {0.55: " pressure", 0.06: " suction"}.get(flank.region[2], "")
            scene = free_scene(flank, tuple(CATALOGUE.values()))
            found.append(_with_cylinder(Case(flank.name + side, scene, PAPER_SWEEPS)))
    return found


def _with_cylinder(case: Case) -> Case:
    return replace(case, scene=replace(case.scene, tools=(*case.scene.tools, CYLINDER)))


# -- sweeps of the pipeline ------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Choosing:
    """What sweeps are chosen with: tools by name, what they must not hit, and the points that they are judged on."""

    tools: Mapping[str, Tool]
    screen: Screen
    collider: Collider
    samples: FaceSamples

    def sweeps(self, candidates: Sequence[Sweep], choice: Choice, most: int) -> list[Sweep]:
        """At most so many sweeps that may be cut, by one of the ways to choose rows of covers."""
        areas = self.samples.areas
        with threads() as pool:
            found = [item for item in pool.map(self.able, candidates) if item is not None]
            cleared: set[int] = set()
            while True:
                order = choice(np.array([covered for _, covered in found]).reshape(-1, len(areas)), areas, most)
                chosen = [found[k][0] for k in order]
                new = [k for k in order if k not in cleared]
                if not new:
                    return chosen
                # What hits something between the poses of the screen is cut short, and everything chosen again.
                swept = [found[k][0] for k in new]
                free = list(pool.map(lambda one: self.collider.allowed(one.motion, self.tools[one.tool]), swept))
                for k, motion in zip(new, free, strict=True):
                    if motion is None:
                        found[k] = found[k][0], np.zeros(len(areas), dtype=np.bool_)
                    elif motion is not found[k][0].motion:
                        found[k] = self.judged(replace(found[k][0], motion=motion))
                cleared.update(new)

    def judged(self, sweep: Sweep) -> tuple[Sweep, BoolArray]:
        """A sweep, and what it covers: nothing if it overcuts anywhere."""
        gap = motion_gap(sweep.motion, self.tools[sweep.tool], self.samples.points)[0]
        return sweep, np.asarray((gap <= LIMIT) & (gap.min() >= -LIMIT))

    def able(self, sweep: Sweep) -> tuple[Sweep, BoolArray] | None:
        """What of a sweep hits nothing and overcuts nowhere, and what it covers."""
        tool = self.tools[sweep.tool]
        motion = self.screen.allowed(sweep.motion, tool)
        if motion is None:
            return None
        gap, at = motion_gap(motion, tool, self.samples.points)
        excess = float(-LIMIT - gap.min())
        if 0.0 < excess <= 2.0 * LIMIT * MOST_LIFT:
            motion = lifted(motion, self.samples, LIFT_MORE * excess)
        elif excess > 0.0:
            motion = longest_between(motion, at[gap < -LIMIT])
        return None if motion is None else self.judged(replace(sweep, motion=motion))


def greedy_order(covers: BoolArray, areas: Array, most: int) -> list[int]:
    """Rows of covers (K, N), each the one that adds most area, as long as that is LEAST_GAIN of all (paper, 5.3)."""
    order: list[int] = []
    left = areas.copy()
    while len(order) < min(most, len(covers)):
        gains = covers @ left
        best = int(np.argmax(gains))
        if gains[best] < LEAST_GAIN * areas.sum():
            break
        order.append(best)
        left[covers[best]] = 0.0
    return order


def widest(covers: BoolArray, areas: Array, most: int) -> list[int]:
    """At most as many rows as `greedy_order` gives, exchanged one for another as long as more area gets covered."""
    order = greedy_order(covers, areas, most)
    if not order:
        return order
    best = widened(covers, areas, order)
    return [best[k] for k in greedy_order(covers[best], areas, most)]


@dataclass(frozen=True, slots=True)
class Posted:
    """Sweeps as a program has them: K sweeps, their gaps (K, N) at the samples, mm, and seconds (K,)."""

    sweeps: list[Sweep]
    gaps: Array
    seconds: Array

    @classmethod
    def of(cls, scene: Scene, sweeps: list[Sweep], samples: FaceSamples) -> Posted:
        """Post the sweeps, and read the text back."""
        posed = pose_program(post_program(scene, sweeps)[0], scene)
        moves = posed.poses.moves
        times = drive(posed, scene).seconds
        # Without the ways to and from the face: what the paper's figure is about.
        seconds = np.array([times[moves.cut == k].sum() for k in range(len(sweeps))])
        return cls(sweeps, gaps_of(posed, samples.points)[1], seconds)

    def of_tools(self, names: Sequence[str]) -> Posted:
        """Only the sweeps of some tools."""
        return self._rows([k for k, sweep in enumerate(self.sweeps) if sweep.tool in names])

    def greedy(self, areas: Array) -> Posted:
        """The same in the order in which each adds most."""
        return self._rows(greedy_order(self.within(), areas, MOST))

    def first(self, count: int) -> tuple[Posted, Posted]:
        """The first so many, and the others."""
        return self._rows(range(count)), self._rows(range(count, len(self.sweeps)))

    def _rows(self, rows: Sequence[int]) -> Posted:
        index = np.array(rows, dtype=np.int64)
        return Posted([self.sweeps[k] for k in rows], self.gaps[index], self.seconds[index])

    def within(self) -> BoolArray:
        """(K, N), what each covers."""
        return np.asarray(np.abs(self.gaps) <= TOLERANCE)

    def coverage(self, areas: Array) -> Array:
        """Share of the area covered by the first k sweeps together, (K,): what one of them gouges is not covered."""
        gap = np.minimum.accumulate(self.gaps, axis=0)
        return np.asarray((np.abs(gap) <= TOLERANCE) @ areas / areas.sum())


def spread(values: Array, weights: Array | None = None) -> dict[str, float]:
    """Mean of absolutes, signed mean and extremes of errors in mm, as µm."""
    um = 1e3 * values
    return {
        "mean_abs": round(float(np.average(np.abs(um), weights=weights)), 2),
        "mean": round(float(np.average(um, weights=weights)), 2),
        "min": round(float(um.min()), 2),
        "max": round(float(um.max()), 2),
    }


def largest_figures(face: WorkFace, tool: Tool, posted: Posted, samples: FaceSamples) -> list[dict[str, Any]]:
    """Errors of the largest sweeps: axis error at the paper's samples, gap of the posted text on the patch."""
    rows = []
    covers = posted.within()
    for k, sweep in enumerate(posted.sweeps[:LARGEST]):
        patch = covers[k]
        errors_field = error_field(face, tool, sweep.motion, 0.0, SAMPLES)[0]
        on_face = errors_field.error[errors_field.on > 0.5]
        inside = on_face[np.abs(on_face) <= TOLERANCE]
        default = default_sweep(face, tool, sweep.motion, patch_box(samples.uv[patch]))[1]
        rows.append(
            {
                "area_mm2": round(float(samples.areas[patch].sum()), 1),
                "share": round(float(samples.areas[patch].sum() / samples.areas.sum()), 4),
                "epsilon_within": round(len(inside) / len(on_face), 4),
                "epsilon_um": spread(inside),
                "gap_um": spread(posted.gaps[k][patch], samples.areas[patch]),
                "seconds": round(float(posted.seconds[k]), 2),
                "rulings_epsilon_um": spread(default),
            }
        )
    return rows


def tool_figures(face: WorkFace, tool: Tool, posted: Posted, samples: FaceSamples) -> dict[str, Any]:
    """What is kept of one tool on one face."""
    coverage = posted.coverage(samples.areas)
    return {
        "tool": tool.name,
        "coverage": coverage.round(4).tolist(),
        "seconds": posted.seconds.round(2).tolist(),
        "cutting_seconds": [round(cutting_seconds(sweep.motion, tool), 2) for sweep in posted.sweeps],
        "largest": largest_figures(face, tool, posted, samples),
    }


# -- other methods ---------------------------------------------------------------------------------------------------


def strip_figures(strips: Strips, count: int, tool: Tool, samples: FaceSamples) -> dict[str, Any]:
    """What is kept of one method with so many strips."""
    return {
        "sweeps": count,
        "rulings": strips.way[0],
        "coverage": round(strips.coverage(samples, TOLERANCE), 4),
        "overcut_um": round(max(-1e3 * float(strips.gap.min()), 0.0), 1),
        "stock_um": round(1e3 * float(strips.gap.max()), 1),
        "cutting_seconds": round(sum(cutting_seconds(motion, tool) for motion in strips.motions), 1),
    }


def method_figures(
    face: WorkFace, samples: FaceSamples, wanted: float
) -> tuple[dict[str, list[dict[str, Any]]], dict[int, Strips]]:
    """Each method with more and more strips, until it covers what is wanted; and the strips that follow rulings."""
    found: dict[str, list[dict[str, Any]]] = {}
    shown: dict[int, Strips] = {}
    for name, method in METHODS.items():
        found[name] = []
        ways: Sequence[Way] = WAYS
        for count in STRIPS:
            strips = by_strips(face, COMPARED, method, count, samples, TOLERANCE, ways)
            # By then it shows which lines serve best.
            ways = (strips.way,) if count >= max(FIGURE_15) else WAYS
            found[name].append(strip_figures(strips, count, COMPARED, samples))
            if method is METHODS["following the rulings"]:
                shown[count] = strips
            if count >= max(FIGURE_15) and (found[name][-1]["coverage"] >= wanted):
                break
    return found, shown


def ball_figures(scene: Scene) -> dict[str, Any]:
    """The ball alone over the whole face, its crests as high as the tolerance: length and time of its passes."""
    keys = BallPasses(enabled=True, scallop=TOLERANCE, tool=COMPARED.name)
    job = msgspec.structs.replace(scene.job, selection=Selection(ASKED, ball_passes=keys))
    passes, summary = ball_passes(replace(scene, job=job), [], SilentProgress())
    length = sum(each.facts["length_mm"] for each in passes)
    return {
        "passes": len(passes),
        "length_mm": round(length, 0),
        "cutting_seconds": round(60.0 * length / COMPARED.feed_mm_min, 1),
        "coverage": round(float(summary["passes_by_face"][0]["coverage"]), 4),
    }


# -- a face ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Measured:
    """One side of a blade: what is kept, and what pictures are made of."""

    name: str
    samples: FaceSamples
    posted: Posted
    strips: dict[int, Strips]
    figures: dict[str, Any] = field(repr=False)


def measure(case: Case, folder: Path | None) -> Measured:
    """Everything that the tables say of one side of a blade."""
    scene = case.scene
    start, used = time.perf_counter(), time.process_time()
    tools = {tool.name: tool for tool in scene.tools}
    work = WorkFace.of(scene.faces[0], 0.0)
    samples = work.samples(work.spacing(POINTS))
    candidates = optimised(case, folder)
    areas = samples.areas
    choosing = Choosing(tools, Screen.of(scene), Collider.of(scene), samples)
    chosen = {
        name: choosing.sweeps(
            [sweep for sweep in candidates if sweep.tool == name], greedy_order, MOST if name in CONES else PAPER_SWEEPS
        )
        for name in tools
    }
    best = choosing.sweeps([sweep for sweep in candidates if sweep.tool in CONES], widest, PAPER_SWEEPS)
    in_turn = [sweep for own in chosen.values() for sweep in own]
    posted, posted_best = Posted.of(scene, [*in_turn, *best], samples).first(len(in_turn))
    rows = {
        name: tool_figures(WorkFace.under(scene.faces[0], tool), tool, posted.of_tools([name]).greedy(areas), samples)
        for name, tool in tools.items()
        if chosen[name]
    }
    mixed, eight = posted.of_tools(CONES).greedy(areas), posted_best.greedy(areas)
    together = {
        "coverage": mixed.coverage(areas).round(4).tolist(),
        "best": float(eight.coverage(areas)[-1].round(4)) if eight.sweeps else 0.0,
        "tools": [sweep.tool for sweep in eight.sweeps],
        "cutting_seconds": [round(cutting_seconds(sweep.motion, tools[sweep.tool]), 2) for sweep in eight.sweeps],
    }
    if together["best"] < ASKED:
        # What no number of sweeps goes beyond, but for ends of the flute.
        cones = replace(scene, tools=tuple(tools[name] for name in CONES))
        together["reachable"] = round(reachable(cones, 0), 4)
    own = rows.get(COMPARED.name, {"coverage": []})["coverage"]
    # As much as the paper's number of sweeps covers here is what others have to reach.
    wanted = own[min(PAPER_SWEEPS, len(own)) - 1] if own else 1.0
    methods, strips = method_figures(WorkFace.under(scene.faces[0], COMPARED), samples, wanted)
    figures = {
        "face": case.name,
        "sample": case.name.split(",")[0] in [title for _, title in SAMPLE_PARTS],
        "area_mm2": round(float(samples.areas.sum()), 1),
        "candidates": {name: sum(sweep.tool == name for sweep in candidates) for name in tools},
        "tools": {name: row for name, row in rows.items() if name in CONES},
        "cylinder": rows.get(CYLINDER.name),
        "together": together,
        "methods": methods,
        "ball": ball_figures(scene),
        "cpu_s": round(time.process_time() - used, 0),
        "wall_s": round(time.perf_counter() - start, 0),
    }
    return Measured(case.name, samples, posted, strips, figures)


def sweeps_for(coverage: Sequence[float], share: float) -> int | None:
    """How many sweeps cover a share, None where all of them do not."""
    return next((k for k, reached in enumerate(coverage, start=1) if reached >= share), None)


def verdicts(found: Sequence[dict[str, Any]]) -> list[Verdict]:
    """What the paper reaches, against what is reached here on the sample parts."""
    own = [row for row in found if row["sample"]]
    asked = []
    for row in own:
        reached, within_reach = row["together"]["best"], row["together"].get("reachable")
        of_it = "" if within_reach is None else f" of {100 * within_reach:.1f} in reach"
        asked.append(
            Verdict(
                f"{row['face']}: covered by {PAPER_SWEEPS} sweeps, %", f"> {100 * ASKED:g}",
                f"{100 * reached:.1f}{of_it}", reached > ASKED,
            )
        )  # fmt: skip
    large = [sweep for row in own for tool in row["tools"].values() for sweep in tool["largest"]]
    mean = float(np.mean([sweep["epsilon_um"]["mean_abs"] for sweep in large]))
    rulings = float(np.mean([sweep["rulings_epsilon_um"]["mean_abs"] for sweep in large]))
    asked.append(
        Verdict(
            "mean |e| of the largest sweeps, um", f"<= {PAPER_EPSILON_UM:g}", f"{mean:.2f}", mean <= PAPER_EPSILON_UM
        )
    )
    asked.append(Verdict("the same following the rulings, um", "", f"{rulings:.1f}", True))
    ratio = PAPER_REFERENCE_UM / PAPER_EPSILON_UM
    asked.append(Verdict("ratio of the two", f">= {ratio:.1f}", f"{rulings / mean:.1f}", rulings >= ratio * mean))
    return asked


def printed(console: Console, found: Sequence[Measured]) -> None:
    """The table on the terminal."""
    shown = table(
        f"+-{1e3 * TOLERANCE:g} um, from the posted text", "face", "tool", "3 sweeps %", "8 sweeps %", "all %",
        "sweeps", "for 90 %", "mean |e| um", "mean |g| um", "s a sweep", "rulings: mean |e|",
    )  # fmt: skip
    for face in found:
        for name, row in face.figures["tools"].items():
            coverage, large = row["coverage"], row["largest"]
            shown.add_row(
                face.name, name, *(f"{100 * coverage[min(k, len(coverage)) - 1]:.1f}" for k in (3, 8, MOST)),
                str(len(coverage)), str(sweeps_for(coverage, ASKED) or "-"),
                *(f"{np.mean([sweep[key]['mean_abs'] for sweep in large]):.2f}" for key in ("epsilon_um", "gap_um")),
                f"{np.mean([sweep['seconds'] for sweep in large]):.1f}",
                f"{np.mean([sweep['rulings_epsilon_um']['mean_abs'] for sweep in large]):.0f}",
            )  # fmt: skip
    console.print(shown)


@click.command()
@click.option("--only", type=click.Choice(["sample"]), help="The sample parts alone.")
@click.option(
    "--face", "faces", multiple=True, metavar="TEXT", help="Only faces with TEXT in their name; writes nothing."
)
@click.option("--keep", metavar="DIR", help="Keep optimised candidates in DIR, and take them from there.")
@click.option("--jobs", type=click.IntRange(min=1), default=2, show_default=True, help="Faces at a time.")
def main(only: str | None, faces: tuple[str, ...], keep: str | None, jobs: int) -> None:
    """Measure, write figures and pictures; exit code 1 where the paper's figures are missed."""
    console = table_console()
    folder = None if keep is None else Path(keep)
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
    real = [] if only == "sample" else shared_cases()
    left_out = sorted({flank.file for flank in FACES if only == "sample" or not (PARTS / flank.file).exists()})
    cases = [case for case in (*sample_cases(), *real) if not faces or any(name in case.name for name in faces)]
    if not PARTS.is_dir():
        console.print(f"no folder {PARTS.parent.name}/{PARTS.name} beside the repository: real blades left out")
    found: list[Measured] = []

    def all_faces() -> tuple[list[Verdict], dict[str, Any]]:
        # Fitting, choosing and posting keep one core busy, so that several faces at a time take less time in all.
        with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
            for each in pool.map(measure, cases, repeat(folder)):
                found.append(each)
                row = each.figures
                console.print(f"{each.name}: {row['wall_s']:.0f} s, {row['cpu_s']:.0f} s of CPU")
        printed(console, found)
        return verdicts([each.figures for each in found]), {"rows": [each.figures for each in found]}

    asked, figures = measured(console, "paper", {"faces": all_faces}, None)
    if not faces:
        document = {
            "verdicts": kept(asked),
            "tolerance_um": 1e3 * TOLERANCE,
            "left_out": left_out,
            "faces": figures["faces"]["rows"],
        }
        (RESULTS / "paper.json").write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
        draw(found, document)
    raise SystemExit(0 if all(verdict.reached for verdict in asked) else 1)


if __name__ == "__main__":
    main()
