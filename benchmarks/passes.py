"""What passes with the ball add to the sweeps, and what they cost: coverage, steps, time beside a finish by ball alone.

Run with ``python -m benchmarks.passes`` (or ``make bench``), one part of it with ``--only blisk``, ``--only blades`` or
``--only wheel``. Every figure is from the posted text, by the verification; only the seconds of computing are the
program's own. On the compressor wheel, a third of whose blades is inside of its hub, coverage is held against what the
ball can touch at all. Real blades are looked for in ``../shared/parts`` beside the repository and left out where that
folder is missing.
"""

from __future__ import annotations

import json
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import click
import msgspec
from rich.console import Console

from benchmarks.free_lines import ball_reached
from benchmarks.jobs import job_text
from benchmarks.run import PARTS, REPOSITORY
from benchmarks.selection import WHEEL, wheel_scene
from benchmarks.verdicts import Part, Verdict, kept, measured, table, table_console
from conflank_cli.ball_pass import Pass
from conflank_cli.cad.scene import load_scene
from conflank_cli.detection import detect
from conflank_cli.geometry.workface import WorkFace
from conflank_cli.job import BallPasses, load_job
from conflank_cli.optimization import optimize
from conflank_cli.passes import ball_passes
from conflank_cli.posting import post_program
from conflank_cli.progress import SilentProgress
from conflank_cli.scene import Scene
from conflank_cli.selection import select
from conflank_cli.sweep import Sweep
from conflank_cli.tool import CATALOGUE
from conflank_cli.verification.judge import verify_program
from conflank_cli.verification.result import Verification

TOLERANCE = 0.010  # mm
FLANK = 0.90  # of the faces, by sweeps, where they are between their neighbours
MOST_SWEEPS = 4  # a side
WHOLE = 0.99995  # what is printed as 100.00 %
STEP_UM = 10.0
SECONDS_A_FACE = 5.0  # of CPU
TOUCHED = 0.995  # of what the ball can touch: as well as so many points tell it
TOUCH_POINTS = 1000


@dataclass(frozen=True, slots=True)
class Blade:
    """A face of a real blade, with the tool for it; as in `benchmarks.run` and `benchmarks.detection`."""

    file: str
    face: int
    tool: str
    rotate_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    region: tuple[float, float, float, float] = (0.0, 1.0, 0.0, 1.0)


BLADES = (
    Blade("rotor37.step", 0, "T1"),
    Blade("rotor37.step", 1, "T1"),
    Blade("tfd4ac_rotor1.igs", 0, "T1"),
    Blade("tfd4ac_rotor1.igs", 1, "T1"),
    Blade("compressor_wheel.step", 0, "T1", (90.0, 0.0, 0.0)),
    Blade("compressor_wheel.step", 2, "T1", (90.0, 0.0, 0.0)),
    Blade("airfoil_closed.igs", 0, "T3", region=(0.0, 1.0, 0.55, 0.90)),
    Blade("propeller_upper.iges", 0, "T3", region=(0.15, 0.85, 0.1, 0.7)),
    Blade("propeller_lower.iges", 0, "T3", region=(0.15, 0.85, 0.1, 0.7)),
)


@dataclass(frozen=True, slots=True)
class Outcome:
    """What the posted text does, of sweeps with passes and of the ball alone; CPU seconds of the passes."""

    both: Verification
    ball: Verification
    seconds: float
    faces: int


def scene_of(job_file: Path) -> Scene:
    """The scene of a job with passes enabled."""
    return with_passes(load_scene(load_job(job_file), job_file.parent))


def with_passes(scene: Scene) -> Scene:
    """The same scene with passes enabled."""
    selection = msgspec.structs.replace(scene.job.selection, ball_passes=BallPasses(enabled=True))
    return replace(scene, job=msgspec.structs.replace(scene.job, selection=selection))


