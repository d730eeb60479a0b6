import time
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from postprocessors.errors import PostError
from postprocessors.kinematics.two_rotary import Run, choose_words, forward, inverse, legs, swing, tilt_all_round
from postprocessors.machines.machine import Linear, LinearAxes, Machine, Rotary, load_machine

LINE = Linear(travel_mm=(-1.0, 1.0), max_speed_mm_min=3e4, max_acceleration_mm_s2=3e3, max_jerk_mm_s3=6e4)
LINEAR = LinearAxes(LINE, LINE, LINE)
TURNING = {"carried_by": "table", "max_speed_deg_min": 9e3, "max_acceleration_deg_s2": 500.0, "max_jerk_deg_s3": 1e4}


def make(first: dict, second: dict) -> Machine:
    axes = tuple(Rotary(**(TURNING | keys)) for keys in ({"letter": "C"} | first, {"letter": "A"} | second))
    return Machine(name="test", rotary=axes, linear=LINEAR, max_feed_mm_min=1e4, block_time_ms=1.0)


def by_scipy(machine: Machine, words: np.ndarray) -> np.ndarray:
    """The tool axis by SciPy's rotations: the independent forward kinematics of these tests."""
    turns = [
        Rotation.from_rotvec(np.radians(axis.sign * words[:, [column]]) * axis.direction)
        for column, axis in enumerate(machine.rotary)
    ]
    return (turns[0] * turns[1]).apply([0.0, 0.0, 1.0])


def units(rng: np.random.Generator, count: int) -> np.ndarray:
    axis = rng.normal(size=(count, 3))
    return axis / np.linalg.norm(axis, axis=1, keepdims=True)


directions = st.tuples(*[st.floats(-1.0, 1.0)] * 3).filter(lambda v: np.linalg.norm(v) > 0.2)


@settings(max_examples=60, deadline=None)
@given(directions, directions, st.sampled_from([-1, 1]), st.sampled_from([-1, 1]), st.integers(0, 2**32 - 1))
def test_forward_of_inverse_is_the_axis_for_any_two_axes(a, b, sign_a, sign_b, seed) -> None:
    machine = make({"vector": a, "sign": sign_a}, {"vector": b, "sign": sign_b})
    first, second = (axis.direction for axis in machine.rotary)
    assume(np.linalg.norm(np.cross(first, second)) > 0.1 and np.hypot(*second[:2]) > 0.1)
    axis = units(np.random.default_rng(seed), 200)
    solutions = inverse(machine, axis)
    signs = np.array([sign_a, sign_b])
    for angles in solutions.angles:
        words = np.degrees(angles) * signs
        reached = by_scipy(machine, words)
        np.testing.assert_allclose(forward(machine, words), reached, atol=1e-14)
        # Near the border of reach the square root halves the digits: 1e-8 rad is 0.5 nm at 50 mm.
        np.testing.assert_allclose(reached[solutions.reachable], axis[solutions.reachable], atol=3e-8)
    # What can be reached is a band about the first axis whose width the second axis and the spindle give.
    spread = np.sqrt((1 - (first @ second) ** 2) * (1 - second[2] ** 2))
    level = (axis @ first - second[2] * (first @ second)) / spread
    clear = np.abs(np.abs(level) - 1.0) > 1e-9
    np.testing.assert_array_equal(solutions.reachable[clear], (np.abs(level) < 1.0)[clear])


def test_ac_table_follows_the_stated_convention() -> None:
    machine = load_machine("ac-table")
    words = np.random.default_rng(7).uniform(-180.0, 180.0, (500, 2))
    c, a = np.radians(words).T
    expected = np.stack([np.sin(c) * np.sin(a), -np.cos(c) * np.sin(a), np.cos(a)], axis=1)
    np.testing.assert_allclose(forward(machine, words), expected, atol=1e-14)


def test_ac_table_matches_published_programs() -> None:
    # t = (0, 1, 0) is A-90 C0, t = (1, 0, 0) is A-90 C270.
    words = choose_words(load_machine("ac-table"), [Run("s", np.eye(3)[[1]]), Run("s", np.eye(3)[[0]])])
    np.testing.assert_allclose(np.vstack(words), [[0.0, -90.0], [270.0, -90.0]], atol=1e-9)


def test_every_reachable_axis_lands_within_range() -> None:
    machine = load_machine("ac-table")
    axis = units(np.random.default_rng(3), 2000)
    axis = axis[axis[:, 2] > -0.45]
    words = np.vstack(choose_words(machine, [Run(f"s{i}", row[None]) for i, row in enumerate(axis[:300])]))
    np.testing.assert_allclose(by_scipy(machine, words), axis[:300], atol=1e-9)
    assert words[:, 0].min() >= 0.0 and words[:, 0].max() < 360.0
    assert words[:, 1].min() >= -120.0 and words[:, 1].max() <= 30.0


