"""What the choice saves against the greedy one of the paper, and how sure it is of that.

Run with ``python -m benchmarks.selection`` (or ``make bench``), one part of it with ``--only faces``, ``time`` or
``refinement``. Faces are both sides of the sample blade between its neighbours with T1, and those of real blades with
T1, T2 and T3 in the drawer (of the compressor wheel with everything around it). Plans are those of
`conflank_cli.selection.select`: no collision, and a certificate for each sweep. One that covers less than is asked for
is held against what single poses can reach with nothing in the way (`benchmarks.free_lines`). Real blades are looked
for in ``../shared/parts`` beside the repository and left out where that folder is missing. Optimised candidates take
most of the time; ``--keep DIR`` keeps them for another run.
"""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import click
import msgspec
import numpy as np
from rich.console import Console

from benchmarks.blind_search import LEAST_RUN
from benchmarks.detection import FLANKS, NO_MACHINE, Flank, load, scene
from benchmarks.envelopes import cylinder
from benchmarks.free_lines import freely_reached
from benchmarks.run import PARTS, REPOSITORY
from benchmarks.verdicts import Verdict, kept, measured, table, table_console
from conflank_cli import job as jobs
from conflank_cli.artifacts import read_artifact, write_artifact
from conflank_cli.cad.scene import load_scene
from conflank_cli.detection import detect
from conflank_cli.geometry.gap import motion_gap
from conflank_cli.geometry.workface import WorkFace
from conflank_cli.job import load_job
from conflank_cli.optimization import optimize
from conflank_cli.progress import Progress, SilentProgress, make_progress
from conflank_cli.scene import Scene
from conflank_cli.selection import select
from conflank_cli.selection.choice import Candidate, choose
from conflank_cli.selection.judging import FINE_POINTS, POSTING
from conflank_cli.sweep import Sweep
from conflank_cli.tool import CATALOGUE, Tool

TOLERANCE = 0.010  # mm, overcut and undercut
COVERAGE = 0.90
OF_REACHABLE = 0.95  # of what single poses can reach, where that is less
REACH_POINTS = 1000
MOST_SWEEPS, MOST_SWEEPS_BLISK = 8, 4  # on a face
SECONDS, CANDIDATES = 20.0, 400
REFINED = 0.002  # of a face, by which refining the points may change a coverage
FINER = 4
DRAWER = tuple(CATALOGUE.values())
WHEEL = "compressor_wheel.step"
TIMED = "propeller_upper 0*"  # the face with the hardest choice

# Those of detection, and the other sides: the suction side of the airfoil, the face of the propeller.
FACES = (
    *FLANKS,
    Flank("airfoil_closed.igs", 0, (0.0, 1.0, 0.06, 0.42)),
    Flank("propeller_lower.iges", 0, (0.15, 0.85, 0.1, 0.7)),
)


@dataclass(frozen=True, slots=True)
class Case:
    """A face (or both sides of the sample blade) to choose sweeps for."""

    name: str
    scene: Scene
    most: int


def cases() -> list[Case]:
    """All faces that there are."""
    job = load_job(REPOSITORY / "sample_parts" / "blisk_blade" / "job.toml")
    found = [Case("blisk", load_scene(job, REPOSITORY / "sample_parts" / "blisk_blade"), MOST_SWEEPS_BLISK)]
    for flank in FACES:
        if (PARTS / flank.file).exists() and flank.file != WHEEL:
            side = {0.55: " pressure", 0.06: " suction"}.get(flank.region[2], "")
            found.append(Case(flank.name + side, free_scene(flank, DRAWER), MOST_SWEEPS))
    if (PARTS / WHEEL).exists():
        found.append(Case("wheel", wheel_scene(), MOST_SWEEPS))
    return found


def wheel_scene() -> Scene:
    """Both sides of a blade of the compressor wheel, with its hub and the other blades around it, axis upright."""
    designs = tuple(jobs.Design(flank.face) for flank in FACES if flank.file == WHEEL)
    job = jobs.Job(
        part=jobs.Part(WHEEL, designs),
        tools=jobs.Tools(tuple(tool.name for tool in DRAWER)),
        tolerance=jobs.Tolerance(TOLERANCE, TOLERANCE),
        selection=jobs.Selection(COVERAGE),
        setup=jobs.Setup(rotate_deg=(90.0, 0.0, 0.0)),
    )
    return load_scene(job, PARTS)


def free_scene(flank: Flank, tools: Sequence[Tool]) -> Scene:
    """A face by itself, on a machine that reaches every axis."""
    own = scene(load(flank), tools)
    job = msgspec.structs.replace(
        own.job,
        tolerance=jobs.Tolerance(TOLERANCE, TOLERANCE),
        selection=jobs.Selection(COVERAGE),
        machine=jobs.Machine("no-limits", None, NO_MACHINE),
    )
    return replace(own, job=job)


