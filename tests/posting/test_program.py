import re
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import msgspec
import numpy as np
import pytest
from scipy.interpolate import make_lsq_spline
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation, Slerp

from conflank_cli.errors import InputError
from conflank_cli.geometry.face import CheckMesh, DesignFace
from conflank_cli.geometry.surface import BSplineSurface
from conflank_cli.job import parse_job
from conflank_cli.machine_frame import machine_of
from conflank_cli.motion import Motion, uniform_knots
from conflank_cli.once import Once
from conflank_cli.posting import plan_to_toolpath, post_program, summarize
from conflank_cli.scene import Scene
from conflank_cli.sweep import Sweep
from conflank_cli.tool import CATALOGUE
from postprocessors.kinematics.visits import visits_with_words
from postprocessors.machines import machine as machines
from postprocessors.machines.machine import load_machine
from postprocessors.toolpath import Purpose, Stretch, ToolPath

JOB = """
[part]
file = "plate.step"
[[part.design]]
face = 4
[tools]
use = ["T1", "T3"]
"""
SQUARE = (np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]),)
CLAMPED = np.array([0.0, 0.0, 1.0, 1.0])


def scene_of(extra: str = "", check: np.ndarray | None = None) -> Scene:
    """A plane x = 0 (y 0 .. 60, z 0 .. 30) with the metal at x > 0: the cutter works from the west."""
    job = parse_job((JOB + extra).encode(), "job.toml", Path())
    poles = np.array([[[0.0, y, z] for z in (0.0, 30.0)] for y in (0.0, 60.0)])
    face = DesignFace(4, "", BSplineSurface(1, 1, CLAMPED, CLAMPED, poles), SQUARE, -1)
    vertices = np.zeros((0, 3)) if check is None else check
    mesh = CheckMesh(vertices, np.zeros((0, 3), dtype=np.int32), np.zeros(0, dtype=np.int32))
    return Scene(job, "plate", (face,), (CATALOGUE["T1"], CATALOGUE["T3"]), Once(lambda: mesh), {})


def motion_of(tip: np.ndarray, axis: np.ndarray, tool: str, count: int = 14) -> Motion:
    """A motion fitted to tips and axes (N, 3) at even times."""
    t = np.linspace(0.0, 1.0, len(tip))
    height = CATALOGUE[tool].tip_height
    p = tip - height * axis
    q = p + CATALOGUE[tool].length * axis
    knots = uniform_knots(count)
    fit = make_lsq_spline(t, np.hstack([p, q]), knots).c
    return Motion(knots, np.ascontiguousarray(fit[:, :3]), np.ascontiguousarray(fit[:, 3:]))


def twisted(tool: str = "T1", tilt: float = 0.6) -> Sweep:
    t = np.linspace(0.0, 1.0, 300)
    tip = np.stack([-3.0 - 4.0 * np.sin(2.0 * t), 60.0 * t, 2.0 + 6.0 * t**2], axis=1)
    lean, turn = tilt + 0.3 * t, 2.5 * t
    axis = np.stack([-np.sin(lean) * np.cos(turn), np.sin(lean) * np.sin(turn), np.cos(lean)], axis=1)
    return Sweep(0, tool, motion_of(tip, axis, tool))


def upright(northward: bool = True) -> Sweep:
    """The cone tangent to the plane x = 0 with its axis leaned west by its half angle, driven along y."""
    tool = CATALOGUE["T1"]
    t = np.linspace(0.0, 1.0, 50)
    axis = np.tile([-np.sin(tool.half_angle), 0.0, np.cos(tool.half_angle)], (50, 1))
    p = np.stack([np.full(50, -tool.r_min * np.cos(tool.half_angle)), 60.0 * t, np.full(50, 2.0)], axis=1)
    tip = p + tool.tip_height * axis
    return Sweep(0, "T1", motion_of(tip if northward else tip[::-1], axis, "T1"))


def stretches_of(path: ToolPath, purpose: Purpose) -> list[Stretch]:
    return [s for operation in path.operations for s in operation.stretches if s.purpose is purpose]


AC = load_machine("ac-table")


