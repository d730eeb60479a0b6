"""The formulas of the sample blades against their dimensions and against the definition of an inscribed sphere."""

import numpy as np
import pytest
from blade_surfaces import (
    PRESSURE,
    SUCTION,
    camber_jet,
    crowded_sites,
    edge_contact,
    evaluate,
    interpolate_bicubic,
    side_contact,
)
from blisk_law import BliskLaw
from impeller_law import ImpellerLaw


def _unrolled(law, x, h):
    """A blisk section on its cylinder, as (axial, tangential) in mm."""
    points = law.camber(x, np.full_like(x, h))
    radius = np.hypot(points[:, 0], points[:, 1])
    return np.stack([points[:, 2], radius * np.arctan2(points[:, 1], points[:, 0])], axis=1)


@pytest.mark.parametrize(
    ("h", "chord", "stagger", "camber", "thickness"), [(0.0, 34.0, 20.0, 45.0, 0.09), (1.0, 28.0, 55.0, 20.0, 0.04)]
)
def test_blisk_sections_have_the_dimensions_asked_for(h, chord, stagger, camber, thickness):
    law = BliskLaw()
    line = _unrolled(law, np.linspace(0.0, 1.0, 2001), h)
    direction = line[-1] - line[0]
    assert np.hypot(*direction) == pytest.approx(chord, abs=1e-9)
    assert np.degrees(np.arctan2(direction[1], direction[0])) == pytest.approx(stagger, abs=1e-9)
    slopes = np.degrees(np.arctan2(np.diff(line[:, 1]), np.diff(line[:, 0])))
    # Chords of the polyline turn by one step less than the arc.
    assert slopes[0] - slopes[-1] == pytest.approx(camber, abs=0.03)
    assert 2.0 * law.radius(np.array(0.5), np.array(h)) == pytest.approx(thickness * chord, abs=1e-12)


def test_blisk_stagger_is_not_linear_in_height():
    law = BliskLaw()
    middle = float(np.degrees(law.stagger(np.array(82.5))))
    assert abs(middle - 37.5) > 3.0


def test_blisk_tip_leans_by_four_millimetres():
    law, straight = BliskLaw(), BliskLaw(lean=0.0)
    x = np.array([0.5])
    shift = _unrolled(law, x, 1.0) - _unrolled(straight, x, 1.0)
    assert shift[0] == pytest.approx([0.0, 4.0], abs=1e-12)
    assert _unrolled(law, x, 0.0) == pytest.approx(_unrolled(straight, x, 0.0), abs=1e-12)


