"""Ways off the part: followed on a known machine, proven where it is not known, found otherwise."""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, radians, sin

import msgspec
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from conflank_cli.commands.tables import judgement
from conflank_cli.geometry.face import CheckMesh
from conflank_cli.job import Copies, Machine
from conflank_cli.posting.program import post_program
from conflank_cli.scene import Scene
from conflank_cli.tool import CATALOGUE
from conflank_cli.verification.findings import Finding
from conflank_cli.verification.judge import verify_program
from conflank_cli.verification.posed import PosedProgram, pose_program
from conflank_cli.verification.standing import Standing, lowest
from conflank_cli.verification.ways import sagitta
from postprocessors.machines.machine import read_machine_file
from tests.verification.scenes import NOTHING, TCPM, header, plane_face, program, scene_of
from tests.verification.test_pattern import pattern_scene, sweep
from tests.verification.test_verify import FLANK, flank_program

FACE = plane_face((0.0, 20.0), (0.0, 20.0))
UP = np.array([0.0, 0.0, 1.0])
LENGTH = 150.0
"""Gauge length of T1."""


def block_of(low: Sequence[float], high: Sequence[float], face: int = 9) -> CheckMesh:
    """A box between two corners."""
    corners = np.array([[(low, high)[i >> k & 1][k] for k in range(3)] for i in range(8)], dtype=np.float64)
    quads = [(0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5)]
    triangles = [[q[a] for a in order] for q in quads for order in ((0, 1, 2), (0, 2, 3))]
    return CheckMesh(corners, np.array(triangles, dtype=np.int32), np.full(12, face, dtype=np.int32))


def on(name: str = "ac-table", check: CheckMesh = NOTHING, definition: str | None = None, **keys: object) -> Scene:
    """A plane at z = 0 on a machine; `zero` makes it one whose ways are known."""
    scene = scene_of(FACE, check=check)
    if "zero" in keys:
        keys["gauge_length"] = {"T1": LENGTH}
    machine = Machine(name=name, definition=definition, **keys)
    return Scene(msgspec.structs.replace(scene.job, machine=machine), "part", scene.faces, scene.tools, scene.mesh, {})


def posed(body: Sequence[str], scene: Scene) -> PosedProgram:
    name = scene.job.machine.name
    head = [line.replace("ac-table", name) for line in header()]
    return pose_program(program(body, head), scene)


def found(body: Sequence[str], scene: Scene, code: str = "CF116") -> list[Finding]:
    return [finding for finding in posed(body, scene).findings if finding.code == code]


def edited(old: str, new: str, name: str = "ac-table") -> str:
    """The text of a shipped machine with one change."""
    text = read_machine_file(name)[0]
    assert old in text
    return text.replace(old, new)


# --- the proof ------------------------------------------------------------------------------------------------------


def test_the_lowest_place_of_a_cutter_by_points_all_over_it() -> None:
    """Circles around the axis, close together, and points on the ball."""
    rng = np.random.default_rng(3)
    tool = CATALOGUE["T3"]
    angle = np.linspace(0.0, 2.0 * np.pi, 721)
    for _ in range(20):
        axis, up = (vector / np.linalg.norm(vector) for vector in rng.normal(size=(2, 3)))
        tip = rng.normal(size=3) * 30.0
        one = np.cross(axis, up) / np.linalg.norm(np.cross(axis, up))
        ring = np.cos(angle)[:, None] * one + np.sin(angle)[:, None] * np.cross(axis, one)
        height, points = tool.length - tool.tip_height, [tip - tool.tip_height * axis + tool.r_min * ring]
        points.append(tip + height * axis + tool.r_max * ring)
        for section in (*tool.shank, *tool.holder):
            points.append(tip + height * axis + section.diameter_low / 2.0 * ring)
            height += section.length
            points.append(tip + height * axis + section.diameter_high / 2.0 * ring)
        ball = tip + tool.ball_radius * axis - tool.ball_radius * up
        expected = min(float((np.concatenate(points) @ up).min()), float(ball @ up))
        # The lower half of the ball alone belongs to the cutter; what lies in the cone as well makes no difference.
        assert float(lowest(tool, tip[None], axis[None], up[None])[0]) == pytest.approx(expected, abs=1e-3)


