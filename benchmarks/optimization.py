"""What optimisation reaches: against following the rulings, on exact envelopes, real blades and ruled flanks; its time.

Run with ``python -m benchmarks.optimization`` (or ``make bench``), one part of it with ``--only ruling``,
``envelopes``, ``blades``, ``gallery`` or ``time``. All gaps are swept gaps g at points of the face. Real blades are
looked for in ``../shared/parts`` beside the repository and left out where that folder is missing.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from math import radians
from pathlib import Path
from typing import Any, Literal

import click
import matplotlib
import msgspec
import numpy as np
import numpy.typing as npt
from rich.console import Console
from scipy.linalg import eigh
from scipy.spatial.transform import Rotation

from benchmarks.detection import NO_MACHINE, NOTHING, Flank, load, whole
from benchmarks.envelopes import EnvelopeCase, cylinder, random_envelopes
from benchmarks.ruled_gallery import (
    FREE,
    GALLERY,
    OneSweep,
    RuledFlank,
    Sampled,
    best_cone,
    one_sweep,
    steady_sweep,
    trade,
)
from benchmarks.ruling_following import Band, band_errors, ruling_following
from benchmarks.run import PARTS, REPOSITORY, SEED
from benchmarks.verdicts import Part, Verdict, kept, measured, table, table_console
from conflank_cli import job as jobs
from conflank_cli.cad.scene import load_scene
from conflank_cli.detection import detect
from conflank_cli.geometry.face import DesignFace
from conflank_cli.geometry.gap import gap_field, motion_gap, travel
from conflank_cli.geometry.growth import away_from, greville, slid
from conflank_cli.geometry.normal_equations import NormalEquations, basis_at
from conflank_cli.geometry.screening import Screen, longest_between
from conflank_cli.geometry.workface import FaceSamples, WorkFace
from conflank_cli.limits import Limits
from conflank_cli.motion import Motion, fitted
from conflank_cli.once import Once
from conflank_cli.optimization import (
    POINTS,
    optimize,
    prepare,
)
from conflank_cli.optimization.gauss_newton import Step, minimise
from conflank_cli.optimization.task import Task
from conflank_cli.progress import SilentProgress
from conflank_cli.scene import Scene
from conflank_cli.selection import select
from conflank_cli.sweep import Sweep
from conflank_cli.tool import CATALOGUE, Tool

Array = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]

TOLERANCE = 0.010  # mm, on real blades
EVERYTHING = 1.0  # mm: gaps are exact up to this where a whole face is asked about
DENSE = 20000  # points that a face is judged on, about
# Poses looked at first when a sweep is judged, mm apart: it must not be the search that misses a gouge.
LOOK = 0.25


def scene(
    face: DesignFace, tools: Sequence[Tool], tolerance: float, *, polish: bool = True, grow: bool = True
) -> Scene:
    """A job for one face without check geometry, on a machine that reaches every axis; shank and holder stay."""
    job = jobs.Job(
        part=jobs.Part("part.step", (jobs.Design(face.number),)),
        tools=jobs.Tools(tuple(tool.name for tool in tools)),
        tolerance=jobs.Tolerance(tolerance, tolerance),
        optimization=jobs.Optimization(polish=polish, grow=grow),
        machine=jobs.Machine("no-limits", None, NO_MACHINE),
    )
    return Scene(job, "part", (face,), tuple(tools), Once(lambda: NOTHING), {})


def task_of(job: Scene, face: int = 0) -> Task:
    """What the sweeps of the first tool on a face are optimised with."""
    key = face, job.tools[0].name
    return prepare(job, [key])[key]


# -- ruling-following ------------------------------------------------------------------------------------------------

# mm: what a program is made with by default, for comparison, and what it takes for the accuracy that is asked for.
USUAL, FINE = 0.010, 0.004
MEAN_EPSILON_UM, MAX_GAP_UM, RATIO = 1.0, 5.0, 12.6
LARGEST = 3  # sweeps of each side
SAMPLES = (100, 30)
SIDES = ("pressure", "suction")
# The box of a patch in the face's parameters leaves out this share of its area at every side, in percent.
FRAYED = 2.0


@dataclass(frozen=True, slots=True)
class Against:
    """One sweep of ours against the ruling-following one over the same extent: errors in um.

    area_mm2, share: of our patch, also of the face. within: share of the samples on the face that are within tolerance.
    mean_epsilon: mean |ε|, ours over these samples, the other's over those in the box of the patch. max_gap: largest
    |g| on our patch. default_overcut: largest overcut of the other in the box.
    """

    area_mm2: float
    share: float
    within: float
    mean_epsilon: float
    max_gap: float
    default_mean_epsilon: float
    default_overcut: float


def patch_box(uv: Array) -> tuple[float, float, float, float]:
    """The box (u0, u1, v0, v1) of parameter points (N, 2), frayed borders left out."""
    low, high = np.percentile(uv, [FRAYED, 100.0 - FRAYED], axis=0)
    return float(low[0]), float(high[0]), float(low[1]), float(high[1])


def default_sweep(
    face: WorkFace, tool: Tool, motion: Motion, box: tuple[float, float, float, float]
) -> tuple[Motion, Array]:
    """The better of the two ruling-following sweeps over a box, its tip where that of `motion` is; with its errors."""
    p, q = motion.ends([0.5])
    feet = face.projector.project(np.vstack([p, q]))
    found = []
    for across, rise in (("u", feet.v[1] - feet.v[0]), ("v", feet.u[1] - feet.u[0])):
        way: Literal["u", "v"] = "u" if across == "u" else "v"
        default = ruling_following(face, tool, Band(box, way, bool(rise > 0.0)))
        found.append((default, band_errors(face, tool, default, box, SAMPLES)))
    return min(found, key=lambda pair: float(np.abs(pair[1]).mean()))


def against_default(face: WorkFace, tool: Tool, sweep: Sweep, samples: FaceSamples, limits: Limits) -> Against:
    """Hold one sweep against the default."""
    gap = motion_gap(sweep.motion, tool, samples.points, step=LOOK)[0]
    patch = (gap <= limits.under) & (gap >= -limits.over)
    box = patch_box(samples.uv[patch])
    errors = band_errors(face, tool, sweep.motion, (-np.inf, np.inf, -np.inf, np.inf), SAMPLES)
    inside = errors[(errors <= limits.under) & (errors >= -limits.over)]
    default, default_errors = default_sweep(face, tool, sweep.motion, box)
    u, v = samples.uv.T
    there = (u >= box[0]) & (u <= box[1]) & (v >= box[2]) & (v <= box[3])
    default_gap = motion_gap(default, tool, samples.points[there], reach=EVERYTHING, step=LOOK)[0]
    return Against(
        float(samples.areas[patch].sum()),
        float(samples.areas[patch].sum() / samples.areas.sum()),
        len(inside) / max(len(errors), 1),
        1e3 * float(np.abs(inside).mean()),
        1e3 * float(np.abs(gap[patch]).max()),
        1e3 * float(np.abs(default_errors).mean()),
        1e3 * max(float(-default_gap.min()), 0.0),
    )


def blisk_scene(side: str, tolerance: float) -> Scene:
    """The job of one side of the sample blade, with T1 and another tolerance."""
    file = REPOSITORY / "sample_parts" / "blisk_blade" / f"{side}.toml"
    job = msgspec.structs.replace(
        jobs.load_job(str(file)), tools=jobs.Tools(("T1",)), tolerance=jobs.Tolerance(tolerance, tolerance)
    )
    return load_scene(job, file.parent)


def largest_against_default(side: str, tolerance: float) -> tuple[list[Against], float]:
    """The largest sweeps of a plan against the default, and the plan's coverage."""
    job = blisk_scene(side, tolerance)
    tool, limits = job.tools[0], Limits.of(job.job.tolerance)
    optimised, _ = optimize(job, detect(job, SilentProgress()), SilentProgress())
    choice = select(job, optimised, SilentProgress())
    plan, summary = choice.plan, choice.summary
    face = WorkFace.under(job.faces[0], tool)
    samples = face.samples(face.spacing(DENSE))
    largest = sorted(plan, key=lambda sweep: -sweep.facts["covered_area_mm2"])[:LARGEST]
    return [against_default(face, tool, sweep, samples, limits) for sweep in largest], float(summary["coverage"])