def outcome(scene: Scene) -> Outcome:
    """Run the stages, post and verify; then the same with passes only."""
    silent = SilentProgress()
    sweeps = select(scene, optimize(scene, detect(scene, silent), silent)[0], silent).plan
    start = time.process_time()
    passes = ball_passes(scene, sweeps, silent)[0]
    seconds = time.process_time() - start
    both = verified(scene, sweeps, passes)
    ball = verified(scene, [], ball_passes(scene, [], silent)[0])
    return Outcome(both, ball, seconds, len(scene.faces))


def verified(scene: Scene, sweeps: Sequence[Sweep], passes: Sequence[Pass]) -> Verification:
    return verify_program(post_program(scene, sweeps, passes)[0], scene)


def cutting_minutes(found: Verification) -> tuple[float, float]:
    """Time of sweeps and of passes, minutes."""
    sweeps, passes = (sum(cut.time_s for cut in cuts) / 60.0 for cuts in (found.sweeps, found.passes))
    return sweeps, passes


def report(console: Console, title: str, outcomes: dict[str, Outcome]) -> None:
    printed = table(
        title, "case", "sweeps", "%", "min", "passes", "both %", "min", "step", "overcut", "stock um",
        "ball min", "ball %", "CPU s",
    )  # fmt: skip
    for name, found in outcomes.items():
        both, (sweeps, passes), alone = found.both, cutting_minutes(found.both), cutting_minutes(found.ball)[1]
        printed.add_row(
            name, str(len(both.sweeps)), f"{100.0 * both.coverage_flank:.2f}", f"{sweeps:.2f}", str(len(both.passes)),
            f"{100.0 * both.coverage:.2f}", f"{passes:.2f}", _figure(both.step_max_um), f"{both.overcut_max_um:.1f}",
            _figure(both.stock_max_um), f"{alone:.2f}", f"{100.0 * found.ball.coverage:.2f}", f"{found.seconds:.1f}",
        )  # fmt: skip
    console.print(printed)
    for name, found in outcomes.items():
        for finding in (*found.both.findings, *found.ball.findings):
            console.print(f"{name}: {finding.code} {finding.text}", markup=False, soft_wrap=True)


def _figure(value: float | None) -> str:
    return "-" if value is None else f"{value:.1f}"


def figures(found: Outcome) -> dict[str, Any]:
    """What is kept of a case."""
    both, (sweeps, passes) = found.both, cutting_minutes(found.both)
    return {
        "coverage_flank": both.coverage_flank,
        "coverage": both.coverage,
        "sweeps": len(both.sweeps),
        "passes": len(both.passes),
        "step_max_um": both.step_max_um,
        "findings": [finding.code for finding in both.findings],
        "sweeps_min": round(sweeps, 2),
        "passes_min": round(passes, 2),
        "ball_alone_min": round(cutting_minutes(found.ball)[1], 2),
        "passes_cpu_s": round(found.seconds, 1),
    }


def verdicts(name: str, found: Outcome) -> list[Verdict]:
    """What is asked of every case: all of the face, no step, no finding, in little time."""
    both, seconds = found.both, found.seconds / found.faces
    step = both.step_max_um
    return [
        Verdict(f"{name}: covered with passes", "100 %", f"{100.0 * both.coverage:.2f} %", both.coverage >= WHOLE),
        Verdict(f"{name}: step um", f"<= {STEP_UM:g}", _figure(step), step is None or step <= STEP_UM),
        Verdict(f"{name}: findings", "none", str(len(both.findings)), not both.findings),
        Verdict(f"{name}: CPU s a face", f"<= {SECONDS_A_FACE:g}", f"{seconds:.1f}", seconds <= SECONDS_A_FACE),
    ]


def blisk(console: Console) -> tuple[list[Verdict], dict[str, Any]]:
    """Both sides of the sample blade between its neighbours."""
    found = outcome(scene_of(REPOSITORY / "sample_parts" / "blisk_blade" / "job.toml"))
    report(console, "Sample blisk blade, both sides between its neighbours, T1, +-10 um", {"blisk": found})
    both = found.both
    sweeps, passes = cutting_minutes(both)
    alone = cutting_minutes(found.ball)[1]
    asked = [
        Verdict(
            "blisk: covered by sweeps", f">= {100.0 * FLANK:.0f} %", f"{100.0 * both.coverage_flank:.2f} %",
            both.coverage_flank >= FLANK,
        ),
        Verdict(
            "blisk: sweeps", f"<= {MOST_SWEEPS * found.faces}", str(len(both.sweeps)),
            len(both.sweeps) <= MOST_SWEEPS * found.faces,
        ),
        *verdicts("blisk", found),
        Verdict("blisk: minutes beside the ball alone", "", f"{sweeps + passes:.1f} and {alone:.1f}", True),
    ]  # fmt: skip
    return asked, figures(found)


