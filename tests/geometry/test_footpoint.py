"""Footpoints: accuracy against known feet, borders, poles, creases, skew and the centre of curvature."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from benchmarks.shapes import clamped_knots, moved, smooth_surface
from conflank_cli.geometry.footpoint import (
    CLAMPED,
    FAILED,
    INTERIOR,
    OUTSIDE,
    WORTH_A_THREAD,
    Footpoints,
    Projector,
)
from conflank_cli.geometry.surface import BSplineSurface

Array = npt.NDArray[np.float64]
WARM_ACCURACY = 1e-9  # mm, what the kernel promises


def offset_points(projector: Projector, u: Array, v: Array, distance: Array) -> tuple[Array, Array, Array]:
    """Points at a distance along the normal, with their feet and unit normals."""
    frame = projector.evaluate(u, v)
    normal = np.cross(frame[:, 1], frame[:, 2])
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    return frame[:, 0] + distance[:, None] * normal, frame[:, 0], normal


def largest_curvature(projector: Projector) -> float:
    """Largest absolute principal curvature over a grid, 1/mm."""
    u0, u1, v0, v1 = projector.spans.box
    u, v = (x.ravel() for x in np.meshgrid(np.linspace(u0, u1, 40), np.linspace(v0, v1, 40)))
    f = projector.evaluate(u, v)
    normal = np.cross(f[:, 1], f[:, 2])
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    first = np.einsum("nax,nbx->nab", f[:, 1:3], f[:, 1:3])
    second = np.einsum("nmx,nx->nm", f[:, 3:], normal)[:, [0, 1, 1, 2]].reshape(-1, 2, 2)
    return float(np.abs(np.linalg.eigvals(np.linalg.solve(first, second))).max())


def assert_feet(found: Footpoints, feet: Array, normal: Array, distance: Array) -> None:
    """The feet found are the feet known."""
    np.testing.assert_array_equal(found.flag, INTERIOR)
    np.testing.assert_allclose(found.foot, feet, rtol=0.0, atol=WARM_ACCURACY)
    np.testing.assert_allclose(found.distance, distance, rtol=0.0, atol=WARM_ACCURACY)
    np.testing.assert_allclose(found.normal, normal, rtol=0.0, atol=WARM_ACCURACY)


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    degrees=st.tuples(st.integers(2, 5), st.integers(2, 5)),
    rational=st.booleans(),
    reach=st.floats(0.05, 0.9),
)
def test_a_point_on_a_normal_has_the_foot_it_came_from(
    seed: int, degrees: tuple[int, int], rational: bool, reach: float
) -> None:
    """Warm, up to 0.9 of the smallest radius of curvature away, on a random surface in a random place."""
    rng = np.random.default_rng(seed)
    surface = smooth_surface(rng, degrees, (4, 3), rational=rational)
    surface = moved(surface, Rotation.random(rng=rng).as_matrix(), rng.uniform(-200.0, 200.0, 3))
    projector = Projector.of(surface)
    u, v = rng.uniform(0.02, 0.98, (2, 60))
    distance = rng.uniform(-1.0, 1.0, 60) * min(reach / largest_curvature(projector), 60.0)
    points, feet, normal = offset_points(projector, u, v, distance)
    start = rng.uniform(-5e-3, 5e-3, (2, 60))
    assert_feet(projector.project(points, u + start[0], v + start[1]), feet, normal, distance)


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_rigid_motion_moves_the_feet_along(seed: int) -> None:
    rng = np.random.default_rng(seed)
    surface = smooth_surface(rng, (3, 3), (6, 4), rational=bool(seed % 2))
    rotation, shift = Rotation.random(rng=rng).as_matrix(), rng.uniform(-100.0, 100.0, 3)
    points = rng.uniform([-5.0, -5.0, -6.0], [65.0, 35.0, 6.0], (50, 3))
    here = Projector.of(surface).project(points)
    there = Projector.of(moved(surface, rotation, shift)).project(points @ rotation.T + shift, here.u, here.v)
    safe = here.flag != FAILED
    assert safe.mean() > 0.9
    np.testing.assert_array_equal(there.flag[safe], here.flag[safe])
    np.testing.assert_allclose(there.distance[safe], here.distance[safe], atol=1e-8)


@pytest.mark.parametrize("shear", [0.0, 5.0, 20.0, 60.0])
def test_skewed_parameter_lines_do_not_matter(shear: float) -> None:
    """z = x^2 / 200 - y^2 / 150 + x y / 90 with x = (1 + shear) u + shear v, y = v: lines down to a degree apart.

    A bound on the determinant of the Hessian alone would take every such Hessian for bad.
    """
    knots = clamped_knots(2, 1)
    u, v = np.meshgrid([0.0, 0.5, 1.0], [0.0, 0.5, 1.0], indexing="ij")
    x, y = (1.0 + shear) * u + shear * v - shear, v
    values = np.stack([x, y, x * x / 200.0 - y * y / 150.0 + x * y / 90.0], axis=-1)
    to_poles = np.array([[1.0, 0.0, 0.0], [-0.5, 2.0, -0.5], [0.0, 0.0, 1.0]])  # Bernstein from values at 0, 1/2, 1
    surface = BSplineSurface(2, 2, knots, knots, np.einsum("ia,jb,abx->ijx", to_poles, to_poles, values))
    projector = Projector.of(surface)
    rng = np.random.default_rng(7)
    u, v = rng.uniform(0.05, 0.95, (2, 500))
    distance = rng.uniform(-10.0, 10.0, 500)
    points, feet, normal = offset_points(projector, u, v, distance)
    assert_feet(projector.project(points, u + 5e-3, v - 5e-3), feet, normal, distance)


def parabolic_trough(radius: float = 10.0) -> BSplineSurface:
    """z = x^2 / (2 radius) over x, y in [-5, 5]; its normal points up, its centre of curvature is at z = radius."""
    knots = clamped_knots(2, 1)
    x, y = np.meshgrid([-5.0, 0.0, 5.0], [-5.0, 0.0, 5.0], indexing="ij")
    z = np.array([1.0, -1.0, 1.0])[:, None] * 25.0 / (2.0 * radius) * np.ones((1, 3))
    return BSplineSurface(2, 2, knots, knots, np.stack([x, y, z], axis=-1))


@pytest.mark.parametrize("height", [9.0, 9.6, 9.8, 9.95, 9.99])
def test_almost_at_the_centre_of_curvature(height: float) -> None:
    """The Hessian is 1 - height / radius of the metric there; Gauss-Newton steps would creep and stop short."""
    projector = Projector.of(parabolic_trough())
    u = np.linspace(0.48, 0.52, 9)
    distance = np.full(9, height)
    points, feet, normal = offset_points(projector, u, np.full(9, 0.5), distance)
    assert_feet(projector.project(points, u + 0.03, np.full(9, 0.5)), feet, normal, distance)


def test_beyond_the_centre_of_curvature_the_nearer_branch_is_found() -> None:
    """Above the trough's centre of curvature the axis of symmetry is a crest, and the feet lie left and right of it."""
    height, radius = 13.0, 10.0
    projector = Projector.of(parabolic_trough(radius))
    point = np.array([[0.0, 0.0, height]])
    x = np.sqrt(2.0 * radius * (height - radius))  # from (z - height) z' + x = 0 with z = x^2 / (2 radius)
    assert x > 5.0  # past the edge: so the nearest point is on the boundary
    found = projector.project(np.repeat(point, 2, axis=0), np.array([0.45, 0.55]), np.array([0.4, 0.6]))
    np.testing.assert_array_equal(found.flag, CLAMPED)
    np.testing.assert_allclose(found.u, [0.0, 1.0], atol=0.0)
    height = 10.5
    x = np.sqrt(2.0 * radius * (height - radius))
    found = projector.project(np.array([[0.0, 0.0, height]] * 2), np.array([0.45, 0.55]), np.array([0.4, 0.6]))
    np.testing.assert_array_equal(found.flag, INTERIOR)
    np.testing.assert_allclose(found.foot[:, 0], [-x, x], atol=WARM_ACCURACY)


