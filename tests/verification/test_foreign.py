"""Programs as other CAM systems and people at machines write them, against poses computed by hand.

The texts are our own, in the manner of public posts. What is expected is computed here from the definitions of the
control's words with NumPy alone; where the control's own answer depends on its machine parameters, a finding is right.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pytest

from conflank_cli.verification.kinematics import CAD_FRAME
from conflank_cli.verification.poses import poses_on_part
from conflank_cli.verification.program import RETRACT_CHECKED, Program
from conflank_cli.verification.reader import read_program

Array = npt.NDArray[np.float64]

UP = (0.0, 0.0, 1.0)
TIP = 1e-3
"""What poses may be off, mm."""
CHORD = 1.05e-4
"""How far the middle of a straight piece may be off an arc, mm."""
NOT_READ = {"CF101", "CF102", "CF105", "CF106", "CF108", "CF109", "CF112", "CF113"}
"""Codes that say that a block was not followed, or wrongly written."""


def x_turn(degrees: float) -> Array:
    """Turn about x."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[1, 0, 0], [0, c, -s], [0, s, c]])


def y_turn(degrees: float) -> Array:
    """Turn about y."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def z_turn(degrees: float) -> Array:
    """Turn about z."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


def ac(a: float, c: float) -> Array:
    """Tool axis of an A/C table, degrees."""
    return z_turn(c) @ x_turn(a) @ UP


def bc(b: float, c: float) -> Array:
    """Tool axis of a B/C table, degrees."""
    return z_turn(c) @ y_turn(b) @ UP


@dataclass(frozen=True)
class Pose:
    """A pose to be reached, from the one before straight or, with a centre, on an arc or helix about it.

    turn: angle of the arc in degrees, counterclockwise seen along -normal; rise: along the normal on the way.
    """

    tip: Array
    axis: Array
    centre: Array | None = None
    turn: float = 0.0
    rise: float = 0.0
    normal: Array | None = None


def at(x: float, y: float, z: float, axis: Sequence[float] | Array = UP) -> Pose:
    """A pose reached straight."""
    return Pose(np.array([x, y, z]), np.asarray(axis, dtype=np.float64))


def around(centre: Sequence[float], turn: float, before: Pose, rise: float = 0.0, normal: Array | None = None) -> Pose:
    """The pose at the end of an arc of `turn` degrees about a centre that begins at a pose."""
    along = np.array(UP) if normal is None else normal
    middle = np.array(centre, dtype=np.float64)
    return Pose(_turned(before.tip, middle, along, turn) + rise * along, before.axis, middle, turn, rise, along)


def _turned(point: Array, centre: Array, normal: Array, degrees: float) -> Array:
    """Rodrigues' formula."""
    arm, angle = point - centre, np.radians(degrees)
    turned = arm * np.cos(angle) + np.cross(normal, arm) * np.sin(angle) + normal * (normal @ arm) * (1 - np.cos(angle))
    return np.asarray(centre + turned)


def moved(poses: Sequence[Pose], turn: Array, shift: Sequence[float] = (0, 0, 0)) -> list[Pose]:
    """The same in another frame: point = shift + turn p."""
    return [
        Pose(
            turn @ pose.tip + shift,
            turn @ pose.axis,
            None if pose.centre is None else turn @ pose.centre + shift,
            pose.turn,
            pose.rise,
            None if pose.normal is None else turn @ pose.normal,
        )
        for pose in poses
    ]


def numbered(lines: Sequence[str], name: str = "P1", unit: str = "MM") -> str:
    """A conversational program of blocks; block n is lines[n - 1]."""
    blocks = [f"BEGIN PGM {name} {unit}", *lines, f"END PGM {name} {unit}"]
    return "".join(f"{number} {block}\n" for number, block in enumerate(blocks))


def iso(lines: Sequence[str], name: str = "P1") -> str:
    """A DIN/ISO program of blocks; block n of the list has number 10 n, counted from 1."""
    body = "".join(f"N{10 * number} {block} *\n" for number, block in enumerate(lines, start=1))
    return f"%{name} G71 *\n{body}N99999999 %{name} G71 *\n"


def read(text: str, called: Callable[[str], str | None] | None = None) -> tuple[Program, Array, Array]:
    """A program with its tips and axes in its own frame."""
    program = read_program(text, called)
    poses = poses_on_part(program.moves, program.letters, CAD_FRAME, np.zeros(len(program.moves.block)))
    return program, poses.tip, poses.axis


def not_followed(program: Program) -> list[tuple[str, int | None, str]]:
    """Findings that name what was not followed."""
    return [(finding.code, finding.block, finding.text) for finding in program.findings if finding.code in NOT_READ]


def _off_arc(point: Array, start: Pose, end: Pose) -> float:
    """Distance of a point from the arc or helix between two poses, mm."""
    assert end.centre is not None and end.normal is not None
    normal, arm, first = end.normal, point - end.centre, start.tip - end.centre
    height, arm, first = (arm - first) @ normal, arm - arm @ normal * normal, first - first @ normal * normal
    angle = float(np.degrees(np.arctan2(np.cross(first, arm) @ normal, first @ arm)))
    # Of all angles that lead here, the one that fits the height, or else the nearest within the turn.
    turns = angle + 360.0 * np.arange(-4, 5)
    share = turns / end.turn
    inside = np.clip(share, 0.0, 1.0)
    along = np.radians(np.abs(share - inside) * abs(end.turn)) * np.linalg.norm(first)
    off = np.hypot(np.abs(height - end.rise * inside), along)
    return float(np.hypot(np.linalg.norm(arm) - np.linalg.norm(first), off.min()))


def _comes_down(high: Array, tip: Array, axis: Array) -> bool:
    """Whether a pose is the beginning of the way down from a retract, whose height the text does not tell."""
    return bool(np.linalg.norm(high - tip - RETRACT_CHECKED * axis) < 1e-6)


def assert_poses(
    text: str, expected: Sequence[Pose], called: Callable[[str], str | None] | None = None, blocks: range | None = None
) -> Program:
    """The program is followed without a finding, through these poses and on nothing but these arcs."""
    program, tip, axis = read(text, called)
    assert not_followed(program) == []
    chosen = [n for n in range(len(tip)) if blocks is None or int(program.moves.block[n]) in blocks]
    chosen = [n for n in chosen if n + 1 == len(tip) or not _comes_down(tip[n], tip[n + 1], axis[n + 1])]
    reached, previous, pieces = 0, -1, 0
    for n in chosen:
        assert reached < len(expected), f"pose {tip[n]} after the last that is expected"
        wanted = expected[reached]
        assert axis[n] == pytest.approx(wanted.axis, abs=1e-6), (int(program.moves.block[n]), wanted)
        if wanted.centre is not None:
            start = expected[reached - 1]
            assert _off_arc(tip[n], start, wanted) <= TIP
            assert _off_arc(0.5 * (tip[previous] + tip[n]), start, wanted) <= CHORD
            pieces += 1
        # A whole circle ends where it begins.
        if np.linalg.norm(tip[n] - wanted.tip) <= TIP and (wanted.centre is None or pieces > abs(wanted.turn) / 20.0):
            reached, pieces = reached + 1, 0
        else:
            assert wanted.centre is not None, (int(program.moves.block[n]), tip[n], wanted)
        previous = n
    assert reached == len(expected)
    return program


