"""Seed lines against the closed forms of surfaces whose curvatures everybody knows."""

from __future__ import annotations

from math import cos, sin, sqrt, tan

import numpy as np
import pytest
from scipy.optimize import least_squares

from conflank_cli.detection.line_field import TURN, SeedLines, seed_lines, turned_lines
from conflank_cli.geometry.workface import WorkFace
from conflank_cli.tool import CATALOGUE, Tool
from tests.faces import interpolated, round_face, stacked, work

# Thin enough that the offset surface is the surface.
NEEDLE = Tool("needle", 1e-7, 1e-7, 20.0)
MIDDLE = np.array([10.0])
UV = np.array([[0.4, 0.3], [0.1, -0.4], [-0.35, 0.45], [-0.2, -0.25]])


def hyperbolic_paraboloid() -> WorkFace:
    """z = x y / 12 over 24 mm: ruled along x and along y."""
    return work(interpolated(lambda u, v: stacked(24 * u, 24 * v, 48 * u * v), (-0.6, 0.6), (-0.6, 0.6), 8), 1)


def hyperboloid(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """x² + y² = 20² + (z / 1.5)², by angle and height."""
    z = 20.0 * v
    r = np.sqrt(400.0 + (z / 1.5) ** 2)
    return stacked(r * np.cos(u), r * np.sin(u), z)


def helicoid(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Horizontal rulings that climb 30 mm a radian, at 10 to 35 mm from the axis."""
    r = 22.0 + 20.0 * v
    return stacked(r * np.cos(u), r * np.sin(u), 30.0 * u)


def across(d: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Sine of the angle between lines, each of `d` (N, 3) against its own of `directions` (N, 3)."""
    return np.linalg.norm(np.cross(d, directions / np.linalg.norm(directions, axis=1)[:, None]), axis=1)


def at(seeds: SeedLines, uv: np.ndarray) -> np.ndarray:
    return np.all(seeds.uv == uv, axis=1)


def test_lines_of_the_hyperbolic_paraboloid_are_its_two_rulings() -> None:
    face = hyperbolic_paraboloid()
    seeds = seed_lines(face, NEEDLE, UV, MIDDLE)
    assert len(seeds.p) == 4 * len(UV)  # two lines, either way round
    for uv in UV:
        d = seeds.d[at(seeds, uv)]
        first, second = np.array([1.0, 0.0, 2.0 * uv[1]]), np.array([0.0, 1.0, 2.0 * uv[0]])
        sines = np.stack([across(d, np.tile(ruling, (4, 1))) for ruling in (first, second)])
        np.testing.assert_allclose(np.sort(sines.min(axis=0)), 0.0, atol=1e-6)
        assert (sines[0] < 1e-6).sum() == 2
        np.testing.assert_allclose(d.sum(axis=0), 0.0, atol=1e-12)


def test_one_family_of_lines_of_the_hyperboloid_and_of_the_helicoid_are_rulings() -> None:
    face = work(interpolated(hyperboloid, (-0.6, 0.6), (-0.6, 0.6)), 1)
    seeds = seed_lines(face, NEEDLE, UV, MIDDLE)
    assert len(seeds.p) == 4 * len(UV)
    for uv in UV:
        x, y, z = hyperboloid(uv[0], uv[1])
        # A ruling (dx, dy, dz) obeys x dx + y dy = z dz / c² and dx² + dy² = dz² / c², with dz = 1.
        radial = z / 1.5**2 / np.hypot(x, y)
        tangential = sqrt(1.0 / 1.5**2 - radial**2)
        out, round_ = np.array([x, y, 0.0]) / np.hypot(x, y), np.array([-y, x, 0.0]) / np.hypot(x, y)
        rulings = [radial * out + s * tangential * round_ + np.array([0.0, 0.0, 1.0]) for s in (1, -1)]
        d = seeds.d[at(seeds, uv)]
        sines = np.stack([across(d, np.tile(ruling, (4, 1))) for ruling in rulings])
        np.testing.assert_allclose(sines.min(axis=0), 0.0, atol=1e-6)
        np.testing.assert_array_equal((sines < 1e-6).sum(axis=1), 2)

    face = work(interpolated(helicoid, (-0.6, 0.6), (-0.6, 0.6)), 1)
    seeds = seed_lines(face, NEEDLE, UV, MIDDLE)
    for uv in UV:
        ruling = np.array([[cos(uv[0]), sin(uv[0]), 0.0]] * 4)
        assert (across(seeds.d[at(seeds, uv)], ruling) < 1e-6).sum() == 2


@pytest.mark.parametrize("sense", [1, -1])
def test_lines_of_a_torus_are_asymptotic_on_the_offset_torus(sense: int) -> None:
    """Inside of a torus of radii 40 and 15; at offset ρ it is the torus of radii 40 and 15 ± ρ.

    Curvatures 1 / r and cos θ / (R + r cos θ) have different signs for cos θ < 0.
    """

    def shape(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        r = 40.0 + 15.0 * np.cos(np.pi + v)
        return stacked(r * np.cos(u), r * np.sin(u), 15.0 * np.sin(np.pi + v))

    face = work(interpolated(shape, (-0.6, 0.6), (-0.6, 0.6)), sense)
    tool = CATALOGUE["T2"]
    seeds = seed_lines(face, tool, UV, MIDDLE)
    rho = float(tool.sphere_radius(10.0))
    for uv in UV:
        theta = np.pi + uv[1]
        round_ = np.array([-sin(uv[0]), cos(uv[0]), 0.0])
        meridian = np.array([-sin(theta) * cos(uv[0]), -sin(theta) * sin(uv[0]), cos(theta)])
        normal = np.array([cos(theta) * cos(uv[0]), cos(theta) * sin(uv[0]), sin(theta)])  # out of the tube
        mine = at(seeds, uv)
        centre = seeds.p[mine] + 10.0 * seeds.d[mine]
        side = np.sign((centre[0] - shape(uv[0], uv[1])) @ normal)
        r = 15.0 + side * rho
        squared = -cos(theta) * r / (40.0 + r * cos(theta))  # tan² of the angle to the parallel circle
        w = seeds.d[mine] - np.outer(seeds.d[mine] @ normal, normal)
        np.testing.assert_allclose((w @ meridian) ** 2 / (w @ round_) ** 2, squared, rtol=1e-6)
        np.testing.assert_array_equal(seeds.curvature[mine], 0.0)
        assert mine.sum() == 4


def test_sense_decides_the_side() -> None:
    surface = round_face(30.0)
    for sense in (1, -1):
        seeds = seed_lines(work(surface, sense), CATALOGUE["T1"], np.array([[0.1, 12.0]]), MIDDLE)
        away = np.hypot(*(seeds.p + 10.0 * seeds.d)[:, :2].T) - 30.0
        np.testing.assert_allclose(away, sense * CATALOGUE["T1"].sphere_radius(10.0), atol=1e-6)


@pytest.mark.parametrize("name", ["T1", "T2", "T3"])
@pytest.mark.parametrize("allowance", [0.0, 0.3])
def test_axes_rise_by_the_half_angle_and_their_sphere_touches(name: str, allowance: float) -> None:
    tool = CATALOGUE[name]
    face = work(interpolated(hyperboloid, (-0.6, 0.6), (-0.6, 0.6)), 1)
    heights = np.array([2.0, 10.0, 20.0])
    seeds = seed_lines(face, tool, UV, heights, allowance)
    assert len(seeds.p) == 4 * len(UV) * 3
    frame = face.projector.evaluate(*seeds.uv.T)
    normal = np.cross(frame[:, 1], frame[:, 2])
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    np.testing.assert_allclose(np.linalg.norm(seeds.d, axis=1), 1.0, atol=1e-14)
    np.testing.assert_allclose(np.sum(seeds.d * normal, axis=1), sin(tool.half_angle), atol=1e-13)
    centre = seeds.p + seeds.height[:, None] * seeds.d
    radius = tool.r_min * cos(tool.half_angle) + seeds.height * sin(tool.half_angle) + allowance
    np.testing.assert_allclose(centre, frame[:, 0] + radius[:, None] * normal, atol=1e-12)


def test_cone_face_gives_its_ruling_and_no_curvature() -> None:
    taper = 0.3
    seeds = seed_lines(work(round_face(25.0, taper), 1), CATALOGUE["T3"], np.array([[0.2, 15.0]]), MIDDLE)
    ruling = np.array([tan(taper) * cos(0.2), tan(taper) * sin(0.2), 1.0])
    normal = np.array([cos(taper) * cos(0.2), cos(taper) * sin(0.2), -sin(taper)])
    w = seeds.d - np.outer(seeds.d @ normal, normal)
    # Rounding may make the face a saddle of curvature 1e-12, whose lines are the square root of that apart.
    np.testing.assert_allclose(across(w, np.tile(ruling, (len(w), 1))), 0.0, atol=1e-4)
    np.testing.assert_allclose(seeds.curvature, 0.0, atol=1e-9)
    assert {float(np.sign(x)) for x in w @ ruling} == {1.0, -1.0}


def test_elliptic_face_gives_the_direction_of_least_curvature() -> None:
    """z = -x²/60 - y²/200 at its top, where curvatures are 1/30 and 1/100; the sphere of 4 mm sits outside."""
    face = work(interpolated(lambda u, v: stacked(u, v, -u * u / 60 - v * v / 200), (-9, 9), (-9, 9), 8), 1)
    tool = Tool("cylinder", 4.0, 4.0, 20.0)
    seeds = seed_lines(face, tool, np.zeros((1, 2)), MIDDLE)
    np.testing.assert_allclose(np.abs(seeds.d), [[0.0, 1.0, 0.0]] * 2, atol=1e-7)
    np.testing.assert_allclose(seeds.curvature, 1.0 / 104.0, rtol=1e-8)


@pytest.mark.parametrize("bend", [0.012, 0.02, 0.05])
def test_turned_lines_spread_to_where_the_distance_bends_by_what_is_let_pass(bend: float) -> None:
    """The same top: cos² ψ / 104 + sin² ψ / 34 at the angle ψ against y; beyond 1 / 34 everything is let pass."""
    face = work(interpolated(lambda u, v: stacked(u, v, -u * u / 60 - v * v / 200), (-9, 9), (-9, 9), 8), 1)
    tool = Tool("cylinder", 4.0, 4.0, 20.0)
    lines = turned_lines(face, tool, np.zeros((1, 2)), MIDDLE, np.array([bend]))
    angle = np.arctan2(np.abs(lines.d[:, 0]), np.abs(lines.d[:, 1]))
    np.testing.assert_allclose(lines.curvature, np.cos(angle) ** 2 / 104 + np.sin(angle) ** 2 / 34, rtol=1e-7)
    widest = np.arcsin(np.sqrt(min((bend - 1 / 104) / (1 / 34 - 1 / 104), 1.0)))
    count = round(widest / TURN)
    steps = widest * np.arange(1, count + 1) / max(count, 1)
    np.testing.assert_allclose(np.unique(angle.round(6)), steps, atol=1e-5)
    # On both sides of y and either way round; along x both sides are one line.
    assert len(lines.d) == 4 * count - (2 if bend > 1 / 34 else 0)


def test_turned_lines_of_a_sphere_go_all_round_or_there_are_none() -> None:
    def cap(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        return stacked(u, v, np.sqrt(2500.0 - u**2 - v**2))

    face = work(interpolated(cap, (-9, 9), (-9, 9)), 1)
    tool = Tool("cylinder", 4.0, 4.0, 20.0)
    none = turned_lines(face, tool, np.zeros((1, 2)), MIDDLE, np.array([0.9 / 54.0]))
    assert len(none.d) == 0
    lines = turned_lines(face, tool, np.zeros((1, 2)), MIDDLE, np.array([1.1 / 54.0]))
    # With the one that `seed_lines` has.
    d = np.concatenate([lines.d, seed_lines(face, tool, np.zeros((1, 2)), MIDDLE).d])
    around = np.sort(np.arctan2(d[:, 1], d[:, 0]))
    np.testing.assert_allclose(np.diff(around), TURN, atol=1e-6)


def test_bend_of_turned_lines_is_the_second_derivative_of_the_distance() -> None:
    """The second difference of the residual over ± h tends to it with h²: halving h divides what is missing by 4."""
    uv = np.array([[0.2, 0.15]])
    tool = CATALOGUE["T3"]
    face = work(interpolated(hyperboloid, (-0.6, 0.6), (-0.6, 0.6)), 1)
    lines = turned_lines(face, tool, uv, MIDDLE, np.array([0.02]))
    assert len(lines.p) >= 4
    for p, d, bend in zip(lines.p, lines.d, lines.curvature, strict=True):
        missing = []
        for h in (2.0, 1.0, 0.5):
            off = [distance_to(hyperboloid, p + (10.0 + s) * d, uv[0]) for s in (-h, 0.0, h)]
            missing.append(abs(off[0] - 2.0 * off[1] + off[2]) / h**2 - bend)
        np.testing.assert_allclose(np.divide(missing[1:], missing[:-1]), 0.25, rtol=0.2)


def test_no_line_where_the_sphere_does_not_fit() -> None:
    """In a bore of radius 5 mm, spheres of radius below 0.98 * 5 mm fit."""
    surface = round_face(5.0)
    for radius, count in ((4.5, 2), (4.95, 0), (7.0, 0)):
        seeds = seed_lines(work(surface, -1), Tool("t", radius, radius, 20.0), np.array([[0.0, 15.0]]), MIDDLE)
        assert (len(seeds.p) >= count) if count else (len(seeds.p) == 0)


def distance_to(shape, point: np.ndarray, start: np.ndarray) -> float:
    """Distance to a closed form by SciPy alone."""
    best = least_squares(lambda x: shape(x[0], x[1]) - point, start, jac="3-point", xtol=1e-15, ftol=1e-15, gtol=1e-15)
    return float(np.linalg.norm(best.fun))


@pytest.mark.parametrize("name", ["T1", "T3"])
@pytest.mark.parametrize("shape", [hyperboloid, helicoid], ids=["hyperboloid", "helicoid"])
def test_residual_along_a_line_is_of_third_order(name: str, shape) -> None:
    """Distance minus sphere radius at ± s from the contact: halving s divides it by 8."""
    tool = CATALOGUE[name]
    uv = np.array([[0.2, 0.15]])
    seeds = seed_lines(work(interpolated(shape, (-0.6, 0.6), (-0.6, 0.6)), 1), tool, uv, MIDDLE)
    steps = np.array([4.0, 2.0, 1.0])
    seen = 0
    for p, d in zip(seeds.p, seeds.d, strict=True):
        residual = np.zeros((2, 3))
        for side, sign in enumerate((1.0, -1.0)):
            for k, s in enumerate(sign * steps):
                distance = distance_to(shape, p + (10.0 + s) * d, uv[0])
                residual[side, k] = distance - float(tool.sphere_radius(10.0 + s))
        odd = np.abs(residual[0] - residual[1])  # the even part is of order 4
        even = np.abs(residual[0] + residual[1])
        np.testing.assert_allclose(odd[1:] / odd[:-1], 1.0 / 8.0, rtol=0.2)
        assert even[-1] < 0.1 * odd[0]
        seen += 1
    assert seen == 4