def test_closest_point_on_the_boundary_is_clamped() -> None:
    surface = smooth_surface(np.random.default_rng(8), (3, 3), (6, 3))
    projector = Projector.of(surface)
    v = np.linspace(0.1, 0.9, 30)
    frame = projector.evaluate(np.zeros_like(v), v)
    normal = np.cross(frame[:, 1], frame[:, 2])
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    away = np.cross(frame[:, 2], normal)  # tangent, square to the edge
    away *= -np.sign(np.einsum("nx,nx->n", away, frame[:, 1]))[:, None]
    away /= np.linalg.norm(away, axis=1)[:, None]
    points = frame[:, 0] + 0.7 * normal + 0.4 * away
    found = projector.project(points)
    np.testing.assert_array_equal(found.flag, CLAMPED)
    np.testing.assert_allclose(found.u, 0.0, atol=0.0)
    np.testing.assert_allclose(found.foot, frame[:, 0], rtol=0.0, atol=WARM_ACCURACY)
    np.testing.assert_allclose(found.distance, 0.7, rtol=0.0, atol=WARM_ACCURACY)


def test_closest_point_in_a_corner_is_clamped() -> None:
    surface = smooth_surface(np.random.default_rng(9), (3, 3), (6, 3), bulge=0.5)
    projector = Projector.of(surface)
    found = projector.project(np.array([[-4.0, -5.0, 1.0], [90.0, 45.0, 1.0]]))
    np.testing.assert_array_equal(found.flag, CLAMPED)
    np.testing.assert_array_equal(found.u, [0.0, 1.0])
    np.testing.assert_array_equal(found.v, [0.0, 1.0])