def assert_refused(text: str, *blocks: int, codes: set[str] | None = None) -> None:
    """A finding names each of these blocks."""
    program, _, _ = read(text)
    named = {block for code, block, _ in not_followed(program) if codes is None or code in codes}
    assert set(blocks) <= named, not_followed(program)


# --- three axes, conversational ---------------------------------------------------------------------------------------

HEAD = ["BLK FORM 0.1 Z X+0 Y+0 Z-20", "BLK FORM 0.2 X+100 Y+100 Z+0", "TOOL CALL 4 Z S8000 F600", "L M140 MB MAX M3"]
FIRST = len(HEAD) + 1
"""Number of the first block after the head."""
TAIL = ["L M140 MB MAX", "M5", "M30"]


def three(*lines: str, unit: str = "MM") -> str:
    """A program of three axes around these blocks."""
    return numbered([*HEAD, *lines, *TAIL], unit=unit)


def span(*lines: str) -> range:
    """Numbers of these blocks after the head."""
    return range(FIRST, FIRST + len(lines))


def assert_three(lines: Sequence[str], expected: Sequence[Pose], unit: str = "MM") -> Program:
    """The lines of a program of three axes lead through these poses."""
    return assert_poses(three(*lines, unit=unit), expected, blocks=span(*lines))


def test_pocket_with_arcs_about_a_centre_and_by_radius() -> None:
    """In the manner of a post for a general CAM system: comments, structure blocks, CC and C, CR."""
    lines = [
        "* - FINISH CONTOUR",
        "; D6 CR3",
        "L X+10 Y-20 R0 FMAX",
        "L Z+15 R0 FMAX M8",
        "L Z-3 F500",
        "L X+40 F1200",
        "CC X+40 Y-10",
        "C X+50 Y-10 DR+",
        "CR X+40 Y+0 R+10 DR+",
        "CR X+40 Y+20 R-10.5 DR-",
        "L Z+15 FMAX",
        "M9",
    ]
    poses = [at(10, -20, 15), at(10, -20, -3), at(40, -20, -3)]
    poses.append(around((40, -10, -3), 90, poses[-1]))
    poses.append(around((40, -10, -3), 90, poses[-1]))
    # Northward from (40, 0) to (40, 20), clockwise the longer way: the arc bulges west, and its centre lies there.
    aside = np.sqrt(10.5**2 - 10.0**2)
    half = np.degrees(np.arcsin(10.0 / 10.5))
    poses.append(around((40 - aside, 10, -3), -(360 - 2 * half), poses[-1]))
    poses.append(at(40, 20, 15))
    assert_three(lines, poses)


def test_increments() -> None:
    lines = [
        "L X+5 Y+5 Z+10 FMAX",
        "L IZ-12 F300",
        "L IX+20 IY+1",
        "CC IX+0 IY+10",
        "C IX+10 IY+10 DR+",
        "L IZ+12 FMAX",
    ]
    poses = [at(5, 5, 10), at(5, 5, -2), at(25, 6, -2)]
    poses += [around((25, 16, -2), 90, poses[-1])]
    poses += [at(35, 16, 10)]
    assert_three(lines, poses)


def test_full_circle_and_centre_taken_from_the_position() -> None:
    lines = ["L X+30 Y+10 Z+0 FMAX", "CC X+20 Y+10", "C X+30 Y+10 DR- F400", "CC", "L X+35 Y+10", "C X+25 Y+10 DR+"]
    poses = [at(30, 10, 0)]
    poses += [around((20, 10, 0), -360, poses[-1])]
    poses += [at(35, 10, 0)]
    poses += [around((30, 10, 0), 180, poses[-1])]
    assert_three(lines, poses)


def test_polar_lines_arcs_and_a_helix() -> None:
    """A thread as a shop floor program mills it."""
    lines = [
        "CC X+50 Y+50",
        "L Z+5 FMAX",
        "LP PR+20 PA+0 R0 FMAX",
        "L Z-2 F200",
        "LP PA+60 F500",
        "LP IPA+60 IPR+5",
        "CP PA+180 DR+",
        "CP IPA+720 IZ-4 DR+",
        "L Z+5 FMAX",
    ]

    def polar(radius: float, angle: float, z: float) -> Pose:
        turn = np.radians(angle)
        return at(50 + radius * np.cos(turn), 50 + radius * np.sin(turn), z)

    poses = [polar(20, 0, 5), polar(20, 0, -2), polar(20, 60, -2), polar(25, 120, -2)]
    poses += [around((50, 50, -2), 60, poses[-1])]
    poses += [around((50, 50, -2), 720, poses[-1], rise=-4.0)]
    poses += [at(25, 50, 5)]
    assert_three(lines, poses)


def test_tangential_arcs() -> None:
    lines = ["L X+0 Y+0 Z-1 FMAX", "L X+20 Y+0 F300", "CT X+30 Y+10", "CT X+20 Y+20"]
    poses = [at(0, 0, -1), at(20, 0, -1)]
    poses += [around((20, 10, -1), 90, poses[-1])]
    poses += [around((20, 10, -1), 90, poses[-1])]
    assert_three(lines, poses)


def test_rounded_corner() -> None:
    lines = ["L X+0 Y+0 Z-1 FMAX", "L X+20 Y+0 F300", "RND R5", "L X+20 Y+20", "L X+0"]
    poses = [at(0, 0, -1), at(15, 0, -1)]
    poses += [around((15, 5, -1), 90, poses[-1])]
    poses += [at(20, 20, -1), at(0, 20, -1)]
    assert_three(lines, poses)


def test_chamfer() -> None:
    """The length is that which is cut off each side."""
    lines = ["L X+0 Y+0 Z-1 FMAX", "L X+20 Y+0 F300", "CHF 4", "L X+20 Y+20", "L X+0"]
    assert_three(lines, [at(0, 0, -1), at(16, 0, -1), at(20, 4, -1), at(20, 20, -1), at(0, 20, -1)])


@pytest.mark.parametrize(
    "line", ["CTP PR+10 PA+180", "CR X+30 Y+0 R+2 DR+", "C X+40 Y+40 DR+", "CT X+40", "SPL X+30 Y+1"]
)
def test_curves_that_cannot_be_or_are_not_followed_name_their_block(line: str) -> None:
    """A radius less than half the chord, a circle whose end is off it, an end that is half said."""
    lines = ["L X+0 Y+0 Z-1 FMAX", "L X+20 Y+0 F300", "CC X+20 Y+30", line, "L X+40 Y+20"]
    named = {block for _, block, _ in not_followed(read(three(*lines))[0])}
    assert named & {FIRST + 3, FIRST + 4}


