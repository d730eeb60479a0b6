"""Passes in the program: poses as they are, links like those of sweeps, numbers that go on from the sweeps."""

import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from conflank_cli.ball_pass import Pass
from conflank_cli.errors import InputError
from conflank_cli.machine_frame import Frame
from conflank_cli.posting import plan_to_toolpath, post_program
from conflank_cli.posting.ride import PassRide, great_circle
from conflank_cli.posting.spacing import CHORD_TOLERANCE, block_deviation, space_blocks
from conflank_cli.tool import CATALOGUE
from postprocessors.kinematics.two_rotary import Run, choose_words
from postprocessors.toolpath import Purpose
from tests.posting.test_program import AC, scene_of, stretches_of, upright

T1 = CATALOGUE["T1"]


def pass_of(count: int = 40, tool: str = "T1", turn: float = 0.3) -> Pass:
    """Up and down the wall x = 0 with an axis that swings by `turn` as it goes."""
    way = np.linspace(0.0, 1.0, count)
    lean, aside = 0.9 + turn * way, 0.4 * way
    axis = np.stack([-np.sin(lean) * np.cos(aside), np.sin(lean) * np.sin(aside), np.cos(lean)], axis=1)
    centre = np.stack([np.full(count, -T1.ball_radius), 10.0 + 8.0 * way, 8.0 + 3.0 * np.sin(6.0 * way)], axis=1)
    return Pass(0, tool, centre - T1.ball_radius * axis, axis)


def test_passes_follow_the_sweeps_and_count_on() -> None:
    text, path = post_program(scene_of(), [upright()], [pass_of(), pass_of()])
    labels = re.findall(r"; (\w+ \d+)\r", text)
    labels = [label for label in labels if not label.startswith("LINK")]
    assert labels == [f"{kind} {n}" for n, kind in enumerate(("SWEEP", "PASS", "PASS"), start=1) for kind in
                      ("APPROACH", kind, "RETRACT")]  # fmt: skip
    assert [s.cut for s in stretches_of(path, Purpose.PASS)] == [2, 3]
    # All poses of the pass are blocks, and whatever is between them lies on the way.
    item = pass_of()
    posted = stretches_of(path, Purpose.PASS)[0]
    for tip in item.tip:
        assert np.linalg.norm(posted.tip - tip, axis=1).min() < 1e-9


def test_a_pass_with_another_tool_is_an_operation_of_its_own() -> None:
    path = plan_to_toolpath(scene_of(), [upright()], AC, [pass_of(), pass_of(tool="T3")])
    assert [operation.cutter.name for operation in path.operations] == ["T1", "T3"]


def test_passes_alone_make_a_program() -> None:
    _, path = post_program(scene_of(), [], [pass_of()])
    assert [s.cut for s in stretches_of(path, Purpose.PASS)] == [1]
    assert path.faces == (4,)


def test_nothing_to_cut_is_refused() -> None:
    with pytest.raises(InputError, match="no sweep"):
        post_program(scene_of(), [], [])
    with pytest.raises(InputError, match="pass 1"):
        post_program(scene_of(), [], [pass_of(tool="T2")])


def test_both_ways_of_the_axis_stay_on_the_pass() -> None:
    """Few poses, far apart: blocks are added until words and great circle differ by no more than posting may cost."""
    ride = PassRide.of(pass_of(6, turn=0.6), T1, Frame(np.eye(3), np.zeros(3), "CAD"))
    (times,) = space_blocks([ride], AC, ["pass 1"], [(np.zeros((0, 3)), np.zeros((0, 3)))])
    assert len(times) > 6
    words = choose_words(AC, [Run("pass 1", ride.poses(times)[1])])[0]
    assert block_deviation(ride, times, words, AC).max() <= CHORD_TOLERANCE


def test_the_feed_is_that_of_the_ball() -> None:
    """The axis turns about the ball's centre, which goes straight at the tool's feed; nothing above it counts."""
    way = np.linspace(0.0, 1.0, 50)[:, None]
    lean = 0.6 + 0.8 * way[:, 0]
    axis = np.stack([-np.sin(lean), np.zeros(50), np.cos(lean)], axis=1)
    centre = np.array([-T1.ball_radius, 10.0, 8.0]) + 20.0 * way * [0.0, 1.0, 0.0]
    _, path = post_program(scene_of(), [], [Pass(0, "T1", centre - T1.ball_radius * axis, axis)])
    (posted,) = stretches_of(path, Purpose.PASS)
    step = np.linalg.norm(np.diff(posted.tip + T1.ball_radius * posted.axis, axis=0), axis=1)
    seconds = np.linalg.norm(np.diff(posted.tip, axis=0), axis=1) / posted.feed[1:] * 60.0
    speed = step / seconds * 60.0
    assert speed.max() <= T1.feed_mm_min * (1.0 + 1e-6)
    assert np.median(speed) >= 0.8 * T1.feed_mm_min


def test_great_circle_against_slerp() -> None:
    rng = np.random.default_rng(4)
    start, end = rng.normal(size=(2, 20, 3))
    start, end = (x / np.linalg.norm(x, axis=1, keepdims=True) for x in (start, end))
    share = rng.uniform(size=(20, 1))
    found = great_circle(start, end, share)
    for k in range(20):
        about = np.cross(start[k], end[k])
        angle = np.arctan2(np.linalg.norm(about), start[k] @ end[k])
        turn = Rotation.from_rotvec(about / np.linalg.norm(about) * angle)
        between = Slerp([0.0, 1.0], Rotation.concatenate([Rotation.identity(), turn]))(share[k, 0])
        assert found[k] == pytest.approx(between.apply(start[k]), abs=1e-12)
    assert great_circle(start, start, share) == pytest.approx(start, abs=1e-15)