def test_what_stands_on_the_table_is_as_high_as_it_is_in_the_programs_frame() -> None:
    scene = on(check=block_of((5, 5, -3), (8, 9, 12)))
    standing = Standing.of(scene, pose_program(program([]), scene).poses.frame)
    assert standing.height(np.array([0.0, 0.0, 1.0])) == pytest.approx(12.0)
    assert standing.height(np.array([0.0, 1.0, 0.0])) == pytest.approx(20.0)
    assert standing.height(np.array([0.0, 0.0, -1.0])) == pytest.approx(3.0)


def test_copies_stand_on_the_table_whether_they_are_cut_or_not() -> None:
    """A plate from x = 30 to 50, and the same a third of a turn on and another third on."""
    scene = pattern_scene(Copies((0.0, 0.0, 1.0), 3, (0,)))
    standing = Standing.of(scene, pose_program(program([]), scene).poses.frame)
    for k in range(3):
        angle = radians(120.0 * k)
        assert standing.height(np.array([cos(angle), sin(angle), 0.0])) == pytest.approx(50.0)


@pytest.mark.parametrize(("height", "proven"), [(12.5, True), (11.5, False)])
def test_the_first_pose_must_be_above_everything(height: float, proven: bool) -> None:
    """Upright beside a block 12 mm high: from the retract the tool could come across it."""
    scene = on(check=block_of((5, 5, -3), (8, 9, 12)))
    result = found([f"L X-30 Y+0 Z{height:+.3f} R0 FMAX"], scene)
    assert (result == []) == proven
    if not proven:
        assert (result[0].amount, result[0].limit, result[0].unit) == (pytest.approx(-0.5), 0.0, "mm")


@pytest.mark.parametrize(("along", "proven"), [(20.5, True), (19.5, False)])
def test_above_means_along_the_machines_z(along: float, proven: bool) -> None:
    """A-90: the table is tilted so that the part's y is up, in which the plane ends at 20."""
    scene = on()
    body = ["L A-90 C+0 R0 FMAX", TCPM, f"L X-30 Y{along:+.3f} Z-50 A-90 C+0 FMAX"]
    assert (found(body, scene) == []) == proven


RAISED = ["L B+0 C+0 R0 FMAX", "L M140 MB MAX"]
"""The retract that counts on a machine whose head may stand anywhere after a tool change."""


def test_with_a_tilted_head_the_holder_counts_and_up_is_z() -> None:
    """B90: the tool lies; its holder, 20 mm in radius, hangs below its tip."""
    scene = on("head-table")
    for height, proven in ((20.1, True), (19.9, False)):
        body = [*RAISED, "L B+90 C+0 R0 FMAX", TCPM, f"L X-30 Y+0 Z{height:+.3f} B+90 C+0 FMAX"]
        assert (found(body, scene) == []) == proven
    # Far out along the tool axis is not above.
    assert found([*RAISED, "L B+90 C+0 R0 FMAX", TCPM, "L X+300 Y+0 Z+0 B+90 C+0 FMAX"], scene)


@pytest.mark.parametrize("turn", ["", "L A-30 C+10 R0 FMAX", "L A-20 C+0 R0 FMAX", "L A-30 R0 FMAX"])
def test_rotary_axes_that_turn_on_the_way_down_are_found(turn: str) -> None:
    body = [*([turn] if turn else []), TCPM, "L X-30 Y+0 Z+100 A-30 C+0 FMAX"]
    assert [finding.code for finding in found(body, on())] == ["CF116"]


def test_a_first_pose_as_a_vector() -> None:
    words = f"X-30 Y+0 Z+100 TX+0 TY+{sin(radians(30)):.9f} TZ+{cos(radians(30)):.9f}"
    assert found(["L A-30 C+0 R0 FMAX", TCPM, f"LN {words} FMAX"], on()) == []
    assert found(["L A-29.9 C+0 R0 FMAX", TCPM, f"LN {words} FMAX"], on())
    assert found([TCPM, f"LN {words} FMAX"], on())


IN = ["L A-90 C+0 R0 FMAX", TCPM, "L X-30 Y+60 Z-50 A-90 C+0 FMAX"]
OUT = ["FUNCTION RESET TCPM", "L M140 MB MAX"]


def test_between_two_stays() -> None:
    scene = on()
    assert found([*IN, *OUT, *IN, *OUT], scene) == []
    assert posed([*IN, *OUT, *IN, *OUT], scene).program.unknown_moves == 0