@pytest.mark.parametrize(
    "line",
    [
        "APPR LT X+10 Y+20 Z-2 LEN15 RL F300",
        "APPR LN X+10 Y+20 LEN15 RR",
        "APPR CT X+10 Y+20 CCA180 R+10 RL",
        "APPR LCT X+10 Y+20 R10 RL",
        "DEP LT LEN12.5 F100",
        "DEP CT CCA180 R+8",
        "DEP LCT X-20 Y+0 R8",
        "DEP LN LEN+20",
    ],
)
def test_approach_and_departure_with_compensation_name_their_block(line: str) -> None:
    """They go to the side by the tool's radius, which stands in the control's table alone."""
    lines = ["L X+0 Y+0 Z-1 FMAX", "L X+10 Y+20 RL F300", "L X+20", line, "L X+40 Y+20", "L X+40 Y+50"]
    program, _, _ = read(three(*lines))
    assert not_followed(program)
    assert any(block in (FIRST + 1, FIRST + 3) for _, block, _ in not_followed(program))


# --- shifts, mirrors, turns, scales -----------------------------------------------------------------------------------


def test_datum_shift_absolute_and_incremental() -> None:
    lines = [
        "CYCL DEF 7.0 DATUM SHIFT",
        "CYCL DEF 7.1 X+60",
        "CYCL DEF 7.2 Y+40",
        "L X+0 Y+0 Z+5 FMAX",
        "CYCL DEF 7.0 DATUM SHIFT",
        "CYCL DEF 7.1 IX-10",
        "CYCL DEF 7.2 IZ-3",
        "L X+1 Y+1 Z+5 F500",
        "CYCL DEF 7.0 DATUM SHIFT",
        "CYCL DEF 7.1 X+0",
        "CYCL DEF 7.2 Y+0",
        "CYCL DEF 7.3 Z+0",
        "L X+2 Y+2 Z+5",
    ]
    assert_three(lines, [at(60, 40, 5), at(51, 41, 2), at(2, 2, 5)])


def test_a_preset_ends_the_shift() -> None:
    lines = [
        "CYCL DEF 247 DATUM SETTING ~",
        "  Q339=+1 ;DATUM NUMBER",
        "CYCL DEF 7.0 DATUM SHIFT",
        "CYCL DEF 7.1 X+60",
        "L X+0 Y+0 Z+5 FMAX",
        "CYCL DEF 247 DATUM SETTING ~",
        "  Q339=+1 ;DATUM NUMBER",
        "L X+0 Y+1 Z+5 FMAX",
    ]
    body = [*HEAD, *lines, *TAIL]
    blocks: list[str] = []
    for line in body:
        if line.startswith("  "):
            blocks[-1] += f"\n{line}"
        else:
            blocks.append(line)
    assert_poses(numbered(blocks), [at(60, 0, 5), at(0, 1, 5)], blocks=range(FIRST, len(blocks) - 2))


def test_mirror_about_a_shifted_datum_turns_arcs_round() -> None:
    lines = [
        "CYCL DEF 7.0 DATUM SHIFT",
        "CYCL DEF 7.1 X+100",
        "CYCL DEF 8.0 MIRROR IMAGE",
        "CYCL DEF 8.1 X",
        "L X+10 Y+0 Z-2 FMAX",
        "CC X+0 Y+0",
        "C X+0 Y+10 DR+ F300",
        "CYCL DEF 8.0 MIRROR IMAGE",
        "CYCL DEF 8.1",
        "L X+10 Y+0",
    ]
    poses = [at(90, 0, -2)]
    poses += [around((100, 0, -2), -90, poses[-1])]
    poses += [at(110, 0, -2)]
    assert_three(lines, poses)


def test_mirror_in_both_axes() -> None:
    lines = [
        "CYCL DEF 8.0 MIRROR IMAGE",
        "CYCL DEF 8.1 X Y",
        "L X+10 Y+5 Z-2 FMAX",
        "CC X+0 Y+5",
        "C X+0 Y+15 DR+ F300",
    ]
    poses = [at(-10, -5, -2)]
    poses += [around((0, -5, -2), 90, poses[-1])]
    assert_three(lines, poses)


def test_rotation_absolute_and_incremental() -> None:
    lines = [
        "CYCL DEF 7.0 DATUM SHIFT",
        "CYCL DEF 7.1 X+10",
        "CYCL DEF 7.2 Y+20",
        "CYCL DEF 10.0 ROTATION",
        "CYCL DEF 10.1 ROT+30",
        "L X+10 Y+0 Z-2 FMAX",
        "CYCL DEF 10.0 ROTATION",
        "CYCL DEF 10.1 IROT+15",
        "L X+10 Y+0 F500",
        "CC X+0 Y+0",
        "C X+0 Y+10 DR+",
        "CYCL DEF 10.0 ROTATION",
        "CYCL DEF 10.1 ROT+0",
        "L X+10 Y+0",
    ]
    shift = (10.0, 20.0, 0.0)
    poses = moved([at(10, 0, -2)], z_turn(30), shift) + moved([at(10, 0, -2)], z_turn(45), shift)
    poses += [around((10, 20, -2), 90, poses[-1])]
    poses += [at(20, 20, -2)]
    assert_three(lines, poses)


def test_scaling_at_height_zero() -> None:
    """Whether Z is scaled is a matter of a machine parameter: the words stay at Z+0, where it makes no difference."""
    lines = [
        "L Z+0 FMAX",
        "CYCL DEF 11.0 SCALING",
        "CYCL DEF 11.1 SCL 0.5",
        "L X+20 Y+0 R0 FMAX",
        "CC X+0 Y+0",
        "C X+0 Y+20 DR+ F400",
        "CYCL DEF 11.0 SCALING",
        "CYCL DEF 11.1 SCL 1",
        "L X+20 Y+0",
    ]
    program, _, _ = read(three(*lines))
    if not_followed(program):
        assert not_followed(program)[0][1] in (FIRST + 1, FIRST + 2)
        return
    poses = [at(10, 0, 0)]
    poses += [around((0, 0, 0), 90, poses[-1])]
    poses += [at(20, 0, 0)]
    assert_three(lines, poses)


def test_scaling_of_heights_is_a_finding() -> None:
    """MP7410 decides whether Z is scaled as well."""
    lines = ["CYCL DEF 11.0 SCALING", "CYCL DEF 11.1 SCL 0.5", "L X+20 Y+0 Z+10 R0 FMAX", "L Z-5 F100"]
    named = {block for _, block, _ in not_followed(read(three(*lines))[0])}
    assert named & set(span(*lines))


