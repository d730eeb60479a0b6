"""The blind search: against definitions spelt out, closed forms, and SciPy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize

from benchmarks.blind_families import ELLIPTIC, blind_families, principal
from benchmarks.blind_search import LEAST_RUN, SPHERES, BlindSearch, Trim, _on_trim, line_error, line_errors, score
from benchmarks.detection import fitted_exponent
from benchmarks.envelopes import PATCH, random_envelopes
from benchmarks.joined import join
from benchmarks.shapes import smooth_surface
from conflank_cli.detection.reachability import Reachability
from conflank_cli.geometry.face import DesignFace
from conflank_cli.geometry.footpoint import Projector
from conflank_cli.geometry.workface import FaceSamples, WorkFace, on_face
from conflank_cli.tool import CATALOGUE, Tool
from tests.faces import interpolated, round_face, stacked, work

CYLINDER = Tool("cylinder", 3.0, 3.0, 22.0)
RADIUS = 30.0


def some(samples: FaceSamples, chosen: np.ndarray) -> FaceSamples:
    return FaceSamples(
        samples.uv[chosen], samples.points[chosen], samples.normals[chosen], samples.areas[chosen],
        samples.cell[chosen], samples.shape,
    )  # fmt: skip


def middle(face: WorkFace, count: int = 2) -> FaceSamples:
    """The samples nearest to the middle of the parameter box, where the flute is on the face in every direction."""
    samples = face.samples(2.0)
    away = np.linalg.norm((samples.uv - samples.uv.mean(axis=0)) / np.ptp(samples.uv, axis=0), axis=1)
    return some(samples, np.sort(np.argsort(away)[:count]))


@pytest.fixture(scope="module")
def ball() -> WorkFace:
    """A sphere seen from outside: all directions alike, no asymptotic ones."""

    def shape(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        return RADIUS * stacked(np.cos(u) * np.cos(v), np.sin(u) * np.cos(v), np.sin(v))

    return work(interpolated(shape, (-0.7, 0.7), (-0.7, 0.7)), 1)


def test_the_error_of_a_line_is_its_definition() -> None:
    rng = np.random.default_rng(1)
    for _ in range(200):
        error, on = rng.normal(size=SPHERES), rng.random(SPHERES) < 0.9
        contact, least = int(rng.integers(SPHERES)), int(rng.integers(1, 13))
        # The least e that satisfies (a) and (b), tried in order, with runs as long as they get.
        for e in np.sort(np.abs(error)):
            good = on & (np.abs(error) <= e)
            low = high = contact
            while good[contact] and low > 0 and good[low - 1]:
                low -= 1
            while good[contact] and high < SPHERES - 1 and good[high + 1]:
                high += 1
            if good[contact] and high - low + 1 >= least and np.all(error[on] >= -e):
                break
        else:
            e = np.inf
        assert line_error(error, on, contact, least)[0] == e


def test_the_score_leaves_shift_and_tilt_out() -> None:
    rng = np.random.default_rng(2)
    error, on = 1e-3 * rng.normal(size=SPHERES), np.ones(SPHERES, dtype=bool)
    plain = score(error, on, 12, LEAST_RUN)
    tilted = score(error + 0.3 - 0.02 * np.arange(SPHERES), on, 12, LEAST_RUN)
    assert tilted[:2] == pytest.approx(plain[:2], abs=1e-12)
    assert tilted[2] - plain[2] == pytest.approx(0.3 - 0.02 * 12)
    assert tilted[3] - plain[3] == pytest.approx(-0.02)


def test_the_trim_is_the_even_odd_rule() -> None:
    turn = np.linspace(0.0, 2.0 * np.pi, 60)[:-1]
    star = np.stack([np.cos(turn), np.sin(turn)], axis=1) * (1.0 + 0.3 * np.cos(5.0 * turn))[:, None]
    hole = 0.2 * star[::-1] + [0.1, -0.2]
    surface = round_face(10.0)
    face = DesignFace(0, "", surface, (star, hole), 1)
    trim = Trim.of(face)
    uv = np.random.default_rng(3).uniform(-1.4, 1.4, (4000, 2))
    uv = np.concatenate([uv, np.repeat(star, 20, axis=0) + 1e-3 * np.random.default_rng(4).normal(size=(1180, 2))])
    found = [_on_trim(u, v, trim.vertices, trim.starts, trim.table, trim.box) for u, v in uv]
    np.testing.assert_array_equal(found, on_face(face, uv))


def test_a_cylinder_lies_along_the_rulings_of_a_cylinder() -> None:
    face = work(round_face(25.0, 0.0, 40.0), 1)
    lines = BlindSearch.of(face, CYLINDER).search(middle(face))
    # The face is interpolated to 1e-9 mm.
    assert lines.error.max() < 1e-7
    best = lines.every[..., 0] < 1e-7
    np.testing.assert_allclose(np.abs(lines.d[..., 0, 2][best]), 1.0, atol=1e-6)


def test_on_a_sphere_the_error_is_that_of_a_chord(ball: WorkFace) -> None:
    search = BlindSearch.of(ball, CYLINDER)
    lines = search.search(middle(ball, 1), (10,))
    # Spheres half a spacing, 1.5, 2.5 and 3.5 spacings either way of the nearest point of the axis, shifted to the
    # least maximum: half the difference of the farthest and the nearest distance from the centre.
    spacing = search.heights[1] - search.heights[0]
    inner, outer = (np.hypot(RADIUS + CYLINDER.r_min, k * spacing) for k in (0.5, 3.5))
    # p = 64 leaves the largest of eight errors a few per cent above the least.
    assert lines.error[0] == pytest.approx(0.5 * (outer - inner), rel=0.05)
    assert lines.error[0] >= 0.5 * (outer - inner) * (1.0 - 1e-3)


def test_no_line_near_the_ones_found_is_better_by_scipy() -> None:
    face = WorkFace.of(_whole(smooth_surface(np.random.default_rng(5))), 10.0)
    samples = middle(face, 1)
    tool, contact = CATALOGUE["T1"], 10
    search = BlindSearch.of(face, tool)
    lines = search.search(samples, (contact,))
    x, n, uv = samples.points[0], samples.normals[0], samples.uv[0]
    error, on, normal = np.empty(SPHERES), np.empty(SPHERES, dtype=bool), np.empty((SPHERES, 3))

    def least(freedoms: np.ndarray, d: np.ndarray) -> float:
        across = np.cross(n, d)
        turned = d + freedoms[1] * across + freedoms[2] * np.cross(d, across)
        turned /= np.linalg.norm(turned)
        centre = x + (search.radii[contact] + freedoms[0]) * n
        arguments = search.heights, search.radii, contact, *uv, error, on, normal
        line_errors(tuple(face.projector.spans), face.sense, search._trim, centre, turned, *arguments)
        return line_error(error, on, contact, search.least)[0]

    assert np.isfinite(lines.every[0, 0, 0])
    for k in np.flatnonzero(np.isfinite(lines.every[0, 0]))[:3]:
        d = lines.d[0, 0, k]
        shift = (lines.p[0, 0, k] + search.heights[contact] * d - x) @ n - search.radii[contact]
        start = np.array([shift, 0.0, 0.0])
        assert least(start, d) == pytest.approx(lines.every[0, 0, k], abs=1e-12)
        simplex = start + np.vstack([np.zeros(3), np.diag([2e-3, 2e-3, 2e-3])])
        found = minimize(least, start, args=(d,), method="Nelder-Mead", options={"initial_simplex": simplex})
        # Nanometres apart, a percentage means nothing.
        assert found.fun > 0.93 * lines.every[0, 0, k] - 1e-6


def test_a_given_line_is_measured_and_must_touch(ball: WorkFace) -> None:
    search, samples = BlindSearch.of(ball, CYLINDER), middle(ball, 1)
    lines = search.search(samples, (10,))
    height = search.heights[[10]]
    error, off = search.check(samples, lines.p[:, 0, 0], lines.d[:, 0, 0], height)
    np.testing.assert_allclose([error[0], off[0]], [lines.error[0], 0.0], atol=1e-9)
    beside = lines.p[:, 0, 0] + 0.2 * np.cross(samples.normals, lines.d[:, 0, 0])
    assert search.check(samples, beside, lines.d[:, 0, 0], height)[1][0] > 0.1


def test_principal_curvatures_of_a_cylinder() -> None:
    face = work(round_face(20.0), 1)
    values, first, _ = principal(BlindSearch.of(face, CYLINDER), middle(face, 2).uv)
    np.testing.assert_allclose(values, [[-1.0 / 20.0, 0.0]] * 2, atol=1e-8)
    np.testing.assert_allclose(first[:, 2], 0.0, atol=1e-6)


def test_on_a_sphere_directions_off_the_field_are_put_down_to_the_elliptic_offset(ball: WorkFace) -> None:
    search, samples = BlindSearch.of(ball, CYLINDER), middle(ball, 2)
    lines = search.search(samples, (10,))
    nothing = Reachability(samples, np.full(2, np.inf), *np.full((2, 2, 3), np.nan), np.full(2, np.nan), 0)
    families = blind_families(search, samples, lines, nothing, 2.0 * lines.error.max())
    assert families
    assert {family.why for family in families} == {ELLIPTIC}
    assert max(family.area_alone for family in families) == pytest.approx(samples.areas.sum())


def test_the_halves_of_a_joined_face_are_the_envelopes_they_are_made_of() -> None:
    a, b = random_envelopes(CATALOGUE["T1"], 2, 5)
    joined = next(face for face in (join(a, b), join(b, a), join(a, a), join(b, b)) if face is not None)
    projector = Projector.of(joined.surface)
    u, v = np.linspace(0.0, 1.0, 40), np.random.default_rng(6).uniform(0.05, 0.95, 40)
    gaps = []
    for start, _ in joined.halves:
        here = projector.evaluate(start + u, v)[:, 0]
        # The second one is moved, so distances between points are compared.
        spread = np.linalg.norm(here[:, None] - here, axis=-1)
        own = [Projector.of(case.surface).evaluate(PATCH[0] + (PATCH[1] - PATCH[0]) * u, v)[:, 0] for case in (a, b)]
        gaps.append(min(np.abs(np.linalg.norm(x[:, None] - x, axis=-1) - spread).max() for x in own))
    assert max(gaps) < 5e-4


def test_the_exponent_of_a_power_is_its_exponent() -> None:
    work_done = np.array([50.0, 420.0, 3000.0])
    assert fitted_exponent(work_done, 0.1 * work_done**0.8) == pytest.approx(0.8)


def _whole(surface) -> DesignFace:  # type: ignore[no-untyped-def]
    u0, u1, v0, v1 = surface.domain
    return DesignFace(0, "", surface, (np.array([[u0, v0], [u1, v0], [u1, v1], [u0, v1]]),), 1)