def pose_distance(tool: str, motion: Motion, tip: np.ndarray, axis: np.ndarray) -> float:
    """Largest distance (mm), at the tip or at r_max, of poses (N, 3) from the exact motion's nearest pose."""
    cutter = CATALOGUE[tool]
    reach = cutter.length - cutter.tip_height
    p, q = motion.ends(np.linspace(0.0, 1.0, 20001))
    d = (q - p) / np.linalg.norm(q - p, axis=1, keepdims=True)
    low = p + cutter.tip_height * d
    exact = np.hstack([low, low + reach * d])
    posted = np.hstack([tip, tip + reach * axis])
    nearest = cKDTree(exact).query(posted)[1]
    worst = np.full(len(tip), np.inf)
    for neighbour in (nearest - 1, nearest):
        start = np.clip(neighbour, 0, len(exact) - 2)
        chord = exact[start + 1] - exact[start]
        share = np.clip(((posted - exact[start]) * chord).sum(1) / (chord * chord).sum(1), 0.0, 1.0)[:, None]
        error = posted - exact[start] - share * chord
        ends = np.maximum(np.linalg.norm(error[:, :3], axis=1), np.linalg.norm(error[:, 3:], axis=1))
        worst = np.minimum(worst, ends)
    return float(worst.max())


def test_a_motion_longer_than_its_tool_is_posted_where_its_gap_is_computed() -> None:
    """The swept gap puts the cone at p; |pq| may be off by micrometres."""
    sweep = upright()
    motion = sweep.motion
    longer = replace(sweep, motion=replace(motion, q=motion.q + 0.005 * (motion.q - motion.p) / 24.0))
    (stretch,) = stretches_of(post_program(scene_of(""), [longer])[1], Purpose.SWEEP)
    assert pose_distance("T1", motion, stretch.tip, stretch.axis) < 1e-5


@pytest.mark.parametrize("setup", ["", "[setup]\nrotate_deg = [20.0, -35.0, 110.0]\ntranslate = [5.0, -40.0, 12.5]\n"])
@pytest.mark.parametrize(("tool", "tilt"), [("T1", 0.6), ("T3", 0.25)])
def test_the_printed_program_stays_within_half_a_micrometre(setup: str, tool: str, tilt: float) -> None:
    """Numbers read from the text, interpolated by SciPy's Slerp and by words, against the motion itself."""
    sweep = twisted(tool, tilt)
    text, path = post_program(scene_of(setup), [sweep])
    rotation, shift = np.eye(3), np.zeros(3)
    if setup:
        a, b, c = np.radians([20.0, -35.0, 110.0])
        about_x = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
        about_y = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
        about_z = np.array([[np.cos(c), -np.sin(c), 0], [np.sin(c), np.cos(c), 0], [0, 0, 1]])
        rotation, shift = about_x @ about_y @ about_z, np.array([5.0, -40.0, 12.5])
        assert "; FRAME ROTATE 20 -35 110 TRANSLATE 5 -40 12.5\r\n" in text
    else:
        assert "; FRAME CAD\r\n" in text
    before, _, after = text.partition("; SWEEP 1\r\n")
    lines = [before.splitlines()[-2], *after.partition("; RETRACT")[0].splitlines()]
    numbers = re.findall(r"L X(\S+) Y(\S+) Z(\S+) A(\S+) C(\S+)", "\n".join(lines))
    block = np.array(numbers, dtype=np.float64)
    assert len(block) == len(stretches_of(path, Purpose.SWEEP)[0].tip)
    words = np.stack([block[:, 3], np.degrees(np.unwrap(np.radians(block[:, 4])))], axis=1)
    share = np.linspace(0.0, 1.0, 21)
    place = (np.arange(len(block) - 1)[:, None] + share).ravel()
    at = np.arange(len(block), dtype=np.float64)
    tip = np.stack([np.interp(place, at, block[:, column]) for column in range(3)], axis=1)
    table = Rotation.from_euler("ZX", words[:, ::-1], degrees=True)
    fine = np.stack([np.interp(place, at, words[:, column]) for column in (1, 0)], axis=1)
    by_words = Rotation.from_euler("ZX", fine, degrees=True).apply([0.0, 0.0, 1.0])
    ends = table.apply([0.0, 0.0, 1.0])
    # The least rotation from each axis to the next, so that Slerp moves the axis on the great circle.
    by_circle = np.empty_like(tip)
    for index in range(len(ends) - 1):
        cross = np.cross(ends[index], ends[index + 1])
        turn = Rotation.from_rotvec(cross / np.linalg.norm(cross) * np.arcsin(np.linalg.norm(cross)))
        path_of_axis = Slerp([0.0, 1.0], Rotation.concatenate([Rotation.identity(), turn]))
        by_circle[index * 21 : index * 21 + 21] = path_of_axis(share).apply(ends[index])
    for axis in (by_words, by_circle):
        error = pose_distance(tool, sweep.motion, (tip - shift) @ rotation, axis @ rotation)
        assert error < 0.5e-3
    # Too many blocks would pass as well; the budget has to be used.
    assert error > 0.2e-3


