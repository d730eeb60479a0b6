"""Evaluation against SciPy's splines, footpoints against its least squares."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import BSpline, NdBSpline
from scipy.optimize import least_squares

from benchmarks.shapes import clamped_knots, smooth_surface
from conflank_cli.geometry.footpoint import INTERIOR, Projector
from conflank_cli.geometry.gap import polynomials_of, travel
from conflank_cli.geometry.kernels.cubic import course, pose
from conflank_cli.geometry.normal_equations import basis_at
from conflank_cli.motion import Motion

DERIVATIVES = [(0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2)]
UNEVEN = np.array([0.0, 0.07, 0.2, 0.2, 0.55, 0.6, 0.6, 0.6, 0.9, 1.0])


@pytest.mark.parametrize("degrees", [(1, 1), (1, 3), (2, 3), (3, 3), (4, 2), (5, 5)])
def test_values_and_all_derivatives(degrees: tuple[int, int]) -> None:
    """Uneven knots, repeated up to three times or the degree; the second direction even."""
    inner = [x for x in np.unique(UNEVEN[1:-1]) for _ in range(min(np.sum(x == UNEVEN), degrees[0]))]
    knots_u = np.concatenate([np.zeros(degrees[0] + 1), inner, np.ones(degrees[0] + 1)])
    knots_v = clamped_knots(degrees[1], 4, -3.0, 5.0)
    rng = np.random.default_rng(21)
    surface = smooth_surface(rng, degrees, knots=(knots_u, knots_v))
    u, v = rng.uniform(0.0, 1.0, 400), rng.uniform(-3.0, 5.0, 400)
    # Ends and knots too: at a knot, SciPy and the kernel both look to the right.
    u[:6], v[:6] = [0.0, 1.0, 0.2, 0.6, 0.07, 0.0], [-3.0, 5.0, -1.0, 1.0, 5.0, 3.0]
    found = Projector.of(surface).evaluate(u, v)
    oracle = NdBSpline((knots_u, knots_v), surface.poles, degrees)
    for which, order in enumerate(DERIVATIVES):
        expected = oracle(np.stack([u, v], axis=1), nu=order)
        scale = max(1.0, float(np.abs(expected).max()))
        # Spans of a twentieth: coordinates of 60 mm lose a few digits on the way to a second derivative.
        np.testing.assert_allclose(found[:, which], expected, rtol=0.0, atol=1e-11 * scale, err_msg=str(order))


@pytest.mark.parametrize("rational", [False, True])
def test_footpoints_against_least_squares(rational: bool) -> None:
    """Cold starts against a trust-region solver that sees nothing but the residual vector."""
    rng = np.random.default_rng(22)
    surface = smooth_surface(rng, (3, 3), (8, 4), rational=rational, bulge=3.0)
    projector = Projector.of(surface)
    points = rng.uniform([2.0, 2.0, -6.0], [55.0, 28.0, 6.0], (40, 3))
    found = projector.project(points)
    interior = found.flag == INTERIOR
    assert interior.sum() > 25
    for k in np.flatnonzero(interior):
        solved = least_squares(
            lambda x, k=k: projector.evaluate(x[0], x[1])[0, 0] - points[k],
            [found.u[k] + 2e-3, found.v[k] - 2e-3],
            jac=lambda x: projector.evaluate(x[0], x[1])[0, 1:3].T,
            bounds=([0.0, 0.0], [1.0, 1.0])
            if 0.01 < found.u[k] < 0.99 and 0.01 < found.v[k] < 0.99
            else (-np.inf, np.inf),
            xtol=1e-15,
            ftol=1e-15,
            gtol=1e-15,
        )
        assert abs(np.linalg.norm(solved.fun) - abs(found.distance[k])) < 1e-9


@pytest.fixture(params=[[], [0.3], [0.2, 0.2, 0.5], [0.1, 0.4, 0.4, 0.4, 0.9]], ids=len)
def knots(request: pytest.FixtureRequest) -> np.ndarray:
    """Clamped cubic knots, with inner ones repeated up to three times."""
    return np.concatenate([np.zeros(4), request.param, np.ones(4)])


def test_the_basis_of_a_motion_and_its_derivatives(knots: np.ndarray) -> None:
    t = np.concatenate([knots, np.random.default_rng(23).random(50)])
    count = len(knots) - 4
    found = basis_at(knots, t)
    for order, rows in enumerate((found.value, found.slope, found.bend)):
        full = np.zeros((len(t), count))
        np.put_along_axis(full, found.first[:, None] + np.arange(4), rows, axis=1)
        np.testing.assert_allclose(full, BSpline(knots, np.eye(count), 3)(t, nu=order), rtol=0.0, atol=1e-11)


def test_a_motion_as_polynomials(knots: np.ndarray) -> None:
    rng = np.random.default_rng(24)
    p, q = rng.normal(scale=10.0, size=(2, len(knots) - 4, 3))
    motion = Motion(knots, p, q)
    polynomials, breaks = polynomials_of(motion)
    at, velocity, again = np.empty(6), np.empty(6), np.empty(6)
    for t in [*breaks, *rng.random(50)]:
        course.py_func(polynomials, breaks, t, at, velocity)
        pose.py_func(polynomials, breaks, t, again)
        np.testing.assert_allclose(at, np.hstack(motion.ends([t]))[0], rtol=0.0, atol=1e-12)
        np.testing.assert_array_equal(at, again)
        # To the left of the end, to the right of all else.
        np.testing.assert_allclose(velocity, np.hstack(motion.ends([t], 1))[0], rtol=0.0, atol=1e-10)
    chords = np.linalg.norm(np.diff(motion.ends(np.linspace(0.0, 1.0, 65)), axis=1), axis=2).sum(axis=1)
    assert travel(motion) == pytest.approx(chords.max(), rel=1e-12)
