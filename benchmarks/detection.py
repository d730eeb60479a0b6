"""What detection finds of what there is: exact envelopes, real blades against a blind search, time.

Run with ``python -m benchmarks.detection`` (or ``make bench``), one part of it with ``--only envelopes``, ``joined``,
``blades`` or ``time``. Nothing is optimised: what is judged is the sweeps as `conflank_cli.detection.detect` returns
them. Real blades are looked for in ``../shared/parts`` beside the repository and left out where that folder is missing.
By default a sample is drawn; the whole of what is asked, a hundred motions of each tool, is ``--only envelopes
--motions 100``. How far it has got is shown on a terminal, on standard error.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import click
import matplotlib
import numpy as np
import numpy.typing as npt
from rich.console import Console

from benchmarks.blind_families import Family, blind_families
from benchmarks.blind_search import CONTACTS, SPHERES, BlindSearch
from benchmarks.envelopes import PATCH, cylinder, random_envelopes
from benchmarks.growth import LINEAR, fitted_exponent
from benchmarks.joined import joined_faces
from benchmarks.run import PARTS, REPOSITORY, SEED
from benchmarks.verdicts import Part, Verdict, kept, measured, table, table_console
from conflank_cli import job as jobs
from conflank_cli.cad.reader import read_part
from conflank_cli.cad.scene import resolve_faces
from conflank_cli.detection import DENSITIES, detect
from conflank_cli.detection.reachability import Reachability, reachability
from conflank_cli.geometry.face import CheckMesh, DesignFace
from conflank_cli.geometry.gap import motion_gap
from conflank_cli.geometry.surface import BSplineSurface
from conflank_cli.geometry.workface import WorkFace
from conflank_cli.once import Once
from conflank_cli.progress import Progress, SilentProgress, make_progress
from conflank_cli.scene import Scene
from conflank_cli.sweep import Sweep
from conflank_cli.tool import CATALOGUE, Tool

Array = npt.NDArray[np.float64]
Density = Literal["quick", "normal", "exhaustive"]

TOLERANCE = 0.020  # mm, of everything that is counted here
KNOWN_SHARE = 0.90  # of a known patch that one sequence has to cut
MAP_DIFFERS = 0.01  # of the area, at most
DETECTED = 0.95  # of what the blind search reaches, at least
FEWER_FOOTPOINTS = 20.0
SECONDS = 2.0
# Points that a known patch is measured on, and a blade's detected patches.
PATCH_POINTS = 1500
PICTURE = REPOSITORY / "docs" / "pictures" / "detection_time.png"
# At these tolerances, mm, map and blind search are compared as well: at one where all of a face or nothing of it is
# reached, they could hardly differ.
TOLERANCES = (0.001, 0.002, 0.005, 0.010, 0.020)
# The part of the flute that has to touch: as the program has it, and a whole one, which is much harder.
ENGAGED = (1.0 / 3.0, 1.0)
# Where all spheres have to touch, it matters less which of them is at the point.
WHOLE_FLUTE = CONTACTS[::2]

NO_MACHINE = """
name = "no-limits"
max_feed_mm_min = 10000.0
block_time_ms = 1.0
[linear.x]
travel_mm = [-10000.0, 10000.0]
max_speed_mm_min = 30000.0
max_acceleration_mm_s2 = 3000.0
max_jerk_mm_s3 = 60000.0
[linear.y]
travel_mm = [-10000.0, 10000.0]
max_speed_mm_min = 30000.0
max_acceleration_mm_s2 = 3000.0
max_jerk_mm_s3 = 60000.0
[linear.z]
travel_mm = [-10000.0, 10000.0]
max_speed_mm_min = 30000.0
max_acceleration_mm_s2 = 3000.0
max_jerk_mm_s3 = 60000.0
[[rotary]]
letter = "C"
vector = [0.0, 0.0, 1.0]
carried_by = "table"
max_speed_deg_min = 10000.0
max_acceleration_deg_s2 = 500.0
max_jerk_deg_s3 = 10000.0
[[rotary]]
letter = "A"
vector = [1.0, 0.0, 0.0]
carried_by = "table"
max_speed_deg_min = 10000.0
max_acceleration_deg_s2 = 500.0
max_jerk_deg_s3 = 10000.0
"""
NOTHING = CheckMesh(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int32), np.zeros(0, dtype=np.int32))


@dataclass(frozen=True, slots=True)
class Flank:
    """A flank of a real blade: the part, the face, a region of it and the tools that are asked about."""

    file: str
    face: int
    region: tuple[float, float, float, float] = (0.0, 1.0, 0.0, 1.0)
    side: Literal["outside", "inside"] = "outside"
    tools: tuple[str, ...] = ("T1", "T3")

    @property
    def name(self) -> str:
        """As the tables print it."""
        return f"{Path(self.file).stem} {self.face}" + ("" if self.region == (0.0, 1.0, 0.0, 1.0) else "*")


# The faces of benchmarks.run. The regions leave the edge radii out, where no flank of a tool has any business; sides
# are where the normals point away from the other side of the blade.
FLANKS = (
    Flank("rotor37.step", 0),
    Flank("rotor37.step", 1),
    Flank("tfd4ac_rotor1.igs", 0),
    Flank("tfd4ac_rotor1.igs", 1),
    Flank("compressor_wheel.step", 0),
    Flank("compressor_wheel.step", 2),
    Flank("airfoil_closed.igs", 0, (0.0, 1.0, 0.55, 0.90), tools=("T3",)),
    Flank("propeller_upper.iges", 0, (0.15, 0.85, 0.1, 0.7), tools=("T3",)),
)


def whole(surface: BSplineSurface, sense: int) -> DesignFace:
    """The whole of a surface as a face."""
    u0, u1, v0, v1 = surface.domain
    return DesignFace(0, "", surface, (np.array([[u0, v0], [u1, v0], [u1, v1], [u0, v1]]),), sense)


def scene(face: DesignFace, tools: Sequence[Tool], density: Density = "normal", *, free: bool = False) -> Scene:
    """A job for one face without check geometry; `free`: no holder, no shank, and a machine that reaches every axis."""
    if free:
        tools = [replace(tool, shank=(), holder=()) for tool in tools]
    job = jobs.Job(
        part=jobs.Part("part.step", (jobs.Design(face.number),)),
        tools=jobs.Tools(tuple(tool.name for tool in tools)),
        tolerance=jobs.Tolerance(TOLERANCE, TOLERANCE),
        detection=jobs.Detection(density),
        machine=jobs.Machine("no-limits", None, NO_MACHINE) if free else jobs.Machine(),
    )
    return Scene(job, "part", (face,), tuple(tools), Once(lambda: NOTHING), {})


def load(flank: Flank) -> DesignFace:
    """Read the face of a real blade."""
    part = read_part(PARTS / flank.file, 1.0)
    return resolve_faces(part, jobs.Part(flank.file, (jobs.Design(flank.face, flank.side, flank.region),)))[0]


def within(sweeps: Sequence[Sweep], tool: Tool, points: Array) -> npt.NDArray[np.bool_]:
    """Which points (N, 3) each sweep leaves within the tolerance, (S, N)."""
    near = np.zeros((len(sweeps), len(points)), dtype=np.bool_)
    for k, sweep in enumerate(sweeps):
        near[k] = np.abs(motion_gap(sweep.motion, tool, points)[0]) <= TOLERANCE
    return near


def share(areas: Array, chosen: npt.NDArray[np.bool_]) -> float:
    """Share of the whole area that the chosen samples stand for."""
    return float(areas[chosen].sum() / areas.sum())


# -- exact envelopes -------------------------------------------------------------------------------------------------


def best_shares(
    face: DesignFace, tool: Tool, regions: Sequence[tuple[float, float]]
) -> tuple[list[float], float, list[int]]:
    """Largest share of each known patch (u within a region) that one sweep cuts, seconds, control points of sweeps."""
    start = time.perf_counter()
    sweeps = detect(scene(face, (tool,)), SilentProgress())
    seconds = time.perf_counter() - start
    work = WorkFace.of(face, 0.0)
    samples = work.samples(work.spacing(PATCH_POINTS))
    cut = within(sweeps, tool, samples.points)
    shares = []
    for low, high in regions:
        keep = (samples.uv[:, 0] >= low) & (samples.uv[:, 0] <= high)
        shares.append(max(share(samples.areas[keep], row[keep]) for row in cut))
    return shares, seconds, [len(sweep.motion.p) for sweep in sweeps]


def envelopes(console: Console, progress: Progress, count: int) -> tuple[list[Verdict], dict[str, Any]]:
    """Exact envelopes of `count` random motions of each tool: does one detected sequence cut the known patch?"""
    printed = table(
        f"exact envelopes: best single sequence as detected, within {1e3 * TOLERANCE:g} um",
        "tool", "motions", ">= 90 %", "least %", "median %", "median s", "control points",
    )  # fmt: skip
    rows: list[dict[str, Any]] = []
    for tool in (*CATALOGUE.values(), cylinder()):
        cases = random_envelopes(tool, count, SEED)
        found = []
        with progress.stage(f"envelopes of {tool.name}", count) as stage:
            for case in cases:
                found.append(best_shares(whole(case.surface, case.sense), tool, [PATCH]))
                stage.advance()
        shares, seconds = np.array([row[0][0] for row in found]), np.array([row[1] for row in found])
        points = [count for row in found for count in row[2]]
        rows += [
            {
                "tool": tool.name,
                "motion": k,
                "share": round(row[0][0], 4),
                "seconds": round(row[1], 2),
                "sweeps": len(row[2]),
                "control_points": [min(row[2]), int(np.median(row[2])), max(row[2])],
            }
            for k, row in enumerate(found)
        ]
        printed.add_row(
            tool.name, str(count), str(int((shares >= KNOWN_SHARE).sum())), f"{100 * shares.min():.1f}",
            f"{100 * np.median(shares):.1f}", f"{np.median(seconds):.2f}",
            f"{min(points)} ... {max(points)}, median {np.median(points):.0f}",
        )  # fmt: skip
    console.print(printed)
    missed = [row for row in rows if row["share"] < KNOWN_SHARE]
    for row in missed:
        console.print(f"  missed: {row['tool']} motion {row['motion']}: {100 * row['share']:.1f} %")
    median = float(np.median([row["seconds"] for row in rows]))
    verdicts = [
        Verdict("known patch cut >= 90 %", f"{len(rows)} of {len(rows)}", f"{len(rows) - len(missed)}", not missed),
        Verdict("detection on an envelope, median s", f"<= {SECONDS:g}", f"{median:.2f}", median <= SECONDS),
    ]
    return verdicts, {"cases": rows}


def joined(console: Console, progress: Progress) -> tuple[list[Verdict], dict[str, Any]]:
    """Two envelopes joined in one face: are both found?"""
    printed = table("two envelopes in one face", "tool", "first half %", "second half %", "sweeps", "s")
    rows: list[dict[str, Any]] = []
    both = 0
    cases = joined_faces(SEED)
    with progress.stage("joined faces", len(cases)) as stage:
        found = []
        for case in cases:
            found.append(best_shares(whole(case.surface, case.sense), case.tool, case.halves))
            stage.advance()
    for case, (shares, seconds, points) in zip(cases, found, strict=True):
        both += min(shares) >= KNOWN_SHARE
        rows.append({"tool": case.tool.name, "shares": [round(half, 4) for half in shares]})
        printed.add_row(
            case.tool.name, *(f"{100 * half:.1f}" for half in shares), str(len(points)), f"{seconds:.2f}"
        )  # fmt: skip
    console.print(printed)
    return [Verdict("both halves of a joined face", f"{len(rows)} of {len(rows)}", str(both), both == len(rows))], {
        "faces": rows
    }


# -- real blades -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Comparison:
    """The map against the blind search: shares of the area at each of TOLERANCES, and footpoints.

    only_blind, only_map: reached by one alone; of what only the map reaches, wrong is what its line does not hold when
    the blind search measures it.
    """

    by_map: Array
    by_blind: Array
    only_blind: Array
    only_map: Array
    wrong: Array
    footpoints: tuple[int, int]

    @property
    def differs(self) -> Array:
        """Share of the area on which the map is wrong or short, at each tolerance."""
        return self.only_blind + self.wrong


def compare(found: Reachability, search: BlindSearch, blind_error: Array, blind_footpoints: int) -> Comparison:
    """Hold a map against what the blind search found at the same samples."""
    areas = found.samples.areas
    measured, off = search.check(found.samples, found.p, found.d, found.height)
    columns = []
    for tolerance in TOLERANCES:
        here, there = found.error <= tolerance, blind_error <= tolerance
        holds = (measured <= tolerance) & (off <= tolerance)
        masks = (here, there, there & ~here, here & ~there, here & ~there & ~holds)
        columns.append([share(areas, mask) for mask in masks])
    by_map, by_blind, only_blind, only_map, wrong = np.array(columns).T
    return Comparison(by_map, by_blind, only_blind, only_map, wrong, (found.footpoints, blind_footpoints))


def blade(flank: Flank, tool: Tool, points: int, density: Density) -> dict[str, Any]:
    """Everything the table of real blades says of one face and tool."""
    design = load(flank)
    face = WorkFace.under(design, tool)
    samples = face.samples(face.spacing(points))
    row: dict[str, Any] = {"face": flank.name, "tool": tool.name, "points": len(samples.uv)}
    comparisons, families = [], []
    for engaged in ENGAGED:
        search = BlindSearch.of(face, tool, least=round(engaged * SPHERES))
        lines = search.search(samples, CONTACTS if engaged < 1.0 else WHOLE_FLUTE)
        found = reachability(face, tool, samples, 0.0, engaged)
        comparisons.append(compare(found, search, lines.error, lines.footpoints))
        if engaged == ENGAGED[0]:
            reach = lines.error <= TOLERANCE
            families = blind_families(search, samples, lines, found, TOLERANCE)
    start = time.perf_counter()
    sweeps = detect(scene(design, (tool,), density, free=True), SilentProgress())
    seconds = time.perf_counter() - start
    detected = np.logical_or.reduce(within(sweeps, tool, samples.points), axis=0)
    areas = samples.areas
    row |= {
        "area_mm2": round(float(areas.sum()), 1),
        "detected": round(share(areas, detected), 4),
        "detected_of_reachable": round(float(areas[detected & reach].sum() / max(areas[reach].sum(), 1e-9)), 4),
        "sweeps": len(sweeps),
        "seconds": round(seconds, 2),
        "comparisons": [
            {
                "engaged": round(engaged, 3),
                "tolerance_um": [1e3 * tolerance for tolerance in TOLERANCES],
                "map": compared.by_map.round(4).tolist(),
                "blind": compared.by_blind.round(4).tolist(),
                "only_blind": compared.only_blind.round(4).tolist(),
                "only_map": compared.only_map.round(4).tolist(),
                "wrong": compared.wrong.round(4).tolist(),
                "footpoints": compared.footpoints,
            }
            for engaged, compared in zip(ENGAGED, comparisons, strict=True)
        ],
        "families": [family.row() for family in families],
        "_comparisons": comparisons,
        "_families": families,
        "_areas": areas,
    }
    return row


def blades(console: Console, progress: Progress, points: int, density: Density) -> tuple[list[Verdict], dict[str, Any]]:
    """Real blades: map against blind search, detected patches against what can be reached."""
    flanks = [flank for flank in FLANKS if (PARTS / flank.file).exists()]
    if not flanks:
        console.print(f"no folder {PARTS.parent.name}/{PARTS.name} beside the repository: real blades left out")
        return [], {}
    asked_about = [(flank, CATALOGUE[name]) for flank in flanks for name in flank.tools]
    rows = []
    with progress.stage("real blades", len(asked_about)) as stage:
        for flank, tool in asked_about:
            rows.append(blade(flank, tool, points, density))
            stage.advance()
    maps = table(
        f"reachable within {1e3 * TOLERANCE:g} um, % of the area (* region); at worst: at any of "
        f"{', '.join(f'{1e3 * t:g}' for t in TOLERANCES)} um",
        "face", "tool", "flute", "map", "blind", "differs", "at worst", "map better", "footpoints", "blind", "ratio",
    )  # fmt: skip
    patches = table(
        "detected patches", "face", "tool", "reachable %", "detected %", "of reachable %", "sweeps", "s", "blind only"
    )
    named = table(
        "families of lines that only the blind search finds; bend: median of |second derivative of the distance|",
        "face", "tool", "explanation", "families", "area %", "map misses %", "bend 1/m",
    )  # fmt: skip
    for row in rows:
        for engaged, compared in zip(ENGAGED, row["_comparisons"], strict=True):
            maps.add_row(
                row["face"], row["tool"], f"{engaged:.2f}", f"{100 * compared.by_map[-1]:.1f}",
                f"{100 * compared.by_blind[-1]:.1f}", f"{100 * compared.differs[-1]:.2f}",
                f"{100 * compared.differs.max():.2f}",
                f"{100 * (compared.only_map - compared.wrong).max():.2f}", f"{compared.footpoints[0]}",
                f"{compared.footpoints[1]}", f"{compared.footpoints[1] / max(compared.footpoints[0], 1):.0f}",
            )  # fmt: skip
        compared = row["_comparisons"][0]
        patches.add_row(
            row["face"], row["tool"], f"{100 * compared.by_blind[-1]:.1f}", f"{100 * row['detected']:.1f}",
            f"{100 * row['detected_of_reachable']:.1f}", str(row["sweeps"]), f"{row['seconds']:.2f}",
            str(len(row["_families"])),
        )  # fmt: skip
        for cells in _explained(row["_families"], row["_areas"]):
            named.add_row(row["face"], row["tool"], *cells)
    for printed in (maps, patches, named):
        console.print(printed)
    every = [compared for row in rows for compared in row["_comparisons"]]
    asked = [row["_comparisons"][0] for row in rows]
    differs = max(float(compared.differs[-1]) for compared in asked)
    hardest = max(float(compared.differs.max()) for compared in every)
    least = min(row["detected_of_reachable"] for row in rows)
    ratio = min(compared.footpoints[1] / max(compared.footpoints[0], 1) for compared in asked)
    verdicts = [
        Verdict("map differs from blind search, % of area", "<= 1", f"{100 * differs:.2f}", differs <= MAP_DIFFERS),
        Verdict("the same, at any tolerance, whole flute too", "", f"{100 * hardest:.2f}", True),
        Verdict("detected of reachable, least %", ">= 95", f"{100 * least:.1f}", least >= DETECTED),
        Verdict("times fewer footpoints, least", ">= 20", f"{ratio:.0f}", ratio >= FEWER_FOOTPOINTS),
    ]
    return verdicts, {"rows": [{key: value for key, value in row.items() if key[0] != "_"} for row in rows]}


def _explained(families: Sequence[Family], areas: Array) -> Iterator[list[str]]:
    """The families of each explanation: how many, the area they pass over, how much of it the map misses."""
    for why in dict.fromkeys(family.why for family in families):
        same = [family for family in families if family.why == why]
        through, alone = (
            100.0 * areas[np.unique(np.concatenate(sets))].sum() / areas.sum()
            for sets in ([family.through for family in same], [family.alone for family in same])
        )
        bend = float(np.median([family.curvature for family in same]))
        yield [why, str(len(same)), f"{through:.1f}", f"{alone:.1f}", f"{1e3 * bend:.2f}"]


# -- time ------------------------------------------------------------------------------------------------------------


def least_seconds(job: Scene, runs: int) -> tuple[float, float]:
    """Least time of several runs, for others may be using the machine: (on the clock, of all cores together)."""
    taken = []
    for _ in range(runs):
        start = time.perf_counter(), time.process_time()
        detect(job, SilentProgress())
        taken.append((time.perf_counter() - start[0], time.process_time() - start[1]))
    clock, cores = zip(*taken, strict=True)
    return min(clock), min(cores)


def timing(console: Console, runs: int) -> tuple[list[Verdict], dict[str, Any]]:
    """Time over density and over the number of tools, on the first blade there is, else on an envelope."""
    there = next((flank for flank in FLANKS if (PARTS / flank.file).exists()), None)
    if there is None:
        case = random_envelopes(CATALOGUE["T1"], 1, SEED)[0]
        face, name = whole(case.surface, case.sense), "envelope"
    else:
        face, name = load(there), there.name
    tools = list(CATALOGUE.values())
    least_seconds(scene(face, tools[:1], "quick", free=True), 1)  # compiles what is not in the cache
    densities: list[Density] = ["quick", "normal", "exhaustive"]
    seeds = [float(DENSITIES[density].contacts * len(DENSITIES[density].heights)) for density in densities]
    measured = [least_seconds(scene(face, tools[:1], density, free=True), runs) for density in densities]
    by_density = [clock for clock, _ in measured]
    alone = [by_density[1], *(least_seconds(scene(face, [tool], free=True), runs)[0] for tool in tools[1:])]
    by_tools = [alone[0], *(least_seconds(scene(face, tools[:count], free=True), runs)[0] for count in (2, 3))]
    printed = table(
        f"time of detection on {name}", "", "contacts x heights", "s", "s of all cores", "per 1000, or per tool alone"
    )
    for density, count, (clock, cores) in zip(densities, seeds, measured, strict=True):
        row = [f"{count:.0f}", f"{clock:.2f}", f"{cores:.2f}", f"{1e3 * clock / count:.2f}"]
        printed.add_row(f"T1, {density}", *row)
    for count, seconds in enumerate(by_tools, 1):
        together = f"{seconds / sum(alone[:count]):.2f}"
        printed.add_row(" ".join(tool.name for tool in tools[:count]), "", f"{seconds:.2f}", "", together)
    console.print(printed)
    exponent = fitted_exponent(seeds, by_density)
    # Tools differ: the drawer is held against the sum of its tools, one at a time.
    of_tools = fitted_exponent(np.cumsum(alone).tolist(), by_tools)
    _plot(seeds, by_density, exponent, np.cumsum(alone).tolist(), by_tools, of_tools, name)
    verdicts = [
        Verdict(
            "detection at the default density, s", f"<= {SECONDS:g}", f"{by_density[1]:.2f}", by_density[1] <= SECONDS
        ),
        Verdict("exponent of time over seeds", "<= 1", f"{exponent:.2f}", exponent <= LINEAR),
        Verdict("exponent of time over tools", "<= 1", f"{of_tools:.2f}", of_tools <= LINEAR),
    ]
    return verdicts, {
        "face": name,
        "seeds": seeds,
        "seconds": [round(value, 3) for value in by_density],
        "seconds_of_all_cores": [round(cores, 3) for _, cores in measured],
        "tools": [round(value, 3) for value in by_tools],
        "tools_alone": [round(value, 3) for value in alone],
        "exponents": [round(exponent, 3), round(of_tools, 3)],
    }


def _plot(
    seeds: Sequence[float], by_density: Sequence[float], exponent: float, alone: Sequence[float],
    by_tools: Sequence[float], of_tools: float, name: str,
) -> None:  # fmt: skip
    """The picture of both growths, with the straight lines that linear growth would be."""
    matplotlib.use("Agg")
    from matplotlib import pyplot as plt  # the backend has to be chosen first

    figure, axes = plt.subplots(1, 2, figsize=(8.0, 3.2), layout="constrained")
    panels = (
        (seeds, by_density, exponent, "contact points × heights"),
        (alone, by_tools, of_tools, "sum of the tools one at a time, s (1, 2, 3 tools)"),
    )
    for axis, (work, seconds, slope, label) in zip(axes, panels, strict=True):
        axis.loglog(work, seconds, "o-", color="#1f5a99", label=f"measured, exponent {slope:.2f}")
        axis.loglog(work, seconds[0] * np.array(work) / work[0], "--", color="0.6", label="linear")
        axis.set_xlabel(label)
        axis.set_ylabel("detection, s")
        axis.grid(True, which="both", alpha=0.3)
        axis.legend(frameon=False)
    axes[0].set_title(f"{name}, T1: density", fontsize=10)
    axes[1].set_title(f"{name}: tools", fontsize=10)
    PICTURE.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(PICTURE, dpi=130, metadata={"Software": None})
    plt.close(figure)


@click.command()
@click.option("--only", type=click.Choice(["envelopes", "joined", "blades", "time"]), help="One part of the table.")
@click.option("--points", default=150, show_default=True, help="Points on a real face, about.")
@click.option("--motions", default=6, show_default=True, help="Random motions of each tool; 100 for what is asked.")
@click.option("--density", default="normal", show_default=True, type=click.Choice(list(DENSITIES)), help="On blades.")
@click.option("--runs", default=2, show_default=True, help="The least time of so many runs counts.")
@click.option("--json", "as_json", metavar="FILE", help="Write the figures to FILE too.")
def main(only: str | None, points: int, motions: int, density: Density, runs: int, as_json: str | None) -> None:
    """Print what detection must reach; exit code 1 where a figure is missed."""
    console = table_console()
    progress = make_progress(quiet=False)
    parts: dict[str, Part] = {
        "time": lambda: timing(console, runs),
        "envelopes": lambda: envelopes(console, progress, motions),
        "joined": lambda: joined(console, progress),
        "blades": lambda: blades(console, progress, points, density),
    }
    verdicts, figures = measured(console, "Detection", parts, only)
    if as_json is not None:
        figures["verdicts"] = kept(verdicts)
        Path(as_json).write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")
    raise SystemExit(0 if all(verdict.reached for verdict in verdicts) else 1)


if __name__ == "__main__":
    main()