def optimised(case: Case, folder: Path | None) -> list[Sweep]:
    """The candidates of a case, from `folder` if they are there."""
    file = None if folder is None else folder / f"{case.name.replace(' ', '_').replace('*', '')}.npz"
    if file is not None and file.exists():
        return list(read_artifact(file, "motions")[1])
    silent = SilentProgress()
    sweeps, _ = optimize(case.scene, detect(case.scene, silent), silent)
    if file is not None:
        write_artifact("motions", case.scene, sweeps, {}, file)
    return sweeps


def faces(console: Console, progress: Progress, folder: Path | None) -> tuple[list[Verdict], dict[str, Any]]:
    """Greedy against exact on every face: sweeps, proven gap, time of the whole stage."""
    printed = table(
        f"+-{1e3 * TOLERANCE:g} um, {100 * COVERAGE:g} % asked for",
        "face", "candidates", "covered %", "reachable %", "of it %", "sweeps", "greedy", "its %", "at least", "gap %",
        "CPU s", "s",
    )  # fmt: skip
    left = table("what is left, mm2", "face", "no line fits", "no sweep", "collision", "machine", "overcut", "small",
                 "not needed")  # fmt: skip
    rows: list[dict[str, Any]] = []
    every = cases()
    with progress.stage("faces", len(every)) as stage:
        for case in every:
            sweeps = optimised(case, folder)
            start, used = time.perf_counter(), time.process_time()
            choice = select(case.scene, sweeps, SilentProgress())
            seconds, used = time.perf_counter() - start, time.process_time() - used
            for index, face in enumerate(choice.summary["faces"]):
                own = sum(case.scene.faces[sweep.face].number == face["face"] for sweep in sweeps)
                name = case.name if len(case.scene.faces) == 1 else f"{case.name} {face['face']}"
                rows.append(
                    {"face": name, "most": case.most, "candidates": own, "cpu_s": round(used, 1),
                     "seconds": round(seconds, 1),
                     "reachable": reachable(case.scene, index) if face["coverage"] < COVERAGE else None}
                    | {k: v for k, v in face.items() if k not in ("face", "objective")}
                )  # fmt: skip
            stage.advance()
    for row in rows:
        most = row["reachable"]
        printed.add_row(
            row["face"], str(row["candidates"]), f"{100 * row['coverage']:.2f}",
            "" if most is None else f"{100 * most:.1f}", "" if most is None else f"{100 * row['coverage'] / most:.1f}",
            f"{row['price']:.0f}", f"{row['greedy']:.0f}", f"{100 * row['greedy_coverage']:.1f}", f"{row['bound']:.0f}",
            f"{100 * row['gap']:.0f}", f"{row['cpu_s']:.0f}", f"{row['seconds']:.0f}",
        )  # fmt: skip
        area = row["left_mm2"]
        names = ("no_line", "no_sweep", "collision", "machine", "overcut", "small", "not_chosen")
        left.add_row(row["face"], *(f"{area[name]:.0f}" if name in area else "" for name in names))
    for each in (printed, left):
        console.print(each)
    worse = [row["face"] for row in rows if row["price"] > row["greedy"] and row["greedy_coverage"] >= COVERAGE]
    saved = sum(max(row["greedy"] - row["price"], 0.0) for row in rows if row["greedy_coverage"] >= COVERAGE)
    proven = sum(row["gap"] == 0.0 for row in rows)
    many = [row["face"] for row in rows if row["price"] > row["most"] or row["coverage"] < _asked(row["reachable"])]
    verdicts = [
        Verdict("exact choice worse than greedy, faces", "0", ", ".join(worse) or "0", not worse),
        Verdict("sweeps saved against greedy", "", f"{saved:.0f} on {len(rows)} faces", True),
        Verdict("fewest proven, faces", "", f"{proven} of {len(rows)}", True),
        Verdict(f">= {100 * COVERAGE:g} %, or {100 * OF_REACHABLE:g} % of the reachable, by <= {MOST_SWEEPS} sweeps"
                f" ({MOST_SWEEPS_BLISK}: sample)", f"{len(rows)} faces", ", ".join(many) or "all", not many),
    ]  # fmt: skip
    return verdicts, {"rows": rows}


def reachable(scene: Scene, index: int) -> float:
    """Share of a face that single poses can reach, whatever many of them it takes."""
    face = WorkFace.of(scene.faces[index], 0.0)
    samples = face.samples(face.spacing(REACH_POINTS))
    return float(samples.areas[freely_reached(scene, index, samples, LEAST_RUN)].sum() / samples.areas.sum())


def _asked(within_reach: float | None) -> float:
    """The coverage that is asked for where so much can be reached."""
    return COVERAGE if within_reach is None else min(COVERAGE, OF_REACHABLE * within_reach)


def hard_case() -> Case | None:
    """The face whose choice takes longest, with more candidates than are asked about."""
    flank = next((flank for flank in FACES if flank.name == TIMED and (PARTS / flank.file).exists()), None)
    return None if flank is None else Case(TIMED + " with a cylinder", free_scene(flank, (*DRAWER, cylinder())), 0)