def test_an_arc_gets_the_blocks_its_sagitta_asks_for() -> None:
    radius, t = 80.0, np.linspace(0.0, 1.0, 400)
    tip = np.stack([radius * np.cos(0.8 * t) - radius, radius * np.sin(0.8 * t), np.full(400, 3.0)], axis=1)
    sweep = Sweep(0, "T1", motion_of(tip, np.tile([0.0, 0.0, 1.0], (400, 1)), "T1", 20))
    blocks = len(stretches_of(plan_to_toolpath(scene_of(), [sweep], AC), Purpose.SWEEP)[0].tip) - 1
    needed = 0.8 * radius / np.sqrt(8.0 * radius * 0.3e-3)
    assert needed <= blocks <= 1.05 * needed + 1


def test_blocks_beside_each_other_are_about_as_long() -> None:
    """At each inflection of the wave the sagitta alone would allow a block of many times the length."""
    t = np.linspace(0.0, 1.0, 400)
    tip = np.stack([-6.0 - 3.0 * np.sin(9.0 * t), 60.0 * t, np.full(400, 3.0)], axis=1)
    sweep = Sweep(0, "T1", motion_of(tip, np.tile([0.0, 0.0, 1.0], (400, 1)), "T1", 40))
    posted = stretches_of(plan_to_toolpath(scene_of(), [sweep], AC), Purpose.SWEEP)[0]
    length = np.linalg.norm(np.diff(posted.tip, axis=0), axis=1)
    assert length.max() > 2.5 * length.min()
    ratio = length[1:] / length[:-1]
    assert max(ratio.max(), 1.0 / ratio.min()) < 1.3


def test_a_straight_sweep_is_one_block() -> None:
    path = plan_to_toolpath(scene_of(), [upright()], AC)
    assert len(stretches_of(path, Purpose.SWEEP)[0].tip) == 2


@pytest.mark.parametrize("northward", [True, False])
@pytest.mark.parametrize("cutting", ["climb", "conventional"])
def test_teeth_run_against_the_feed_when_climbing(northward: bool, cutting: str) -> None:
    """A tooth at the contact is turned by the spindle (clockwise from above) and its step compared with the feed."""
    path = plan_to_toolpath(scene_of(f'[program]\ncutting = "{cutting}"\n'), [upright(northward)], AC)
    sweep = stretches_of(path, Purpose.SWEEP)[0]
    feed = sweep.tip[-1] - sweep.tip[0]
    centre = sweep.tip[0] + 12.0 * sweep.axis[0]
    tooth = np.array([0.0, centre[1], centre[2]]) - centre
    tooth_step = Rotation.from_rotvec(-0.01 * sweep.axis[0]).apply(tooth) - tooth
    assert (tooth_step @ feed < 0.0) == (cutting == "climb")
    # With the metal east of an upright tool, climb milling runs north.
    assert (feed[1] > 0.0) == (cutting == "climb")


