"""What posting does to a motion: kinematics, blocks, rotary motion, times, and the change of the swept gap.

Run with ``python -m benchmarks.posting``; ``--only`` picks one part. Parts of the measurement: ``roundtrip`` (random
poses on all shipped machines), ``blocks`` (per sweep, beside uniform spacing; rotary steps; the gap that the text
leaves beside that of the exact motion), ``machines`` (the sample's plan on every shipped machine), ``time`` (predicted
beside a machine simulated in steps of 0.1 ms). Plans come from the whole program on the sample blade, on exact
envelopes, and on flanks of real blades where ../shared/parts is there.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from benchmarks.certificate import motion_cells
from benchmarks.run import PARTS, REPOSITORY, Case, Required, cases, run
from benchmarks.simulated_machine import drive, on_the_part
from benchmarks.verdicts import Part, Verdict, kept, measured, table, table_console
from conflank_cli.artifacts import read_artifact
from conflank_cli.errors import ConflankError
from conflank_cli.job import Machine as JobMachine
from conflank_cli.machine_frame import Frame
from conflank_cli.posting import plan_to_toolpath, summarize
from conflank_cli.posting.mounting import axis_positions, mounting_of
from conflank_cli.posting.ride import Ride
from conflank_cli.posting.spacing import CHORD_TOLERANCE, block_deviation, space_blocks
from conflank_cli.posting.summary import nominal_seconds
from conflank_cli.scene import Scene
from conflank_cli.sweep import Sweep
from conflank_cli.verification.gap import cutting_body, nearest
from conflank_cli.verification.kinematics import Frame as ReadFrame
from conflank_cli.verification.poses import build_cells, poses_on_part
from conflank_cli.verification.program import Interpolation
from conflank_cli.verification.reader import read_program
from conflank_cli.verification.sampling import sample_face
from postprocessors.errors import PostError
from postprocessors.kinematics.linear_axes import nose_positions
from postprocessors.kinematics.timing import profile
from postprocessors.kinematics.two_rotary import Run, choose_words, inverse
from postprocessors.kinematics.visits import visits_with_words
from postprocessors.machines.machine import (
    Machine,
    load_machine,
    read_machine_file,
    shipped_machines,
    unknown_keys,
)
from postprocessors.post import ProgramOptions, post_named
from postprocessors.toolpath import ToolPath

Array = npt.NDArray[np.float64]
Plan = tuple[str, Scene, Sequence[Sweep]]

POSES = 100_000
SEED = 2018
FLUTE = 35.0  # mm above the tip, more than the largest of the built-in tools
LENGTH = 170.0  # mm, tip to spindle nose
DIGITS = 4  # of coordinates and words in a program
POINTS = 60_000  # on each face
NEAR = 0.5  # mm: farther off a point says nothing of a sweep
REAL = ("rotor37_0", "tfd4ac_rotor1_0", "compressor_wheel_0")
STYLES = (("h", "tcpm"), ("h", "m128"), ("h", "ln"), ("i", "m128"), ("apt", "multax"))
ENVELOPES = ("envelope_T1_0", "envelope_T2_0", "envelope_T3_0", "envelope_CYL6_0")

TIP_UM, FLUTE_UM, GAP_UM, TIME_SHARE = 0.1, 0.2, 0.5, 0.005


def ready_machines() -> list[str]:
    """Names of the shipped machines that have all their values."""
    return [name for name in shipped_machines() if not unknown_keys(*read_machine_file(name))]


# --- kinematics -----------------------------------------------------------------------------------------------------


def measure_round_trip() -> tuple[list[Verdict], dict[str, Any]]:
    rng = np.random.default_rng(SEED)
    printed = table(
        "Part pose > machine > part pose", "machine", "poses", "solutions", "exact um", "tip um", "flute um"
    )
    worst, figures = np.zeros(3), {}
    zero = np.array([12.0, -7.0, 40.0])
    for name in ready_machines():
        machine = load_machine(name)
        tip = rng.uniform(-200.0, 200.0, (POSES, 3))
        axis = rng.normal(size=(POSES, 3))
        axis /= np.linalg.norm(axis, axis=1, keepdims=True)
        solutions = inverse(machine, axis)
        signs = np.array([rotary.sign for rotary in machine.rotary])
        errors, count = np.zeros(3), 0
        for angles in solutions.angles:
            words = np.degrees(angles) * signs
            inside = solutions.reachable.copy()
            for column, rotary in enumerate(machine.rotary):
                if rotary.range_deg is not None:
                    inside &= (words[:, column] >= rotary.range_deg[0]) & (words[:, column] <= rotary.range_deg[1])
            p, d, w = tip[inside], axis[inside], words[inside]
            count += len(p)
            there, along = on_the_part(machine, nose_positions(machine, p, w).at(zero, LENGTH), w, zero, LENGTH)
            exact = np.linalg.norm(there + FLUTE * along - p - FLUTE * d, axis=1).max(initial=0.0)
            # What a program carries: the tip itself and the words, rounded; the control moves X, Y, Z accordingly.
            q, w = np.round(p, DIGITS), np.round(w, DIGITS)
            there, along = on_the_part(machine, nose_positions(machine, q, w).at(zero, LENGTH), w, zero, LENGTH)
            low = np.linalg.norm(there - p, axis=1).max(initial=0.0)
            high = np.linalg.norm(there + FLUTE * along - p - FLUTE * d, axis=1).max(initial=0.0)
            errors = np.maximum(errors, 1000.0 * np.array([exact, low, high]))
        worst = np.maximum(worst, errors)
        figures[name] = {"poses": POSES, "solutions": count, "tip_um": errors[1], "flute_um": errors[2]}
        printed.add_row(name, f"{POSES:,}", f"{count:,}", f"{errors[0]:.1e}", f"{errors[1]:.3f}", f"{errors[2]:.3f}")
    CONSOLE.print(printed)
    return [
        Verdict(f"{POSES:,} random poses, tip", f"<= {TIP_UM} um", f"{worst[1]:.3f} um", bool(worst[1] <= TIP_UM)),
        Verdict(
            f"the same, {FLUTE:g} mm above the tip",
            f"<= {FLUTE_UM} um",
            f"{worst[2]:.3f} um",
            bool(worst[2] <= FLUTE_UM),
        ),
    ], figures


# --- plans ----------------------------------------------------------------------------------------------------------


@cache
def plans() -> tuple[Plan, ...]:
    """The plans that are given, or those that the whole program makes of the sample blade, of envelopes and flanks."""
    if GIVEN:
        stored = [(Path(file).parent.name, *read_artifact(file, "plan")) for file in GIVEN]
        return tuple((name, scene, tuple(sweeps)) for name, scene, sweeps, _ in stored)
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        sample = REPOSITORY / "sample_parts" / "blisk_blade" / "job.toml"
        wanted = [Case("blisk_blade", sample, "T1", Required(0.9, 10.0))]
        wanted += [case for case in cases(folder, None, 1) if case.name in (*ENVELOPES, *REAL)]
        found = []
        for case in wanted:
            run(case, folder / f"{case.name}_out")
            scene, sweeps, _ = read_artifact(str(folder / f"{case.name}_out" / "plan.npz"), "plan")
            found.append((case.name, scene, tuple(sweeps)))
    return tuple(found)


def on_machine(scene: Scene, sweeps: Sequence[Sweep], name: str) -> Scene:
    """The same job on another shipped machine, set up so that the tools lean by 30 degrees in the mean."""
    ends = [sweep.motion.ends([0.5]) for sweep in sweeps]
    mean = np.sum([(q[0] - p[0]) / np.linalg.norm(q[0] - p[0]) for p, q in ends], axis=0)
    turn, _ = Rotation.align_vectors([[0.0, -0.5, np.sqrt(0.75)]], [mean / np.linalg.norm(mean)])
    a, b, c = (float(angle) for angle in turn.as_euler("XYZ", degrees=True))
    setup = msgspec.structs.replace(scene.job.setup, rotate_deg=(a, b, c))
    return replace(scene, job=msgspec.structs.replace(scene.job, machine=JobMachine(name=name), setup=setup))


# --- blocks and gap -------------------------------------------------------------------------------------------------


def uniform_blocks(ride: Ride, machine: Machine) -> int:
    """Least number of blocks of even length, at the middle of the flute, that stay within the same deviation."""
    t = np.linspace(0.0, 1.0, 2001)
    tip, axis = ride.poses(t)
    way = np.linalg.norm(np.diff(tip + 0.5 * ride.reach * axis, axis=0), axis=1)
    length = np.concatenate([[0.0], np.cumsum(way)])

    def holds(count: int) -> bool:
        times = np.interp(np.linspace(0.0, length[-1], count + 1), length, t)
        words = choose_words(machine, [Run("sweep", ride.poses(times)[1])])[0]
        return bool(block_deviation(ride, times, words, machine).max() <= CHORD_TOLERANCE)

    many = 1
    while not holds(many):
        many *= 2
    few = many // 2
    while many - few > 1:
        middle = (few + many) // 2
        few, many = (few, middle) if holds(middle) else (middle, many)
    return many


def rotary_load(machine: Machine, text: str) -> float:
    """Largest share of a rotary axis' speed that a block at feed asks for, from the text alone."""
    program = read_program(text)
    moves = program.moves
    fed = moves.joined & ~moves.rapid & (moves.feed > 0.0)
    way = np.linalg.norm(np.diff(moves.point, axis=0, prepend=moves.point[:1]), axis=1)
    minutes = way / np.where(fed, moves.feed, 1.0)
    turn = np.degrees(np.abs(np.diff(moves.rotary, axis=0, prepend=moves.rotary[:1])))
    share = 0.0
    for column, letter in enumerate(program.rotary_letters):
        rotary = next(axis for axis in machine.rotary if axis.letter == letter)
        step = turn[fed, column]
        if rotary.range_deg is None:
            step = np.minimum(step % 360.0, 360.0 - step % 360.0)
        share = max(share, float((step / rotary.max_speed_deg_min / np.maximum(minutes[fed], 1e-12)).max(initial=0.0)))
    return share