@pytest.mark.parametrize(
    ("body", "why"),
    [
        ([*IN, "FUNCTION RESET TCPM", *IN], "not fully retracted"),
        ([*IN, "L M140 MB MAX", *IN[:1], "L X-30 Y+60 Z-50 A-90 C+0 FMAX"], "does not follow"),
        ([*IN, *OUT, IN[0].replace("FMAX", "F1000"), *IN[1:]], "feed move"),
        ([*IN, "FUNCTION RESET TCPM", "L Z+100 R0 FMAX M91", *IN], "below the machine's retract height"),
        ([*IN, "FUNCTION RESET TCPM", "L Z+500 R0 F1000 M91", *IN], "feed move in machine coordinates"),
        ([*IN, "FUNCTION RESET TCPM", "L X+0 Y+0 R0 FMAX M91", *IN], "not retracted"),
        ([*IN, *OUT, "L Z+500 R0 FMAX M92", *IN], "M92"),
        ([*IN, "L Y+19 F500", "FUNCTION RESET TCPM", "TOOL CALL 1 Z S3000", "L M140 MB MAX", *IN], "a tool is called"),
    ],
)
def test_what_is_neither_followed_nor_proven(body: list[str], why: str) -> None:
    result = posed(body, on())
    texts = [finding.text for finding in result.findings if finding.code == "CF116"]
    assert texts and why in texts[0]
    assert result.program.unknown_moves >= 1


@pytest.mark.parametrize(
    "body",
    [
        [*IN, "FUNCTION RESET TCPM", "L Z+500 R0 FMAX M91", *IN],
        [*IN, *OUT, "L X+100 Y+100 R0 FMAX M91", *IN],
        [*IN, *OUT, "TOOL CALL 1 Z S3000", *IN],
        [*IN, "FUNCTION RESET TCPM", "TOOL CALL 1 Z S3000", "L M140 MB MAX", *IN],
    ],
)
def test_retracts_that_are_certain(body: list[str]) -> None:
    assert found(body, on()) == []


def test_the_retract_height_of_the_machine_file_counts() -> None:
    text = edited('retract = "M140"', 'retract = "M91"\nretract_z_mm = 450.0')
    body = [*IN, "FUNCTION RESET TCPM", "L Z+450 R0 FMAX M91", *IN]
    assert found(body, on(definition=text)) == []
    assert found(body, on())
    assert found([line.replace("Z+450", "Z+449") for line in body], on(definition=text))


def test_a_retract_goes_on_until_it_is_above_everything() -> None:
    """A wall 300 mm high beside the tool: 200 mm of retract would end beside it."""
    scene = on(check=block_of((40, 0, -3), (41, 20, 300)))
    result = posed(["L X-30 Y+0 Z+301 R0 FMAX", "L Z+10 FMAX", "L M140 MB MAX"], scene)
    assert result.poses.tip[-1] == pytest.approx([-30.0, 0.0, 301.0])
    low = posed(["L X-30 Y+0 Z+301 R0 FMAX", "L Z+200 FMAX", "L M140 MB MAX"], scene)
    assert low.poses.tip[-1] == pytest.approx([-30.0, 0.0, 400.0])


def test_the_number_of_unknown_moves_is_printed() -> None:
    for body, line in ((IN, "no move"), ([*IN, "FUNCTION RESET TCPM", *IN], "1 move whose way is neither")):
        assert f"unknown       {line}" in judgement(verify_program(program(body), on(), "", 500))


# --- a tilted head --------------------------------------------------------------------------------------------------


def test_a_tilted_head_retracts_both_ways_and_is_not_retracted() -> None:
    body = ["L B+30 C+0 R0 FMAX", TCPM, "L X-30 Y+0 Z+60 B+30 C+0 FMAX", "FUNCTION RESET TCPM", "L M140 MB MAX"]
    result = posed([*RAISED, *body], on("head-table"))
    start = np.array([-30.0, 0.0, 60.0])
    ends = [start + 200.0 * np.array([sin(radians(30)), 0.0, cos(radians(30))]), start, start + 200.0 * UP]
    np.testing.assert_allclose(result.poses.tip, [start, *ends], atol=1e-9)
    assert result.poses.moves.joined.tolist() == [False, True, False, True]
    assert found([*RAISED, *body], on("head-table")) == []
    again = found([*RAISED, *body, *body], on("head-table"))
    assert len(again) == 1 and "not fully retracted" in again[0].text
    upright = [*body[:3], "L B+0 FMAX", *body[3:]]
    assert found([*RAISED, *upright, *body], on("head-table")) == []