def circle(tilt_deg: float, start: float, stop: float, count: int) -> np.ndarray:
    azimuth, tilt = np.radians(np.linspace(start, stop, count)), np.radians(tilt_deg)
    return np.stack([np.sin(tilt) * np.cos(azimuth), np.sin(tilt) * np.sin(azimuth), np.full(count, np.cos(tilt))], 1)


def test_c_runs_on_through_half_a_turn() -> None:
    axis = circle(40.0, 0.0, 800.0, 801)
    endless = make({"vector": (0, 0, 1), "output": "continuous"}, {"vector": (1, 0, 0), "range_deg": (-120.0, 30.0)})
    words = choose_words(endless, [Run("s", axis)])[0]
    np.testing.assert_allclose(np.diff(words[:, 0]), 1.0, atol=1e-9)
    modulo = choose_words(load_machine("ac-table"), [Run("s", axis)])[0]
    np.testing.assert_allclose(np.mod(words[:, 0] - modulo[:, 0] + 180.0, 360.0), 180.0, atol=1e-9)


def test_a_limited_c_starts_where_its_range_suffices() -> None:
    machine = make(
        {"vector": (0, 0, 1), "range_deg": (-200.0, 200.0)}, {"vector": (1, 0, 0), "range_deg": (-90.0, 5.0)}
    )
    # Azimuth 80 .. 285 is C 170 .. 375, or one turn back -190 .. 15, which fits.
    words = choose_words(machine, [Run("s", circle(30.0, 80.0, 285.0, 400))])[0]
    assert words[:, 0].min() >= -200.0 and words[:, 0].max() <= 200.0
    assert np.abs(np.diff(words[:, 0])).max() < 1.0
    with pytest.raises(PostError, match="without unwinding"):
        choose_words(machine, [Run("sweep 4", circle(30.0, 0.0, 420.0, 400))])


def test_a_range_that_ends_on_the_way_is_left_and_entered_again() -> None:
    """C begins at -73 and ends at 200: 273 degrees, then 360 with each piece: 200 is -160 again."""
    machine = make(
        {"vector": (0, 0, 1), "range_deg": (-200.0, 200.0)}, {"vector": (1, 0, 0), "range_deg": (-90.0, 5.0)}
    )
    for turn, pieces in ((270.0, 1), (390.0, 2), (620.0, 2), (700.0, 3)):
        axis = circle(30.0, 17.0, 17.0 + turn, 1 + int(2 * turn))
        found = legs(machine, Run("sweep 4", axis))
        assert len(found) == pieces
        assert found[0][0] == 0 and found[-1][1] == len(axis) - 1
        assert all(before[1] == after[0] for before, after in pairwise(found))
        words = choose_words(machine, [Run("sweep 4", axis[first : last + 1]) for first, last in found])
        for (first, last), chosen in zip(found, words, strict=True):
            assert chosen[:, 0].min() >= -200.0 and chosen[:, 0].max() <= 200.0
            np.testing.assert_allclose(by_scipy(machine, chosen), axis[first : last + 1], atol=1e-9)
            assert first == 0 or last == len(axis) - 1 or np.ptp(chosen[:, 0]) > 358.0


def test_a_tilt_that_ends_beyond_the_pole_is_entered_again_from_the_other_side() -> None:
    machine = make({"vector": (0, 0, 1)}, {"vector": (1, 0, 0), "range_deg": (-10.0, 30.0)})
    tilt = np.radians(np.linspace(-25.5, 25.5, 52))
    through = np.stack([np.zeros(52), -np.sin(tilt), np.cos(tilt)], axis=1)
    (first, middle), (again, last) = legs(machine, Run("sweep 2", through))
    assert (first, again, last) == (0, middle, 51)
    words = choose_words(machine, [Run("s", through[: middle + 1]), Run("s", through[middle:])])
    assert words[0][-1, 1] < 0.0 < words[1][0, 1]
    np.testing.assert_allclose(
        by_scipy(machine, np.vstack(words)), np.vstack([through[: middle + 1], through[middle:]]), atol=1e-9
    )


def test_two_poses_without_a_way_between_them_are_named() -> None:
    """The tool lies over by 25 degrees to either side, at once: C would whip by half a turn."""
    machine = make({"vector": (0, 0, 1)}, {"vector": (1, 0, 0), "range_deg": (-10.0, 30.0)})
    with pytest.raises(PostError, match=r"sweep 2.*without unwinding"):
        legs(machine, Run("sweep 2", np.array([[0.0, -np.sin(tilt), np.cos(tilt)] for tilt in (-0.44, 0.44)])))