def test_approach_comes_from_outside_along_the_axis_and_off_the_face() -> None:
    obstacle = np.array([[40.0, 30.0, 15.0], [-40.0, 30.0, 90.0]])
    scene = scene_of("[program]\nsafe = {clearance = 7.0}\n", obstacle)
    path = plan_to_toolpath(scene, [twisted()], AC)
    approach, sweep, retract = (stretches_of(path, p)[0] for p in (Purpose.APPROACH, Purpose.SWEEP, Purpose.RETRACT))
    corners = np.vstack([obstacle, [[0.0, y, z] for y in (0.0, 60.0) for z in (0.0, 30.0)]])
    for link, pose in ((approach, 0), (retract, -1)):
        forth = slice(None) if link is approach else slice(None, None, -1)
        tip, axis = link.tip[forth], link.axis[forth]
        np.testing.assert_array_equal(tip[-1], sweep.tip[pose])
        np.testing.assert_array_equal(axis[-1], sweep.axis[pose])
        # Everything lies at least the clearance below the plane where the tool waits; down from it goes the axis.
        assert ((tip[0] - corners) @ axis[0]).min() >= 7.0 - 1e-9
        np.testing.assert_array_equal(axis[0], axis[1])
        np.testing.assert_allclose(np.cross(tip[0] - tip[1], axis[0]), 0.0, atol=1e-9)
        # Beside the face the middle of the flute is off by the radius of the arc where the sweep, gone straight on,
        # would have taken it.
        middle, cut = tip + 12.0 * axis, sweep.tip + 12.0 * sweep.axis
        along = cut[1] - cut[0] if pose == 0 else cut[-1] - cut[-2]
        along /= np.linalg.norm(along)
        beside = middle[1] - middle[-1]
        beside -= beside @ along * along
        assert np.linalg.norm(beside) == pytest.approx(7.0, abs=2.0) and beside[0] < -3.0
    assert approach.feed[0] == approach.feed[1] == 0.0 and retract.feed[-1] == 0.0
    assert (approach.feed[2:] > 0.0).all() and (retract.feed[:-1] > 0.0).all()


@pytest.mark.parametrize("backwards", [False, True])
def test_arcs_meet_the_sweep_as_if_it_had_gone_on(backwards: bool) -> None:
    """At both joints both ends of the flute keep their direction and, in proportion, their speeds."""
    scene = scene_of(f'[program]\ncutting = "{"conventional" if backwards else "climb"}"\n')
    path = plan_to_toolpath(scene, [twisted()], AC)
    approach, sweep, retract = (stretches_of(path, p)[0] for p in (Purpose.APPROACH, Purpose.SWEEP, Purpose.RETRACT))
    reach = CATALOGUE["T1"].length - CATALOGUE["T1"].tip_height
    for before, after in ((approach, sweep), (sweep, retract)):
        steps = []
        for height in (0.0, reach):
            a, b = (s.tip + height * s.axis for s in (before, after))
            steps.append((a[-1] - a[-2], b[1] - b[0]))
        speeds = [np.linalg.norm(second) / np.linalg.norm(first) for first, second in steps]
        assert speeds[0] == pytest.approx(speeds[1], rel=0.05)
        for first, second in steps:
            cosine = first @ second / np.linalg.norm(first) / np.linalg.norm(second)
            # Half a block of the arc, 3.75 degrees for the faster end; the slower one comes off the face as far.
            assert np.degrees(np.arccos(cosine)) < 7.0


def test_where_an_arc_would_hit_something_the_way_is_another() -> None:
    """A post stands where the tool would come from on its arc: a smaller arc, or one that lifts, stays clear of it."""
    free = stretches_of(plan_to_toolpath(scene_of(), [upright()], AC), Purpose.APPROACH)[0]
    at = free.tip[1]
    post = [[at[0], at[1], z] for z in np.arange(at[2], at[2] + 20.0, 0.25)]
    corners = np.array(post)
    scene = scene_of(check=np.zeros((0, 3)))
    triangles = np.stack([np.arange(len(post) - 2), np.arange(1, len(post) - 1), np.arange(2, len(post))], axis=1)
    mesh = CheckMesh(corners, triangles.astype(np.int32), np.zeros(len(triangles), dtype=np.int32))
    approach = stretches_of(plan_to_toolpath(scene.checking(mesh), [upright()], AC), Purpose.APPROACH)[0]
    share = np.linspace(0.0, 1.0, 50)[:, None]
    for start, end, axis in zip(approach.tip[:-1], approach.tip[1:], approach.axis[:-1], strict=True):
        for place in start + share * (end - start):
            height = (corners - place) @ axis
            off = np.linalg.norm(corners - place - height[:, None] * axis, axis=1)
            assert off[(height > 1.5) & (height < 24.0)].min(initial=np.inf) > 1.5