def test_foot_on_the_extension_is_outside() -> None:
    surface = smooth_surface(np.random.default_rng(10), (3, 3), (6, 3), bulge=2.0)
    projector = Projector.of(surface, (0.1, 0.1, 0.1, 0.1))
    u = np.array([-0.05, 1.05, 0.4, 0.6, -0.02, 0.001, 0.999])
    v = np.array([0.5, 0.3, -0.07, 1.07, 1.03, 0.5, 0.5])
    distance = np.full(7, 1.0)
    points, feet, _ = offset_points(projector, u, v, distance)
    found = projector.project(points)
    np.testing.assert_array_equal(found.flag, [OUTSIDE] * 5 + [INTERIOR] * 2)
    np.testing.assert_allclose(found.foot, feet, rtol=0.0, atol=WARM_ACCURACY)
    np.testing.assert_allclose(found.distance, distance, rtol=0.0, atol=WARM_ACCURACY)


def test_points_past_the_extension_are_clamped_to_its_end() -> None:
    surface = smooth_surface(np.random.default_rng(10), (3, 3), (6, 3), bulge=0.5)
    found = Projector.of(surface, (0.1, 0.1, 0.0, 0.0)).project(np.array([[-30.0, 15.0, 0.0]]))
    assert found.flag[0] == CLAMPED
    assert found.u[0] == pytest.approx(-0.1, abs=1e-15)


@pytest.mark.parametrize("degrees", [(1, 3), (3, 1), (1, 1)])
def test_ruled_and_bilinear_surfaces(degrees: tuple[int, int]) -> None:
    """Degree 1 with one span: a second derivative vanishes, the mixed one does not."""
    rng = np.random.default_rng(11)
    spans = (1 if degrees[0] == 1 else 5, 1 if degrees[1] == 1 else 5)
    projector = Projector.of(smooth_surface(rng, degrees, spans, bulge=2.0))
    u, v = rng.uniform(0.02, 0.98, (2, 300))
    distance = rng.uniform(-3.0, 3.0, 300)
    points, feet, normal = offset_points(projector, u, v, distance)
    assert_feet(projector.project(points), feet, normal, distance)


def test_crease_between_facets() -> None:
    """Degree 1 with several spans: points above a ridge have no orthogonal foot, and must not be given one."""
    x, y = np.meshgrid([0.0, 10.0, 20.0], [0.0, 10.0], indexing="ij")
    z = np.array([0.0, 5.0, 0.0])[:, None] * np.ones((1, 2))
    surface = BSplineSurface(1, 1, clamped_knots(1, 2), clamped_knots(1, 1), np.stack([x, y, z], axis=-1))
    projector = Projector.of(surface)
    points = np.array([[10.0, 4.0, 7.0], [10.3, 6.0, 8.0], [6.0, 5.0, 6.0]])
    found = projector.project(points)
    assert np.all(found.flag[:2] != INTERIOR)  # never taken for an orthogonal foot
    assert np.all(np.isfinite(found.foot))
    assert found.flag[2] == INTERIOR
    np.testing.assert_allclose(found.foot[2], [7.2, 5.0, 3.6], atol=WARM_ACCURACY)


