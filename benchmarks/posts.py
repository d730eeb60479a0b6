"""What posts may change: poses through text and back, the swept gap, time, and what another interpreter reads.

Run with ``python -m benchmarks.posts``, one part of it with ``--only poses``, ``time``, ``gap`` or ``rs274``. The gap
needs a plan of a sample part (``--plan``); without one, that of one flank of the blisk blade is made first. The part
``rs274`` needs LinuxCNC's stand-alone interpreter on the path, or named by ``--rs274``; it is left out without.
"""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import click
import msgspec
import numpy as np
import numpy.typing as npt
from rich.console import Console

from benchmarks.certificate import motion_cells
from benchmarks.run import REPOSITORY, SEED
from benchmarks.verdicts import Part, Verdict, kept, measured, table, table_console
from conflank_cli.artifacts import read_artifact
from conflank_cli.cad.scene import load_scene
from conflank_cli.detection import detect
from conflank_cli.job import load_job
from conflank_cli.optimization import optimize
from conflank_cli.posting import post_program
from conflank_cli.progress import SilentProgress
from conflank_cli.scene import Scene
from conflank_cli.selection import select
from conflank_cli.sweep import Sweep
from conflank_cli.verification.gap import cutting_body, nearest
from conflank_cli.verification.kinematics import CAD_FRAME
from conflank_cli.verification.poses import Poses, build_cells, poses_on_part
from conflank_cli.verification.program import Interpolation
from conflank_cli.verification.reader import read_program
from conflank_cli.verification.sampling import sample_face
from conflank_cli.verification.swept import REACH
from postprocessors.errors import PostError
from postprocessors.heidenhain.rides import Ride, rides_of
from postprocessors.kinematics.two_rotary import within_range
from postprocessors.machines.machine import Machine, load_machine, shipped_machines
from postprocessors.post import ProgramOptions, post_named
from postprocessors.toolpath import Cutter, Operation, Purpose, Stretch, ToolPath

Array = npt.NDArray[np.float64]

STYLES = (("h", "tcpm"), ("h", "m128"), ("h", "ln"), ("i", "m128"), ("apt", "multax"))
POSES = 100_000
REACH_MM = 50.0
"""Height above the tip where the far end of a long flute is."""
TIP_UM, FAR_UM, GAP_UM = 0.1, 0.2, 0.5
WRITE_S, READ_S = 2.0, 4.0
GAP_POINTS = 20_000
JOB = REPOSITORY / "sample_parts" / "blisk_blade" / "pressure.toml"
CUTTER = Cutter(1, "T1", 1.5, 3.0, 24.0, 3000.0)
_CANON = re.compile(
    r"(STRAIGHT_TRAVERSE|STRAIGHT_FEED|SET_FEED_RATE)\(([^)]*)\)",
)


def machines() -> dict[str, Machine]:
    """The shipped machines that are filled in, and the first of them with other pairs of rotary axes."""
    found: dict[str, Machine] = {}
    for name in shipped_machines():
        # A template says itself what has to be filled in.
        with suppress(PostError):
            found[name] = load_machine(name)
    shipped = found["ac-table"]
    first = shipped.rotary[0]
    wide = (-170.0, 170.0)

    def with_axes(name: str, *axes: tuple[str, tuple[float, float, float], int, str]) -> Machine:
        made = [
            msgspec.structs.replace(
                first, letter=letter, vector=vector, sign=sign, carried_by=carried, range_deg=None, output=output
            )
            for (letter, vector, sign, carried), output in zip(axes, ("modulo", "continuous"), strict=True)
        ]
        made[1] = msgspec.structs.replace(made[1], range_deg=wide)
        return msgspec.structs.replace(shipped, name=name, rotary=(made[0], made[1]))

    x, y, z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
    return found | {
        "B/C table": with_axes("bc", ("C", z, 1, "table"), ("B", y, 1, "table")),
        "A table, B head": with_axes("ab", ("A", x, 1, "table"), ("B", y, 1, "head")),
        "C table, nutating B head": with_axes("nutating", ("C", z, 1, "table"), ("B", (0.0, 1.0, 1.0), 1, "head")),
        "any two, turning backwards": with_axes(
            "any", ("C", (0.1, -0.05, 1.0), -1, "table"), ("A", (1.0, 0.2, -0.3), -1, "head")
        ),
    }


