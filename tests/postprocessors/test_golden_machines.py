"""One small program for each style on each shipped machine, reviewed by hand.

A golden program is compared as text, and what it says is taken apart a second time: the axes that its words or vectors
stand for, by SciPy's rotations about axes that are written down here, and its poses by the reader of verification.
After a change on purpose, write them anew with CONFLANK_SNAPSHOTS=write, and review them again.
"""

import os
import re
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from conflank_cli.verification.kinematics import CAD_FRAME
from conflank_cli.verification.poses import poses_on_part
from conflank_cli.verification.reader import read_program
from postprocessors.errors import PostError
from postprocessors.machines import machine as machines
from postprocessors.machines.machine import Machine, load_machine, parse_machine, shipped_machines
from postprocessors.post import ProgramOptions, post_named
from postprocessors.toolpath import Cutter, Operation, Purpose, Stretch, ToolPath

GOLDEN = Path(__file__).parent / "golden" / "machines"
T1 = Cutter(1, "T1", 1.5, 3.0, 24.0, 3000.0)
STYLES = (("h", "tcpm"), ("h", "m128"), ("h", "ln"), ("i", "m128"), ("apt", "multax"))

# Letter, direction and sign of both axes in the order of t = R(first) R(second) z, written down independently.
AXES = {
    "ac-table": (("C", (0, 0, 1), 1), ("A", (1, 0, 0), 1)),
    "bc-table": (("C", (0, 0, 1), 1), ("B", (0, 1, 0), 1)),
    "head-table": (("C", (0, 0, 1), 1), ("B", (0, 1, 0), 1)),
    "head-head": (("C", (0, 0, 1), 1), ("A", (1, 0, 0), 1)),
    "nutating-head": (("C", (0, 0, 1), 1), ("B", (0, 1, 1), 1)),
    # Not of the real machine: any values do that differ from the examples. Here A turns the other way.
    "kondia_hs1000": (("C", (0, 0, 1), 1), ("A", (1, 0, 0), -1)),
}
FILLED = {
    "max_feed_mm_min": ["10000.0"],
    "block_time_ms": ["4.0"],
    "travel_mm": ["[-500.0, 500.0]", "[-400.0, 400.0]", "[-500.0, 0.0]"],
    "max_speed_mm_min": ["20000.0"] * 3,
    "max_acceleration_mm_s2": ["3000.0"] * 3,
    "max_jerk_mm_s3": ["30000.0"] * 3,
    "letter": ['"C"', '"A"'],
    "vector": ["[0.0, 0.0, 1.0]", "[1.0, 0.0, 0.0]"],
    "carried_by": ['"table"', '"table"'],
    "sign": ["1", "-1"],
    "pivot_mm": ["[0.0, 0.0, 0.0]"] * 2,
    "range_deg": ["[-3600.0, 3600.0]", "[-10.0, 110.0]"],
    "max_speed_deg_min": ["9000.0"] * 2,
    "max_acceleration_deg_s2": ["500.0"] * 2,
    "max_jerk_deg_s3": ["5000.0"] * 2,
    "output": ['"continuous"'] * 2,
}


def machine_named(name: str) -> Machine:
    """A shipped machine; the template with its blanks filled in."""
    if name != "kondia_hs1000":
        return load_machine(name)
    text = (Path(machines.__file__).parent / f"{name}.toml").read_text("utf-8")
    values = {key: iter(found) for key, found in FILLED.items()}
    text = re.sub(r'^(\w+) = "\?"', lambda match: f"{match[1]} = {next(values[match[1]])}", text, flags=re.MULTILINE)
    return parse_machine(text, f"{name}.toml")


HEADS = ("head-table", "head-head", "nutating-head")


