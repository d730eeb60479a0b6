"""The reachability map against closed forms."""

from __future__ import annotations

from math import sqrt

import numpy as np
import pytest

from benchmarks.envelopes import cylinder
from conflank_cli.detection.reachability import SPHERES, reachability
from conflank_cli.geometry.face import DesignFace
from conflank_cli.geometry.footpoint import Projector
from conflank_cli.geometry.workface import WorkFace, on_face
from conflank_cli.tool import CATALOGUE, Tool
from tests.faces import envelope, interpolated, round_face, stacked, work

Array = np.ndarray
CYLINDER = cylinder()
RADIUS = 40.0


def ball_cap(u: Array, v: Array) -> Array:
    """A piece of a sphere about the origin, seen from outside along z."""
    return stacked(u, v, np.sqrt(RADIUS**2 - u**2 - v**2))


@pytest.mark.parametrize("engaged", [1.0 / 3.0, 2.0 / 3.0])
def test_on_a_sphere_the_error_is_half_the_sagitta_of_the_window(engaged: float) -> None:
    """Every line is as good as any other: at distance a from the centre the distance to the sphere runs, over a window
    of half length w, from a to sqrt(a² + w²), and the best line shares that range between overcut and stock left."""
    face = work(interpolated(ball_cap, (-14.0, 14.0), (-14.0, 14.0)), 1, 20.0)
    samples = face.samples(7.0)
    found = reachability(face, CYLINDER, samples, engaged=engaged)
    run = round(engaged * SPHERES)
    spacing = CYLINDER.length / (SPHERES - 1)
    # An even run of spheres has none at its middle: the nearest ones are half a spacing off.
    half, nearest = 0.5 * (run - 1) * spacing, 0.5 * spacing
    a = RADIUS + CYLINDER.r_min
    middle = np.linalg.norm(samples.uv, axis=1) < 6.0
    expected = 0.5 * (sqrt(a * a + half * half) - sqrt(a * a + nearest * nearest))
    assert np.all(found.error[middle] > 0.995 * expected)
    assert np.all(found.error[middle] < 1.02 * expected)


def test_a_cylinder_lies_along_the_rulings_of_a_cylinder() -> None:
    """Every point is reached exactly, along the whole flute, by the parallel through it."""
    face = work(round_face(RADIUS, height=40.0), 1, 20.0)
    samples = face.samples(8.0)
    found = reachability(face, CYLINDER, samples, engaged=0.9)
    assert found.error.max() < 1e-6
    inner = np.abs(samples.uv[:, 1] - 20.0) < 8.0
    assert np.abs(found.d[inner, 2]).min() > 1.0 - 1e-6
    # The line found does touch at the point: its sphere there is as far from it as its radius.
    centre = found.p + found.height[:, None] * found.d
    assert np.abs(np.linalg.norm(centre - samples.points, axis=1) - CYLINDER.r_min).max() < 1e-6


def test_an_exact_envelope_is_reached_over_the_flute() -> None:
    tool = CATALOGUE["T1"]
    case = envelope(tool)
    face = work(case.surface, case.sense, 0.7 * tool.length)
    samples = face.samples(5.0)
    found = reachability(face, tool, samples, engaged=0.75)
    assert found.share(0.002) > 0.95
    assert found.footpoints / len(samples.areas) < 5000


def test_no_line_fits_into_a_bore_narrower_than_the_tool() -> None:
    face = work(round_face(2.9, height=20.0), -1, 8.0)
    found = reachability(face, CYLINDER, face.samples(3.0))
    assert np.all(np.isinf(found.error))
    assert found.share(1.0) == 0.0


def test_the_error_reported_is_that_of_the_line_reported() -> None:
    """Recomputed from p and d with cold projections."""
    tool = CATALOGUE["T3"]
    face = work(interpolated(lambda u, v: stacked(u, v, 0.012 * u * v), (-20.0, 20.0), (-20.0, 20.0)), 1, 20.0)
    samples = face.samples(9.0)
    found = reachability(face, tool, samples)
    plain = Projector.of(face.face.surface)
    low, high = tool.centre_range
    heights = np.linspace(low, high, SPHERES)
    for k in range(len(samples.areas)):
        feet = plain.project(found.p[k] + heights[:, None] * found.d[k])
        error = feet.distance - tool.sphere_radius(heights)
        there = feet.flag == 1
        contact = int(np.argmin(np.abs(heights - found.height[k])))
        runs = [
            max(np.abs(error[a : a + 8]).max(), -error[there].min())
            for a in range(SPHERES - 7)
            if a <= contact < a + 8 and there[a : a + 8].all()
        ]
        assert min(runs) == pytest.approx(found.error[k], abs=1e-6)


def test_a_whole_flute_on_a_face_hardly_longer_than_it_reaches_every_point() -> None:
    """Each point has its own few heights at which the flute stays on the face; no start has them all."""
    face = work(round_face(RADIUS, height=1.1 * CYLINDER.length), 1, 0.5 * CYLINDER.length)
    found = reachability(face, CYLINDER, face.samples(2.0), engaged=1.0)
    assert found.error.max() < 1e-6