# --- the machine is known -------------------------------------------------------------------------------------------

ZERO = (10.0, -20.0, 120.0)


def nose_of(result: PosedProgram, rows: slice) -> np.ndarray:
    moves = result.poses.moves
    return result.machine.nose(moves.point[rows], result.rotary[rows], np.array(ZERO), LENGTH)


def test_a_retract_ends_at_the_first_limit_along_the_tool_axis() -> None:
    """B60 over X up to 600: from x0 the nose goes (600 - x0) / sin 60 along the axis, or straight up to 900."""
    scene = on("head-table", zero=ZERO)
    entry = "L X-30 Y+0 Z+60 B+60 C+0 FMAX"
    result = posed(["L B+60 C+0 R0 FMAX", TCPM, entry, "FUNCTION RESET TCPM", "L M140 MB MAX"], scene)
    # Pivot 150 mm above the nose.
    arm = 150.0 + LENGTH
    x, z = -30.0 + ZERO[0] + arm * sin(radians(60)), 60.0 + ZERO[2] + arm * cos(radians(60)) - 150.0
    along = min((600.0 - x) / sin(radians(60)), (900.0 - z) / cos(radians(60)))
    axis = np.array([sin(radians(60)), 0.0, cos(radians(60))])
    np.testing.assert_allclose(result.poses.tip[1], np.array([-30.0, 0.0, 60.0]) + along * axis, atol=1e-9)
    assert nose_of(result, slice(1, 2))[0] == pytest.approx([600.0, -20.0, z + along * cos(radians(60))])
    # Straight up is looked at as well: it is above everything all the way, as the start is.
    assert len(result.poses.tip) == 2


def test_a_table_that_turns_at_rest_takes_the_tool_along_an_arc() -> None:
    """No retract before C+90: the part turns under the tool, which goes around the table's axis on it."""
    body = ["L A+0 C+0 R0 FMAX", "L X+60 Y+0 Z+5 R0 FMAX", "L Z-5 FMAX", "L A+0 C+90 R0 FMAX", "L M140 MB MAX"]
    assert found(body, on()) != []
    scene = on(zero=ZERO)
    assert found(body, scene) == []
    result = posed(body, scene)
    tip = result.poses.tip
    # The table's axis is at machine x = y = 0: at -zero in the program's frame.
    centre = -np.array(ZERO[:2])
    start = np.array([60.0, 0.0])
    radius = np.linalg.norm(start - centre)
    turning = result.poses.moves.block == [move.block for move in result.program.unknown if move.kind == "turn"][-1]
    arc = tip[turning]
    np.testing.assert_allclose(np.linalg.norm(arc[:, :2] - centre, axis=1), radius, atol=1e-9)
    end = centre + Rotation.from_euler("z", 90, degrees=True).as_matrix()[:2, :2] @ (start - centre)
    np.testing.assert_allclose(arc[-1], [*end, -5.0], atol=1e-9)
    # Between two poses it goes straight: no more than CHORD off the arc.
    middle = 0.5 * (arc[1:] + arc[:-1])
    assert np.abs(np.linalg.norm(middle[:, :2] - centre, axis=1) - radius).max() < 0.0101
    assert np.abs(np.diff(result.rotary[turning], axis=0)).max() <= radians(2.0) + 1e-12


def test_a_retract_with_a_head_that_may_stand_anywhere() -> None:
    """Nothing positions the axes before the first vector: the machine's Z is not known on the part."""
    vector = f"TX+0 TY+{sin(radians(30)):.9f} TZ+{cos(radians(30)):.9f}"
    body = [TCPM, f"LN X-30 Y+0 Z+100 {vector} FMAX", "FUNCTION RESET TCPM", "L M140 MB MAX"]
    result = posed(body, on("head-table"))
    assert np.isfinite(result.poses.tip).all()
    assert [finding.block for finding in result.findings if finding.code == "CF116"] == [17, 19]