def test_rapids_stay_off_the_face_and_spindle_and_coolant_run_in_every_cut() -> None:
    """Along the text: no feed without M3, coolant and TCPM; rotary axes are positioned retracted and without TCPM."""
    text, _ = post_program(scene_of(), [twisted("T1"), upright(), twisted("T3")])
    spindle = coolant = tcpm = False
    retracted = False
    cutting = feeds = 0
    for line in text.splitlines():
        block = line.partition(" ")[2]
        if block.startswith("TOOL CALL"):
            assert not spindle and not coolant and not tcpm
        spindle = (spindle or block.endswith(" M3")) and block != "M5" and not block.startswith("TOOL CALL")
        coolant = (coolant or block == "M8") and block != "M9"
        if block.startswith("FUNCTION"):
            tcpm = block.startswith("FUNCTION TCPM")
        elif block.startswith("L M140"):
            assert not tcpm
            retracted = True
        elif block.startswith("; SWEEP"):
            cutting += 1
        elif block.startswith("; RETRACT"):
            cutting -= 1
        elif block.startswith("L X"):
            assert tcpm and spindle
            # From the full retract the first way under TCPM goes to the safe plane, by rapid.
            assert "FMAX" in block or not retracted
            retracted = False
            if "FMAX" not in block:
                assert coolant
                feeds += 1
            assert not (cutting and "FMAX" in block)
        elif block.startswith("L "):
            assert retracted and not tcpm, block
    assert feeds > 100 and not cutting and not spindle and not coolant and not tcpm


def test_the_fastest_point_of_the_flute_has_the_tools_feed() -> None:
    sweep = stretches_of(plan_to_toolpath(scene_of(), [twisted()], AC), Purpose.SWEEP)[0]
    tool = CATALOGUE["T1"]
    heights = np.linspace(0.0, tool.length - tool.tip_height, 40)
    steps = np.stack([np.linalg.norm(np.diff(sweep.tip + h * sweep.axis, axis=0), axis=1) for h in heights])
    minutes = steps[0] / sweep.feed[1:]
    # Feeds are whole numbers and coordinates are rounded, so that one of 500 is right to two thousandths.
    np.testing.assert_allclose((steps / minutes).max(axis=0), tool.feed_mm_min, rtol=0.002 + 1.0 / sweep.feed.min())
    at_tip = scene_of('[program]\nfeed = "tip"\n')
    sweep = stretches_of(plan_to_toolpath(at_tip, [twisted()], AC), Purpose.SWEEP)[0]
    np.testing.assert_array_equal(sweep.feed, tool.feed_mm_min)


def test_rotary_speed_limits_the_feed() -> None:
    slow = replace_speed(20.0)
    sweep = stretches_of(plan_to_toolpath(scene_of(), [twisted()], slow), Purpose.SWEEP)[0]
    azimuth = np.unwrap(np.arctan2(sweep.axis[:, 0], -sweep.axis[:, 1]))
    minutes = np.linalg.norm(np.diff(sweep.tip, axis=0), axis=1) / sweep.feed[1:]
    rate = np.degrees(np.abs(np.diff(azimuth))) / minutes
    assert rate.max() < 20.0 * (1.0 + 1e-9)
    # The feed is 7 to 50 mm/min, in whole numbers.
    assert np.median(rate) > 18.5