def test_scaling_of_single_axes_about_a_centre() -> None:
    lines = [
        "L Z-2 FMAX",
        "CYCL DEF 26.0 AXIS-SPEC. SCALING",
        "CYCL DEF 26.1 X1.5 Y0.5 CCX+10 CCY+0",
        "L X+20 Y+10 R0 FMAX",
        "CYCL DEF 26.0 AXIS-SPEC. SCALING",
        "CYCL DEF 26.1 X1 Y1 CCX+0 CCY+0",
        "L X+20 Y+10",
    ]
    program, _, _ = read(three(*lines))
    if not_followed(program):
        assert not_followed(program)[0][1] in (FIRST + 1, FIRST + 2)
        return
    assert_three(lines, [at(25, 5, -2), at(20, 10, -2)])


def test_an_arc_in_axes_that_are_scaled_differently_is_a_finding() -> None:
    lines = [
        "L Z-2 FMAX",
        "CYCL DEF 26.0 AXIS-SPEC. SCALING",
        "CYCL DEF 26.1 X1.5 Y0.5 CCX+0 CCY+0",
        "L X+20 Y+0 R0 FMAX",
        "CC X+0 Y+0",
        "C X+0 Y+20 DR+ F100",
    ]
    named = {block for _, block, _ in not_followed(read(three(*lines))[0])}
    assert named & {FIRST + 2, FIRST + 5}


def test_shift_mirror_and_rotation_act_in_this_order() -> None:
    lines = [
        "CYCL DEF 7.0 DATUM SHIFT",
        "CYCL DEF 7.1 X+100",
        "CYCL DEF 10.0 ROTATION",
        "CYCL DEF 10.1 ROT+90",
        "CYCL DEF 8.0 MIRROR IMAGE",
        "CYCL DEF 8.1 X",
        "L X+10 Y+3 Z+0 FMAX",
    ]
    mirror = np.diag([-1.0, 1.0, 1.0])
    place = np.array([100.0, 0.0, 0.0]) + mirror @ z_turn(90) @ [10.0, 3.0, 0.0]
    program, _, _ = read(three(*lines))
    if not_followed(program):
        # Which of the two is the inner one is not said where the control's cycles are.
        assert {block for _, block, _ in not_followed(program)} & set(span(*lines))
        return
    assert_three(lines, [at(*place)])


@pytest.mark.parametrize(
    "first", [["CYCL DEF 10.0 ROTATION", "CYCL DEF 10.1 ROT+90"], ["CYCL DEF 8.0 MIRROR IMAGE", "CYCL DEF 8.1 X"]]
)
def test_a_shift_in_a_turned_system_is_a_finding(first: list[str]) -> None:
    """Whether it acts along the turned axes is not to be read from the text."""
    lines = [*first, "CYCL DEF 7.0 DATUM SHIFT", "CYCL DEF 7.1 X+100", "L X+10 Y+3 Z+0 FMAX"]
    named = {block for _, block, _ in not_followed(read(three(*lines))[0])}
    assert named & {FIRST + 2, FIRST + 3}


# --- parameters, labels, calls ----------------------------------------------------------------------------------------


def test_loop_with_fn_assignments_and_a_jump() -> None:
    lines = [
        "FN 0: Q1 = +0",
        "FN 0: Q2 = +5 ;STEP",
        "L Y+0 Z-1 FMAX",
        "LBL 1",
        "L X+Q1 F500",
        "FN 1: Q1 = +Q1 + +Q2",
        "FN 12: IF +Q1 LT +21 GOTO LBL 1",
    ]
    assert_three(lines, [at(x, 0, -1) for x in (0, 5, 10, 15, 20)])


@pytest.mark.parametrize(
    ("jump", "last"),
    [
        ("FN 12: IF +Q1 LT +3 GOTO LBL 1", 2),
        ("FN 11: IF +4 GT +Q1 GOTO LBL 1", 3),
        ("FN 10: IF +Q1 NE +5 GOTO LBL 1", 4),
        ("FN 9: IF +Q1 EQU +1 GOTO LBL 1", 1),
        ("FN 12: IF +Q1 LT -3 GOTO LBL 1", 0),
    ],
)
def test_jumps(jump: str, last: int) -> None:
    lines = ["FN 0: Q1 = +0", "L Y+0 Z-1 FMAX", "LBL 1", "L X+Q1 F500", "FN 1: Q1 = +Q1 + +1", jump]
    assert_three(lines, [at(x, 0, -1) for x in range(last + 1)])


def test_functions_of_q_parameters() -> None:
    lines = [
        "FN 0: Q1 = +12",
        "FN 1: Q2 = +Q1 + +5",
        "FN 2: Q3 = +Q2 - +7.5",
        "FN 3: Q4 = +Q3 * -2",
        "FN 4: Q5 = +Q1 DIV +8",
        "FN 5: Q6 = SQRT +Q1",
        "FN 6: Q7 = SIN +30",
        "FN 7: Q8 = COS +60",
        "FN 8: Q9 = +3 LEN +4",
        "FN 13: Q10 = +3 ANG +4",
        "L X+Q2 Y+Q3 Z-Q4 FMAX",
        "L X+Q5 Y+Q6 Z+Q7 F100",
        "L X+Q8 Y+Q9 Z+Q10",
    ]
    program, _, _ = read(three(*lines))
    angle = np.degrees(np.arctan2(3, 4))
    poses = [at(17, 9.5, 19), at(1.5, np.sqrt(12), 0.5), at(0.5, 5, angle)]
    if not_followed(program):
        # Those beyond FN 5 may be named instead.
        assert {block for _, block, _ in not_followed(program)} & set(range(FIRST + 6, FIRST + 13))
        return
    assert_three(lines, poses)


def test_formulae() -> None:
    lines = [
        "Q1 = 5 * 3 + 2 * 10",
        "Q2 = 5 ^ 2 - 3 ^ 3",
        "Q3 = SQRT ( Q1 - 10 ) / 2",
        "Q4 = Q2 + 3 * SIN 90",
        "Q5 = ABS Q2 - INT 3.7",
        "Q6 = ATAN 1",
        "Q7 = - ( Q1 + 1 )",
        "Q8 = COS ( Q6 * 2 - 90 ) * PI",
        "L X+Q1 Y+Q2 Z+Q3 FMAX",
        "L X+Q4 Y+Q5 Z+Q6 F100",
        "L X+Q7 Y+Q8",
    ]
    poses = [at(35, -2, 2.5), at(1, -1, 45), at(-36, np.pi, 45)]
    assert_three(lines, poses)


def test_ellipse_by_a_loop_of_formulae() -> None:
    """As the manual's own example of parametric programs goes about it."""
    lines = [
        "FN 0: Q5 = +0",
        "Q20 = 36",
        "L Z-3 FMAX",
        "LBL 1",
        "Q21 = 50 + 30 * COS Q5",
        "Q22 = 40 + 20 * SIN Q5",
        "L X+Q21 Y+Q22 F500",
        "Q5 = Q5 + Q20",
        "FN 12: IF +Q5 LT +360 GOTO LBL 1",
    ]
    angles = np.radians(np.arange(0.0, 360.0, 36.0))
    assert_three(lines, [at(50 + 30 * np.cos(t), 40 + 20 * np.sin(t), -3) for t in angles])


