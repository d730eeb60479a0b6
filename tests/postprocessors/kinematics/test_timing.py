"""Predicted times against closed forms and against a machine simulated in steps of a tenth of a millisecond."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.simulated_machine import STEP, drive
from postprocessors.kinematics.time_scaling import Run, scaled_seconds
from postprocessors.kinematics.timing import least_seconds, profile, unwound
from postprocessors.machines.machine import Limits, load_machine

LIMITS = Limits(
    np.array([500.0, 500.0, 500.0, 300.0, 150.0]),
    np.array([3000.0, 3000.0, 3000.0, 1000.0, 500.0]),
    np.array([60000.0, 60000.0, 60000.0, 20000.0, 10000.0]),
)


@pytest.mark.parametrize(("length", "feed"), [(100.0, 50.0), (20.0, 30.0), (300.0, 400.0)])
def test_a_straight_block_takes_the_time_of_the_s_curve(length: float, feed: float) -> None:
    """Seven phases: s / v + v / a + a / j, where v is reached."""
    axes = np.array([[0.0] * 5, [length, 0.0, 0.0, 0.0, 0.0]])
    acceleration, jerk = 3000.0, 60000.0
    assert feed**2 / acceleration < length
    expected = length / feed + feed / acceleration + acceleration / jerk
    found = profile(axes, np.array([length / feed]), LIMITS)
    assert found.total == pytest.approx(expected, rel=1e-12)
    assert drive(axes, np.array([length / feed]), LIMITS).seconds == pytest.approx(expected, abs=1e-3)


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
    seconds, filtered = drive(axes, nominal, LIMITS)
    assert found.total == pytest.approx(seconds, rel=0.005, abs=0.002)
    speed = np.diff(filtered, axis=0) / STEP
    assert (np.abs(speed) / LIMITS.speed).max() < 1.001


def test_scaled_blocks_are_run_as_they_are_programmed() -> None:
    """A circle too fast for the axes: with the times of time_scaling the simulated machine only starts and stops."""
    angle = np.linspace(0.0, 4.0 * np.pi, 600)
    axes = np.stack([20.0 * np.cos(angle), 20.0 * np.sin(angle), angle, 2.0 * np.sin(angle), 5.0 * angle], axis=1)
    way = np.linalg.norm(np.diff(axes[:, :3], axis=0), axis=1)
    (scaled,) = scaled_seconds([Run(axes, way / 400.0, way)], LIMITS)
    assert scaled.sum() > 1.2 * way.sum() / 400.0
    found = profile(axes, scaled, LIMITS)
    seconds, filtered = drive(axes, scaled, LIMITS)
    assert found.total == pytest.approx(seconds, rel=0.005)
    assert found.total - scaled.sum() < 0.3
    every = 20
    acceleration = np.diff(filtered[::every], 2, axis=0) / (every * STEP) ** 2
    # Starting and stopping come on top at the ends; the rest is what the blocks ask for.
    middle = slice(len(acceleration) // 4, -(len(acceleration) // 4))
    assert (np.abs(acceleration[middle]) / LIMITS.acceleration).max() < 1.01


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
