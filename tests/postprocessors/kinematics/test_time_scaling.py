"""Times of blocks: closed forms, and the limits from the definition for paths that no machine likes."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from postprocessors.kinematics import time_scaling
from postprocessors.kinematics.time_scaling import RESERVE, WEIGHTS, Run, scaled_seconds
from postprocessors.machines.machine import Limits

Array = npt.NDArray[np.float64]
LIMITS = Limits(
    np.array([500.0, 500.0, 500.0, 300.0, 150.0]),
    np.array([3000.0, 3000.0, 3000.0, 1000.0, 500.0]),
    np.array([60000.0, 60000.0, 60000.0, 20000.0, 10000.0]),
)
BLOCK = 0.004


def run_of(axes: Array, feed: float) -> Run:
    """Blocks at a feed of the tip, mm/s, no shorter than a block of the control."""
    way = np.linalg.norm(np.diff(axes[:, :3], axis=0), axis=1)
    speed = (np.abs(np.diff(axes, axis=0)) / LIMITS.speed).max(axis=1)
    return Run(axes, np.maximum(np.maximum(way / feed, BLOCK), speed), way)


def circle(radius: float, count: int = 400) -> Array:
    angle = np.linspace(0.0, 4.0 * np.pi, count)
    none = np.zeros(count)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), none, none, none], axis=1)


def asked(axes: Array, seconds: Array) -> tuple[float, float, float, float]:
    """Largest shares of speed, acceleration and jerk, block by block as they are defined; jerk over both times."""
    worst = [0.0, 0.0, 0.0, 0.0]
    for column in range(5):
        v = [(axes[k + 1, column] - axes[k, column]) / seconds[k] for k in range(len(seconds))]
        a = [(v[k + 1] - v[k]) / (0.5 * (seconds[k] + seconds[k + 1])) for k in range(len(v) - 1)]
        j = [a[k + 1] - a[k] for k in range(len(a) - 1)]
        three = [abs(j[k]) / (seconds[k : k + 3].sum() / 3.0) for k in range(len(j))]
        middle = [abs(j[k]) / seconds[k + 1] for k in range(len(j))]
        for order, (values, limits) in enumerate(
            [(v, LIMITS.speed), (a, LIMITS.acceleration), (three, LIMITS.jerk), (middle, LIMITS.jerk)]
        ):
            worst[order] = max([worst[order], *(abs(value) / limits[column] for value in values)])
    return worst[0], worst[1], worst[2], worst[3]


def printed(run: Run, seconds: Array) -> Array:
    """Times at feeds that are whole numbers, mm/min."""
    feed = np.maximum(np.round(60.0 * run.way / seconds), 1.0)
    return np.asarray(60.0 * run.way / feed)


def test_a_straight_line_keeps_its_feed() -> None:
    axes = np.zeros((200, 5))
    axes[:, 0], axes[:, 4] = np.linspace(0.0, 100.0, 200), np.linspace(0.0, 30.0, 200)
    run = run_of(axes, 20.0)
    (seconds,) = scaled_seconds([run], LIMITS)
    assert (seconds >= run.least).all()
    np.testing.assert_array_equal(seconds, run.least)


def test_on_a_circle_the_acceleration_sets_the_feed() -> None:
    """v^2 / r = a where it is along X or Y: at 20 mm the jerk, v^3 / r^2, is far from its limit."""
    run = run_of(circle(20.0, 200), 450.0)
    (seconds,) = scaled_seconds([run], LIMITS)
    speed = run.way / seconds
    along = np.abs(np.diff(run.axes[:, 0])) / run.way < 0.05
    along[:15] = along[-15:] = False
    assert along.any()
    limit = np.sqrt(RESERVE * 3000.0 * 20.0)
    # Elsewhere two axes share it; there it is faster, so that where one has all of it braking costs it nothing.
    np.testing.assert_allclose(speed[along], limit, rtol=0.02)


def test_on_a_small_circle_the_jerk_sets_the_feed() -> None:
    run = run_of(circle(0.5, 61), 450.0)
    (seconds,) = scaled_seconds([run], LIMITS)
    mean = run.way[8:-8].sum() / seconds[8:-8].sum()
    # v^3 / r^2 = j where one axis has all of it, and up to the third root of the root of two faster between.
    limit = (RESERVE * 60000.0 * 0.5**2) ** (1.0 / 3.0)
    assert 0.95 * limit < mean < 1.2 * limit
    _, acceleration, jerk, _ = asked(run.axes, seconds)
    assert acceleration < 0.9 and 0.93 * RESERVE < jerk <= RESERVE


def paths(kind: str, seed: int, count: int) -> Array:
    rng = np.random.default_rng(seed)
    if kind == "smooth":
        t = np.linspace(0.0, 1.0, count + 1)[:, None]
        waves = [rng.normal(0.0, 1.0, 5) * np.sin(k * np.pi * t + rng.uniform(0.0, 6.0, 5)) for k in (1, 2, 5)]
        axes = 0.02 * count * sum(waves) * np.array([1.0, 1.0, 1.0, 3.0, 1.0])
        axes[:, 0] += 0.3 * np.arange(count + 1)
    elif kind == "corners":
        steps = np.repeat(rng.normal(0.0, 1.0, (count // 7 + 1, 5)), 7, axis=0)[:count]
        axes = np.vstack([np.zeros(5), np.cumsum(steps * [0.3, 0.3, 0.3, 1.0, 0.5], axis=0)])
    else:
        steps = rng.normal(0.0, 0.2, (count, 5)) * rng.lognormal(0.0, 1.0, (count, 1))
        axes = np.vstack([np.zeros(5), np.cumsum(steps, axis=0)])
    return np.asarray(np.round(axes, 4))


@settings(max_examples=25, deadline=None)
@given(st.sampled_from(["smooth", "corners", "nasty"]), st.integers(0, 2**32 - 1), st.integers(1, 90))
def test_printed_feeds_keep_every_limit(kind: str, seed: int, count: int) -> None:
    axes = paths(kind, seed, count)
    run = run_of(axes, 25.0)
    if run.way.min() < 1e-3:
        return
    (seconds,) = scaled_seconds([run], LIMITS)
    assert (seconds >= run.least).all()
    # Half a mm/min is 2 % of a feed of 25; of a lower one it takes more than second order leaves room for.
    if (60.0 * run.way / seconds).min() > 25.0:
        assert max(asked(axes, printed(run, seconds))) <= 1.0


@pytest.mark.parametrize("limit", ["acceleration", "jerk"])
def test_without_a_limit_it_is_passed(limit: str) -> None:
    """Each of the limits is what keeps the times, not the other one."""
    axes = paths("corners", 3, 60)
    run = run_of(axes, 100.0)
    free = LIMITS._replace(**{limit: 1e9 * getattr(LIMITS, limit)})
    shares = dict(
        zip(["speed", "acceleration", "jerk", "middle"], asked(axes, *scaled_seconds([run], free)), strict=True)
    )
    assert shares[limit] > 1.0


def test_rounding_is_kept_back() -> None:
    """A swing about an almost standing tip: half a mm/min is much of a feed of 20, and of the jerk."""
    angle = np.linspace(0.0, np.pi, 60)
    axes = np.zeros((60, 5))
    axes[:, 0], axes[:, 3] = 0.02 * np.arange(60), 20.0 * np.sin(angle)
    run = run_of(np.round(axes, 4), 20.0)
    (seconds,) = scaled_seconds([run], LIMITS)
    assert max(asked(run.axes, printed(run, seconds))) <= 1.0
    none = time_scaling._Problem.of([run], LIMITS)._replace(rounding=np.zeros((5, 59)))
    y = none.start()
    for weight in WEIGHTS:
        for _ in range(time_scaling.STEPS):
            y = none.step(y, weight)
    assert np.exp(y).sum() < seconds.sum()
    assert max(asked(run.axes, printed(run, np.exp(y)))) > 1.0


def test_runs_do_not_know_of_each_other() -> None:
    runs = [run_of(paths(kind, 1, 40), 25.0) for kind in ("smooth", "corners", "nasty")]
    together = scaled_seconds(runs, LIMITS)
    for run, seconds in zip(runs, together, strict=True):
        np.testing.assert_allclose(scaled_seconds([run], LIMITS)[0], seconds, rtol=1e-9)


def test_slopes_are_those_of_differences() -> None:
    run = run_of(paths("nasty", 5, 12), 25.0)
    problem = time_scaling._Problem.of([run], LIMITS)
    y = problem.start()
    found = problem.slopes(y, problem.stencils(y))
    step = 1e-6
    for k in range(len(y)):
        nudge = np.where(np.arange(len(y)) == k, step, 0.0)
        high, low = problem.stencils(y + nudge), problem.stencils(y - nudge)
        for index, slopes in enumerate(found):
            for offset, slope in enumerate(slopes):
                if 0 <= k - offset < slope.share.shape[1]:
                    for name in ("share", "kept"):
                        by_difference = (getattr(high[index], name) - getattr(low[index], name))[:, k - offset]
                        np.testing.assert_allclose(
                            getattr(slope, name)[:, k - offset], by_difference / (2.0 * step), rtol=1e-5, atol=1e-7
                        )


def test_nothing_to_run() -> None:
    assert scaled_seconds([], LIMITS) == []
    empty = Run(np.zeros((1, 5)), np.zeros(0), np.zeros(0))
    one = run_of(np.array([[0.0] * 5, [1.0, 0.0, 0.0, 0.0, 0.0]]), 20.0)
    first, second = scaled_seconds([empty, one], LIMITS)
    assert len(first) == 0
    np.testing.assert_allclose(second, 0.05, rtol=2.0 * WEIGHTS[-1])


def test_a_run_that_all_but_stands_is_slowed_down_as_a_whole() -> None:
    """Blocks of a digit while C swings by half a degree: whole feeds leave next to nothing of the limits."""
    axes = np.zeros((200, 5))
    axes[:, 0], axes[:, 3] = 1e-4 * (np.arange(200) % 2), 0.5 * np.arange(200)
    run = run_of(axes, 20.0)
    (seconds,) = scaled_seconds([run], LIMITS)
    assert np.isfinite(seconds).all() and max(asked(axes, seconds)) <= 1.0