def test_local_and_lasting_parameters() -> None:
    lines = ["QL1 = 4", "QR2 = QL1 * 2", "L X+QL1 Y-QR2 Z+0 FMAX", "L X-QL1 F100"]
    assert_three(lines, [at(4, -8, 0), at(-4, -8, 0)])


def test_feeds_from_parameters() -> None:
    lines = [
        "FN 0: Q50 = +750 ;CUTTING",
        "FN 0: Q51 = +300 ;PLUNGE",
        "L X+0 Y+0 Z+5 FMAX",
        "L Z-1 FQ51",
        "L X+10 FQ50",
        "L Y+9 F Q51",
    ]
    program = assert_three(lines, [at(0, 0, 5), at(0, 0, -1), at(10, 0, -1), at(10, 9, -1)])
    chosen = np.isin(program.moves.block, list(span(*lines)))
    assert program.moves.feed[chosen][1:].tolist() == [300.0, 750.0, 300.0]


def test_parameter_that_nothing_sets_is_a_finding() -> None:
    lines = ["L X+0 Y+0 Z+5 FMAX", "L Z-1 FQ51", "L X+Q77"]
    assert_refused(three(*lines), FIRST + 1, FIRST + 2)


def test_system_data_are_not_followed() -> None:
    lines = ["L X+0 Y+0 Z+5 FMAX", "FN 18: SYSREAD Q50 = ID270 NR1 IDX1", "L X+Q50 F100"]
    program, _, _ = read(three(*lines))
    assert any(block in (FIRST + 1, FIRST + 2) for _, block, _ in not_followed(program))


def test_repetitions_and_subprograms() -> None:
    """Holes in a grid: an incremental step repeated, a subprogram of increments at every hole."""
    lines = [
        "L X+0 Y+0 Z+2 FMAX",
        "CALL LBL 2",
        "LBL 1",
        "L IX+10 FMAX",
        "CALL LBL 2",
        "CALL LBL 1 REP 2/2",
        "L Y+20 FMAX",
    ]
    text = numbered([*HEAD, *lines, *TAIL, "LBL 2", "L IZ-6 F100", "L IZ+6 FMAX", "LBL 0"])
    poses = [at(0, 0, 2)]
    for x in (0, 10, 20, 30):
        poses += ([at(x, 0, 2)] if x else []) + [at(x, 0, -4), at(x, 0, 2)]
    poses += [at(30, 20, 2)]
    after = [block for block in range(FIRST, FIRST + len(lines) + len(TAIL) + 4) if block != FIRST + len(lines)]
    program, tip, _ = read(text)
    assert not_followed(program) == []
    chosen = np.isin(program.moves.block, after)
    assert tip[chosen] == pytest.approx(np.array([pose.tip for pose in poses]), abs=TIP)


def test_named_labels_and_a_subprogram_within_a_subprogram() -> None:
    lines = ["L X+0 Y+0 Z+2 FMAX", 'CALL LBL "ROW"', "L Y+10 FMAX", 'CALL LBL "ROW"']
    text = numbered(
        [*HEAD, *lines, *TAIL, 'LBL "ROW"', "L X+5 F100", 'CALL LBL "END"', "LBL 0", 'LBL "END"', "L X+7", "LBL 0"]
    )
    program, tip, _ = read(text)
    assert not_followed(program) == []
    chosen = program.moves.block != FIRST + len(lines)
    chosen &= program.moves.block >= FIRST
    expected = [(0, 0, 2), (5, 0, 2), (7, 0, 2), (7, 10, 2), (5, 10, 2), (7, 10, 2)]
    assert tip[chosen] == pytest.approx(np.array(expected, dtype=float), abs=TIP)


def test_a_called_program_gets_the_parameters() -> None:
    part = "0 BEGIN PGM SUB MM\n1 L X+Q1 F400\n2 Q1 = Q1 * 2\n3 L X+Q1\n4 END PGM SUB MM\n"
    text = three("L X+0 Y+0 Z+5 FMAX", "Q1 = 6", "CALL PGM SUB.H", "L Y+Q1 F200")
    program, tip, _ = read(text, {"SUB.H": part}.get)
    assert not_followed(program) == []
    assert tip[:4] == pytest.approx(np.array([[0, 0, 5], [6, 0, 5], [12, 0, 5], [12, 12, 5]], dtype=float), abs=TIP)


def test_a_called_program_that_is_not_there_is_a_finding() -> None:
    assert_refused(three("L X+0 Y+0 Z+5 FMAX", "CALL PGM TNC:\\NC\\SUB.H", "L Y+1 F200"), FIRST + 1)


def test_inches() -> None:
    lines = ["L X+1 Y-0.5 Z+0.25 FMAX", "CC X+0 Y-0.5", "C X-1 Y-0.5 DR+ F200"]
    poses = [at(25.4, -12.7, 6.35)]
    poses += [around((0, -12.7, 6.35), 180, poses[-1])]
    assert_three(lines, poses, unit="INCH")


def test_decimal_commas() -> None:
    lines = ["L X+1,25 Y-,5 Z+0,25 FMAX", "L X+2,5 F100,5", "Q1 = 2,5 * 2", "L X+Q1"]
    assert_three(lines, [at(1.25, -0.5, 0.25), at(2.5, -0.5, 0.25), at(5, -0.5, 0.25)])


# --- tilted planes ----------------------------------------------------------------------------------------------------


def assert_tilted(lines: Sequence[str], expected: Sequence[Pose]) -> None:
    """As `assert_three`, the rotary axes brought to zero by the head."""
    head = [*HEAD, "L A+0 C+0 R0 FMAX"]
    blocks = [*head, *lines, "L M140 MB MAX", "PLANE RESET STAY", "L A+0 C+0 R0 FMAX", "M5", "M30"]
    assert_poses(numbered(blocks), expected, blocks=range(len(head) + 1, len(head) + 1 + len(lines)))


def test_plane_spatial_stay_and_the_angles_the_control_found() -> None:
    """3+2 with a shift to the plane's origin, and an arc in the plane."""
    lines = [
        "CYCL DEF 7.0 DATUM SHIFT",
        "CYCL DEF 7.1 X+20",
        "CYCL DEF 7.2 Y-10",
        "CYCL DEF 7.3 Z+5",
        "PLANE SPATIAL SPA+20 SPB+30 SPC+40 STAY",
        "L A+Q120 C+Q122 R0 FMAX",
        "L X+10 Y+0 R0 FMAX",
        "L Z+15 FMAX",
        "L Z-2 F300",
        "CC X+0 Y+0",
        "C X+0 Y+10 DR+ F500",
        "L M140 MB MAX",
    ]
    turn = x_turn(20) @ y_turn(30) @ z_turn(40)
    poses = [at(10, 0, 15), at(10, 0, -2)]
    poses += [around((0, 0, -2), 90, poses[-1])]
    assert_tilted(lines[:-1], moved(poses, turn, (20, -10, 5)))