def ruling(console: Console) -> tuple[list[Verdict], dict[str, Any]]:
    """The sample blade: the three largest sweeps of each side against as many that follow the rulings."""
    printed = table(
        "sample blade, T1: largest sweeps; following the rulings over their extent",
        "side", "+-um", "mm2", "%", "samples %", "mean |e| um", "max |g| um", "rulings: mean |e|", "overcut", "ratio",
    )  # fmt: skip
    found = {
        (side, tolerance): largest_against_default(side, tolerance) for tolerance in (USUAL, FINE) for side in SIDES
    }
    for (side, tolerance), (rows, _) in found.items():
        for row in rows:
            printed.add_row(
                side, f"{1e3 * tolerance:g}", f"{row.area_mm2:.0f}", f"{100 * row.share:.1f}",
                f"{100 * row.within:.0f}", f"{row.mean_epsilon:.2f}", f"{row.max_gap:.2f}",
                f"{row.default_mean_epsilon:.1f}", f"{row.default_overcut:.0f}",
                f"{row.default_mean_epsilon / row.mean_epsilon:.1f}",
            )  # fmt: skip
    console.print(printed)
    for tolerance in (USUAL, FINE):
        shares = ", ".join(f"{side} {100 * found[side, tolerance][1]:.1f} %" for side in SIDES)
        area = sum(row.area_mm2 for side in SIDES for row in found[side, tolerance][0])
        console.print(
            f"  +-{1e3 * tolerance:g} um: the largest sweeps {area:.0f} mm2 together, whole plans cover {shares}"
        )
    fine = [row for side in SIDES for row in found[side, FINE][0]]
    ours = float(np.mean([row.mean_epsilon for row in fine]))
    theirs = float(np.mean([row.default_mean_epsilon for row in fine]))
    worst = max(row.max_gap for row in fine)
    verdicts = [
        Verdict(
            "mean |e| of the largest sweeps, um", f"<= {MEAN_EPSILON_UM:g}", f"{ours:.2f}", ours <= MEAN_EPSILON_UM
        ),
        Verdict("largest |g| on their patches, um", f"<= {MAX_GAP_UM:g}", f"{worst:.2f}", worst <= MAX_GAP_UM),
        Verdict("mean |e| following the rulings, um", "", f"{theirs:.1f}", True),
        Verdict("ratio of the means", f">= {RATIO:g}", f"{theirs / ours:.1f}", theirs >= RATIO * ours),
    ]
    return verdicts, {
        "plans": [
            {
                "side": side, "tolerance_um": 1e3 * tolerance, "coverage": round(coverage, 4),
                "sweeps": [rounded(row) for row in rows],
            }
            for (side, tolerance), (rows, coverage) in found.items()
        ]
    }  # fmt: skip