def blades(console: Console) -> tuple[list[Verdict], dict[str, Any]]:
    """Faces of real blades, without what stands round them."""
    outcomes: dict[str, Outcome] = {}
    with tempfile.TemporaryDirectory() as folder:
        for blade in BLADES:
            part = PARTS / blade.file
            if not part.exists():
                console.print(f"no {blade.file} in {PARTS.parent.name}/{PARTS.name} beside the repository: left out")
                continue
            name = f"{part.stem}_{blade.face}"
            job = Path(folder) / f"{name}.toml"
            text = job_text(
                str(part), blade.face, "outside", CATALOGUE[blade.tool], tolerance=TOLERANCE, coverage=0.9,
                program=name.upper()[:16], rotate_deg=blade.rotate_deg,
            )  # fmt: skip
            text = text.replace('side = "outside"', f'side = "outside"\nregion = {list(blade.region)}')
            job.write_text(text, encoding="utf-8")
            outcomes[name] = outcome(scene_of(job))
    report(console, "Real blades, +-10 um, nothing else in the way", outcomes)
    asked = [verdict for name, found in outcomes.items() for verdict in verdicts(name, found)]
    return asked, {name: figures(found) for name, found in outcomes.items()}


def wheel(console: Console) -> tuple[list[Verdict], dict[str, Any]]:
    """Both sides of a blade of the compressor wheel, with its hub and the other blades around it."""
    if not (PARTS / WHEEL).exists():
        return [], {}
    scene = with_passes(wheel_scene())
    found = outcome(scene)
    report(console, "Compressor wheel, hub and neighbours around it, T1-T3, +-10 um", {"wheel": found})
    asked, shares = [], []
    for design, face in zip(scene.faces, found.both.faces, strict=True):
        work = WorkFace.of(design, 0.0)
        samples = work.samples(work.spacing(TOUCH_POINTS))
        touched = float(samples.areas[ball_reached(scene, samples)].sum() / samples.areas.sum())
        shares.append({"face": design.number, "coverage": face.coverage, "touched": round(touched, 4)})
        asked.append(
            Verdict(
                f"wheel {design.number}: covered, of what the ball can touch", f">= {100.0 * TOUCHED:g} %",
                f"{100.0 * face.coverage:.2f} of {100.0 * touched:.2f} %", face.coverage >= TOUCHED * touched,
            )
        )  # fmt: skip
    # What is inside of the hub is missing from the coverage that the job asks for.
    others = [finding.code for finding in found.both.findings if finding.code != "CF202"]
    asked += [verdict for verdict in verdicts("wheel", found) if "step" in verdict.what]
    asked.append(Verdict("wheel: findings but coverage", "none", ", ".join(others) or "0", not others))
    return asked, figures(found) | {"faces": shares}


@click.command()
@click.option("--only", type=click.Choice(["blisk", "blades", "wheel"]), help="One part of it.")
@click.option("--json", "as_json", metavar="FILE", help="Write the figures to FILE too.")
def main(only: str | None, as_json: str | None) -> None:
    """Print what passes add to the sweeps and what they cost; exit code 1 where a figure is missed."""
    console = table_console()
    parts: dict[str, Part] = {
        "blisk": lambda: blisk(console),
        "blades": lambda: blades(console),
        "wheel": lambda: wheel(console),
    }
    asked, found = measured(console, "Passes", parts, only)
    if as_json is not None:
        document = {"verdicts": kept(asked), **found}
        Path(as_json).write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    raise SystemExit(0 if all(verdict.reached for verdict in asked) else 1)


if __name__ == "__main__":
    main()