@pytest.mark.parametrize("left_out", [None, "L B+0 C+0 R0 FMAX", "L M140 MB MAX"])
def test_after_a_tool_change_the_head_turns_upright_before_the_retract_that_counts(left_out: str | None) -> None:
    """Where the head stands after a tool change is not in the text: M140 might go anywhere along it."""
    body = [*(block for block in RAISED if block != left_out), "L B+30 C+0 R0 FMAX", TCPM]
    body += ["L X+0 Y+0 Z+300 B+30 C+0 R0 FMAX", "L Z+320 F500"]
    findings = posed(body, on("head-table")).findings
    assert [finding.code for finding in findings] == ([] if left_out is None else ["CF116"])


@pytest.mark.parametrize("turns", [(0.03, 0.0), (0.0, 0.03), (0.02, 0.01), (0.015, -0.015)])
def test_between_two_poses_nothing_rises_more_than_the_sagitta(turns: tuple[float, float]) -> None:
    """Points turned by both tables at once, against the chord between the ends."""
    rng = np.random.default_rng(7)
    share = np.linspace(0.0, 1.0, 101)
    worst, most = 0.0, 0.0
    for _ in range(50):
        point, start = rng.normal(size=3) * 100.0, rng.uniform(-3.0, 3.0, 2)
        turned = start + share[:, None] * np.array(turns)
        place = (
            Rotation.from_rotvec(turned[:, 1:] * [1.0, 0.0, 0.0]) * Rotation.from_rotvec(turned[:, :1] * UP)
        ).apply(point)
        chord = place[0] + share[:, None] * (place[-1] - place[0])
        bound = float(sagitta(float(np.linalg.norm(point)), np.array([np.abs(turns).sum()]))[0])
        off = float(np.linalg.norm(place - chord, axis=1).max())
        assert off <= bound
        worst, most = max(worst, off / bound), max(most, off)
    # It is no wide guess either: where one axis turns some point comes close to it.
    assert most > 0.0 and (0.0 not in turns or worst > 0.9)


def test_what_stands_on_the_arc_is_hit() -> None:
    body = ["L A+0 C+0 R0 FMAX", "L X+60 Y+0 Z+50 R0 FMAX", "L Z-5 FMAX", "L A+0 C+90 R0 FMAX", "L M140 MB MAX"]
    centre = -np.array(ZERO[:2])
    there = centre + Rotation.from_euler("z", 45, degrees=True).as_matrix()[:2, :2] @ (np.array([60.0, 0.0]) - centre)
    for place, code in ((there, True), (there + 8.0, False)):
        post = block_of([*(place - 1.0), -10.0], [*(place + 1.0), 10.0])
        scene = on(check=post, zero=ZERO)
        codes = {finding.code for finding in verify_program(program(body), scene, "", 500).findings}
        assert ("CF203" in codes) == code, place


def test_machine_coordinates_are_followed() -> None:
    body = ["L X+60 Y+0 Z+5 R0 FMAX", "L Z-5 FMAX", "L X-100 Y+50 Z+260 R0 FMAX M91", "L M140 MB MAX"]
    result = posed(body, on(zero=ZERO))
    assert [finding for finding in result.findings if finding.code == "CF116"] == []
    there = np.array([-100.0, 50.0, 260.0 - LENGTH]) - ZERO
    assert np.abs(result.poses.tip - there).max(axis=1).min() < 1e-9


@pytest.mark.parametrize(("height", "proven"), [(275.0, True), (265.0, False)])
def test_a_tool_change_from_a_known_place(height: float, proven: bool) -> None:
    """The tip is LENGTH below the nose, the plane at machine Z 120: above it from 270 on."""
    body = [
        "L X+60 Y+0 Z+5 R0 FMAX",
        f"L X-100 Y+50 Z{height:+.1f} R0 FMAX M91",
        "TOOL CALL 1 Z S3000",
        "L M140 MB MAX",
    ]
    assert (found(body, on(zero=ZERO)) == []) == proven


