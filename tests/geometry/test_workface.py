"""Faces made ready: areas by formula, the trim, the margin."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.path import Path

from conflank_cli.geometry.face import DesignFace
from conflank_cli.geometry.kernels.polygon import inside_even_odd
from conflank_cli.geometry.workface import RASTER, WorkFace, on_face
from tests.faces import design, round_face, work
from tests.verification.scenes import plane_face, rectangle


def polygon(rng: np.random.Generator, corners: int, centre: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
    """Star shaped, so that it does not cross itself."""
    angle = np.sort(rng.uniform(0.0, 2.0 * np.pi, corners))
    radius = rng.uniform(0.3, 1.0, corners)
    return np.stack([centre[0] + radius * np.cos(angle), centre[1] + radius * np.sin(angle)], axis=1)


@settings(max_examples=40, deadline=None, derandomize=True)
@given(st.integers(0, 2**32 - 1), st.integers(3, 12))
def test_even_odd_against_matplotlib(seed: int, corners: int) -> None:
    rng = np.random.default_rng(seed)
    outer, inner = 2.0 * polygon(rng, corners), 0.4 * polygon(rng, corners)
    points = rng.uniform(-2.0, 2.0, (300, 2))
    out = np.empty(300, dtype=np.bool_)
    vertices = np.concatenate([outer, inner])
    inside_even_odd(points[:, 0].copy(), points[:, 1].copy(), vertices, np.array([0, corners, 2 * corners]), out)
    expected = Path(outer).contains_points(points) ^ Path(inner).contains_points(points)
    np.testing.assert_array_equal(out, expected)


def test_samples_measure_the_area_of_a_cylinder() -> None:
    """Radius 25, angle 1.2, height 30."""
    samples = work(round_face(25.0), 1).samples(0.5)
    assert samples.areas.sum() == pytest.approx(25.0 * 1.2 * 30.0, rel=1e-9)
    out = samples.points[:, :2] / np.linalg.norm(samples.points[:, :2], axis=1)[:, None]
    np.testing.assert_allclose(samples.normals[:, :2], out, atol=1e-6)
    np.testing.assert_allclose(work(round_face(25.0), -1).samples(2.0).normals[:, 2], 0.0, atol=1e-6)
    assert np.all(np.sum(work(round_face(25.0), -1).samples(2.0).normals[:, :2], axis=1) < 0.5)
    assert samples.areas.max() <= 0.5**2 * 1.01


def test_samples_are_clipped_by_the_trim() -> None:
    """A plate of 40 x 20 with a hole of radius 6: area to the pixels on the rim."""
    angle = np.linspace(0.0, 2.0 * np.pi, 200, endpoint=False)
    hole = np.stack([20.0 + 6.0 * np.cos(angle), 10.0 + 6.0 * np.sin(angle)], axis=1)
    plate = plane_face((0.0, 40.0), (0.0, 20.0))
    face = DesignFace(0, "", plate.surface, (rectangle(0.0, 40.0, 0.0, 20.0), hole), 1)
    prepared = WorkFace.of(face, 5.0)
    samples = prepared.samples(0.25)
    assert samples.areas.sum() == pytest.approx(800.0 - 36.0 * np.pi, rel=2e-3)
    assert np.hypot(samples.points[:, 0] - 20.0, samples.points[:, 1] - 10.0).min() > 5.99
    np.testing.assert_array_equal(
        on_face(face, np.array([[20.0, 10.0], [20.0, 3.0], [-1.0, 3.0]])), [False, True, False]
    )
    np.testing.assert_array_equal(samples.cell.max(axis=0) < samples.shape, True)
    # The raster spans the extended domain, the face 40 x 20 of it.
    breaks_u, breaks_v = prepared.projector.spans.breaks_u, prepared.projector.spans.breaks_v
    whole = (breaks_u[-1] - breaks_u[0]) * (breaks_v[-1] - breaks_v[0])
    assert prepared.raster.shape == (RASTER, RASTER)
    assert prepared.raster.mean() * whole == pytest.approx(800.0 - 36.0 * np.pi, rel=5e-3)


def test_spacing_gives_about_the_number_asked_for() -> None:
    face = work(round_face(25.0), 1)
    for count in (200, 3000):
        assert len(face.samples(face.spacing(count)).areas) == pytest.approx(count, rel=0.15)


def test_margin_is_only_what_the_surface_lacks() -> None:
    """A face in the middle of a surface of 40 x 20 mm, 4 mm from each side."""
    plate = plane_face((0.0, 40.0), (0.0, 20.0))
    inner = DesignFace(0, "", plate.surface, (rectangle(4.0, 36.0, 4.0, 16.0),), 1)
    for margin, low, high in ((3.0, 0.0, 40.0), (7.0, -3.0, 43.0)):
        breaks = WorkFace.of(inner, margin).projector.spans.breaks_u
        assert (breaks[0], breaks[-1]) == pytest.approx((low, high), abs=1e-12)
    # However large the margin, the guess is not continued past 0.4 of the surface.
    far = WorkFace.of(design(plate.surface, 1), 100.0).projector.spans
    assert (far.breaks_v[0], far.breaks_v[-1]) == pytest.approx((-8.0, 28.0), abs=1e-12)