def gap_changes(scene: Scene, sweeps: Sequence[Sweep], texts: Mapping[str, str]) -> dict[str, float]:
    """By style the largest change, mm, of the gap of any sweep by posting, whichever way the axis moves."""
    setup = scene.job.setup
    programs = {style: read_program(text) for style, text in texts.items()}
    tools = {tool.name: tool for tool in scene.tools}
    changes = dict.fromkeys(texts, 0.0)
    for number, sweep in enumerate(sweeps):
        tool = tools[sweep.tool]
        points = sample_face(scene.faces[sweep.face], POINTS).points
        exact = nearest(points, motion_cells(sweep.motion, tool), cutting_body(tool), NEAR)
        # Beyond what is near nothing is looked for in the text either.
        near = exact.move >= 0
        points, distance = np.ascontiguousarray(points[near]), exact.distance[near]
        for style, program in programs.items():
            frame = program.header.frame or ReadFrame(setup.rotate_deg, setup.translate)
            poses = poses_on_part(program.moves, program.letters, frame, np.zeros(len(program.moves.block)))
            chosen = np.flatnonzero(program.moves.cut == number)
            for mode in (Interpolation.VECTOR, Interpolation.AXIS):
                posted = nearest(points, build_cells(poses, chosen, mode), cutting_body(tool), NEAR)
                both = posted.move >= 0
                change = float(np.abs(posted.distance - distance)[both].max(initial=0.0))
                changes[style] = max(changes[style], change)
    return changes