@pytest.mark.parametrize(
    ("name", "tilt"),
    [("ac-table", 120), ("bc-table", 110), ("head-table", 110), ("head-head", 110), ("nutating-head", 90)],
)
def test_tilts_that_the_shipped_machines_reach(name: str, tilt: int) -> None:
    assert tilt_all_round(load_machine(name)) == tilt


def test_the_solution_with_less_motion_between_cuts_wins() -> None:
    machine = make({"vector": (0, 0, 1), "output": "modulo"}, {"vector": (1, 0, 0), "range_deg": (-100.0, 100.0)})
    here, opposite = circle(20.0, 10.0, 10.0, 1), circle(20.0, 190.0, 190.0, 1)
    words = np.vstack(choose_words(machine, [Run("a", here), Run("b", opposite)]))
    # A swings through 40 degrees instead of C through 180.
    assert abs(words[1, 1] - words[0, 1]) == pytest.approx(40.0)
    assert words[1, 0] == pytest.approx(words[0, 0])


def test_straight_through_the_pole_a_changes_sign_and_c_holds() -> None:
    tilt = np.radians(np.linspace(-10.0, 10.0, 21))
    axis = np.stack([np.sin(tilt) * 0.6, np.sin(tilt) * 0.8, np.cos(tilt)], axis=1)
    words = choose_words(load_machine("ac-table"), [Run("s", axis)])[0]
    np.testing.assert_allclose(words[:, 0], words[0, 0], atol=1e-6)
    np.testing.assert_allclose(np.abs(np.diff(words[:, 1])), 1.0, atol=1e-6)
    assert swing(load_machine("ac-table"), axis, words).max() < 1e-9


def test_c_holds_while_the_axis_stands_at_the_pole() -> None:
    axis = np.vstack([circle(20.0, 30.0, 30.0, 1), np.tile([0.0, 0.0, 1.0], (5, 1)), circle(20.0, 30.0, 30.0, 1)])
    words = choose_words(load_machine("ac-table"), [Run("s", axis)])[0]
    np.testing.assert_allclose(words[:, 0], words[0, 0], atol=1e-9)
    upright = choose_words(load_machine("ac-table"), [Run("s", axis[1:4])])[0]
    np.testing.assert_allclose(upright, 0.0, atol=1e-9)


def test_a_change_of_solution_never_happens_off_the_pole() -> None:
    # A cannot change its sign, and at the pole C would have to whip by half a turn: refused.
    machine = make({"vector": (0, 0, 1)}, {"vector": (1, 0, 0), "range_deg": (-10.0, 30.0)})
    tilt = np.radians(np.linspace(-25.0, 25.0, 51))
    through = np.stack([np.zeros(51), -np.sin(tilt), np.cos(tilt)], axis=1)
    with pytest.raises(PostError, match=r"sweep 2, pose .* without unwinding"):
        choose_words(machine, [Run("sweep 2", through)])
    # Past the pole at a distance C turns by half a turn in many steps instead.
    near = np.stack([np.full(51, 0.02), -np.sin(tilt), np.cos(tilt)], axis=1)
    near /= np.linalg.norm(near, axis=1, keepdims=True)
    words = choose_words(machine, [Run("s", near)])[0]
    turn = (np.diff(words[:, 0]) + 180.0) % 360.0 - 180.0
    assert abs(turn.sum()) > 150.0
    np.testing.assert_allclose(by_scipy(machine, words), near, atol=1e-9)


def test_out_of_range_and_unreachable_poses_are_named() -> None:
    down = circle(130.0, 0.0, 0.0, 1)
    up = circle(20.0, 0.0, 0.0, 1)
    with pytest.raises(PostError) as caught:
        choose_words(load_machine("ac-table"), [Run("sweep 1", up), Run("sweep 7", np.vstack([up, down]))])
    assert caught.value.where == "sweep 7, pose 2"
    assert "A-130.0000" in caught.value.found
    nutating = make({"letter": "C", "vector": (0, 0, 1)}, {"letter": "B", "vector": (0, 1, 1)})
    with pytest.raises(PostError) as caught:
        choose_words(nutating, [Run("sweep 5", np.vstack([up, circle(100.0, 0.0, 0.0, 1)]))])
    assert caught.value.where == "sweep 5, pose 2"
    assert "can reach" in caught.value.expected


def test_words_for_a_large_program_take_a_moment() -> None:
    axis = circle(35.0, 0.0, 3600.0, 100_000)
    began = time.process_time()
    choose_words(load_machine("ac-table"), [Run("s", axis)])
    assert time.process_time() - began < 2.0