@pytest.mark.parametrize("x", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("h", [0.0, 0.6, 1.0])
def test_impeller_blade_angle_is_the_angle_of_the_camber_surface(x, h):
    law = ImpellerLaw()
    step = 1e-6
    ends = law.camber(np.array([x - step, x + step]), np.full(2, h))
    radius, angle = np.hypot(ends[:, 0], ends[:, 1]), np.arctan2(ends[:, 1], ends[:, 0])
    meridional = np.hypot(np.diff(radius), np.diff(ends[:, 2]))[0]
    tangential = -np.diff(angle)[0] * radius.mean()
    assert np.arctan2(tangential, meridional) == pytest.approx(
        float(law.blade_angle(np.array(x), np.array(h))), abs=1e-6
    )
    if x == 1.0:
        assert np.degrees(np.arctan2(tangential, meridional)) == pytest.approx(35.0, abs=1e-3)


def test_impeller_meridian_has_the_dimensions_asked_for():
    law = ImpellerLaw()
    points = law.camber(np.array([0.0, 0.0, 1.0, 1.0]), np.array([0.0, 1.0, 0.0, 1.0]))
    assert 2.0 * np.hypot(points[:, 0], points[:, 1]) == pytest.approx([30.0, 80.0, 120.0, 120.0], abs=1e-9)
    assert points[3, 2] - points[2, 2] == pytest.approx(8.0, abs=1e-9)


def test_impeller_blade_is_not_ruled():
    law = ImpellerLaw()
    h = np.linspace(0.0, 1.0, 51)
    for x, least in ((0.0, 3.0), (0.25, 2.0), (0.5, 1.0)):
        points = law.camber(np.full_like(h, x), h) - law.camber(np.array(x), np.array(0.0))
        line = points[-1] / np.linalg.norm(points[-1])
        assert np.linalg.norm(points - np.outer(points @ line, line), axis=1).max() > least


@pytest.mark.parametrize("law", [BliskLaw(), ImpellerLaw()], ids=["blisk", "impeller"])
def test_spheres_about_the_camber_surface_touch_both_sides(law):
    """Their radius is the least distance from the centre to the side: minimised here without the envelope's formula."""
    for sheet in (SUCTION, PRESSURE):
        contact = side_contact(law, sheet)
        for x, h in ((0.3, 0.4), (0.5, 0.7), (0.7, 0.2)):
            centre = law.camber(np.array(x), np.array(h))
            near_x, near_h = np.meshgrid(x + np.linspace(-0.05, 0.05, 101), h + np.linspace(-0.05, 0.05, 101))
            points, _ = contact(near_x, near_h)
            least = np.linalg.norm(points - centre, axis=-1).min()
            # The grid contains the contact itself, so its minimum is the radius or, were the formula wrong, less.
            assert least == pytest.approx(float(law.radius(np.array(x), np.array(h))), abs=1e-9)


@pytest.mark.parametrize("law", [BliskLaw(), ImpellerLaw()], ids=["blisk", "impeller"])
def test_normals_are_normal_to_sides_and_edges(law):
    u, h = np.meshgrid(np.linspace(0.05, 0.95, 7), np.linspace(0.1, 0.9, 5))
    step = 1e-5
    for contact in (side_contact(law, SUCTION), side_contact(law, PRESSURE), edge_contact(law, 0.0)):
        _, normal = contact(u, h)
        for du, dh in ((step, 0.0), (0.0, step)):
            tangent = contact(u + du, h + dh)[0] - contact(u - du, h - dh)[0]
            tangent /= np.linalg.norm(tangent, axis=-1, keepdims=True)
            assert np.abs(np.sum(tangent * normal, axis=-1)).max() < 1e-7


@pytest.mark.parametrize("edge", [0.0, 1.0])
def test_round_edges_join_the_sides_with_common_tangent_planes(edge):
    law = BliskLaw()
    h = np.linspace(0.0, 1.0, 21)
    for turn, sheet in ((0.0, SUCTION), (1.0, PRESSURE)):
        round_point, round_normal = edge_contact(law, edge)(np.full_like(h, turn), h)
        side_point, side_normal = side_contact(law, sheet)(np.full_like(h, edge), h)
        assert np.abs(round_point - side_point).max() < 1e-12
        assert np.abs(round_normal - side_normal).max() < 1e-12


def test_round_edges_go_around_the_outside():
    law = BliskLaw()
    for edge, sign in ((0.0, -1.0), (1.0, 1.0)):
        middle = np.array([0.5])
        jet = camber_jet(law, np.array([edge]), middle)
        _, normal = edge_contact(law, edge)(middle, middle)
        assert sign * np.sum(normal * jet.along_x) / np.linalg.norm(jet.along_x) > 0.95


def test_interpolation_converges_with_the_fourth_order():
    def exact(u, v):
        return np.stack([u, v, np.sin(2.0 * u + v) * np.exp(v)], axis=-1)

    fine = np.linspace(0.0, 1.0, 101)
    truth = exact(*np.meshgrid(fine, fine, indexing="ij"))
    errors = []
    for count in (9, 17, 33):
        sites = crowded_sites(0.0, 1.0, count)
        surface = interpolate_bicubic(exact(*np.meshgrid(sites, sites, indexing="ij")), sites, sites)
        errors.append(np.abs(evaluate(surface, fine, fine) - truth).max())
    orders = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    assert orders.min() > 3.6