def every_style(scene: Scene, path: ToolPath, machine: Machine) -> dict[str, str]:
    """The program of a tool path in every style of every format."""
    program = scene.job.program
    return {
        f"{kind} {style}": post_named(kind)
        .write(path, machine, ProgramOptions("0", style=style, tolerance_mm=program.cycle32.t))[0]
        .text
        for kind, style in STYLES
    }


def measure_blocks() -> tuple[list[Verdict], dict[str, Any]]:
    machine = load_machine("ac-table")
    printed = table(
        "Blocks, rotary motion, gap (um by style)", "plan", "sweeps", "blocks", "uniform", "ratio", "step ratio",
        "rotary %", *(f"{kind} {style}" for kind, style in STYLES),
    )  # fmt: skip
    figures: dict[str, Any] = {}
    blocks_in_all = uniform_in_all = 0
    worst_gap = worst_load = worst_step = 0.0
    for name, scene, sweeps in plans():
        texts = every_style(scene, plan_to_toolpath(scene, sweeps, machine), machine)
        text = texts["h tcpm"]
        tools = {tool.name: tool for tool in scene.tools}
        rides = [Ride(sweep.motion, tools[sweep.tool], Frame.of(scene.job.setup)) for sweep in sweeps]
        labels = [f"sweep {number}" for number in range(1, len(rides) + 1)]
        # As they are by themselves: links only decide which solution they get.
        nothing = np.zeros((0, 3))
        times = space_blocks(rides, machine, labels, [(nothing, nothing)] * len(rides))
        blocks, uniform = [len(t) - 1 for t in times], [uniform_blocks(ride, machine) for ride in rides]
        steps = [_step_ratio(ride, t) for ride, t in zip(rides, times, strict=True)]
        load = rotary_load(machine, text)
        changes = {style: 1000.0 * change for style, change in gap_changes(scene, sweeps, texts).items()}
        gap = max(changes.values())
        figures[name] = {"blocks": blocks, "uniform": uniform, "rotary_share": load, "gap_um": changes}
        blocks_in_all, uniform_in_all = blocks_in_all + sum(blocks), uniform_in_all + sum(uniform)
        worst_gap, worst_load, worst_step = max(worst_gap, gap), max(worst_load, load), max(worst_step, *steps)
        printed.add_row(
            name, str(len(sweeps)), str(sum(blocks)), str(sum(uniform)), f"{sum(blocks) / sum(uniform):.2f}",
            f"{max(steps):.2f}", f"{100.0 * load:.1f}", *(f"{changes[style]:.3f}" for style in texts),
        )  # fmt: skip
    CONSOLE.print(printed)
    CONSOLE.print(
        "step ratio: of the lengths of two blocks next to each other, at most; rotary: share of an axis' speed that a"
        " block asks for at its feed, at most; gap: change by posting at any point within 0.5 mm, both interpolations"
    )
    return [
        Verdict(
            "change of the swept gap by posting, every style",
            f"<= {GAP_UM} um",
            f"{worst_gap:.3f} um",
            bool(worst_gap <= GAP_UM),
        ),
        Verdict("rotary speed asked for", "<= 100 %", f"{100.0 * worst_load:.1f} %", bool(worst_load <= 1.0)),
        Verdict("blocks, and for uniform spacing", "", f"{blocks_in_all} and {uniform_in_all}", True),
        Verdict("lengths of neighbouring blocks", "", f"ratio {worst_step:.2f} at most", True),
    ], figures