def test_rotary_acceleration_limits_the_feed() -> None:
    """The azimuth goes to and fro; its acceleration is that of the whole sweep at the printed feeds."""
    t = np.linspace(0.0, 1.0, 300)
    tip = np.stack([np.full(300, -3.0), 60.0 * t, np.full(300, 2.0)], axis=1)
    turn = 0.3 * np.sin(12.0 * t)
    axis = np.stack([-0.5 * np.cos(turn), 0.5 * np.sin(turn), np.full(300, np.sqrt(0.75))], axis=1)
    wavy = Sweep(0, "T1", motion_of(tip, axis, "T1", 40))
    rates = []
    for limit in (1000.0, 5.0):
        text = (Path(machines.__file__).parent / "ac-table.toml").read_text("utf-8")
        machine = machines.parse_machine(
            text.replace("max_acceleration_deg_s2 = 1000.0", f"max_acceleration_deg_s2 = {limit}"), "m"
        )
        sweep = stretches_of(plan_to_toolpath(scene_of(), [wavy], machine), Purpose.SWEEP)[0]
        azimuth = np.degrees(np.unwrap(np.arctan2(sweep.axis[:, 0], -sweep.axis[:, 1])))
        seconds = 60.0 * np.linalg.norm(np.diff(sweep.tip, axis=0), axis=1) / sweep.feed[1:]
        speed = np.diff(azimuth) / seconds
        # A straight line through five blocks: neighbours that are not limited alike differ by a step of their own.
        at = np.cumsum(seconds) - 0.5 * seconds
        rates.append(max(abs(np.polyfit(at[k : k + 5], speed[k : k + 5], 1)[0]) for k in range(len(at) - 5)))
    assert rates[0] > 20.0
    # Turning off and changing the feed may each take the whole of it; feeds are rounded.
    assert rates[1] < 2.1 * 5.0


def test_a_swing_about_the_tip_is_refused_by_block() -> None:
    """The tip all but stands while the tool turns: at 1 mm/min the table would have to be far too fast."""
    t = np.linspace(0.0, 1.0, 300)
    tip = np.stack([np.full(300, -3.0), 1e-4 * t, np.full(300, 2.0)], axis=1)
    axis = np.stack([-0.5 * np.cos(t), 0.5 * np.sin(t), np.full(300, np.sqrt(0.75))], axis=1)
    with pytest.raises(
        InputError, match=r"sweep 1 with its approach, block \d+: found .*C by .* while the tip moves 0\.0"
    ):
        post_program(scene_of(), [Sweep(0, "T1", motion_of(tip, axis, "T1"))])


def limited(c_range: str) -> machines.Machine:
    text = (Path(machines.__file__).parent / "ac-table.toml").read_text("utf-8")
    return machines.parse_machine(
        text.replace('output = "modulo"', f'output = "continuous"\nrange_deg = {c_range}'), "limited.toml"
    )


def test_a_sweep_beyond_a_range_is_left_and_taken_up_again_at_the_same_pose() -> None:
    t = np.linspace(0.0, 1.0, 400)
    tip = np.stack([-8.0 - 4.0 * np.cos(6.0 * t), 30.0 + 4.0 * np.sin(6.0 * t), np.full(400, 2.0)], axis=1)
    axis = np.stack([-0.5 * np.cos(6.0 * t), 0.5 * np.sin(6.0 * t), np.full(400, np.sqrt(0.75))], axis=1)
    turning = Sweep(0, "T1", motion_of(tip, axis, "T1", 40))
    machine = limited("[-181.0, 181.0]")
    path = plan_to_toolpath(scene_of(), [turning], machine)
    kinds = [stretch.purpose for stretch in path.operations[0].stretches]
    assert kinds in [[Purpose.APPROACH, Purpose.SWEEP, Purpose.RETRACT] * count for count in (2, 3)]
    assert {stretch.cut for stretch in path.operations[0].stretches} == {1}
    parts = stretches_of(path, Purpose.SWEEP)
    for before, after in pairwise(parts):
        np.testing.assert_allclose(before.tip[-1], after.tip[0], atol=1e-9)
        np.testing.assert_allclose(before.axis[-1], after.axis[0], atol=1e-9)
    posted = np.vstack([part.tip for part in parts]), np.vstack([part.axis for part in parts])
    assert pose_distance("T1", turning.motion, *posted) < 1e-6
    # Beginning and end are those of the whole sweep.
    ends = np.array([parts[0].tip[0], parts[-1].tip[-1]])
    assert min(np.abs(ends - tip[[0, -1]]).max(), np.abs(ends - tip[[-1, 0]]).max()) < 0.01
    for visit in visits_with_words(machine, path):
        assert np.abs(visit.words[:, 0]).max() <= 181.0 + 1e-9

    # In the text the axis unwinds while the tool is fully retracted and TCPM is off.
    job = parse_job(JOB.encode(), "job.toml", Path())
    text = (Path(machines.__file__).parent / "ac-table.toml").read_text("utf-8")
    definition = text.replace('output = "modulo"', 'output = "continuous"\nrange_deg = [-181.0, 181.0]')
    job = msgspec.structs.replace(job, machine=msgspec.structs.replace(job.machine, definition=definition))
    program, _ = post_program(replace(scene_of(), job=job), [turning])
    assert program.count("; SWEEP 1") == program.count("L M140 MB MAX") - 1 == len(parts)
    words = [float(word) for word in re.findall(r" C([+-][0-9.]+)", program)]
    assert max(np.abs(words)) <= 181.0
    jumps = [k for k, (a, b) in enumerate(pairwise(words)) if abs(b - a) > 90.0]
    lines = [line for line in program.splitlines() if re.search(r" C[+-]", line)]
    assert len(jumps) == len(parts) - 1
    assert all(" X" not in lines[k + 1] for k in jumps)