# -- exact envelopes -------------------------------------------------------------------------------------------------

OFF, TURNED = 0.2, radians(1.0)  # mm and rad off the true motion
START_SPACING = 6.0  # mm of travel between control points, as detection has them
MEAN_UM, MAX_UM = 0.05, 0.5
PATCH_POINTS = 4000
SOFT = 1e-6


def disturbed(case: EnvelopeCase, rng: np.random.Generator) -> Motion:
    """The true motion, moved rigidly at every time: by OFF and TURNED about directions that turn slowly.

    The directions run from one random vector to another over the sweep; the rotation is about the middle of the axis.
    """
    t = np.linspace(0.0, 1.0, len(case.t))
    weights = np.stack([1.0 - t, t], axis=1)
    shift, spin = (weights @ rng.normal(size=(2, 3)) for _ in range(2))
    shift *= OFF / np.linalg.norm(shift, axis=1)[:, None]
    turn = Rotation.from_rotvec(TURNED * spin / np.linalg.norm(spin, axis=1)[:, None])
    middle = 0.5 * (case.p + case.q)
    ends = np.hstack([middle + shift + turn.apply(end - middle) for end in (case.p, case.q)])
    count = round(travel(fitted(t, ends, 64)) / START_SPACING) + 3
    return fitted(t, ends, count)


@dataclass(frozen=True, slots=True)
class Conditioning:
    """Mean square of the gap over the face for a mean square way of the axis ends of 1 mm2, in mm2, by mode.

    slide: sliding along the contact, evenly over the sweep. normal: moving away from the face, evenly. largest: of all
    motions of the control points that keep |pq|. soft: share of these motions' eigenvalues that are below SOFT of it.
    """

    slide: float
    normal: float
    largest: float
    soft: float


def conditioning(tool: Tool, motion: Motion, face: WorkFace, samples: FaceSamples) -> Conditioning:
    """Rayleigh quotients and eigenvalues of the Gauss-Newton matrix of g, without regularisation, over that of the way.

    The matrix is the mean over the face of grad g grad gᵀ, that of the way the mean over time of (|δp|² + |δq|²) / 2.
    Each control point keeps five freedoms of its six: those that do not lengthen the axis there.
    """
    field = gap_field(motion, tool, samples.points)
    at = basis_at(motion.knots, field.time)
    equations = NormalEquations.of(len(motion.p))
    weight = samples.areas / samples.areas.sum()
    equations.add(at.first, at.value, field.rows[:, None, :], field.gap[:, None], weight[:, None])
    gap = dense_matrix(equations)
    even = basis_at(motion.knots, np.linspace(0.0, 1.0, 6 * len(motion.p)))
    m = len(even.first)
    equations = NormalEquations.of(len(motion.p))
    unit = np.broadcast_to(np.eye(6), (m, 6, 6))
    equations.add(even.first, even.value, unit, np.zeros((m, 6)), np.full((m, 6), 0.5 / m))
    way = dense_matrix(equations)

    away = away_from(face, motion)
    moved = slid(motion, tool, np.ones(2), away)
    modes = (np.hstack([moved.p - motion.p, moved.q - motion.q]), np.tile(away, 2))
    slide, normal = (float(mode @ gap @ mode / (mode @ way @ mode)) for mode in (mode.ravel() for mode in modes))

    p, q = motion.ends(greville(motion))
    d = (q - p) / np.linalg.norm(q - p, axis=1)[:, None]
    free = np.zeros((6 * len(d), 5 * len(d)))
    for k, longer in enumerate(np.hstack([-d, d])):
        free[6 * k : 6 * k + 6, 5 * k : 5 * k + 5] = np.linalg.svd(longer[None, :])[2][1:].T
    values = eigh(free.T @ gap @ free, free.T @ way @ free, eigvals_only=True)
    return Conditioning(slide, normal, float(values[-1]), float(np.mean(values < SOFT * values[-1])))