def small_path(with_pass: bool, with_head: bool) -> ToolPath:
    """A sweep of three poses that swings and, linked to it, a pass of two; at least 20 degrees off upright.

    `with_head`: at the end the spindle comes upright; all these machines then have their C along Z.
    """

    def axes(*angles: tuple[float, float]) -> np.ndarray:
        tilt, azimuth = np.radians(np.array(angles)).T
        return np.stack([np.sin(tilt) * np.cos(azimuth), np.sin(tilt) * np.sin(azimuth), np.cos(tilt)], axis=1)

    def ways(number: int, purpose: Purpose, tip: np.ndarray, axis: np.ndarray, low: bool, high: bool) -> list[Stretch]:
        start, end = tip[0] + [-3.0, -3.0, 0.0], tip[-1] + [3.0, -3.0, 0.0]
        inward = np.array([start, tip[0]] if low else [start + 40.0 * axis[0], start, tip[0]])
        outward = np.array([tip[-1], end] if high else [tip[-1], end, end + 40.0 * axis[-1]])
        feeds = np.array([800.0, 800.0] if low else [0.0, 0.0, 800.0]), np.full(len(tip), 800.0)
        away = np.array([640.0, 640.0] if high else [640.0, 640.0, 0.0])
        return [
            Stretch(Purpose.APPROACH, number, inward, np.repeat(axis[:1], len(inward), axis=0), feeds[0]),
            Stretch(purpose, number, tip, axis, feeds[1]),
            Stretch(Purpose.RETRACT, number, outward, np.repeat(axis[-1:], len(outward), axis=0), away),
        ]

    sweep = np.array([[0.0, 0.0, -5.0], [2.0, 0.1, -5.0], [4.0, 0.3, -5.0]]), axes((20, -90), (20.5, -88), (21, -86))
    ball = np.array([[4.0, 1.0, -6.0], [0.0, 0.9, -6.0]]), axes((21, -86), (21, -86))
    stretches = ways(1, Purpose.SWEEP, *sweep, low=False, high=with_pass)
    if with_pass:
        after = ways(2, Purpose.PASS, *ball, low=True, high=False)
        tip = np.vstack([stretches[-1].tip[-1:], after[0].tip[:1]])
        stretches += [Stretch(Purpose.LINK, 2, tip, np.repeat(ball[1][:1], 2, axis=0), np.zeros(2)), *after]
    if with_head:
        top = stretches[-1].tip[-1:]
        stretches.append(Stretch(Purpose.UPRIGHT, 1, top, np.array([[0.0, 0.0, 1.0]]), np.zeros(1)))
    return ToolPath(
        "GOLDEN", "tiny", (0,), "CAD", (-5.0, -5.0, -10.0), (10.0, 5.0, 0.0), (Operation(T1, tuple(stretches)),)
    )


def golden_axis(block: str, name: str) -> np.ndarray | None:
    """The tool axis that a block states, taken apart by hand; None in a block that states none."""
    if found := re.search(r"GOTO/[^,]+,[^,]+,[^,]+,(\S+)", block):
        return np.array([float(word) for word in found[1].split(",")])
    if "TX" in block:
        return np.array([float(word) for word in re.findall(r"T[XYZ]([+-][\d.]+)", block)])
    if not re.search(r" X[+-].*[ABC][+-]", block):
        return None
    turned = Rotation.identity()
    for letter, direction, sign in AXES[name]:
        word = re.search(rf" {letter}([+-][\d.]+)", block)
        assert word, block
        vector = np.array(direction) / np.linalg.norm(direction)
        turned = turned * Rotation.from_rotvec(sign * np.radians(float(word[1])) * vector)
    return np.asarray(turned.apply([0.0, 0.0, 1.0]))


def test_every_shipped_machine_has_golden_programs() -> None:
    assert set(AXES) == set(shipped_machines())


@pytest.mark.parametrize("name", AXES)
@pytest.mark.parametrize(("kind", "style"), STYLES)
def test_golden_program_of_the_machine(name: str, kind: str, style: str) -> None:
    path = small_path(with_pass=name == "ac-table", with_head=name in HEADS)
    post = post_named(kind)
    text = post.write(path, machine_named(name), ProgramOptions("0.1.0", style=style))[0].text
    golden = GOLDEN / f"{name}.{style}{post.suffix}"
    if os.environ.get("CONFLANK_SNAPSHOTS") == "write":
        golden.parent.mkdir(exist_ok=True)
        golden.write_bytes(text.replace("\r\n", "\n").encode("ascii"))
    assert text == golden.read_text("ascii").replace("\n", "\r\n")
    assert text.count("\r\n") <= 56

    # All poses in order; one that repeats the last is written once.
    wanted = np.hstack(
        [np.vstack([getattr(s, part) for s in path.operations[0].stretches]) for part in ("tip", "axis")]
    )
    wanted = wanted[np.concatenate([[True], np.abs(np.diff(wanted, axis=0)).max(axis=1) > 0.0])]
    axes = [
        axis
        for axis in (golden_axis(block, name) for block in text.replace(",$\r\n", ",").splitlines())
        if axis is not None
    ]
    # Half of the last digit of two words in degrees: 1.3e-6.
    np.testing.assert_allclose(axes, wanted[:, 3:], atol=1.3e-6)

    read = read_program(text)
    assert not read.findings
    poses = poses_on_part(read.moves, read.letters, CAD_FRAME, np.zeros(len(read.moves.block)))
    # The retract to the limit of the machine is no pose of the path.
    known = np.array([np.abs(wanted[:, :3] - tip).max(axis=1).min() < 1e-4 for tip in poses.tip])
    np.testing.assert_allclose(poses.tip[known], wanted[:, :3], atol=0.5001e-4)
    np.testing.assert_allclose(poses.axis[known], wanted[:, 3:], atol=1.3e-6)
    labels = [(cut.kind, cut.number) for cut in read.cuts]
    assert labels == [("sweep", 1), ("pass", 2)][: len(labels)] and len(labels) == (2 if name == "ac-table" else 1)


def test_an_upright_pose_for_another_machine_is_refused() -> None:
    """A path whose spindle stands upright along Z, on a machine whose table would have to be at 0 for that."""
    path = small_path(with_pass=False, with_head=True)
    with pytest.raises(PostError, match="one pose with the head axes of ac-table at 0"):
        post_named("h").write(path, load_machine("ac-table"), ProgramOptions("0.1.0"))