def test_a_program_that_does_not_fit_the_travel_is_not_written() -> None:
    known = "[machine]\nzero = [380.0, 0.0, 100.0]\ngauge_length = {T1 = 150.0}\n"
    with pytest.raises(
        InputError, match=r"sweep 1 with its approach, pose \d+: found [XYZ][+-].* in machine coordinates"
    ):
        post_program(scene_of(known), [twisted()])
    fits = known.replace("380.0", "10.0")
    summary = summarize(scene_of(fits).job, post_program(scene_of(fits), [twisted()])[1])
    assert summary.travel.complete and summary.travel.margin > 0.0
    summary = summarize(scene_of().job, post_program(scene_of(), [twisted()])[1])
    assert not summary.travel.complete
    assert "checked for its extent only" in dict(summary.lines())["travel"]


def test_the_summary_says_what_is_known_before_it_runs() -> None:
    scene = scene_of("[program]\ncycle32 = {t = 0.003, ta = 0.01}\n")
    path = plan_to_toolpath(scene, [twisted(), upright()], AC)
    summary = summarize(scene.job, path)
    assert [cut.cut for cut in summary.cuts] == ["sweep 1", "sweep 2"]
    for cut, sweep in zip(summary.cuts, stretches_of(path, Purpose.SWEEP), strict=True):
        way = np.linalg.norm(np.diff(sweep.tip, axis=0), axis=1)
        assert cut.blocks == len(way) and cut.length_mm == pytest.approx(way.sum())
        at_feed = 60.0 * (way / sweep.feed[1:]).sum()
        assert at_feed <= cut.seconds < 1.1 * at_feed + 0.1
        assert cut.with_links > cut.seconds + 0.05
    assert summary.seconds == pytest.approx(sum(cut.with_links for cut in summary.cuts))
    assert summary.control_mm == pytest.approx(0.003 + np.radians(0.01) * 25.5)
    assert "not verified" in dict(summary.lines())["machine"]


def replace_speed(speed: float) -> machines.Machine:
    text = (Path(machines.__file__).parent / "ac-table.toml").read_text("utf-8")
    return machines.parse_machine(text.replace("18000.0", str(speed)), "slow.toml")


def test_sweeps_keep_their_order_and_tools_change_only_where_needed() -> None:
    text, path = post_program(scene_of(), [twisted("T1"), upright(), twisted("T3"), twisted("T1")])
    assert [operation.cutter.name for operation in path.operations] == ["T1", "T3", "T1"]
    assert re.findall(r"; SWEEP (\d)", text) == ["1", "2", "3", "4"]
    assert re.findall(r"TOOL CALL (\d)", text) == ["1", "3", "1"]
    assert "; PART plate FACE 4\r\n" in text
    assert post_program(scene_of(), [twisted("T1"), upright(), twisted("T3"), twisted("T1")])[0] == text