def dense_matrix(equations: NormalEquations) -> Array:
    """The matrix of banded normal equations, in full."""
    size = equations.band.shape[1]
    full = np.zeros((size, size))
    for offset, diagonal in enumerate(equations.band):
        rows = np.arange(size - offset)
        full[rows + offset, rows] = full[rows, rows + offset] = diagonal[: size - offset]
    return full


@dataclass(frozen=True, slots=True)
class Recovered:
    """An exact envelope after optimisation: |g| before and after, um; seconds of one core."""

    start_mean: float
    start_max: float
    first_mean: float
    mean: float
    max: float
    seconds: float


def recover(case: EnvelopeCase, rng: np.random.Generator) -> tuple[Recovered, Conditioning, Motion]:
    """Optimise a disturbed motion on its own envelope, and judge it there."""
    face = whole(case.surface, case.sense)
    job = scene(face, (case.tool,), TOLERANCE)
    task = task_of(job)
    start = disturbed(case, rng)
    seconds = time.thread_time()
    first = task.first(start)
    motion = task.grown(task.refined(first, start), start).motion
    seconds = time.thread_time() - seconds
    samples = task.face.samples(task.face.spacing(PATCH_POINTS))
    gaps = [
        1e3 * np.abs(motion_gap(each, case.tool, samples.points, reach=EVERYTHING, step=LOOK)[0])
        for each in (start, first.motion, motion)
    ]
    soft = conditioning(case.tool, motion, task.face, samples)
    means = [float(gap @ samples.areas / samples.areas.sum()) for gap in gaps]
    return (
        Recovered(means[0], float(gaps[0].max()), means[1], means[2], float(gaps[2].max()), seconds),
        soft,
        motion,
    )


def envelopes(console: Console, count: int) -> tuple[list[Verdict], dict[str, Any]]:
    """Exact envelopes of `count` random motions of each tool, started off the true motion: is it found again?"""
    printed = table(
        f"exact envelopes started {OFF:g} mm and {np.degrees(TURNED):g} degree off: |g| um, worst of the motions",
        "tool", "motions", "reached", "start mean", "first mean", "mean", "median mean", "max", "median max",
        "s each", "slide / normal", "soft %",
    )  # fmt: skip
    rows: list[dict[str, Any]] = []
    for tool in (*CATALOGUE.values(), cylinder()):
        cases = random_envelopes(tool, count, SEED)
        rngs = np.random.default_rng(SEED).spawn(count)
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            found = list(pool.map(lambda pair: recover(*pair)[:2], zip(cases, rngs, strict=True)))
        mine = [
            {
                "tool": tool.name,
                "motion": k,
                **rounded(result),
                **{f"mode_{n}": v for n, v in rounded(soft, 12).items()},
            }
            for k, (result, soft) in enumerate(found)
        ]
        rows += mine
        results = [result for result, _ in found]
        reached = sum(result.mean <= MEAN_UM and result.max <= MAX_UM for result in results)
        printed.add_row(
            tool.name, str(count), str(reached), f"{max(r.start_mean for r in results):.0f}",
            f"{max(r.first_mean for r in results):.2f}", f"{max(r.mean for r in results):.3f}",
            f"{np.median([r.mean for r in results]):.3f}", f"{max(r.max for r in results):.2f}",
            f"{np.median([r.max for r in results]):.2f}", f"{np.median([r.seconds for r in results]):.2f}",
            f"{np.median([soft.slide / soft.normal for _, soft in found]):.1e}",
            f"{100 * np.median([soft.soft for _, soft in found]):.0f}",
        )  # fmt: skip
    console.print(printed)
    missed = [row for row in rows if row["mean"] > MEAN_UM or row["max"] > MAX_UM]
    for row in missed:
        console.print(
            f"  missed: {row['tool']} motion {row['motion']}: mean {row['mean']:.3f}, max {row['max']:.2f} um"
        )
    hit = len(rows) - len(missed)
    asked = f"{len(rows)} of {len(rows)}"
    return [Verdict(f"mean |g| <= {MEAN_UM:g} and max <= {MAX_UM:g} um", asked, str(hit), not missed)], {"cases": rows}


