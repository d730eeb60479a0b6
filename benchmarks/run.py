"""The "must reach" table: the whole program on every case, judged by what the posted text cuts.

Run with ``python -m benchmarks.run`` (or ``make bench``). Every case is a job that ``conflank run`` works through in a
process of its own; the figures are those of the verification, which knows nothing but the program's text, the job and
the part. Real blades are looked for in ``../shared/parts`` beside the repository and left out where that folder is
missing.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
from rich.console import Console
from rich.table import Table

from benchmarks.envelopes import cylinder, random_envelopes, write_job
from benchmarks.footpoints import report as report_footpoints
from benchmarks.jobs import job_text
from conflank_cli.tool import CATALOGUE, Tool

REPOSITORY = Path(__file__).resolve().parent.parent
PARTS = REPOSITORY.parent / "shared" / "parts"
SEED = 2018
TABLE_WIDTH = 132  # in a log file, where the width of the terminal is not known
WALL_SECONDS = 20.0  # one face, one tool, after the first run has compiled


@dataclass(frozen=True, slots=True)
class Required:
    """What a case must reach: coverage as a share, figures in um, sweeps; None where nothing is asked."""

    coverage: float
    gap_mean_um: float
    overcut_um: float | None = None
    sweeps: int | None = None


@dataclass(frozen=True, slots=True)
class Case:
    """One row of the table: its name, its job file, the tool and what is required."""

    name: str
    job: Path
    tool: str
    required: Required


@dataclass(frozen=True, slots=True)
class Blade:
    """A flank of a real blade: the side is always along the face's oriented normal.

    That was checked by geometry: on each of these parts the normals of the pressure and of the suction side point away
    from the other one. `rotate_deg` lays the span level (the wheel: stands its axis up), so that the
    machine reaches axes that point either way along it.
    """

    file: str
    face: int
    tool: str
    rotate_deg: tuple[float, float, float]


BLADES = (
    Blade("rotor37.step", 0, "T1", (0.0, 0.0, 0.0)),
    Blade("rotor37.step", 1, "T1", (0.0, 0.0, 0.0)),
    Blade("tfd4ac_rotor1.igs", 0, "T1", (0.0, 0.0, 0.0)),
    Blade("tfd4ac_rotor1.igs", 1, "T1", (0.0, 0.0, 0.0)),
    Blade("compressor_wheel.step", 0, "T1", (90.0, 0.0, 0.0)),
    Blade("compressor_wheel.step", 2, "T1", (90.0, 0.0, 0.0)),
)

ENVELOPE_REQUIRED = Required(coverage=0.97, gap_mean_um=0.3, sweeps=1)
BLADE_REQUIRED = Required(coverage=0.85, gap_mean_um=3.0, overcut_um=20.0, sweeps=9)
BLISK_REQUIRED = Required(coverage=0.90, gap_mean_um=2.7)


def cases(folder: Path, tool: str | None, envelopes: int) -> Iterator[Case]:
    """All cases, their jobs written to `folder`; `tool` restricts the envelopes and replaces the blades' tools."""
    for cutter in (*CATALOGUE.values(), cylinder()):
        if tool in (None, cutter.name):
            for k, case in enumerate(random_envelopes(cutter, envelopes, SEED)):
                name = f"envelope_{cutter.name}_{k}"
                yield Case(name, write_job(case, folder / name, name), cutter.name, ENVELOPE_REQUIRED)
    for blade in BLADES:
        part = PARTS / blade.file
        if part.exists():
            yield _blade_case(blade, part, CATALOGUE[tool or blade.tool], folder)
    for name in ("pressure", "suction"):
        job = REPOSITORY / "sample_parts" / "blisk_blade" / f"{name}.toml"
        if job.exists():
            used = tomllib.loads(job.read_text(encoding="utf-8"))["tools"]["use"]
            if tool is None or tool in used:
                yield Case(f"blisk_{name}", job, "+".join(used), BLISK_REQUIRED)