def test_near_the_pole_blocks_get_short_only_there() -> None:
    t = np.linspace(0.0, 1.0, 300)
    tip = np.stack([np.full(300, -3.0), 60.0 * t, np.full(300, 2.0)], axis=1)
    axis = np.stack([np.full(300, 0.002), 0.4 * t - 0.2, np.ones(300)], axis=1)
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    path = plan_to_toolpath(scene_of(), [Sweep(0, "T1", motion_of(tip, axis, "T1"))], AC)
    blocks = np.diff(stretches_of(path, Purpose.SWEEP)[0].tip[:, 1])
    assert np.median(np.abs(blocks)) < np.abs(blocks[[0, -1]]).min()
    assert len(blocks) < 1500


def test_a_sweep_that_begins_beside_the_pole_is_approached_straight() -> None:
    """Gone on with, on an arc, its axis would pass the pole within a block, and C would turn by half a turn in it."""
    t = np.linspace(0.0, 1.0, 300)
    tip = np.stack([np.full(300, -3.0), 60.0 * t, np.full(300, 2.0)], axis=1)
    axis = np.stack([np.full(300, 0.002), 0.8 * t + 0.01, np.ones(300)], axis=1)
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    sweep = Sweep(0, "T1", motion_of(tip, axis, "T1"))
    text, _ = post_program(scene_of(), [sweep])
    assert "TOOL CALL" in text
    path = plan_to_toolpath(scene_of(), [sweep], AC)
    (approach,), (retract,) = stretches_of(path, Purpose.APPROACH), stretches_of(path, Purpose.RETRACT)
    np.testing.assert_allclose(approach.axis, np.broadcast_to(approach.axis[-1], approach.axis.shape), atol=1e-12)
    np.testing.assert_allclose(retract.axis, np.broadcast_to(retract.axis[0], retract.axis.shape), atol=1e-12)


def test_a_machine_file_travels_with_the_job(tmp_path: Path) -> None:
    text = (Path(machines.__file__).parent / "ac-table.toml").read_text("utf-8")
    (tmp_path / "mine.toml").write_text(text.replace('name = "ac-table"', 'name = "mine"'), "utf-8")
    job = parse_job((JOB + '[machine]\nfile = "mine.toml"\n').encode(), "job.toml", tmp_path)
    (tmp_path / "mine.toml").unlink()
    assert machine_of(job).name == "mine"


def test_bad_plans_are_named() -> None:
    with pytest.raises(InputError, match="no sweep"):
        post_program(scene_of(), [])
    with pytest.raises(InputError, match=r"sweep 2.*T9"):
        post_program(scene_of(), [upright(), replace(upright(), tool="T9")])
    with pytest.raises(InputError, match=r"sweep 1.*face 3"):
        post_program(scene_of(), [replace(upright(), face=3)])
    with pytest.raises(InputError, match=r"sweep 1, pose 1: found .*expected A -120 .. 30"):
        post_program(scene_of("[setup]\nrotate_deg = [180.0, 0.0, 0.0]\n"), [upright()])
    with pytest.raises(InputError, match="hs9"):
        post_program(scene_of('[machine]\nname = "hs9"\n'), [upright()])


def test_a_blank_is_never_too_thin() -> None:
    path = plan_to_toolpath(scene_of(), [upright()], AC)
    size = np.subtract(path.blank_high, path.blank_low)
    assert size.min() >= 1.0 and size.max() / size.min() < 200.0


@pytest.mark.parametrize(("cutting", "material"), [("climb", "right"), ("conventional", "left")])
def test_the_side_of_the_material_follows_from_the_feed(cutting: str, material: str) -> None:
    """Metal to the east: on the right of who goes north, on the left of who goes south."""
    path = plan_to_toolpath(scene_of(f'[program]\ncutting = "{cutting}"\n'), [upright()], AC)
    (sweep,) = stretches_of(path, Purpose.SWEEP)
    north = sweep.tip[-1, 1] > sweep.tip[0, 1]
    assert sweep.material == material == ("right" if north else "left")