# -- real blades -----------------------------------------------------------------------------------------------------

FACES = (
    Flank("rotor37.step", 0),
    Flank("rotor37.step", 1),
    Flank("tfd4ac_rotor1.igs", 0),
    Flank("tfd4ac_rotor1.igs", 1),
    Flank("compressor_wheel.step", 0),
    Flank("compressor_wheel.step", 2),
)
TOOLS = ("T1", "T2", "T3")
# Area of the largest single sweep that is asked for, as a share of the face, by face and tool.
ASKED = {("rotor37 0", "T1"): 0.42, ("rotor37 0", "T3"): 0.47, ("compressor_wheel 2", "T3"): 0.65}
SWEEP_MEAN_UM = 2.0
# The largest sweeps by a first look are judged closely.
CLOSELY = 40
STAGES = {"before": (False, False), "polished": (True, False), "grown": (True, True)}


@dataclass(frozen=True, slots=True)
class Largest:
    """The largest sweep of a stage: share of the face, area in mm2, mean |g| and overcut in um; None for none."""

    share: float
    area_mm2: float
    mean: float
    overcut: float
    motion: Motion


def trimmed(motion: Motion, tool: Tool, points: Array, limits: Limits) -> tuple[Motion, Array] | None:
    """The longest stretch of a motion that overcuts nowhere, and its gaps (N,); None where there is none."""
    gap, t = motion_gap(motion, tool, points)
    if gap.min() < -limits.over:
        shorter = longest_between(motion, t[gap < -limits.over])
        if shorter is None:
            return None
        motion = shorter
        gap = motion_gap(motion, tool, points)[0]
    return (motion, gap) if gap.min() >= -limits.over else None


def largest_sweeps(sweeps: Sequence[Sweep], job: Scene, most_mean: Sequence[float]) -> list[Largest | None]:
    """The largest sweep with at most each of these mean |g|, um, after trimming off whatever overcuts or collides."""
    tool, limits = job.tools[0], Limits.of(job.job.tolerance)
    face = WorkFace.under(job.faces[0], tool)
    coarse, dense = (face.samples(face.spacing(count)) for count in (POINTS, DENSE))
    screen = Screen.of(job)

    def first_look(sweep: Sweep) -> tuple[float, Motion] | None:
        allowed = screen.allowed(sweep.motion, tool)
        found = None if allowed is None else trimmed(allowed, tool, coarse.points, limits)
        return None if found is None else (float(coarse.areas[found[1] <= limits.under].sum()), found[0])

    def close_look(motion: Motion) -> Largest | None:
        found = trimmed(motion, tool, dense.points, limits)
        if found is None:
            return None
        motion, gap = found
        inside = gap <= limits.under
        area = float(dense.areas[inside].sum())
        mean = 1e3 * float(np.abs(gap[inside]) @ dense.areas[inside]) / max(area, 1e-9)
        return Largest(area / float(dense.areas.sum()), area, mean, 1e3 * max(float(-gap.min()), 0.0), motion)

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        looked = [found for found in pool.map(first_look, sweeps) if found is not None]
        looked.sort(key=lambda found: -found[0])
        closely = [found for found in pool.map(close_look, [motion for _, motion in looked[:CLOSELY]]) if found]
    fitting = [[found for found in closely if found.mean <= mean] for mean in most_mean]
    return [max(found, key=lambda each: each.area_mm2, default=None) for found in fitting]


def blade(flank: Flank, tool: Tool) -> dict[str, Largest | None]:
    """The largest sweep after each stage, and the largest that is accurate as well."""
    face = load(flank)
    sweeps = detect(scene(face, (tool,), TOLERANCE), SilentProgress())
    found: dict[str, Largest | None] = {}
    for stage, (polish, grow) in STAGES.items():
        job = scene(face, (tool,), TOLERANCE, polish=polish, grow=grow)
        optimised, _ = optimize(job, sweeps, SilentProgress())
        found[stage], found[f"{stage}, accurate"] = largest_sweeps(optimised, job, (np.inf, SWEEP_MEAN_UM))
    return found