def _blade_case(blade: Blade, part: Path, tool: Tool, folder: Path) -> Case:
    """The job of a real blade without check geometry: +-10 um, twice as fine as what is required."""
    name = f"{part.stem}_{blade.face}"
    job = folder / f"{name}.toml"
    program = name.upper()[:16]
    text = job_text(
        str(part),
        blade.face,
        "outside",
        tool,
        tolerance=0.010,
        coverage=0.95,
        program=program,
        rotate_deg=blade.rotate_deg,
    )
    job.write_text(text, encoding="utf-8")
    return Case(name, job, tool.name, BLADE_REQUIRED)


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a run gave: its verification (None where there is none), wall time in s, and the last of what it said."""

    verification: dict[str, Any] | None
    seconds: float
    said: str


def run(case: Case, out: Path) -> Outcome:
    """Run the whole pipeline on a case in a process of its own."""
    program = tomllib.loads(case.job.read_text(encoding="utf-8")).get("program", {})
    file = f"{program.get('name', 'BLADE1')}.{program.get('format', 'h').upper()}"
    command = [str(Path(sys.executable).with_name("conflank")), "run", str(case.job), "--out", str(out)]
    start = time.perf_counter()
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    seconds = time.perf_counter() - start
    result = out / f"{file}.verification.json"
    verification = json.loads(result.read_text(encoding="utf-8")) if result.exists() else None
    return Outcome(verification, seconds, done.stderr.strip()[-600:])


def shortfalls(required: Required, verification: dict[str, Any]) -> list[str]:
    """The figures that miss what is required, by name."""
    mean = verification["gap_um"]["mean_abs"]
    checks = [
        ("coverage", verification["coverage_flank"] >= required.coverage),
        ("mean |g|", mean is not None and mean <= required.gap_mean_um),
        ("overcut", required.overcut_um is None or verification["overcut_max_um"] <= required.overcut_um),
        ("sweeps", required.sweeps is None or len(verification["sweeps"]) <= required.sweeps),
    ]
    return [name for name, reached in checks if not reached]


def figures(case: Case, outcome: Outcome) -> dict[str, Any]:
    """The row as numbers; None where there is no program."""
    found = outcome.verification
    cells = _row(case, outcome)
    return {
        "case": case.name,
        "tool": case.tool,
        "coverage": None if found is None else round(found["coverage_flank"], 4),
        "coverage_required": case.required.coverage,
        "sweeps": None if found is None else len(found["sweeps"]),
        "overcut_max_um": None if found is None else round(found["overcut_max_um"], 2),
        "gap_mean_abs_um": None if found is None else found["gap_um"]["mean_abs"],
        "gap_mean_abs_required_um": case.required.gap_mean_um,
        "seconds": round(outcome.seconds, 1),
        "result": cells[-1],
    }


def _row(case: Case, outcome: Outcome) -> list[str]:
    """Cells of the table; the last is "pass" where the case reaches everything."""
    found = outcome.verification
    late = outcome.seconds > WALL_SECONDS
    if found is None:
        return [case.name, case.tool, *["-"] * 6, f"{outcome.seconds:.1f}", "MISS: no program"]
    missed = shortfalls(case.required, found) + (["time"] if late else [])
    mean = found["gap_um"]["mean_abs"]
    return [
        case.name,
        case.tool,
        f"{100.0 * found['coverage_flank']:.1f}",
        f"{100.0 * case.required.coverage:.0f}",
        str(len(found["sweeps"])),
        f"{found['overcut_max_um']:.1f}",
        "-" if mean is None else f"{mean:.2f}",
        f"{case.required.gap_mean_um:g}",
        f"{outcome.seconds:.1f}",
        "MISS: " + ", ".join(missed) if missed else "pass",
    ]


@click.command()
@click.option("--only", metavar="NAME", help="Cases whose name contains NAME; 'footpoints' for the kernel alone.")
@click.option("--tool", metavar="TOOL", help="Envelopes of this tool alone; real blades with this tool.")
@click.option("--jobs", default=1, show_default=True, help="Cases run at once; more than one blurs the times.")
@click.option("--envelopes", default=3, show_default=True, help="Random motions for each tool.")
@click.option("--out", metavar="DIR", help="Keep jobs and results in DIR.")
@click.option(
    "--json", "as_json", metavar="FILE", help="Write the rows to FILE too (README's: benchmarks/results/bench.json)."
)
def main(only: str | None, tool: str | None, jobs: int, envelopes: int, out: str | None, as_json: str | None) -> None:
    """Print the table of what the program must reach; exit code 1 where a figure is missed."""
    console = Console()
    if not console.is_terminal:
        console = Console(width=TABLE_WIDTH)
    # Wall times on a machine that has other things to do say little, and a reader should know.
    load = round(os.getloadavg()[0], 1)
    passed = True
    if only is None or "footpoints" in only:
        passed &= report_footpoints(console)
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(out or temporary)
        folder.mkdir(parents=True, exist_ok=True)
        chosen = [case for case in cases(folder, tool, envelopes) if only is None or only in case.name]
        if chosen:
            outcomes = _report_cases(console, chosen, folder, jobs)
            rows = [figures(case, outcome) for case, outcome in zip(chosen, outcomes, strict=True)]
            passed &= all(row["result"] == "pass" for row in rows)
            if as_json is not None:
                document = {"cores": os.cpu_count(), "jobs": jobs, "load": load, "rows": rows}
                Path(as_json).write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    raise SystemExit(0 if passed else 1)


def _report_cases(console: Console, chosen: list[Case], folder: Path, jobs: int) -> list[Outcome]:
    """Run the cases and print the table."""
    if not PARTS.is_dir():
        console.print(f"no folder {PARTS.parent.name}/{PARTS.name} beside the repository: real blades left out")
    first = run(chosen[0], folder / "first")
    console.print(f"first run, which compiles what is not in the cache: {first.seconds:.1f} s (not counted)")
    with ThreadPoolExecutor(jobs) as pool:
        outcomes = list(pool.map(lambda case: run(case, folder / f"{case.name}_out"), chosen))
    table = Table(title="From the posted text")
    for heading in (
        "case",
        "tool",
        "covered %",
        "(>=)",
        "sweeps",
        "overcut um",
        "mean |g| um",
        "(<=)",
        "wall s",
        "result",
    ):
        table.add_column(heading, justify="left" if heading in ("case", "tool", "result") else "right")
    for case, outcome in zip(chosen, outcomes, strict=True):
        table.add_row(*_row(case, outcome))
    console.print(table)
    for case, outcome in zip(chosen, outcomes, strict=True):
        if outcome.verification is None:
            console.print(f"{case.name}: {outcome.said}", markup=False)
        else:
            for finding in outcome.verification["findings"]:
                console.print(f"{case.name}: {json.dumps(finding)}", markup=False, soft_wrap=True)
    return outcomes


if __name__ == "__main__":
    main()