def test_a_line_may_be_best_in_a_direction_that_bends_more() -> None:
    """z = x⁴ c - x² k / 2 - 0.3 k y², with c = k / (2 a²): a Chebyshev polynomial along x over the run of length 2 a.

    At the top the face bends more along x than along y, but over the run a line along x is off by k a² / 16 only, and
    one along y by 0.6 k a² / 4.
    """
    k, run = 0.004, 8
    a = 0.5 * (run - 1) * CYLINDER.length / (SPHERES - 1)

    def shape(x: Array, y: Array) -> Array:
        return stacked(x, y, 0.5 * k / a**2 * x**4 - 0.5 * k * x**2 - 0.3 * k * y**2)

    face = work(interpolated(shape, (-4.0, 4.0), (-20.0, 20.0)), 1, 20.0)
    samples = face.samples(2.0)
    found = reachability(face, CYLINDER, samples, engaged=run / SPHERES)
    top = np.linalg.norm(samples.uv, axis=1) < 1.5
    assert top.any()
    assert np.all(found.error[top] < 1.05 * k * a**2 / 16)


@pytest.mark.parametrize("contact", [0.0, 6.0])
def test_the_error_is_the_least_maximum_of_a_cubic(contact: float) -> None:
    """z = b x y + c (x³ + y³): along either ruling of b x y the level, slope and curvature of the error can be had for
    nothing, and what is left of c s³ over a run of length 2 a is c a³ / 4, wherever the run touches."""
    b, c, thin = 0.012, 8e-5, Tool("thin", 0.2, 0.2, 16.0)
    face = work(
        interpolated(lambda x, y: stacked(x, y, b * x * y + c * (x**3 + y**3)), (-12.0, 12.0), (-12.0, 12.0)), 1, 8.0
    )
    samples = face.samples(1.5)
    found = reachability(face, thin, samples, engaged=1.0)
    a = 0.5 * thin.length
    heights = np.linspace(-a, a, SPHERES)
    cubic = np.abs(heights**3 - 0.75 * a**2 * heights).max()
    near = np.linalg.norm(samples.uv - contact, axis=1) < 2.0
    np.testing.assert_allclose(found.error[near], c * cubic, rtol=0.03)


@pytest.mark.parametrize("run", [8, 16])
def test_in_a_corner_a_line_turns_just_so_far_that_its_run_stays_on_the_face(run: int) -> None:
    """A round face trimmed to a corner of 90° whose chords along the rulings grow from nothing.

    Where the chord is shorter than the run the line has to turn by τ from the ruling. Its feet then lie on a line with
    the tangent R / (R + r) tan τ in the developed face, and the distance bends by sin² τ / (R + r) along it.
    """
    size, r = 20.0, CYLINDER.r_min
    corner = np.array([0.0, 1.5 * size])
    loop = (corner + size * np.array([[0.0, 0.0], [1.0, -1.0], [1.0, 1.0]])) / np.array([RADIUS, 1.0])
    face = WorkFace.of(DesignFace(0, "", round_face(RADIUS, height=3.0 * size, turn=1.4), (loop,), 1), size)
    samples = face.samples(1.5)
    found = reachability(face, CYLINDER, samples, engaged=run / SPHERES)

    spacing = CYLINDER.length / (SPHERES - 1)
    turn = np.radians(np.arange(-89.0, 89.0, 0.1))
    along = np.stack([RADIUS / (RADIUS + r) * np.sin(turn), np.cos(turn)], axis=1)
    point = samples.uv * np.array([RADIUS, 1.0]) - corner

    def on(foot: Array) -> Array:
        return np.asarray((np.abs(foot[..., 1]) <= foot[..., 0]) & (foot[..., 0] <= size))

    ends = [point[:, None] + k * spacing * along for k in range(1 - run, run)]
    possible = np.any([on(ends[k]) & on(ends[k + run - 1]) for k in range(run)], axis=0)
    least = np.where(possible, np.sin(turn) ** 2, np.inf).min(axis=1)
    # An even run of spheres has none at its middle: the nearest ones are half a spacing off.
    half, nearest = 0.5 * (run - 1) * spacing, 0.5 * spacing
    expected = least * (half**2 - nearest**2) / (4.0 * (RADIUS + r))
    turned = expected > 1e-3
    assert turned.sum() > 5
    ratio = found.error[turned] / expected[turned]
    assert ratio.min() > 0.95
    assert np.median(ratio) < 1.05
    # A line that is held back by the trim stops where it meets it, which need not be the best place.
    assert ratio.max() < 2.2


def test_the_trim_counts_exactly() -> None:
    """A round trim, whose cells in the raster are a tenth of a millimetre: the feet of every line are on the face."""
    angle = np.linspace(0.0, 2.0 * np.pi, 60, endpoint=False)
    surface = interpolated(lambda u, v: stacked(u, v, 0.012 * u * v), (-20.0, 20.0), (-20.0, 20.0))
    loop = 11.0 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    face = WorkFace.of(DesignFace(0, "", surface, (loop,), 1), 0.0)
    tool = CATALOGUE["T1"]
    # The outermost samples are nearer to the loop than the middle of their cell is.
    samples = face.samples(1.0)
    found = reachability(face, tool, samples)
    assert np.all(np.isfinite(found.error))
    heights = np.linspace(*tool.centre_range, SPHERES)
    centres = found.p[:, None] + heights[:, None] * found.d[:, None]
    feet = face.projector.project(centres.reshape(-1, 3))
    error = feet.distance.reshape(len(centres), -1) - tool.sphere_radius(heights)
    there = on_face(face.face, np.stack([feet.u, feet.v], axis=1)).reshape(error.shape)
    contact = np.argmin(np.abs(heights - found.height[:, None]), axis=1)
    for k in range(len(centres)):
        runs = [
            max(np.abs(error[k, a : a + 8]).max(), -error[k, there[k]].min())
            for a in range(SPHERES - 7)
            if a <= contact[k] < a + 8 and there[k, a : a + 8].all()
        ]
        assert min(runs) == pytest.approx(found.error[k], abs=1e-6)