def random_path(machine: Machine, count: int, rng: np.random.Generator) -> ToolPath:
    """Tips anywhere within 400 mm, axes on a random smooth way through all that the machine reaches.

    The axes must follow each other: the posts refuse steps over which the rotary axes would whip around.
    """
    t = np.linspace(0.0, count / 1000.0, 4 * count)
    rates, phases = rng.uniform(0.05, 0.35, (2, 12)), rng.uniform(0.0, 2.0 * np.pi, (2, 12))
    waves = np.sin(rates[:, :, None] * t + phases[:, :, None]).sum(axis=1) / np.sqrt(6.0)
    tilt = np.radians(4.0 + 80.0 / (1.0 + np.exp(-2.0 * waves[0])))
    turn = 2.0 * np.pi * waves[1]
    axis = np.stack([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)], axis=1)
    inside = within_range(machine, axis)
    runs = np.split(np.flatnonzero(inside), np.flatnonzero(np.diff(np.flatnonzero(inside)) > 1) + 1)
    stretches: list[Stretch] = []
    left = count
    for run in runs:
        chosen = run[:left]
        if len(chosen) > 1:
            tip = rng.uniform(-400.0, 400.0, (len(chosen), 3))
            number = len(stretches) // 2 + 1
            feed = np.full(len(chosen), 900.0)
            stretches.append(Stretch(Purpose.SWEEP, number, tip, axis[chosen], feed))
            # It closes the sweep, and adds no pose.
            stretches.append(Stretch(Purpose.RETRACT, number, tip[-1:], axis[chosen[-1:]], feed[-1:]))
            left -= len(chosen)
    operation = Operation(CUTTER, tuple(stretches))
    return ToolPath("POSES", "part", (0,), "CAD", (-400.0,) * 3, (400.0,) * 3, (operation,))


def poses_of(text: str) -> Poses:
    """A program's poses in its own frame, by verification's reader and kinematics."""
    read = read_program(text)
    if read.findings:
        raise AssertionError(read.findings[0].text)
    return poses_on_part(read.moves, read.letters, CAD_FRAME, np.zeros(len(read.moves.block)))


def round_trip(path: ToolPath, poses: Poses) -> tuple[int, float, float]:
    """How many poses came back, and by how much they are off at the tip and at the far end, µm."""
    sweeps = [
        stretch for operation in path.operations for stretch in operation.stretches if stretch.purpose is Purpose.SWEEP
    ]
    tip = np.concatenate([stretch.tip for stretch in sweeps])
    axis = np.concatenate([stretch.axis for stretch in sweeps])
    chosen = poses.moves.cut >= 0
    off = poses.tip[chosen] - tip
    far = off + REACH_MM * (poses.axis[chosen] - axis)
    worst_tip, worst_far = (1e3 * float(np.linalg.norm(each, axis=1).max()) for each in (off, far))
    return len(tip), worst_tip, worst_far


def write(path: ToolPath, machine: Machine, kind: str, style: str) -> str:
    """The text of a program."""
    return post_named(kind).write(path, machine, ProgramOptions("0", style=style))[0].text


def poses(console: Console, count: int) -> tuple[list[Verdict], dict[str, Any]]:
    """Pose to text to pose, for every style and kind of machine."""
    rng = np.random.default_rng(SEED)
    shown = table(
        "poses through text and back", "machine", "format", "style", "poses", "tip µm", f"at {REACH_MM:g} mm µm"
    )
    rows: list[dict[str, Any]] = []
    worst = (0.0, 0.0)
    for name, machine in machines().items():
        path = random_path(machine, count, rng)
        for kind, style in STYLES:
            found, tip, far = round_trip(path, poses_of(write(path, machine, kind, style)))
            shown.add_row(name, kind, style, f"{found:,}", f"{tip:.4f}", f"{far:.4f}")
            rows.append({"machine": name, "format": kind, "style": style, "poses": found, "tip_um": tip, "far_um": far})
            worst = max(worst[0], tip), max(worst[1], far)
    console.print(shown)
    least = min(int(row["poses"]) for row in rows)
    return [
        Verdict("poses through text and back, each style and machine", f"{POSES:,}", f"{least:,}", least >= POSES),
        Verdict("off at the tip", f"<= {TIP_UM} µm", f"{worst[0]:.4f} µm", worst[0] <= TIP_UM),
        Verdict("off at the far end of the flute", f"<= {FAR_UM} µm", f"{worst[1]:.4f} µm", worst[1] <= FAR_UM),
    ], {"rows": rows}