def blades(console: Console, named: str) -> tuple[list[Verdict], dict[str, Any]]:
    """Real blades: the largest single sweep before polish and growth, after polish, after growth."""
    flanks = [flank for flank in FACES if (PARTS / flank.file).exists() and named in flank.name]
    if not flanks:
        console.print(f"no folder {PARTS.parent.name}/{PARTS.name} beside the repository: real blades left out")
        return [], {}
    printed = table(
        f"largest single sweep within +-{1e3 * TOLERANCE:g} um: % of the face (mm2), mean |g| um; "
        f"at most {SWEEP_MEAN_UM:g}: the largest that is so accurate",
        "face", "tool", "before", "|g|", "polished", "|g|", "grown", "|g|", f"at most {SWEEP_MEAN_UM:g}", "|g|", "s",
    )  # fmt: skip
    rows: list[dict[str, Any]] = []
    verdicts: list[Verdict] = []
    for flank in flanks:
        for name in TOOLS:
            start = time.perf_counter()
            found = blade(flank, CATALOGUE[name])
            seconds = time.perf_counter() - start
            cells = []
            for key in (*STAGES, "grown, accurate"):
                best = found[key]
                cells += ["-", "-"] if best is None else [
                    f"{100 * best.share:.1f} ({best.area_mm2:.0f})", f"{best.mean:.2f}"
                ]  # fmt: skip
            printed.add_row(flank.name, name, *cells, f"{seconds:.0f}")
            rows.append(
                {"face": flank.name, "tool": name, "seconds": round(seconds, 1)}
                | {
                    key: None if best is None else {
                        "share": round(best.share, 4), "area_mm2": round(best.area_mm2, 1),
                        "mean_um": round(best.mean, 3), "overcut_um": round(best.overcut, 2),
                    }
                    for key, best in found.items()
                }
            )  # fmt: skip
            grown = found["grown"]
            asked = ASKED.get((flank.name, name))
            if asked is not None:
                share = 0.0 if grown is None else grown.share
                verdicts.append(
                    Verdict(
                        f"{flank.name} {name}, largest sweep %", f">= {100 * asked:g}", f"{100 * share:.1f}",
                        share >= asked,
                    )
                )  # fmt: skip
            mean = np.inf if grown is None else grown.mean
            verdicts.append(
                Verdict(
                    f"{flank.name} {name}, mean |g| of it, um", f"<= {SWEEP_MEAN_UM:g}", f"{mean:.2f}",
                    mean <= SWEEP_MEAN_UM,
                )
            )  # fmt: skip
    console.print(printed)
    return verdicts, {"rows": rows}


# -- ruled gallery ---------------------------------------------------------------------------------------------------

PICTURE = REPOSITORY / "docs" / "pictures" / "gallery.png"
SHARES = (0.75, 0.5, 0.25, 0.0)  # of the balanced overcut, as limits in turn


def flank_figures(flank: RuledFlank) -> dict[str, list[OneSweep]]:
    """Balanced sweeps on both sides, one that may swing back, the trade-off with the cylinder and with the best cone.

    All but the first are on the better side.
    """
    sampled = Sampled.of(flank)
    sides = [steady_sweep(flank, side, sampled) for side in (1, -1)]
    better = min(sides, key=lambda sweep: sweep.worst)
    free = one_sweep(flank, 1 if better is sides[0] else -1, sampled, FREE)
    tapered = best_cone(flank, better, sampled)
    return {
        "sides": sides,
        "free": [free],
        "cylinder": trade(better, sampled, SHARES),
        "cone": trade(tapered, sampled, SHARES),
    }


def gallery(console: Console) -> tuple[list[Verdict], dict[str, Any]]:
    """Ruled flanks in one sweep, whole face and border: overcut and stock left against the published overcut."""
    printed = table(
        "ruled gallery: one sweep, whole face with its border, um",
        "face", "cutter", "side", "overcut", "stock left", "published overcut", "least turn",
    )  # fmt: skip
    traded = table(
        "least stock left under a limit on overcut, um (overcut : stock left)",
        "face", "cutter", "balanced", *(f"{100 * part:g} %" for part in SHARES),
    )  # fmt: skip
    verdicts: list[Verdict] = []
    figures: dict[str, Any] = {}
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        every = list(zip(GALLERY, pool.map(flank_figures, GALLERY), strict=True))
    for flank, found in every:
        for side, sweep in zip(("+", "-"), found["sides"], strict=True):
            printed.add_row(flank.name, "cylinder", side, *_cells(sweep, f"{1e3 * flank.published:g}"))
        free = found["free"][0]
        printed.add_row(flank.name, "cylinder, free", "better", *_cells(free, ""))
        tapered = found["cone"][0]
        name = f"cone {np.degrees(tapered.tool.half_angle):.1f}"
        printed.add_row(flank.name, name, "better", *_cells(tapered, ""))
        for cutter, sweeps in (("cylinder", found["cylinder"]), (name, found["cone"])):
            traded.add_row(
                flank.name, cutter, *(f"{1e3 * each.overcut:.1f} : {1e3 * each.stock:.1f}" for each in sweeps)
            )
        worst = found["cylinder"][0].worst
        verdicts += [
            Verdict(
                f"{flank.name}, max |g| um",
                f"< {1e3 * flank.published:g}",
                f"{1e3 * worst:.1f}",
                worst < flank.published,
            ),
            Verdict(f"{flank.name}, may swing back", "", f"{1e3 * free.worst:.1f}", True),
        ]
        figures[flank.name] = {
            "published_um": 1e3 * flank.published,
            "half_angle_deg": round(float(np.degrees(tapered.tool.half_angle)), 2),
            **{
                kind: [[round(1e3 * each.overcut, 2), round(1e3 * each.stock, 2)] for each in sweeps]
                for kind, sweeps in found.items()
            },
        }
    console.print(printed)
    console.print(traded)
    _plot(every)
    return verdicts, figures


