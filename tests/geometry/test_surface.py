"""Per-span polynomials: the smooth extension, and what a surface says about itself."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.shapes import clamped_knots, smooth_surface
from conflank_cli.geometry.footpoint import Projector
from conflank_cli.geometry.surface import BSplineSurface, to_spans

EXTENSION = (0.2, 0.3, 0.15, 0.25)
ABOVE_ALL_ROUNDING = 1e-10  # relative to coordinates of tens of millimetres and derivatives of some thousands


@pytest.mark.parametrize("degrees", [(1, 3), (2, 2), (3, 3), (5, 4)])
@pytest.mark.parametrize("side", ["u0", "u1", "v0", "v1"])
def test_extension_continues_value_slope_and_curvature(degrees: tuple[int, int], side: str) -> None:
    surface = smooth_surface(np.random.default_rng(3), degrees, (4, 3))
    extended = Projector.of(surface, EXTENSION)
    along = np.linspace(-0.15, 1.25, 29)
    at, step = (0.0, -1e-9) if side.endswith("0") else (1.0, 1e-9)
    edge, past = np.full_like(along, at), np.full_like(along, at + step)
    inside = extended.evaluate(edge - step, along) if side[0] == "u" else extended.evaluate(along, edge - step)
    outside = extended.evaluate(past, along) if side[0] == "u" else extended.evaluate(along, past)
    # 2e-9 of parameter apart: third derivatives (some thousands) bound what may change.
    np.testing.assert_allclose(outside, inside, atol=1e-4 if 5 in degrees else 2e-5, rtol=0.0)


def test_extension_is_quadratic_beyond_the_boundary() -> None:
    surface = smooth_surface(np.random.default_rng(4), (5, 3), (4, 3))
    extended = Projector.of(surface, EXTENSION)
    plain = Projector.of(surface)
    along = np.linspace(0.0, 1.0, 9)
    for start, reach in ((0.0, -0.2), (1.0, 0.3)):
        edge = plain.evaluate(np.full_like(along, start), along)
        for x in (0.25 * reach, 0.7 * reach, reach):
            expected = edge[:, 0] + edge[:, 1] * x + 0.5 * edge[:, 3] * x * x
            found = extended.evaluate(np.full_like(along, start + x), along)[:, 0]
            np.testing.assert_allclose(found, expected, atol=ABOVE_ALL_ROUNDING)
    for start, reach in ((0.0, -0.15), (1.0, 0.25)):
        edge = plain.evaluate(along, np.full_like(along, start))
        for x in (0.25 * reach, 0.7 * reach, reach):
            expected = edge[:, 0] + edge[:, 2] * x + 0.5 * edge[:, 5] * x * x
            found = extended.evaluate(along, np.full_like(along, start + x))[:, 0]
            np.testing.assert_allclose(found, expected, atol=ABOVE_ALL_ROUNDING)


def test_extension_leaves_the_surface_proper_alone() -> None:
    surface = smooth_surface(np.random.default_rng(5), (3, 2), (6, 2), rational=True)
    u, v = np.random.default_rng(0).uniform(0.0, 1.0, (2, 200))
    np.testing.assert_array_equal(Projector.of(surface, EXTENSION).evaluate(u, v), Projector.of(surface).evaluate(u, v))


def test_extension_of_a_rational_cylinder_is_smooth() -> None:
    """A quarter circle extruded: in homogeneous coordinates the quadratic extension is the circle itself."""
    half = np.sqrt(0.5)
    poles = np.array([[[8.0, 0.0, z], [8.0, 8.0, z], [0.0, 8.0, z]] for z in (0.0, 20.0)]).transpose(1, 0, 2)
    weights = np.array([[1.0, 1.0], [half, half], [1.0, 1.0]])
    surface = BSplineSurface(2, 1, clamped_knots(2, 1), clamped_knots(1, 1), np.ascontiguousarray(poles), weights)
    u = np.linspace(-0.3, 1.3, 50)
    points = Projector.of(surface, (0.3, 0.3, 0.2, 0.2)).evaluate(u, 0.5)[:, 0]
    np.testing.assert_allclose(np.hypot(points[:, 0], points[:, 1]), 8.0, atol=1e-12)


def test_domain_and_box_of_an_uneven_knot_vector() -> None:
    knots = np.array([-2.0, -2.0, -2.0, -1.0, 0.5, 0.5, 3.0, 3.0, 3.0])
    surface = smooth_surface(np.random.default_rng(6), (2, 1), knots=(knots, clamped_knots(1, 2, 5.0, 7.0)))
    assert surface.domain == (-2.0, 3.0, 5.0, 7.0)
    spans = to_spans(surface, (1.0, 0.0, 0.0, 2.0))
    np.testing.assert_array_equal(spans.breaks_u, [-3.0, -2.0, -1.0, 0.5, 3.0])
    np.testing.assert_array_equal(spans.breaks_v, [5.0, 6.0, 7.0, 9.0])
    np.testing.assert_array_equal(spans.box, [-2.0, 3.0, 5.0, 7.0])
    assert spans.coefficients.shape == (4, 3, 4, 4, 4)  # cubics at least, and four coordinates
    assert not spans.coefficients[:, :, 3].any() and not spans.coefficients[:, :, :, 2:].any()
    assert not spans.coefficients[..., 3].any()