def timing(console: Console, count: int) -> tuple[list[Verdict], dict[str, Any]]:
    """Seconds of processor time to write a program and to read it back into poses."""
    machine = load_machine("ac-table")
    path = random_path(machine, count, np.random.default_rng(SEED))
    shown = table("processor time", "format", "style", "poses", "MB", "write s", "read s")
    rows: list[dict[str, Any]] = []
    for kind, style in STYLES:
        written, read, text = [], [], ""
        for _ in range(2):
            start = time.process_time()
            text = write(path, machine, kind, style)
            written.append(time.process_time() - start)
            start = time.process_time()
            poses_of(text)
            read.append(time.process_time() - start)
        row = {"format": kind, "style": style, "write_s": min(written), "read_s": min(read), "bytes": len(text)}
        shown.add_row(kind, style, f"{count:,}", f"{len(text) / 1e6:.1f}", f"{min(written):.2f}", f"{min(read):.2f}")
        rows.append(row)
    console.print(shown)
    slowest = [max(float(row[key]) for row in rows) for key in ("write_s", "read_s")]
    return [
        Verdict(f"{count:,} blocks written", f"<= {WRITE_S} s", f"{slowest[0]:.2f} s", slowest[0] <= WRITE_S),
        Verdict(f"{count:,} blocks read back", f"<= {READ_S} s", f"{slowest[1]:.2f} s", slowest[1] <= READ_S),
    ], {"rows": rows}


# --- gap ------------------------------------------------------------------------------------------------------------


def sample_plan(plan: str | None) -> tuple[Scene, Sequence[Sweep]]:
    """A plan from a file, or made here with a quick search."""
    if plan is not None:
        scene, sweeps, _ = read_artifact(plan, "plan")
        return scene, sweeps
    job = load_job(JOB)
    job = msgspec.structs.replace(job, detection=msgspec.structs.replace(job.detection, density="quick"))
    scene = load_scene(job, JOB.parent)
    progress = SilentProgress()
    return scene, select(scene, optimize(scene, detect(scene, progress), progress)[0], progress).plan


def with_style(scene: Scene, kind: str, style: str) -> Scene:
    """The scene with another format in its job."""
    program = msgspec.structs.replace(scene.job.program, format=kind, style=style, split="none", datum=1)
    return replace(scene, job=msgspec.structs.replace(scene.job, program=program))


def changes(scene: Scene, sweeps: Sequence[Sweep], kind: str, style: str) -> tuple[int, float]:
    """Blocks within sweeps, and the most that the swept gap of a sweep changes anywhere on its face, µm."""
    read = read_program(post_program(with_style(scene, kind, style), sweeps)[0])
    frame = read.header.frame or CAD_FRAME
    found = poses_on_part(read.moves, read.letters, frame, np.zeros(len(read.moves.block)))
    tools = {tool.name: tool for tool in scene.tools}
    worst = 0.0
    for index, label in enumerate(read.cuts):
        sweep = sweeps[label.number - 1]
        points = np.ascontiguousarray(sample_face(scene.faces[sweep.face], GAP_POINTS).points)
        body = cutting_body(tools[sweep.tool])
        exact = nearest(points, motion_cells(sweep.motion, tools[sweep.tool]), body, REACH).distance
        chosen = np.flatnonzero(read.moves.cut == index)
        for mode in Interpolation:
            posted = nearest(points, build_cells(found, chosen, mode), body, REACH).distance
            near = np.isfinite(exact) & np.isfinite(posted) & (np.minimum(exact, posted) < REACH - 0.01)
            worst = max(worst, 1e3 * float(np.abs(posted - exact)[near].max(initial=0.0)))
    return int((read.moves.cut >= 0).sum()), worst


def gap(console: Console, plan: str | None) -> tuple[list[Verdict], dict[str, Any]]:
    """What posting changes in the swept gap."""
    scene, sweeps = sample_plan(plan)
    shown = table(f"swept gap of {scene.part_name}, {len(sweeps)} sweeps", "format", "style", "blocks", "change µm")
    rows: list[dict[str, Any]] = []
    for kind, style in STYLES:
        blocks, change = changes(scene, sweeps, kind, style)
        shown.add_row(kind, style, f"{blocks:,}", f"{change:.3f}")
        rows.append({"format": kind, "style": style, "blocks": blocks, "change_um": change})
    console.print(shown)
    worst = max(float(row["change_um"]) for row in rows)
    return [
        Verdict("change of the swept gap by posting, anywhere", f"<= {GAP_UM} µm", f"{worst:.3f} µm", worst <= GAP_UM)
    ], {"rows": rows, "part": scene.part_name, "sweeps": len(sweeps)}


# --- another interpreter --------------------------------------------------------------------------------------------


def rs274_blocks(rides: Sequence[Ride]) -> Iterator[str]:
    """The rides in plain RS-274: rotary words, and inverse time for the feed (one over the minutes of a block)."""
    yield "G21 G90 G93"
    for ride in rides:
        letters = ("X", "Y", "Z", *ride.letters)
        before: Array | None = None
        for tip, turn, feed in zip(ride.tip, ride.turns, ride.feed, strict=True):
            pose = np.concatenate([tip, turn])
            if before is not None and (pose == before).all():
                continue
            words = " ".join(f"{letter}{value:.4f}" for letter, value in zip(letters, pose, strict=True))
            length = 0.0 if before is None else float(np.linalg.norm(tip - before[:3]))
            before = pose
            yield f"G0 {words}" if feed == 0 or length == 0.0 else f"G1 {words} F{feed / length:.9f}"
    yield "M2"


