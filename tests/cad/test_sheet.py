from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import BSpline

from conflank_cli.cad.sheet import Sheet, clamp, close_smooth_seams, unwrap
from conflank_cli.geometry.kernels.footpoint import evaluate
from conflank_cli.geometry.surface import to_spans


def _points(surface, u, v):
    spans = to_spans(surface)
    out = np.empty((len(u), 6, 3))
    evaluate(spans.breaks_u, spans.breaks_v, spans.coefficients, u, v, out)
    return out[:, 0]


@settings(max_examples=40, deadline=None)
@given(st.integers(1, 5), st.integers(0, 2**31 - 1), st.floats(0.0, 0.4), st.floats(0.6, 1.0))
def test_clamp_does_not_change_the_spline(degree, seed, low, high):
    rng = np.random.default_rng(seed)
    count = degree + 1 + int(rng.integers(0, 8))
    knots = np.sort(rng.uniform(0, 1, count + degree + 1))
    if rng.random() < 0.5:
        knots[: degree + 1], knots[-degree - 1 :] = knots[0], knots[-1]
    values = rng.normal(size=(count, 2, 3))
    start, end = knots[degree], knots[-degree - 1]
    if not end - start > 1e-3:
        return
    a, b = start + low * (end - start), start + high * (end - start)
    new_knots, new_values = clamp(knots, degree, values, a, b)
    assert np.all(new_knots[: degree + 1] == a) and np.all(new_knots[-degree - 1 :] == b)
    t = np.linspace(a, b, 23)[:-1]
    np.testing.assert_allclose(BSpline(new_knots, new_values, degree)(t), BSpline(knots, values, degree)(t), atol=1e-7)


@settings(max_examples=40, deadline=None)
@given(st.integers(1, 5), st.integers(2, 9), st.integers(0, 2**31 - 1), st.floats(-2.0, 2.0), st.floats(0.05, 1.5))
def test_unwrap_repeats_after_the_period(degree, count, seed, start, width):
    rng = np.random.default_rng(seed)
    knots = np.concatenate([[0.0], np.cumsum(rng.uniform(0.2, 1.0, count))])
    knots /= knots[-1]
    values = rng.normal(size=(count, 3))
    # SciPy's own way to a periodic spline: wrap knots and coefficients far enough in both directions.
    index = np.arange(-6 * count - degree, 7 * count + degree + 1)
    wide = knots[index % count] + index // count
    reference = BSpline(wide, values[index[: -degree - 1] % count], degree)
    low, high = start, start + width
    new_knots, new_values = unwrap(knots, degree, values, low, high)
    t = np.linspace(low, high, 31)[:-1]
    np.testing.assert_allclose(BSpline(new_knots, new_values, degree)(t), reference(t), atol=1e-9)


def _tube(samples, seam_gap=0.0):
    """A clamped tube that closes in u (a cubic through a circle's points would not do: poles set by hand)."""
    angle = np.linspace(0, 2 * np.pi, samples)
    ring = np.stack([10 * np.cos(angle), 10 * np.sin(angle)], axis=1)
    ring[-1] += seam_gap
    ring[0], ring[-1] = 0.5 * (ring[1] + ring[-2]) + (ring[0] - ring[0]), 0.5 * (ring[1] + ring[-2]) + seam_gap
    poles = np.stack([np.concatenate([ring, np.full((samples, 1), z)], axis=1) for z in (0.0, 8.0)], axis=1)
    inner = np.linspace(0, 1, samples - 2)
    knots = np.concatenate([[0.0] * 3, inner, [1.0] * 3])
    return Sheet(3, 1, knots, np.array([0.0, 0.0, 1.0, 1.0]), poles)


def test_a_clamped_tube_that_meets_itself_gets_its_period():
    sheet = _tube(9)
    closed = close_smooth_seams(sheet)
    assert closed.period_u == pytest.approx(1.0) and closed.period_v is None
    assert closed.closes((0.0, 1.0, 0.0, 1.0)) == (True, False)
    assert closed.closes((0.0, 0.9, 0.0, 1.0)) == (False, False)
    surface = closed.unwrapped((0.8, 1.3, 0.0, 1.0))
    assert surface.domain == pytest.approx((0.55, 1.55, 0.0, 1.0))
    u, v = np.linspace(0.56, 1.54, 60), np.linspace(0.1, 0.9, 60)
    plain = sheet.unwrapped((0.0, 1.0, 0.0, 1.0))
    np.testing.assert_allclose(_points(surface, u, v), _points(plain, u % 1.0, v), atol=1e-12)


def test_a_tube_with_a_gap_stays_open():
    assert close_smooth_seams(_tube(9, seam_gap=0.01)).period_u is None