@pytest.mark.parametrize(
    "word", ["MOVE DIST50 F2000", "TURN F2000", "TURN FMAX SEQ-", "TURN MB MAX FMAX SEQ+", "MOVE DIST0 F1000"]
)
def test_plane_that_turns_the_axes_itself(word: str) -> None:
    lines = [f"PLANE SPATIAL SPA+0 SPB-35 SPC+10 {word}", "L X+10 Y+3 Z+40 R0 FMAX", "L Z-2 F300"]
    turn = y_turn(-35) @ z_turn(10)
    head = [*HEAD, "L A+0 C+0 R0 FMAX"]
    text = numbered([*head, *lines, "PLANE RESET STAY", "M5", "M30"])
    program, _, _ = read(text)
    if "MB" in word and not_followed(program):
        assert {block for _, block, _ in not_followed(program)} >= {len(head) + 1}
        return
    assert_poses(text, moved([at(10, 3, 40), at(10, 3, -2)], turn), blocks=range(len(head) + 1, len(head) + 4))


def test_before_the_axes_stand_in_the_plane_nothing_is_known() -> None:
    """STAY turns nothing: words then lead somewhere in the tilted frame with a tool that stands as before."""
    head = [*HEAD, "L A+0 C+0 R0 FMAX"]
    lines = ["PLANE SPATIAL SPA+0 SPB+30 SPC+0 STAY", "L X+10 Y+0 Z+50 R0 F500"]
    text = numbered([*head, *lines, "M5", "M30"])
    program, _, axis = read(text)
    named = {block for _, block, _ in not_followed(program)} | {move.block for move in program.unknown}
    known = program.moves.block == len(head) + 2
    assert len(head) + 2 in named or not known.any()
    # If it gives a pose at all, it is that of a tool that still stands upright.
    assert axis[known] == pytest.approx(np.tile(UP, (int(known.sum()), 1)))


def test_plane_vector() -> None:
    """Base vector x of the plane, and its normal; the control squares them up."""
    normal, base = np.array([0.4, -0.3, 0.9]), np.array([1.0, 0.1, 0.0])
    words = " ".join(
        f"{letter}{value:+g}"
        for letter, value in zip(("BX", "BY", "BZ", "NX", "NY", "NZ"), [*base, *normal], strict=True)
    )
    lines = [f"PLANE VECTOR {words} STAY", "L A+Q120 C+Q122 R0 FMAX", "L X+10 Y+5 Z+20 FMAX", "L Z+1 F300"]
    z = normal / np.linalg.norm(normal)
    x = base - base @ z * z
    x /= np.linalg.norm(x)
    turn = np.stack([x, np.cross(z, x), z], axis=1)
    assert_tilted(lines, moved([at(10, 5, 20), at(10, 5, 1)], turn))


def test_plane_relative_goes_on_from_the_plane_before() -> None:
    lines = [
        "PLANE SPATIAL SPA+0 SPB+30 SPC+0 STAY",
        "PLANE RELATIV SPC+25 STAY",
        "L A+Q120 C+Q122 R0 FMAX",
        "L X+10 Y+0 Z+20 FMAX",
        "L Z+1 F300",
    ]
    assert_tilted(lines, moved([at(10, 0, 20), at(10, 0, 1)], y_turn(30) @ z_turn(25)))


def test_plane_by_euler_angles() -> None:
    lines = ["PLANE EULER EULPR+45 EULNU+20 EULROT+22 STAY", "L A+Q120 C+Q122 R0 FMAX", "L X+10 Y+0 Z+20 FMAX"]
    head = [*HEAD, "L A+0 C+0 R0 FMAX"]
    program, _, _ = read(numbered([*head, *lines, "M30"]))
    if not_followed(program):
        assert len(head) + 1 in {block for _, block, _ in not_followed(program)}
        return
    assert_tilted(lines, moved([at(10, 0, 20)], z_turn(45) @ x_turn(20) @ z_turn(22)))


@pytest.mark.parametrize(
    "plane",
    [
        "PLANE POINTS P1X+0 P1Y+0 P1Z+20 P2X+30 P2Y+31 P2Z+20 P3X+0 P3Y+41 P3Z+32.5 STAY",
        "PLANE PROJECTED PROPR+24 PROMIN+24 ROT+30 STAY",
    ],
)
def test_planes_by_points_or_projections_name_their_block(plane: str) -> None:
    head = [*HEAD, "L A+0 C+0 R0 FMAX"]
    program, _, _ = read(numbered([*head, plane, "L A+Q120 C+Q122 R0 FMAX", "L X+10 Y+0 Z+20 F100", "M30"]))
    assert len(head) + 1 in {block for _, block, _ in not_followed(program)}


def test_plane_axial() -> None:
    lines = ["PLANE AXIAL A-30 C+90 TURN FMAX", "L X+10 Y+5 Z+20 R0 FMAX", "L Z+1 F300"]
    head = [*HEAD, "L A+0 C+0 R0 FMAX"]
    text = numbered([*head, *lines, "PLANE RESET STAY", "M30"])
    program, _, _ = read(text)
    if not_followed(program):
        # How the plane's x lies about its normal is a matter of the machine.
        assert len(head) + 1 in {block for _, block, _ in not_followed(program)}
        return
    assert_poses(
        text, moved([at(10, 5, 20), at(10, 5, 1)], z_turn(90) @ x_turn(-30)), blocks=range(len(head) + 1, len(head) + 4)
    )


@pytest.mark.parametrize("step", ["PLANE RESET STAY", "PLANE RESET TURN FMAX", "PLANE RESET MOVE DIST0 F1000"])
def test_after_the_plane_is_reset_words_are_the_parts(step: str) -> None:
    head = [*HEAD, "L A+0 C+0 R0 FMAX"]
    back = ["L A+0 C+0 R0 FMAX"] if "STAY" in step else []
    lines = ["PLANE SPATIAL SPA+0 SPB+30 SPC+0 STAY", "L A+Q120 C+Q122 R0 FMAX", "L X+10 Y+0 Z+20 FMAX", "L Z+60 FMAX"]
    text = numbered([*head, *lines, "L M140 MB MAX", step, *back, "L X+1 Y+2 Z+30 FMAX", "M30"])
    turn = y_turn(30)
    expected = [*moved([at(10, 0, 20), at(10, 0, 60)], turn), at(1, 2, 30)]
    program, tip, axis = read(text)
    assert not_followed(program) == []
    chosen = (program.moves.block >= len(head) + 1) & (program.moves.block != len(head) + 1 + len(lines))
    assert tip[chosen] == pytest.approx(np.array([pose.tip for pose in expected]), abs=TIP)
    assert axis[chosen] == pytest.approx(np.array([pose.axis for pose in expected]), abs=1e-6)