def _step_ratio(ride: Ride, times: Array) -> float:
    tip, axis = ride.poses(times)
    length = np.linalg.norm(np.diff(tip + 0.5 * ride.reach * axis, axis=0), axis=1)
    ratio = length[1:] / length[:-1]
    return float(np.maximum(ratio, 1.0 / ratio).max(initial=1.0))


# --- machines -------------------------------------------------------------------------------------------------------


def measure_machines() -> tuple[list[Verdict], dict[str, Any]]:
    name, scene, sweeps = plans()[0]
    printed = table(
        f"The plan of {name} on each machine",
        "machine",
        "visits",
        "blocks",
        "rotary %",
        "room mm",
        "time s",
        "explanation",
    )
    verdicts: list[Verdict] = []
    figures: dict[str, Any] = {}
    for machine_name in ready_machines():
        machine, moved = load_machine(machine_name), on_machine(scene, sweeps, machine_name)
        try:
            path = plan_to_toolpath(moved, sweeps, machine)
            summary = summarize(moved.job, path)
        except (ConflankError, PostError) as error:
            printed.add_row(machine_name, "-", "-", "-", "-", "-", f"{error.where}: {error.found}")
            figures[machine_name] = str(error)
            continue
        load, beyond = 0.0, 0.0
        visits = visits_with_words(machine, path)
        for visit in visits:
            axes = axis_positions(machine, mounting_of(moved.job), visit.tool, visit.tip, visit.words)
            seconds = nominal_seconds(machine, visit, axes)
            moving = seconds > 0.0
            turn = np.abs(np.diff(axes[:, 3:], axis=0))[moving] / machine.limits.speed[3:]
            load = max(load, float((turn / seconds[moving, None]).max(initial=0.0)))
            for column, rotary in enumerate(machine.rotary):
                if rotary.range_deg is not None:
                    out = np.maximum(
                        visit.words[:, column] - rotary.range_deg[1], rotary.range_deg[0] - visit.words[:, column]
                    )
                    beyond = max(beyond, float(out.max()))
        blocks = sum(cut.blocks for cut in summary.cuts)
        figures[machine_name] = {"blocks": blocks, "rotary_share": load, "seconds": summary.seconds}
        printed.add_row(
            machine_name, str(len(visits)), str(blocks), f"{100.0 * load:.1f}", f"{summary.travel.margin:.0f}",
            f"{summary.seconds:.1f}", "",
        )  # fmt: skip
        # Words are printed with four decimals; a speed to the last digit of a word is that speed.
        verdicts.append(
            Verdict(f"{machine_name}: rotary speed", "<= 100 %", f"{100.0 * load:.2f} %", bool(load <= 1.0 + 1e-9))
        )
        verdicts.append(
            Verdict(f"{machine_name}: words beyond range", "none", f"{max(beyond, 0.0):.1e}", bool(beyond <= 1e-7))
        )
    CONSOLE.print(printed)
    return verdicts, figures