def _cells(sweep: OneSweep, published: str) -> list[str]:
    return [f"{1e3 * sweep.overcut:.1f}", f"{1e3 * sweep.stock:.1f}", published, f"{sweep.turn:.2f}"]


def _plot(every: Sequence[tuple[RuledFlank, dict[str, list[OneSweep]]]]) -> None:
    """The picture of the trade between overcut and stock left."""
    matplotlib.use("Agg")
    from matplotlib import pyplot as plt  # the backend has to be chosen first

    figure, axes = plt.subplots(1, len(every), figsize=(10.0, 3.4), layout="constrained")
    for axis, (flank, found) in zip(axes, every, strict=True):
        cone_degrees = np.degrees(found["cone"][0].tool.half_angle)
        for kind, colour, label in (
            ("cylinder", "#1f5a99", "cylinder"),
            ("cone", "#c1440e", f"cone, half angle {cone_degrees:.1f}°"),
        ):
            pairs = np.array([[1e3 * each.overcut, 1e3 * each.stock] for each in found[kind]])
            axis.plot(pairs[:, 0], pairs[:, 1], "o-", color=colour, label=label)
        axis.axvline(1e3 * flank.published, color="0.5", linestyle="--", label="published overcut")
        axis.set_xlim(left=-2.0)
        axis.set_ylim(bottom=0.0)
        axis.set_xlabel("overcut, µm")
        axis.set_title(flank.name, fontsize=10)
        axis.legend(frameon=False, fontsize=7)
        axis.grid(True, alpha=0.3)
    axes[0].set_ylabel("stock left, µm")

    PICTURE.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(PICTURE, dpi=110, metadata={"Software": None})
    plt.close(figure)


# -- time ------------------------------------------------------------------------------------------------------------

PAPER_MS, WHOLE_MS, SCALING = 50.0, 500.0, 1.7
ITERATIONS = 10
# Sweeps of the face that are timed: every so manyth that detection found.
TIMED = {"paper": 24, "all": 8}