def test_from_a_known_place_to_a_pose_that_is_not_above() -> None:
    """From the limit straight to a pose below the top of a block: followed, and what is in the way is hit."""
    down = "L X+60 Y+0 Z+5 R0 FMAX"
    body = ["L X-60 Y+0 Z+40 R0 FMAX", "L M140 MB MAX", down]
    free = on(check=block_of((-20, 0, -3), (-10, 20, 30)), zero=ZERO)
    assert found(body, free) == []
    result = posed(body, free)
    assert result.poses.moves.joined[-1] and nose_of(result, slice(-2, -1))[0, 2] == pytest.approx(500.0)
    # Halfway down the straight line is at x = 0 and (500 - 150 - 120 + 5) / 2.
    half = (500.0 - LENGTH - ZERO[2] + 5.0) / 2.0
    blocked = on(check=block_of((-2, -2, -3), (2, 2, half)), zero=ZERO)
    codes = {finding.code for finding in verify_program(program(body), blocked, "", 500).findings}
    assert "CF203" in codes
    # Where the machine is not known it is not proven.
    assert found(body, on(check=block_of((-20, 0, -3), (-10, 20, 30))))


# --- the job's machine ----------------------------------------------------------------------------------------------


def codes_of(text: str, scene: Scene) -> list[str]:
    return [finding.code for finding in pose_program(text, scene).findings]


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("; MACHINE ac-table", "; MACHINE bc-table"),
        ("; PART part FACE 0", "; PART other FACE 0"),
        ("; PART part FACE 0", "; PART part FACE 0,3"),
        ("; STYLE tcpm", "; ROTARY C 0 0 -1\r\n1 ; ROTARY A 1 0 0"),
        ("; STYLE tcpm", "; ROTARY A 1 0 0\r\n1 ; ROTARY C 0 0 1"),
    ],
)
def test_a_header_of_another_machine_or_part_is_a_contradiction(old: str, new: str) -> None:
    scene = scene_of(FLANK)
    assert "CF110" not in codes_of(flank_program(), scene)
    assert "CF110" in codes_of(flank_program().replace(old, new), scene)


def test_rotary_words_are_read_by_the_jobs_machine_whatever_the_header_says() -> None:
    """C turns the other way: t = (-sin C sin A, -cos C sin A, cos A)."""
    text = edited("vector = [0.0, 0.0, 1.0]", "vector = [0.0, 0.0, 1.0]\nsign = -1").replace("ac-table", "shop-ac")
    body = ["L A-30 C+40 R0 FMAX", TCPM, "L X+0 Y+0 Z+100 A-30 C+40 FMAX"]
    a, c = radians(-30), radians(40)
    other = on(definition=text)
    for head in (header(), [line for line in header() if "MACHINE" not in line]):
        result = pose_program(program(body, head), other)
        np.testing.assert_allclose(result.poses.axis[0], [-sin(c) * sin(a), -cos(c) * sin(a), cos(a)], atol=1e-12)
        assert ("CF110" in [finding.code for finding in result.findings]) == ("; MACHINE ac-table" in head)
    np.testing.assert_allclose(posed(body, on()).poses.axis[0], [sin(c) * sin(a), -cos(c) * sin(a), cos(a)], atol=1e-12)


def test_an_axis_that_the_machine_does_not_have() -> None:
    body = ["L B-30 C+40 R0 FMAX", TCPM, "L X+0 Y+0 Z+100 B-30 C+40 FMAX"]
    findings = posed(body, on()).findings
    assert {"CF110", "CF108"} & {finding.code for finding in findings}


@pytest.mark.parametrize(("word", "code"), [("A+30", []), ("A+30.001", ["CF401"]), ("A-121", ["CF401"])])
def test_words_out_of_the_range_of_their_axis(word: str, code: list[str]) -> None:
    body = [f"L {word} C+0 R0 FMAX", TCPM, f"L X+0 Y+0 Z+200 {word} C+0 FMAX"]
    result = found(body, on(), "CF401")
    assert [finding.code for finding in result] == code
    if code:
        assert result[0].amount == pytest.approx(float(word[1:]))
        assert (result[0].limit, result[0].unit, result[0].count) == ((30.0 if "+" in word else -120.0), "deg", 2)
    # Positioning off the part counts as well.
    assert [finding.code for finding in found(body[:1], on(), "CF401")] == code


def test_the_shorter_way_is_for_axes_within_one_turn() -> None:
    """M126 acts on C, whose display is reduced to 0 .. 360, and not on A, which counts from -110 to 110 degrees."""
    text = edited("range_deg = [-120.0, 30.0]", "range_deg = [-110.0, 110.0]")
    place = "X+0 Y+0 Z+300"
    body = ["M126", "L A-100 C+350 R0 FMAX", TCPM, f"L {place} A-100 C+350 FMAX", f"L {place} A+100 C+10 F500"]
    result = posed(body, on(definition=text))
    np.testing.assert_allclose(np.degrees(result.rotary), [[350.0, -100.0], [370.0, 100.0]])
    assert [finding for finding in result.findings if finding.code == "CF401"] == []