@dataclass(frozen=True, slots=True)
class Canonical:
    """What an interpreter makes of a program: positions X Y Z A B C, and the feed into each (0: rapid), mm/min."""

    position: Array
    feed: Array


def interpreted(program: str, rs274: str) -> Canonical:
    """The canonical moves that LinuxCNC's interpreter sends for a program."""
    with tempfile.TemporaryDirectory() as folder:
        file, tools, variables = (Path(folder) / name for name in ("program.ngc", "tool.tbl", "rs274.var"))
        file.write_text(program, "ascii")
        tools.touch()
        variables.write_text("5161 0\n")
        command = [rs274, "-t", str(tools), "-v", str(variables), "-g", str(file)]
        done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=folder)
    rows: list[list[float]] = []
    feeds: list[float] = []
    rate = 0.0
    for name, arguments in _CANON.findall(done.stdout):
        values = [float(value) for value in arguments.split(",")]
        if name == "SET_FEED_RATE":
            rate = values[0]
            continue
        rows.append(values)
        feeds.append(0.0 if name == "STRAIGHT_TRAVERSE" else rate)
    return Canonical(np.array(rows), np.array(feeds))


def rs274(console: Console, command: str | None, count: int) -> tuple[list[Verdict], dict[str, Any]]:
    """The canonical moves of LinuxCNC's interpreter against the poses of our reader, for the same rides."""
    command = command or shutil.which("rs274")
    if command is None:
        console.print("rs274: LinuxCNC's stand-alone interpreter is not here (--rs274 FILE)")
        return [], {}
    machine = load_machine("ac-table")
    path = random_path(machine, count, np.random.default_rng(SEED))
    rides = [ride for operation in rides_of(path, machine, ProgramOptions("0")) for ride in operation]
    canonical = interpreted("\n".join(rs274_blocks(rides)) + "\n", command)
    ours = read_program(write(path, machine, "i", "m128")).moves
    chosen = ours.cut >= 0
    turn = np.degrees(ours.rotary[chosen]) - canonical.position[:, [3, 5]]
    off = float(np.abs(ours.point[chosen] - canonical.position[:, :3]).max())
    turned = float(np.abs(turn - 360.0 * np.round(turn / 360.0)).max())
    cutting = canonical.feed > 0.0
    # Our own feeds of these moves; the first pose of a ride is reached at rapid in both.
    feed = float(np.abs(canonical.feed[cutting] / ours.feed[chosen][cutting] - 1.0).max())
    console.print(f"rs274: {len(canonical.feed):,} canonical moves")
    return [
        Verdict(
            "canonical moves of rs274 against ours", f"{count:,}", f"{len(cutting):,}", bool(len(cutting) == count)
        ),
        Verdict("rs274: tip", "<= 0.1 µm", f"{1e3 * off:.4f} µm", off <= 1e-4),
        Verdict("rs274: rotary words", "<= 0.0001 deg", f"{turned:.6f} deg", turned <= 1e-4),
        Verdict("rs274: feed", "<= 0.1 %", f"{100.0 * feed:.5f} %", feed <= 1e-3),
    ], {"moves": len(cutting), "tip_um": 1e3 * off, "turn_deg": turned, "feed_share": feed}


@click.command(help=__doc__)
@click.option("--only", type=click.Choice(["poses", "time", "gap", "rs274"]), help="One part of it.")
@click.option("--count", default=POSES, show_default=True, help="Poses of each program.")
@click.option("--plan", metavar="FILE", help="Plan of a sample part, for the gap.")
@click.option("--rs274", "command", metavar="FILE", help="LinuxCNC's stand-alone interpreter.")
@click.option("--json", "as_json", metavar="FILE", help="Keep the figures in FILE, beside those of other parts.")
def main(only: str | None, count: int, plan: str | None, command: str | None, as_json: str | None) -> None:
    """Print what posts must reach; exit code 1 where a figure is missed."""
    console = table_console()
    parts: dict[str, Part] = {
        "poses": lambda: poses(console, count),
        "time": lambda: timing(console, count),
        "gap": lambda: gap(console, plan),
        "rs274": lambda: rs274(console, command, count),
    }
    verdicts, figures = measured(console, "Posts", parts, only)
    if as_json is not None:
        file = Path(as_json)
        before = json.loads(file.read_bytes()) if file.exists() else {}
        figures["verdicts"] = before.get("verdicts", {}) | kept(verdicts)
        file.write_text(json.dumps(before | figures, indent=1) + "\n", encoding="utf-8")
    raise SystemExit(0 if all(verdict.reached for verdict in verdicts) else 1)


if __name__ == "__main__":
    main()