def test_cycle_19_on_a_machine_with_b_and_c() -> None:
    """In the manner of posts of the time before PLANE."""
    head = [*HEAD, "L B+0 C+0 R0 FMAX"]
    lines = [
        "CYCL DEF 7.0 DATUM SHIFT",
        "CYCL DEF 7.1 Z-10",
        "CYCL DEF 19.0 WORKING PLANE",
        "CYCL DEF 19.1 A+0 B+30 C+15",
        "L B+Q121 C+Q122 R0 FMAX",
        "L X+10 Y+0 R0 FMAX",
        "L Z+15 R0 FMAX",
        "L Z-2 F300",
        "L X+30",
    ]
    ending = [
        "L M140 MB MAX",
        "CYCL DEF 19.0 WORKING PLANE",
        "CYCL DEF 19.1 A+0 B+0 C+0",
        "CYCL DEF 19.0 WORKING PLANE",
        "CYCL DEF 19.1",
        "M30",
    ]
    poses = moved([at(10, 0, 15), at(10, 0, -2), at(30, 0, -2)], y_turn(30) @ z_turn(15), (0, 0, -10))
    assert_poses(numbered([*head, *lines, *ending]), poses, blocks=range(len(head) + 1, len(head) + 1 + len(lines)))


# --- five axes --------------------------------------------------------------------------------------------------------


def assert_five(lines: Sequence[str], expected: Sequence[Pose], head: Sequence[str] = HEAD) -> Program:
    """Five axes at once; the lines of the program."""
    text = numbered([*head, *lines, "M30"])
    program, tip, axis = read(text)
    assert not_followed(program) == []
    inner = [n for n, block in enumerate(program.moves.block.tolist()) if "MB MAX" not in text.splitlines()[block]]
    assert tip[inner] == pytest.approx(np.array([pose.tip for pose in expected]), abs=TIP)
    assert axis[inner] == pytest.approx(np.array([pose.axis for pose in expected]), abs=1e-6)
    return program


def test_m128_with_tables_a_and_c() -> None:
    """Modal words: an axis that is not said again stays."""
    lines = [
        "L A-35.5 C+120 R0 FMAX",
        "M128",
        "L X+10 Y+20 Z+50 A-35.5 C+120 FMAX",
        "L Z+12.5 F1000",
        "L X+11 Y+21 A-36 C+121.25 F750",
        "L Y+22 C+122",
        "L Z+50 FMAX",
        "M129",
        "L M140 MB MAX",
    ]
    poses = [
        at(10, 20, 50, ac(-35.5, 120)),
        at(10, 20, 12.5, ac(-35.5, 120)),
        at(11, 21, 12.5, ac(-36, 121.25)),
        at(11, 22, 12.5, ac(-36, 122)),
        at(11, 22, 50, ac(-36, 122)),
    ]
    assert_five(lines, poses)


def test_tcpm_with_b_and_c_and_increments() -> None:
    lines = [
        "L B+40 C-30 R0 FMAX",
        "FUNCTION TCPM F TCP AXIS POS PATHCTRL AXIS",
        "L X+1 Y+2 Z+30 B+40 C-30 FMAX",
        "L IZ-25 F1000",
        "L X+5 IB+2.5 IC-1",
        "L Z+30 FMAX",
        "FUNCTION RESET TCPM",
        "L M140 MB MAX",
    ]
    poses = [
        at(1, 2, 30, bc(40, -30)),
        at(1, 2, 5, bc(40, -30)),
        at(5, 2, 5, bc(42.5, -31)),
        at(5, 2, 30, bc(42.5, -31)),
    ]
    assert_five(lines, poses)


def test_lines_with_tool_vectors() -> None:
    """In the manner of posts that leave the machine to the control."""
    axes = np.array([[0.6, 0.0, 0.8], [0.48, 0.36, 0.8]])
    words = [" ".join(f"T{letter}{value:+.7f}" for letter, value in zip("XYZ", axis, strict=True)) for axis in axes]
    lines = [
        "FUNCTION TCPM F TCP AXIS POS PATHCTRL VECTOR",
        f"LN X+0 Y+0 Z+40 {words[0]} FMAX",
        f"LN X+0 Y+0 Z+2 {words[0]} F500",
        f"LN X+5 Y+1 Z+2 {words[1]}",
        "FUNCTION RESET TCPM",
        "L M140 MB MAX",
    ]
    assert_five(lines, [at(0, 0, 40, axes[0]), at(0, 0, 2, axes[0]), at(5, 1, 2, axes[1])])


def test_lines_with_normals_and_tool_vectors() -> None:
    """Without deltas the normal moves nothing."""
    lines = [
        "M128",
        "LN X+0 Y+0 Z+40 NX+0 NY+0 NZ+1 TX+0.6 TY+0 TZ+0.8 FMAX",
        "LN X+1 Y+0 Z+2 NX+0 NY-0.6 NZ+0.8 TX+0.6 TY+0 TZ+0.8 F500",
        "M129",
        "L M140 MB MAX",
    ]
    text = numbered([*HEAD, *lines, "M30"])
    program, _, _ = read(text)
    if not_followed(program):
        assert {block for _, block, _ in not_followed(program)} & {FIRST + 1, FIRST + 2}
        return
    assert_five(lines, [at(0, 0, 40, (0.6, 0, 0.8)), at(1, 0, 2, (0.6, 0, 0.8))])


def test_deltas_with_normals_are_a_finding() -> None:
    """They move every point along its normal."""
    head = [line.replace("F600", "F600 DR-0.05") for line in HEAD]
    lines = [
        "M128",
        "LN X+0 Y+0 Z+40 NX+0 NY+0 NZ+1 TX+0.6 TY+0 TZ+0.8 FMAX",
        "LN X+1 Y+0 Z+2 NX+0 NY-0.6 NZ+0.8 TX+0.6 TY+0 TZ+0.8 F500",
    ]
    assert not_followed(read(numbered([*head, *lines, "M129", "M30"]))[0])


def test_spatial_angles_under_tcpm_name_their_block() -> None:
    lines = ["FUNCTION TCPM F TCP AXIS SPAT PATHCTRL AXIS", "L X+0 Y+0 Z+40 A+10 B+20 C+0 FMAX", "L Z+2 F500"]
    named = {block for _, block, _ in not_followed(read(numbered([*HEAD, *lines, "M30"]))[0])}
    assert named & {FIRST, FIRST + 1}


def test_m128_in_the_block_of_the_first_point() -> None:
    """It acts at the beginning of its block."""
    lines = [
        "L A+15 C+0 R0 FMAX",
        "L X+0 Y+0 Z+40 A+15 C+0 R0 FMAX M128",
        "L Z+2 F500",
        "L Z+40 FMAX M129",
        "L M140 MB MAX",
    ]
    assert_five(lines, [at(0, 0, 40, ac(15, 0)), at(0, 0, 2, ac(15, 0)), at(0, 0, 40, ac(15, 0))])


