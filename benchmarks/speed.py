"""How fast everything is: whole jobs, the first run ever, footpoints beside their peers, stages by cores and by size.

    python -m benchmarks.speed [--only PART] [--json benchmarks/results/speed.json]
    python -m benchmarks.speed --profile STAGE

(or ``make bench-speed``). Everything but the footpoints' peers runs in processes of its own. Rates of one core and
growth are by the processor's time, which others on the machine hardly disturb; wall times are what a clock says, and
the load is printed beside them. With ``--json`` figures are kept in FILE beside those of other parts, and docs/speed.md
and its pictures are made anew from them.
"""

from __future__ import annotations

import cProfile
import json
import os
import pstats
import re
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, Future
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

import click
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter
from rich.console import Console

from benchmarks import footpoints, readme, speed_stages
from benchmarks.growth import LINEAR, fitted_exponent
from benchmarks.process import ran
from benchmarks.run import REPOSITORY
from benchmarks.speed_tables import PARTS_OF_JOB, TABLES
from benchmarks.verdicts import Part, Verdict, kept, measured, table, table_console
from conflank_cli import cores

DOCUMENT = "docs/speed.md"
PICTURES = REPOSITORY / "docs" / "pictures"
PART = REPOSITORY / "sample_parts" / "blisk_blade" / "blisk_blade.step"
BOTH_SIDES = f"""
[part]
file = '{PART}'
check_faces = "rest"
[[part.design]]
face = "pressure"
[[part.design]]
face = "suction"
[tools]
use = ["T1", "T2", "T3"]
[tolerance]
overcut = 0.010
undercut = 0.010
[program]
name = "BOTH"
"""
WARM_PER_SECOND, SCALING, WARM_RATIO, COLD_RATIO = 4.0e6, 1.8, 15.0, 300.0
ONE_SIDE, ONE_SIDE_MB, BOTH, FIRST = 5.0, 600.0, 25.0, 60.0
RUNS = 3  # of a job: the median counts
SHOWN = 25  # functions of a profile
_STAGE = re.compile(r"^(?P<stage>\w+): (?P<seconds>[\d.]+) s$", re.MULTILINE)
_COMPUTED = re.compile(r"^computed in\s+([\d.]+) s$", re.MULTILINE)
_WAITED_FOR = "compiled once"


def load() -> float:
    """How many processes wait for a core, this one's included."""
    return round(os.getloadavg()[0], 1)


# -- whole jobs ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Place:
    """A folder for all runs: compiled kernels are kept there once the first run has compiled them."""

    folder: Path

    @property
    def material(self) -> Path:
        """The run of one side, which the stages work on."""
        return self.folder / "one"

    @property
    def compiled(self) -> Path:
        """Where the first run keeps its kernels."""
        return self.folder / "compiled"

    @property
    def environment(self) -> dict[str, str]:
        """What processes are told: which compiled kernels to use."""
        return {"NUMBA_CACHE_DIR": str(self.compiled)} if self.compiled.exists() else {}


def parts_of(said: str, wall: float) -> dict[str, float]:
    """Seconds of a job's parts, from what `conflank run --verbose` says and its wall time.

    Raises
    ------
    ValueError: it does not say in what time it was computed.
    """
    computed = _COMPUTED.search(said)
    if computed is None:
        raise ValueError(f"no line 'computed in ... s' in: {said}")
    stages = {match["stage"]: float(match["seconds"]) for match in _STAGE.finditer(said)}
    inside = float(computed[1])
    # Both are rounded: nothing takes less than no time.
    return {"start": max(wall - inside, 0.0), **stages, "rest": max(inside - sum(stages.values()), 0.0)}


