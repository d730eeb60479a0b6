"""Predicted times against closed forms and against a machine simulated in steps of a tenth of a millisecond."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from postprocessors.kinematics.timing import Profile, followed_seconds, least_seconds, profile, unwound
from postprocessors.machines.machine import Limits, load_machine

LIMITS = Limits(
    np.array([500.0, 500.0, 500.0, 300.0, 150.0]),
    np.array([3000.0, 3000.0, 3000.0, 1000.0, 500.0]),
    np.array([60000.0, 60000.0, 60000.0, 20000.0, 10000.0]),
)
STEP = 1e-4


def simulated(axes: np.ndarray, nominal: np.ndarray, found: Profile) -> tuple[float, np.ndarray]:
    """Drive through the path in steps of time, as fast as caps allow; filter; seconds to arrive, and axes over time.

    Braking is by looking back from the end in fine steps of way, not by the formulas of the model.
    """
    cells = 20
    way = np.concatenate([[0.0], np.cumsum(np.repeat(nominal / cells, cells))])
    change = np.repeat(found.change, cells)
    speed = np.diff(axes, axis=0) / nominal[:, None]
    cap = np.minimum(1.0, (LIMITS.speed / np.maximum(np.abs(speed), 1e-12)).min(axis=1))
    brake = np.empty(len(way))
    brake[-1] = 0.0
    node = np.full(len(way), np.inf)
    node[:-1] = np.repeat(cap, cells)
    node[1:] = np.minimum(node[1:], np.repeat(cap, cells))
    # A corner is passed at the speed at which each axis changes its speed within the filter's time.
    for k in range(1, len(nominal)):
        jump = (np.abs(speed[k] - speed[k - 1]) / LIMITS.acceleration).max() / found.tail
        node[k * cells] = min(node[k * cells], 1.0 / max(jump, 1e-12))
    for k in range(len(way) - 2, -1, -1):
        brake[k] = min(node[k], np.sqrt(brake[k + 1] ** 2 + 2.0 * change[k] * (way[k + 1] - way[k])))
    place, rate, places = 0.0, 0.0, [0.0]
    while place < way[-1] - 1e-12:
        cell = min(int(np.searchsorted(way, place, side="right")) - 1, len(change) - 1)
        ahead = np.sqrt(brake[cell + 1] ** 2 + 2.0 * change[cell] * max(way[cell + 1] - place, 0.0))
        rate = max(min(rate + change[cell] * STEP, ahead, np.repeat(cap, cells)[cell]), 1e-4)
        place = min(place + rate * STEP, way[-1])
        places.append(place)
    at = np.stack([np.interp(places, np.r_[0.0, np.cumsum(nominal)], column) for column in axes.T], axis=1)
    width = max(round(found.tail / STEP), 1)
    padded = np.vstack([np.repeat(at[:1], width, axis=0), at, np.repeat(at[-1:], width, axis=0)])
    sums = np.vstack([np.zeros((1, 5)), np.cumsum(padded, axis=0)])
    filtered = (sums[width:] - sums[:-width]) / width
    arrived = int(np.flatnonzero(np.abs(filtered - axes[-1]).max(axis=1) > 1e-6)[-1]) + 1
    return (arrived - 1) * STEP, filtered


@pytest.mark.parametrize(("length", "feed"), [(100.0, 50.0), (20.0, 30.0), (300.0, 400.0)])
def test_a_straight_block_takes_the_time_of_the_s_curve(length: float, feed: float) -> None:
    """Seven phases: s / v + v / a + a / j, where v is reached."""
    axes = np.array([[0.0] * 5, [length, 0.0, 0.0, 0.0, 0.0]])
    acceleration, jerk = 3000.0, 60000.0
    assert feed**2 / acceleration < length
    expected = length / feed + feed / acceleration + acceleration / jerk
    found = profile(axes, np.array([length / feed]), LIMITS)
    assert found.total == pytest.approx(expected, rel=1e-12)
    assert simulated(axes, np.array([length / feed]), found)[0] == pytest.approx(expected, abs=1e-3)


def test_a_block_too_short_for_its_feed_is_a_triangle() -> None:
    axes = np.array([[0.0] * 5, [2.0, 0.0, 0.0, 0.0, 0.0]])
    found = profile(axes, np.array([2.0 / 400.0]), LIMITS)
    assert found.total == pytest.approx(2.0 * np.sqrt(2.0 / 3000.0) + 3000.0 / 60000.0, rel=1e-12)


def test_the_slowest_axis_sets_the_pace() -> None:
    """A swings by 30 degrees while X goes 1 mm: its 150 deg/s and 500 deg/s2 count."""
    axes = np.array([[0.0] * 5, [1.0, 0.0, 0.0, 0.0, 120.0]])
    nominal = np.array([0.1])
    expected = 120.0 / 150.0 + 150.0 / 500.0 + 0.05
    assert profile(axes, nominal, LIMITS).total == pytest.approx(expected, rel=1e-12)


def test_a_right_angle_is_passed_slowly() -> None:
    corner = np.zeros((3, 5))
    corner[1, 0], corner[2, :2] = 50.0, [50.0, 50.0]
    straight = np.zeros((3, 5))
    straight[1:, 0] = [50.0, 100.0]
    nominal = np.array([0.2, 0.2])
    found = profile(corner, nominal, LIMITS)
    # Both axes change their speed by the feed there, within the filter's 50 ms.
    assert found.rate[1] * 250.0 == pytest.approx(3000.0 * found.tail)
    assert found.total > profile(straight, nominal, LIMITS).total


@settings(max_examples=12, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(3, 40), st.floats(5.0, 60.0))
def test_many_blocks_against_the_simulated_machine(seed: int, blocks: int, feed: float) -> None:
    rng = np.random.default_rng(seed)
    steps = np.cumsum(rng.normal(0.0, 0.2, (blocks, 5)), axis=0) + rng.normal(0.0, 0.5, 5)
    axes = np.vstack([np.zeros(5), np.cumsum(steps, axis=0)])
    nominal = np.linalg.norm(np.diff(axes[:, :3], axis=0), axis=1) / feed
    found = profile(axes, nominal, LIMITS)
    seconds, filtered = simulated(axes, nominal, found)
    assert found.total == pytest.approx(seconds, rel=0.005, abs=0.002)
    speed = np.diff(filtered, axis=0) / STEP
    assert (np.abs(speed) / LIMITS.speed).max() < 1.001


def test_a_smooth_path_keeps_all_limits_of_the_axes() -> None:
    """A circle that is too fast for the axes: after spreading, the simulated machine keeps speeds and accelerations."""
    angle = np.linspace(0.0, 4.0 * np.pi, 600)
    axes = np.stack([20.0 * np.cos(angle), 20.0 * np.sin(angle), angle, 2.0 * np.sin(angle), 5.0 * angle], axis=1)
    nominal = np.linalg.norm(np.diff(axes[:, :3], axis=0), axis=1) / 400.0
    spread = followed_seconds(axes, nominal, LIMITS)
    assert spread.sum() > 1.2 * nominal.sum()
    # v = sqrt(a r) on the circle of 20 mm where one axis does all of it, more where two share it.
    speed = np.median(np.diff(angle) / spread) * 20.0
    assert 0.9 < speed / np.sqrt(3000.0 * 20.0) < 1.19
    found = profile(axes, spread, LIMITS)
    seconds, filtered = simulated(axes, spread, found)
    assert found.total == pytest.approx(seconds, rel=0.005)
    every = 20
    acceleration = np.diff(filtered[::every], 2, axis=0) / (every * STEP) ** 2
    # Speeding up and turning both ask for acceleration; together they may pass it by the root of two.
    assert (np.abs(acceleration) / LIMITS.acceleration).max() < 1.45


def test_blocks_without_motion_take_no_time() -> None:
    axes = np.zeros((4, 5))
    axes[2:, 0] = 10.0
    found = profile(axes, np.array([0.0, 0.2, 0.0]), LIMITS)
    assert found.seconds[0] == found.seconds[2] == 0.0
    assert found.total == pytest.approx(0.2 + 50.0 / 3000.0 + 0.05)
    assert profile(np.zeros((2, 5)), np.zeros(1), LIMITS).total == 0.0


def test_the_control_and_each_axis_have_their_least_time() -> None:
    """X at 500 mm/s, C at 300 deg/s, and 3.6 ms for a block."""
    axes = np.array([[0.0] * 5, [5.0, 0.0, 0.0, 0.0, 0.0], [5.0, 0.0, 0.0, 9.0, 0.0], [5.0, 0.0, 0.1, 9.0, 0.0]])
    np.testing.assert_allclose(least_seconds(load_machine("ac-table"), axes), [0.01, 0.03, 0.0036])


def test_endless_axes_take_the_shorter_way() -> None:
    words = np.array([[350.0, 0.0], [10.0, -5.0], [355.0, -400.0]])
    expected = [[350.0, 0.0], [370.0, -5.0], [355.0, -400.0]]
    np.testing.assert_allclose(unwound(load_machine("ac-table"), words), expected)