def spherical_cap() -> BSplineSurface:
    """An eighth of a sphere of radius 10, exact and rational; the edge v = 1 is collapsed into the pole (0, 0, 10)."""
    half = np.sqrt(0.5)
    arc = np.array([[1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    weights = np.array([1.0, half, 1.0])
    poles = np.empty((3, 3, 3))
    poles[..., :2] = 10.0 * arc[:, None, :] * arc[None, :, :1]
    poles[..., 2] = 10.0 * arc[None, :, 1]
    knots = clamped_knots(2, 1)
    return BSplineSurface(2, 2, knots, knots, poles, weights[:, None] * weights[None, :])


def test_pole_of_the_parametrisation() -> None:
    projector = Projector.of(spherical_cap())
    angle = np.linspace(0.05, 1.5, 20)
    for tilt in (0.6, 0.1, 1e-2, 1e-4):
        direction = np.stack(
            [np.cos(angle) * np.sin(tilt), np.sin(angle) * np.sin(tilt), np.full_like(angle, np.cos(tilt))], axis=1
        )
        for radius in (9.0, 12.0):
            found = projector.project(radius * direction)
            assert np.all(np.isfinite(found.foot))
            assert not np.any(found.flag == FAILED)
            np.testing.assert_allclose(found.foot, 10.0 * direction, atol=1e-6)


def test_nearest_point_is_the_pole_itself() -> None:
    """All tangents along u vanish there: no division by them."""
    points = np.array([[0.0, 0.0, 12.0], [0.0, 0.0, 9.5], [-2.0, -1.5, 11.0], [-0.1, -0.2, 8.0]])
    projector = Projector.of(spherical_cap())
    for start in (None, np.full(4, 0.5), np.zeros(4), np.ones(4)):
        found = projector.project(points, start, np.ones(4) if start is not None else None)
        assert np.all(found.flag[2:] == CLAMPED)  # the residual is not along the normal
        np.testing.assert_allclose(found.foot, [[0.0, 0.0, 10.0]] * 4, atol=1e-6)
        np.testing.assert_allclose(found.normal, [[0.0, 0.0, 1.0]] * 4, atol=1e-6)
        np.testing.assert_allclose(found.distance, points[:, 2] - 10.0, atol=1e-6)


def test_cold_start_finds_the_nearest_point() -> None:
    """Against a dense search, on a strongly waved surface."""
    rng = np.random.default_rng(12)
    surface = smooth_surface(rng, (3, 3), (17, 7), bulge=6.0)
    projector = Projector.of(surface)
    points = rng.uniform([0.0, 0.0, -8.0], [60.0, 30.0, 8.0], (2000, 3))
    found = projector.project(points)
    u, v = (x.ravel() for x in np.meshgrid(np.linspace(0.0, 1.0, 500), np.linspace(0.0, 1.0, 250)))
    nearest, _ = cKDTree(projector.evaluate(u, v)[:, 0]).query(points)
    distance = np.linalg.norm(points - found.foot, axis=1)
    assert np.mean(distance <= nearest + 1e-9) > 0.995  # what `project` promises short of two equally near parts
    assert not np.any(found.flag == FAILED)


def test_threads_change_nothing() -> None:
    rng = np.random.default_rng(13)
    projector = Projector.of(smooth_surface(rng))
    points = rng.uniform([0.0, 0.0, -2.0], [60.0, 30.0, 2.0], (2 * WORTH_A_THREAD, 3))
    whole = projector.project(points)
    parts = [projector.project(chunk) for chunk in np.array_split(points, 2)]
    for field, name in enumerate(Footpoints._fields):
        np.testing.assert_array_equal(whole[field], np.concatenate([part[field] for part in parts]), err_msg=name)


def test_starts_outside_the_domain_are_allowed() -> None:
    projector = Projector.of(smooth_surface(np.random.default_rng(14), bulge=1.0))
    points, feet, _ = offset_points(projector, np.array([0.02, 0.97]), np.array([0.5, 0.98]), np.array([1.0, -1.0]))
    found = projector.project(points, np.array([-0.4, 1.6]), np.array([0.5, 1.2]))
    np.testing.assert_allclose(found.foot, feet, rtol=0.0, atol=WARM_ACCURACY)