def choice_time(console: Console, folder: Path | None) -> tuple[list[Verdict], dict[str, Any]]:
    """The choice among as many candidates as asked about, for the fewest sweeps and for the least time."""
    case = hard_case()
    if case is None:
        return [], {}
    tools = {tool.name: tool for tool in case.scene.tools}
    sweeps = optimised(case, folder)[:CANDIDATES]
    face = WorkFace.of(case.scene.faces[0], 0.0)
    samples = face.samples(face.spacing(6000))
    limit = TOLERANCE - POSTING
    items = []
    for sweep in sweeps:
        gap = motion_gap(sweep.motion, tools[sweep.tool], samples.points)[0]
        items.append(Candidate.of(sweep, tools[sweep.tool], gap, np.abs(gap) <= limit, 5.0))
    printed = table(f"choice among {len(items)}", "objective", "sweeps", "time s", "at least", "gap %", "CPU s", "s")
    rows: list[dict[str, Any]] = []
    objectives: tuple[Literal["sweeps", "time"], ...] = ("sweeps", "time")
    for objective in objectives:
        job = msgspec.structs.replace(case.scene.job, selection=jobs.Selection(COVERAGE, objective))
        start, used = time.perf_counter(), time.process_time()
        chosen = choose(items, samples.areas, samples.cell, job, (), COVERAGE)
        seconds, used = time.perf_counter() - start, time.process_time() - used
        cut = sum(item.seconds for item in chosen.items)
        rows.append({"objective": objective, "sweeps": len(chosen.items), "cut_s": round(cut, 1),
                     "bound": chosen.bound, "gap": chosen.gap, "cpu_s": round(used, 1),
                     "seconds": round(seconds, 1)})  # fmt: skip
        printed.add_row(objective, str(len(chosen.items)), f"{cut:.1f}", f"{chosen.bound:.1f}",
                        f"{100 * chosen.gap:.1f}", f"{used:.1f}", f"{seconds:.1f}")  # fmt: skip
    console.print(printed)
    worst = max(row["seconds"] for row in rows)
    return [Verdict(f"choice among {len(items)} candidates, s", f"<= {SECONDS:g}", f"{worst:.1f}", worst <= SECONDS)], {
        "rows": rows
    }


def refinement(console: Console, folder: Path | None) -> tuple[list[Verdict], dict[str, Any]]:
    """Coverage of plans on the points that figures are stated on, and on more."""
    printed = table(
        f"coverage on {FINE_POINTS} points and on {FINER} times as many, %", "face", "all", "finer", "largest change"
    )
    rows: list[dict[str, Any]] = []
    for case in cases():
        choice = select(case.scene, optimised(case, folder), SilentProgress())
        tools = {tool.name: tool for tool in case.scene.tools}
        limit = TOLERANCE - POSTING
        for index, design in enumerate(case.scene.faces):
            face = WorkFace.of(design, 0.0)
            plan = [sweep for sweep in choice.plan if sweep.face == index]
            shares = []
            for count in (FINE_POINTS, FINER * FINE_POINTS):
                samples = face.samples(face.spacing(count))
                within = np.array(
                    [motion_gap(s.motion, tools[s.tool], samples.points)[0] <= limit for s in plan], dtype=np.bool_
                ).reshape(len(plan), -1)
                within = np.vstack([within.any(axis=0), within])
                shares.append(within @ samples.areas / samples.areas.sum())
            change = float(np.abs(shares[1] - shares[0]).max(initial=0.0))
            name = case.name if len(case.scene.faces) == 1 else f"{case.name} {design.number}"
            rows.append({"face": name, "coverage": float(shares[0][0]), "finer": float(shares[1][0]),
                         "change": change})  # fmt: skip
            printed.add_row(name, f"{100 * shares[0][0]:.3f}", f"{100 * shares[1][0]:.3f}", f"{100 * change:.3f}")
    console.print(printed)
    worst = max(row["change"] for row in rows)
    return [
        Verdict(
            "refining changes a coverage by, % of the face", f"<= {100 * REFINED:g}", f"{100 * worst:.3f}",
            worst <= REFINED,
        )
    ], {"rows": rows}  # fmt: skip


@click.command()
@click.option("--only", type=click.Choice(["faces", "time", "refinement"]), help="One part alone.")
@click.option("--keep", metavar="DIR", help="Keep optimised candidates in DIR, and take them from there.")
@click.option("--json", "as_json", metavar="FILE", help="Write the figures to FILE too.")
def main(only: str | None, keep: str | None, as_json: str | None) -> None:
    """Print what is chosen and what was asked; exit code 1 where a figure is missed."""
    console, progress = table_console(), make_progress(False)
    folder = None if keep is None else Path(keep)
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
    verdicts, figures = measured(
        console,
        "choice",
        {
            "faces": lambda: faces(console, progress, folder),
            "time": lambda: choice_time(console, folder),
            "refinement": lambda: refinement(console, folder),
        },
        only,
    )
    if as_json is not None:
        Path(as_json).write_text(json.dumps({"verdicts": kept(verdicts)} | figures, indent=1) + "\n", encoding="utf-8")
    raise SystemExit(0 if all(verdict.reached for verdict in verdicts) else 1)


if __name__ == "__main__":
    main()