@pytest.mark.parametrize("tilt", [29.0, 31.0])
def test_vectors_out_of_range(tilt: float) -> None:
    """A vector that A+31 would reach is reached by the other solution, C half a turn on, if that is in range."""
    text = edited("range_deg = [-120.0, 30.0]", "range_deg = [-20.0, 30.0]")
    vector = f"TX+0 TY{-sin(radians(tilt)):+.9f} TZ{cos(radians(tilt)):+.9f}"
    body = ["L A+29 C+0 R0 FMAX", TCPM, "LN X+0 Y+0 Z+200 TX+0 TY-0.484809620 TZ+0.874619707 FMAX"]
    result = found([*body, f"LN X+0 Y+0 Z+200 {vector} F500"], on(definition=text), "CF401")
    assert (result == []) == (tilt < 30.0)


def test_travel_on_the_text() -> None:
    """Table-table, upright: nose = tip + zero + L z; X up to 400."""
    scene = on(zero=ZERO)
    body = ["L X+380 Y+0 Z+40 R0 FMAX", "L X+391.5 Y-5 F500", "L X+300 F500"]
    (finding,) = found(body, scene, "CF402")
    assert (finding.amount, finding.limit, finding.unit) == (pytest.approx(401.5), 400.0, "mm")
    assert finding.text.startswith("X")
    assert found([line.replace("391.5", "390") for line in body], scene, "CF402") == []
    assert found(body, on(), "CF402") == []
    deep = found(["L X+0 Y+0 Z+40 R0 FMAX", "L Z-371 F500"], scene, "CF402")
    assert [(item.text[0], item.limit) for item in deep] == [("Z", -100.0)]


# --- posted programs ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["ac-table", "bc-table"])
@pytest.mark.parametrize("style", ["tcpm", "m128", "ln"])
def test_posted_programs_for_tables_have_ways_that_are_proven(name: str, style: str) -> None:
    scene = posted_scene(name, style)
    text, _ = post_program(scene, [sweep()])
    result = pose_program(text, scene)
    assert [finding for finding in result.findings if finding.code in ("CF110", "CF116", "CF401", "CF402")] == []
    assert result.program.unknown_moves == 0


def posted_scene(name: str, style: str, **keys: object) -> Scene:
    scene = pattern_scene()
    job = msgspec.structs.replace(
        scene.job,
        machine=Machine(name=name, **keys),
        program=msgspec.structs.replace(scene.job.program, style=style),
    )
    return Scene(job, scene.part_name, scene.faces, scene.tools, scene.mesh, {})


def test_each_first_move_of_a_posted_program_is_needed() -> None:
    """Without the rapid to the safe plane, the turn before it, or the retract, the way is not proven any more."""
    scene = posted_scene("ac-table", "tcpm")
    lines = post_program(scene, [sweep()])[0].splitlines(keepends=True)
    needed = [k for k, line in enumerate(lines) if "M140" in line or " R0 FMAX" in line]
    first = [k + 1 for k, line in enumerate(lines) if line.split(" ", 1)[1].startswith("; APPROACH")]
    checked = 0
    # The retract after a tool change finds the tool retracted; nothing comes after the last one.
    for k in (*needed[1:-1], *first):
        result = pose_program("".join(lines[:k] + lines[k + 1 :]), scene)
        assert "CF116" in {finding.code for finding in result.findings}, lines[k]
        checked += 1
    assert checked >= 8


def test_posted_programs_on_a_known_machine() -> None:
    """All of it is followed, and the limits of travel hold."""
    scene = posted_scene("ac-table", "tcpm", zero=(0.0, 0.0, 150.0), gauge_length={"T1": LENGTH})
    text, _ = post_program(scene, [sweep()])
    result = pose_program(text, scene)
    assert [finding for finding in result.findings if finding.code in ("CF110", "CF116", "CF401", "CF402")] == []
    own = result.poses.moves.cut < 0
    nose = result.machine.nose(result.poses.moves.point, result.rotary, np.array([0.0, 0.0, 150.0]), LENGTH)
    assert nose[own][:, 2].max() <= 500.0 + 1e-6
