"""Motions: restriction is exact, derivatives are derivatives, fits reproduce what they can."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import make_interp_spline

from conflank_cli.motion import DEGREE, Motion, fitted, uniform_knots


def random_motion(seed: int, count: int = 9) -> Motion:
    rng = np.random.default_rng(seed)
    return Motion(uniform_knots(count), rng.uniform(-30.0, 30.0, (count, 3)), rng.uniform(-30.0, 30.0, (count, 3)))


def test_uniform_knots_are_clamped_and_even() -> None:
    knots = uniform_knots(8)
    assert len(knots) == 12
    np.testing.assert_array_equal(knots[:4], 0.0)
    np.testing.assert_array_equal(knots[-4:], 1.0)
    np.testing.assert_allclose(np.diff(knots[3:-3]), 0.2, atol=1e-15)


@settings(max_examples=30, deadline=None, derandomize=True)
@given(st.integers(0, 99), st.floats(0.0, 0.9), st.floats(0.05, 1.0), st.integers(4, 12))
def test_restriction_is_the_same_motion(seed: int, start: float, share: float, count: int) -> None:
    """Also where start or end is a knot (1/6, 1/2, ...), which the floats of the strategy rarely hit."""
    motion = random_motion(seed, count)
    inner = np.unique(motion.knots)
    cases = [(start, start + share * (1.0 - start))]
    if len(inner) > 2:
        cases += [(float(inner[1]), 1.0), (0.0, float(inner[-2])), (float(inner[1]), float(inner[1]) + 0.03)]
    x = np.linspace(0.0, 1.0, 41)
    for low, high in cases:
        part = motion.restricted(low, high)
        for mine, theirs in zip(part.ends(x), motion.ends(low + x * (high - low)), strict=True):
            # Knot insertion averages control points of 30 mm: rounding only.
            np.testing.assert_allclose(mine, theirs, atol=1e-11)
        assert len(part.knots) == len(part.p) + DEGREE + 1 == len(part.q) + DEGREE + 1
        np.testing.assert_array_equal(part.knots[:4], 0.0)
        np.testing.assert_array_equal(part.knots[-4:], 1.0)


def test_restriction_of_a_restriction() -> None:
    motion = random_motion(1)
    once = motion.restricted(0.2, 0.8).restricted(0.25, 0.5)
    direct = motion.restricted(0.35, 0.5)
    x = np.linspace(0.0, 1.0, 20)
    np.testing.assert_allclose(np.hstack(once.ends(x)), np.hstack(direct.ends(x)), atol=1e-11)


def test_derivatives_against_differences() -> None:
    motion = random_motion(2)
    t = np.array([0.05, 0.31, 0.72, 0.95])
    step = 1e-4
    for order in (1, 2):
        for end in (0, 1):
            before, after = (motion.ends(t + s, order - 1)[end] for s in (-step, step))
            # The third derivative of such motions is some 1e5 mm: step² / 6 of it is the error of a central difference.
            np.testing.assert_allclose(motion.ends(t, order)[end], (after - before) / (2.0 * step), atol=0.05)


def test_fit_reproduces_a_motion_of_its_own_kind() -> None:
    motion = random_motion(3)
    t = np.linspace(0.0, 1.0, 60)
    again = fitted(t, np.hstack(motion.ends(t)), len(motion.p))
    np.testing.assert_allclose(again.p, motion.p, atol=1e-9)
    np.testing.assert_allclose(again.q, motion.q, atol=1e-9)
    same = motion.respaced(len(motion.p))
    np.testing.assert_allclose(same.q, motion.q, atol=1e-9)


def test_respacing_converges_with_order_four() -> None:
    """A cubic spline through something smooth: twice the control points, a sixteenth of the error."""
    t = np.linspace(0.0, 1.0, 200)
    shape = np.stack([40.0 * np.sin(2.0 * t), 40.0 * np.cos(2.0 * t), 5.0 * t, 50.0 * t, t**2, np.cos(t)], axis=1)
    fine = make_interp_spline(t, shape, k=3)
    motion = Motion(fine.t, fine.c[:, :3], fine.c[:, 3:])
    errors = [
        np.abs(np.hstack(motion.respaced(count + DEGREE).ends(t)) - np.hstack(motion.ends(t))).max()
        for count in (4, 8, 16)
    ]
    assert 10.0 < errors[0] / errors[1] < 25.0
    assert 10.0 < errors[1] / errors[2] < 25.0


def test_ends_of_one_time_and_contiguity() -> None:
    p, q = random_motion(4).ends([0.5])
    assert p.shape == q.shape == (1, 3)
    assert p.flags.c_contiguous and q.flags.c_contiguous
    assert random_motion(4).ends(0.0)[0] == pytest.approx(random_motion(4).p[0])