def job_figures(name: str, job: Path, out: Path, place: Place, *options: str, runs: int = 1) -> dict[str, Any]:
    """Run a job as a process, so many times: the figures of the run with the median of the wall times.

    Raises
    ------
    RuntimeError: it ended with neither a sound program nor findings.
    """
    before = load()
    command = [str(Path(sys.executable).with_name("conflank")), "run", str(job), "--out", str(out), "--verbose"]
    every = []
    for _ in range(runs):
        every.append(ran([*command, *options], place.environment))
        if every[-1].code not in (0, 1):
            raise RuntimeError(f"{' '.join(command)}: exit code {every[-1].code}\n{every[-1].errors}")
    found = sorted(every, key=lambda one: one.wall)[runs // 2]
    return {
        "name": name,
        "wall_s": round(found.wall, 2),
        "cpu_s": round(found.cpu, 2),
        "memory_mb": round(found.memory, 1),
        "parts_s": {part: round(value, 2) for part, value in parts_of(found.errors, found.wall).items()},
        "says_what_is_waited_for": any(_WAITED_FOR in one.errors for one in every),
        "load": before,
    }


def jobs(place: Place) -> tuple[list[Verdict], Any]:
    """The first run ever, then one side of the sample blade with one tool, then both sides with three."""
    both = place.folder / "both.toml"
    both.write_text(BOTH_SIDES, encoding="utf-8")
    place.compiled.mkdir(exist_ok=True)
    first = job_figures("first run ever", speed_stages.JOB, place.folder / "first", place)
    one = job_figures("one side, one tool", speed_stages.JOB, place.material, place, "--no-report", runs=RUNS)
    two = job_figures("both sides, three tools", both, place.folder / "both", place, runs=RUNS)
    verdicts = [
        Verdict(f"{name}, {what}", f"<= {most:g} {unit}", f"{found[key]:.1f} {unit}", found[key] <= most)
        for name, found, what, key, most, unit in (
            ("one side, one tool", one, "wall", "wall_s", ONE_SIDE, "s"),
            ("one side, one tool", one, "memory", "memory_mb", ONE_SIDE_MB, "MB"),
            ("both sides, three tools", two, "wall", "wall_s", BOTH, "s"),
            ("first run ever", first, "wall", "wall_s", FIRST, "s"),
        )
    ]
    says = bool(first["says_what_is_waited_for"])
    verdicts.append(Verdict("first run says what is waited for", "yes", "yes" if says else "no", says))
    return verdicts, [first, one, two]


# -- footpoints and their peers --------------------------------------------------------------------------------------


def peers(place: Place) -> tuple[list[Verdict], Any]:
    """Footpoints beside OCP and SciPy, in turns."""
    before = load()
    rows = footpoints.measure()
    ours, scipy, ocp_warm, ocp_cold = (
        rows[0],
        *(next(row for row in rows if row.name.startswith(start)) for start in ("SciPy", "OCP Extrema", "OCP GeomAPI")),
    )
    error = max(ours.foot_error, ours.distance_error)
    verdicts = [
        Verdict(
            "footpoints, warm, one core", f">= {WARM_PER_SECOND / 1e6:g} M/s", f"{ours.per_second / 1e6:.2f} M/s",
            ours.per_second >= WARM_PER_SECOND,
        ),
        Verdict(
            "footpoints, largest error, 1e-9 mm", f"<= {footpoints.REQUIRED_ACCURACY / 1e-9:g}", f"{error / 1e-9:.3f}",
            error <= footpoints.REQUIRED_ACCURACY,
        ),
        *(
            Verdict(f"times faster than {what}", asked and f">= {least:g}", f"{ratio:.1f}", ratio >= least)
            for what, other, asked, least in (
                ("OCP warm", ocp_warm, "yes", WARM_RATIO),
                ("OCP cold", ocp_cold, "yes", COLD_RATIO),
                ("SciPy warm", scipy, "", 0.0),
            )
            for ratio in (ours.per_second / other.per_second,)
        ),
    ]  # fmt: skip
    return verdicts, {
        "load": before,
        "methods": [
            {
                "name": row.name,
                "per_second": round(row.per_second),
                "error_mm": float(f"{max(row.foot_error, row.distance_error):.1e}"),
            }
            for row in rows
        ],
    }


# -- stages ----------------------------------------------------------------------------------------------------------


def stage(place: Place, name: str) -> tuple[list[Verdict], Any]:
    """One stage, in processes of its own: all figures in one, then the cold start and the memory in another."""
    if not place.material.exists():
        job_figures("material", speed_stages.JOB, place.material, place)
    before = load()
    figures: dict[str, Any] = {"load": before}
    for what in ("measured", "cold"):
        found = ran(
            [sys.executable, "-m", "benchmarks.speed_stages", what, name, str(place.material)], place.environment
        )
        if found.code != 0:
            raise RuntimeError(f"{name}: exit code {found.code}\n{found.errors}")
        figures |= json.loads(found.output)
    steepest, against = max(
        (fitted_exponent(grown["sizes"], grown["seconds"]), against) for against, grown in figures["growth"].items()
    )
    verdicts = [
        Verdict(f"{name}: steepest exponent", "<= 1", f"{steepest:.2f}, with {against}", steepest <= LINEAR),
    ]
    if name == "footpoints":
        ratio = figures["wall_s"]["one"] / figures["wall_s"]["all"]
        asked = f">= {SCALING:g}" if cores.cores() == 2 else ""
        verdicts.append(Verdict("footpoints, all cores over one", asked, f"{ratio:.2f}", not asked or ratio >= SCALING))
    return verdicts, figures


# -- where the time goes ---------------------------------------------------------------------------------------------


class InThisThread(Executor):
    """Does all work at once in the thread that asks for it, where a profile sees it."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Run it now."""
        done: Future[Any] = Future()
        done.set_result(fn(*args, **kwargs))
        return done


def profile(console: Console, name: str, place: Place) -> None:
    """Print where the time of a stage goes, or of a whole run: functions, and compiled ones together."""
    if name == "run":
        from conflank_cli.cli import cli

        arguments = ["run", str(speed_stages.JOB), "--out", str(place.folder / "profile"), "--quiet"]
        run: Callable[[], object] = partial(cli.main, arguments, standalone_mode=False)
    else:
        if not place.material.exists():
            job_figures("material", speed_stages.JOB, place.material, place)
        run = speed_stages.STAGES[name](speed_stages.Material(place.material)).usual().run
        run()
    profiler = cProfile.Profile(time.thread_time)
    with patch.object(cores, "ThreadPoolExecutor", lambda count: InThisThread()), speed_stages.one_core():
        profiler.runcall(run)
    found: dict[tuple[str, int, str], tuple[int, int, float, float, Any]] = pstats.Stats(profiler).stats  # type: ignore[attr-defined]
    total = sum(own for _, _, own, _, _ in found.values())
    printed = table(f"{name}: {total:.2f} s of one core", "function", "calls", "own s", "own %", "with what it calls s")
    for (file, line, function), (_, calls, own, along, _) in sorted(found.items(), key=lambda item: -item[1][2])[
        :SHOWN
    ]:
        where = "/".join(Path(file).parts[-2:])
        printed.add_row(
            f"{where}:{line} {function}" if line else function, str(calls), f"{own:.3f}", f"{100 * own / total:.1f}",
            f"{along:.3f}",
        )  # fmt: skip
    console.print(printed)
    compiled = sum(own for (file, *_), (_, _, own, _, _) in found.items() if "kernels" in Path(file).parts)
    console.print(f"compiled kernels: {compiled:.2f} s, {100 * compiled / total:.0f} %")


# -- pictures --------------------------------------------------------------------------------------------------------


def growth_picture(figures: dict[str, Any]) -> Figure:
    """Time against size of every stage, each from its first size on, with the line of linear growth."""
    stages = figures["stages"]
    figure = Figure(figsize=(11.0, 5.6), layout="constrained")
    axes = figure.subplots(2, 4).ravel()
    for axis, (name, found) in zip(axes, stages.items(), strict=False):
        largest = 1.0
        for against, grown in found["growth"].items():
            sizes, seconds = grown["sizes"], grown["seconds"]
            times = [size / sizes[0] for size in sizes]
            largest = max(largest, *times)
            exponent = fitted_exponent(sizes, seconds)
            axis.loglog(times, [each / seconds[0] for each in seconds], "o-", ms=3, label=f"{against}: {exponent:.2f}")
        axis.loglog([1.0, largest], [1.0, largest], "--", color="0.6", lw=1.0)
        axis.set_title(name, fontsize=10)
        axis.grid(True, which="both", alpha=0.25)
        # Short axes would label every minor tick, one over the other.
        for way in (axis.xaxis, axis.yaxis):
            way.set_minor_formatter(NullFormatter())
        axis.legend(frameon=False, fontsize=7)
    for axis in axes[len(stages) :]:
        axis.set_axis_off()
    figure.supxlabel("size, in the smallest that was timed (dashed: linear growth)", fontsize=9)
    figure.supylabel("processor's time, in that of the smallest", fontsize=9)
    return figure


def jobs_picture(figures: dict[str, Any]) -> Figure:
    """Where the time of whole jobs goes."""
    figure = Figure(figsize=(9.0, 2.2), layout="constrained")
    axis = figure.subplots()
    for row, found in enumerate(figures["jobs"]):
        left = 0.0
        for k, part in enumerate(PARTS_OF_JOB):
            seconds = found["parts_s"].get(part, 0.0)
            axis.barh(row, seconds, left=left, color=f"C{k}", label=part if row == 0 else None)
            left += seconds
    axis.set_yticks(range(len(figures["jobs"])), [found["name"] for found in figures["jobs"]], fontsize=8)
    axis.invert_yaxis()
    axis.set_xlabel("s on the clock", fontsize=9)
    axis.legend(frameon=False, fontsize=7, ncols=len(PARTS_OF_JOB), loc="lower center", bbox_to_anchor=(0.4, 1.0))
    return figure


def save(figure: Figure, name: str) -> None:
    """Write a picture of docs."""
    FigureCanvasAgg(figure)
    figure.savefig(PICTURES / name, dpi=100, metadata={"Software": None})


def together(file: Path | None, figures: dict[str, Any], verdicts: Sequence[Verdict]) -> dict[str, Any]:
    """All figures in a file of results, new ones in the place of older ones; None: only the new ones."""
    before: dict[str, Any] = json.loads(file.read_bytes()) if file is not None and file.exists() else {}
    stages = before.get("stages", {}) | figures
    new: dict[str, Any] = {
        "cores": cores.cores(),
        **{name: figures[name] for name in ("jobs", "peers") if name in figures},
        "stages": {name: stages[name] for name in speed_stages.STAGES if name in stages},
        "asked": before.get("asked", {}) | {verdict.what: verdict.asked for verdict in verdicts},
        "verdicts": before.get("verdicts", {}) | kept(verdicts),
    }
    return before | new


NAMES = ("jobs", "peers", *speed_stages.STAGES)


@click.command()
@click.option("--only", type=click.Choice(NAMES), help="One part alone.")
@click.option("--profile", "profiled", type=click.Choice(["run", *speed_stages.STAGES]), help="Where its time goes.")
@click.option("--json", "as_json", metavar="FILE", type=click.Path(path_type=Path), help="Keep the figures in FILE.")
def main(only: str | None, profiled: str | None, as_json: Path | None) -> None:
    """Print what speed must reach; exit code 1 where a figure is missed."""
    console = table_console()
    with tempfile.TemporaryDirectory() as temporary:
        place = Place(Path(temporary))
        if profiled is not None:
            profile(console, profiled, place)
            return
        console.print(f"{cores.cores()} cores, load {load()}")
        parts: dict[str, Part] = {
            "jobs": partial(jobs, place),
            "peers": partial(peers, place),
            **{name: partial(stage, place, name) for name in speed_stages.STAGES},
        }
        verdicts, figures = measured(console, "Speed", parts, only)
    document = together(as_json, figures, verdicts)
    for name, rows in TABLES.items():
        if name in document or name in ("asked", "growth"):
            headings, cells = rows(document)
            printed = table(name, *headings)
            for row in cells:
                printed.add_row(*row)
            console.print(printed)
    if as_json is not None:
        as_json.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    if as_json is not None and set(document) >= {"jobs", "peers"}:
        save(growth_picture(document), "speed_growth.png")
        save(jobs_picture(document), "speed_jobs.png")
        text = (REPOSITORY / DOCUMENT).read_text(encoding="utf-8")
        (REPOSITORY / DOCUMENT).write_text(readme.filled(text, DOCUMENT), encoding="utf-8")
    raise SystemExit(0 if all(verdict.reached for verdict in verdicts) else 1)


if __name__ == "__main__":
    main()