# --- time -----------------------------------------------------------------------------------------------------------


def measure_time() -> tuple[list[Verdict], dict[str, Any]]:
    printed = table("Predicted time, s", "plan", "visits", "at feed", "predicted", "simulated", "off %")
    figures: dict[str, Any] = {}
    worst = 0.0
    for name, scene, sweeps in plans():
        machine = load_machine("ac-table")
        path = plan_to_toolpath(scene, sweeps, machine)
        at_feed = predicted = simulated = 0.0
        visits = visits_with_words(machine, path)
        for visit in visits:
            axes = axis_positions(machine, mounting_of(scene.job), visit.tool, visit.tip, visit.words)
            nominal = nominal_seconds(machine, visit, axes)
            moving = nominal > 0.0
            kept_axes = axes[np.concatenate([[True], moving])]
            one, other = profile(axes, nominal, machine.limits).total, drive(kept_axes, nominal[moving], machine.limits)
            at_feed, predicted, simulated = at_feed + nominal.sum(), predicted + one, simulated + other.seconds
            worst = max(worst, abs(one / other.seconds - 1.0))
        figures[name] = {"predicted_s": predicted, "simulated_s": simulated}
        printed.add_row(
            name, str(len(visits)), f"{at_feed:.2f}", f"{predicted:.2f}", f"{simulated:.2f}",
            f"{100.0 * (predicted / simulated - 1.0):+.2f}",
        )  # fmt: skip
    CONSOLE.print(printed)
    found = f"{100.0 * worst:.2f} %"
    return [
        Verdict(
            "predicted time of a cut beside steps of 0.1 ms",
            f"<= {100.0 * TIME_SHARE} %",
            found,
            bool(worst <= TIME_SHARE),
        )
    ], figures


MEASUREMENTS: dict[str, Part] = {
    "roundtrip": measure_round_trip,
    "blocks": measure_blocks,
    "machines": measure_machines,
    "time": measure_time,
}
CONSOLE = table_console()
GIVEN: list[str] = []


def main() -> None:
    """Print the tables; exit code 1 where a figure is missed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", choices=MEASUREMENTS)
    parser.add_argument("--plan", nargs="+", metavar="FILE", default=[], help="plans that were made before")
    parser.add_argument("--json", dest="as_json", metavar="FILE")
    arguments = parser.parse_args()
    GIVEN.extend(arguments.plan)
    if not PARTS.is_dir():
        CONSOLE.print(f"no folder {PARTS.parent.name}/{PARTS.name} beside the repository: real blades left out")
    verdicts, figures = measured(CONSOLE, "Posting", MEASUREMENTS, arguments.only)
    if arguments.as_json:
        document = {"figures": figures, "verdicts": kept(verdicts)}
        Path(arguments.as_json).write_text(json.dumps(document, indent=1) + "\n", "utf-8")
    sys.exit(0 if all(verdict.reached for verdict in verdicts) else 1)


if __name__ == "__main__":
    main()