def timing(console: Console, runs: int) -> tuple[list[Verdict], dict[str, Any]]:
    """Time a sweep on one core: the paper's problem, and with polish and growth; what two cores give."""
    case_face = _timed_face()
    job = scene(case_face, (CATALOGUE["T1"],), TOLERANCE)
    task = task_of(job)
    detected = [sweep.motion for sweep in detect(job, SilentProgress())]
    motions = {name: detected[:: max(len(detected) // count, 1)][:count] for name, count in TIMED.items()}
    steps = (Step(1.0, 1.0, 3.0 * TOLERANCE, False),) * ITERATIONS

    def paper(motion: Motion) -> None:
        minimise(task.face, task.tool, motion, task.limits, task.weights, SAMPLES, steps)

    def everything(motion: Motion) -> None:
        task.grown(task.refined(task.first(motion), motion), motion)

    works: dict[str, Callable[[Motion], None]] = {"paper": paper, "all": everything}
    each, pooled = {}, {}
    for name, work in works.items():
        work(motions[name][0])  # compiles what is not in the cache
        each[name] = _seconds_each(work, motions[name], runs)
        pooled[name] = {cores: _pooled(work, motions[name], cores, runs) for cores in (1, 2)}
    printed = table(
        f"time on {case_face.name or 'a face'}, T1, load {os.getloadavg()[0]:.1f}",
        "", "sweeps", "ms a sweep, median", "most", "sweeps a s, one core", "two cores", "ratio",
    )  # fmt: skip
    labels = {"paper": f"paper's problem, {ITERATIONS} steps", "all": "with polish and growth"}
    for name, label in labels.items():
        one, two = (len(motions[name]) / pooled[name][cores] for cores in (1, 2))
        printed.add_row(
            label, str(len(motions[name])), f"{1e3 * np.median(each[name]):.1f}", f"{1e3 * max(each[name]):.1f}",
            f"{one:.1f}", f"{two:.1f}", f"{two / one:.2f}",
        )  # fmt: skip
    console.print(printed)
    paper_ms, whole_ms = (1e3 * float(np.median(each[name])) for name in ("paper", "all"))
    ratio = pooled["all"][1] / pooled["all"][2]
    return [
        Verdict("paper's problem, ms a sweep", f"<= {PAPER_MS:g}", f"{paper_ms:.1f}", paper_ms <= PAPER_MS),
        Verdict("with polish and growth, ms a sweep", f"<= {WHOLE_MS:g}", f"{whole_ms:.0f}", whole_ms <= WHOLE_MS),
        Verdict("throughput of two cores over one", f">= {SCALING:g}", f"{ratio:.2f}", ratio >= SCALING),
        Verdict(
            "the same, paper's problem", "", f"{pooled['paper'][1] / pooled['paper'][2]:.2f}", True,
        ),
    ], {
        "load": round(os.getloadavg()[0], 2),
        "ms": {name: [round(1e3 * value, 2) for value in values] for name, values in each.items()},
        "seconds_pooled": {
            name: {str(cores): round(value, 3) for cores, value in values.items()} for name, values in pooled.items()
        },
    }  # fmt: skip


def _timed_face() -> DesignFace:
    """The first real blade there is, else an exact envelope."""
    there = next((flank for flank in FACES if (PARTS / flank.file).exists()), None)
    if there is not None:
        return load(there)
    case = random_envelopes(CATALOGUE["T1"], 1, SEED)[0]
    return whole(case.surface, case.sense)


def _seconds_each(work: Callable[[Motion], None], motions: Sequence[Motion], runs: int) -> list[float]:
    """Least seconds of one core over some runs, of each motion."""
    taken = []
    for motion in motions:
        measured = []
        for _ in range(runs):
            start = time.thread_time()
            work(motion)
            measured.append(time.thread_time() - start)
        taken.append(min(measured))
    return taken


def _pooled(work: Callable[[Motion], None], motions: Sequence[Motion], threads: int, runs: int) -> float:
    """Least seconds on the clock over some runs, of all motions on so many threads."""
    measured = []
    with ThreadPoolExecutor(threads) as pool:
        for _ in range(runs):
            start = time.perf_counter()
            list(pool.map(work, motions))
            measured.append(time.perf_counter() - start)
    return min(measured)


def rounded(record: Any, digits: int = 4) -> dict[str, float]:
    """The fields of a record of figures, rounded."""
    return {name: round(float(getattr(record, name)), digits) for name in record.__slots__}


PARTS_OF_TABLE = ("ruling", "envelopes", "blades", "gallery", "time")


@click.command()
@click.option("--only", type=click.Choice(PARTS_OF_TABLE), help="One part of the table.")
@click.option("--face", metavar="NAME", default="", help="Of the real blades those whose name contains NAME.")
@click.option("--motions", default=25, show_default=True, help="Random motions of each tool.")
@click.option("--runs", default=3, show_default=True, help="The least time of so many runs counts.")
@click.option("--json", "as_json", metavar="FILE", help="Keep the figures in FILE, beside those of other parts.")
def main(only: str | None, face: str, motions: int, runs: int, as_json: str | None) -> None:
    """Print what optimisation must reach; exit code 1 where a figure is missed."""
    console = table_console()
    parts: dict[str, Part] = {
        "time": lambda: timing(console, runs),
        "envelopes": lambda: envelopes(console, motions),
        "ruling": lambda: ruling(console),
        "blades": lambda: blades(console, face),
        "gallery": lambda: gallery(console),
    }
    verdicts, figures = measured(console, "Optimisation", parts, only)
    if as_json is not None:
        file = Path(as_json)
        before = json.loads(file.read_bytes()) if file.exists() else {}
        figures["verdicts"] = before.get("verdicts", {}) | kept(verdicts)
        if face and "blades" in figures and "blades" in before:
            # Rows of other faces stay.
            mine = {(row["face"], row["tool"]) for row in figures["blades"]["rows"]}
            others = [row for row in before["blades"]["rows"] if (row["face"], row["tool"]) not in mine]
            figures["blades"]["rows"] = sorted(others + figures["blades"]["rows"], key=lambda r: (r["face"], r["tool"]))
        file.write_text(json.dumps(before | figures, indent=1) + "\n", encoding="utf-8")
    raise SystemExit(0 if all(verdict.reached for verdict in verdicts) else 1)


if __name__ == "__main__":
    main()