def test_rotary_axes_between_passes_turn_about_the_tip() -> None:
    """A block of rotary words alone under TCPM: the tip stays, the axis swings."""
    lines = [
        "L A-20 C+0 R0 FMAX",
        "M128 F2000",
        "L X+0 Y+0 Z+40 A-20 C+0 FMAX",
        "L A-40 C+10 F500",
        "M129",
        "L M140 MB MAX",
    ]
    assert_five(lines, [at(0, 0, 40, ac(-20, 0)), at(0, 0, 40, ac(-40, 10))])


# --- DIN/ISO ----------------------------------------------------------------------------------------------------------

ISO_HEAD = ["G30 G17 X+0 Y+0 Z-20", "G31 G90 X+100 Y+100 Z+0", "T4 G17 S8000", "G00 G40 G90 M140 MB MAX M3"]


def assert_iso(lines: Sequence[str], expected: Sequence[Pose]) -> Program:
    """The blocks of a DIN/ISO program lead through these poses."""
    start = 10 * (len(ISO_HEAD) + 1)
    text = iso([*ISO_HEAD, *lines, "G00 G40 M140 MB MAX", "M30"])
    return assert_poses(text, expected, blocks=range(start, start + 10 * len(lines)))


def test_iso_arcs_with_centre_and_radius() -> None:
    lines = [
        "G00 X+10 Y-20 M8",
        "Z-3",
        "G01 X+40 F1200",
        "I+40 J-10",
        "G03 X+50 Y-10",
        "G03 X+40 Y+0 R+10",
        "G02 X+30 Y+10 R-10",
    ]
    poses = [at(10, -20, -3), at(40, -20, -3)]
    poses += [around((40, -10, -3), 90, poses[-1])]
    poses += [around((40, -10, -3), 90, poses[-1])]
    # From (40, 0) clockwise to (30, 10) the longer way: three quarters of the circle about (30, 0).
    poses += [around((30, 0, -3), -270, poses[-1])]
    assert_iso(lines, poses)


def test_iso_increments() -> None:
    lines = ["G00 G90 X+5 Y+5 Z+10", "G01 G91 Z-12 F300", "X+20 Y+1", "G90 X+0", "G91 Y+4 G90"]
    expected = [at(5, 5, 10), at(5, 5, -2), at(25, 6, -2), at(0, 6, -2)]
    assert_iso(lines[:4], expected)


def test_iso_shift_mirror_rotation() -> None:
    lines = [
        "G54 G90 X+100 Y+0",
        "G28 X",
        "G00 G90 X+10 Y+0 Z+5",
        "G28",
        "G73 G90 H+90",
        "G01 X+10 Y+0 F300",
        "G73 G90 H+0",
        "G54 G90 X+0 Y+0",
        "X+1",
    ]
    assert_iso(lines, [at(90, 0, 5), at(100, 10, 5), at(1, 10, 5)])


def test_iso_scaling_at_height_zero() -> None:
    lines = ["G00 Z+0", "G72 F0.5", "G00 X+20 Y+10", "G72 F1", "G01 X+20 F300"]
    program, _, _ = read(iso([*ISO_HEAD, *lines, "M30"]))
    if not_followed(program):
        assert {block for _, block, _ in not_followed(program)} & {10 * (len(ISO_HEAD) + 2)}
        return
    assert_iso(lines, [at(10, 5, 0), at(20, 5, 0)])


def test_iso_rounding_and_chamfer() -> None:
    lines = ["G00 X+0 Y+0 Z-1", "G01 X+20 Y+0 F300", "G25 R5", "G01 X+20 Y+20", "G24 R4", "G01 X+0 Y+20"]
    poses = [at(0, 0, -1), at(15, 0, -1)]
    poses += [around((15, 5, -1), 90, poses[-1])]
    poses += [at(20, 16, -1), at(16, 20, -1), at(0, 20, -1)]
    assert_iso(lines, poses)


def test_iso_parameters_and_jumps() -> None:
    lines = [
        "D00 Q1 P01 +0",
        "D00 Q2 P01 +5",
        "G00 Y+0 Z-1",
        "G98 L1",
        "G01 X+Q1 F500",
        "D01 Q1 P01 +Q1 P02 +Q2",
        "D12 P01 +Q1 P02 +21 P03 1",
    ]
    assert_iso(lines, [at(x, 0, -1) for x in (0, 5, 10, 15, 20)])


def test_iso_arithmetic() -> None:
    lines = [
        "D00 Q1 P01 +12",
        "D02 Q3 P01 +Q1 P02 +2.5",
        "D03 Q4 P01 +Q3 P02 -2",
        "D04 Q5 P01 +Q1 P02 +8",
        "D05 Q6 P01 +16",
        "G00 X+Q3 Y+Q4 Z+Q5",
        "G01 X-Q6 F100",
    ]
    assert_iso(lines, [at(9.5, -19, 1.5), at(-4, -19, 1.5)])


def test_iso_repetition_and_subprogram() -> None:
    lines = ["G00 X+0 Y+0 Z+2", "G98 L1", "G00 G91 X+10", "L2,0", "G90", "L1,2"]
    text = iso([*ISO_HEAD, *lines, "G00 G90 G40 M140 MB MAX", "M30", "G98 L2", "G01 G91 Z-6 F100", "G00 Z+6", "G98 L0"])
    program, tip, _ = read(text)
    assert not_followed(program) == []
    expected = [(0, 0, 2)]
    for x in (10, 20, 30):
        expected += [(x, 0, 2), (x, 0, -4), (x, 0, 2)]
    assert tip[: len(expected)] == pytest.approx(np.array(expected, dtype=float), abs=TIP)


def test_iso_m128() -> None:
    lines = [
        "G00 A-20 C+30",
        "M128",
        "G00 X+1 Y+2 Z+30 A-20 C+30",
        "G01 Z+3 F500",
        "X+4 A-21 C+31 F600",
        "G00 Z+30",
        "M129",
    ]
    program, tip, axis = read(iso([*ISO_HEAD, *lines, "G00 G40 M140 MB MAX", "M30"]))
    assert not_followed(program) == []
    assert tip[:4] == pytest.approx(np.array([[1, 2, 30], [1, 2, 3], [4, 2, 3], [4, 2, 30]], dtype=float))
    assert axis[:4] == pytest.approx(np.array([ac(-20, 30), ac(-20, 30), ac(-21, 31), ac(-21, 31)]))


@pytest.mark.parametrize(
    "line", ["G26 R5", "G27 R5", "G83 P01 -2 P02 -20", "G79", "G05 X+20 Y+10 R", "G77 X+3", "%OTHER"]
)
def test_iso_blocks_that_are_not_followed_name_themselves(line: str) -> None:
    lines = ["G00 X+0 Y+0 Z-1", "G01 X+20 Y+0 F300", line, "G01 X+20 Y+20"]
    named = {block for _, block, _ in not_followed(read(iso([*ISO_HEAD, *lines, "M30"]))[0])}
    assert 10 * (len(ISO_HEAD) + 3) in named
