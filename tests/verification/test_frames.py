"""Coordinate systems, arcs and corners against SciPy's rotations and closed forms."""

from __future__ import annotations

from math import cos, hypot, pi, radians, sin, tan

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from conflank_cli.verification.arcs import (
    CHORD,
    about_pole,
    chamfered,
    points_on,
    pole_of_radius,
    pole_of_tangent,
    rounded,
)
from conflank_cli.verification.frames import Frame, euler, further, spanned, spatial

ANGLE = st.floats(-3.0, 3.0)
LENGTH = st.floats(-50.0, 50.0)


@given(ANGLE, ANGLE, ANGLE)
def test_tilts_are_scipys_rotations(a: float, b: float, c: float) -> None:
    assert spatial(a, b, c) == pytest.approx(Rotation.from_euler("XYZ", [a, b, c]).as_matrix(), abs=1e-12)
    # The same as turns about the fixed axes, the last angle first.
    assert spatial(a, b, c) == pytest.approx(Rotation.from_euler("zyx", [c, b, a]).as_matrix(), abs=1e-12)
    assert euler(a, b, c) == pytest.approx(Rotation.from_euler("ZXZ", [a, b, c]).as_matrix(), abs=1e-12)
    turned = Rotation.from_euler("XYZ", [a, b, c]) * Rotation.from_euler("Y", 0.4)
    assert further(spatial(a, b, c), "Y", 0.4) == pytest.approx(turned.as_matrix(), abs=1e-12)


@given(ANGLE, ANGLE, ANGLE, st.tuples(LENGTH, LENGTH, LENGTH), st.tuples(LENGTH, LENGTH, LENGTH))
def test_coordinates_are_the_reverse_of_points(
    a: float, b: float, c: float, shift: tuple[float, float, float], place: tuple[float, float, float]
) -> None:
    frame = Frame(shift, spatial(a, b, c), "X", rotation=c, scale=(2.0, 0.5, 1.0))
    assert frame.coordinates(frame.point(*place)) == pytest.approx(place, abs=1e-9)
    # Mirroring, rotation and scaling act in the tilted plane.
    inner = np.diag([-1.0, 1.0, 1.0]) @ Rotation.from_euler("z", c).as_matrix() @ np.diag([2.0, 0.5, 1.0])
    expected = np.array(shift) + Rotation.from_euler("XYZ", [a, b, c]).as_matrix() @ inner @ np.array(place)
    assert frame.point(*place) == pytest.approx(expected, abs=1e-9)


def test_a_plane_by_vectors() -> None:
    """The base vector is laid into the plane; the normal is its Z."""
    tilt = spanned((1.0, 0.0, 1.0), (0.0, 0.0, 2.0))
    assert tilt == pytest.approx(np.eye(3))
    tilt = spanned((0.0, 2.0, 0.0), (1.0, 0.0, 0.0))
    assert pytest.approx(np.array([[0, 1, 0], [0, 0, 1], [1, 0, 0]])) == np.array(tilt).T
    assert spanned((0.0, 0.0, 1.0), (0.0, 0.0, 1.0)) is None


@given(st.floats(1.0, 30.0), ANGLE, st.floats(0.01, 6.2), st.sampled_from([1, -1]))
def test_arcs_about_a_pole(radius: float, start: float, angle: float, turn: int) -> None:
    first = (5.0 + radius * cos(start), 7.0 + radius * sin(start))
    last = (5.0 + radius * cos(start + turn * angle), 7.0 + radius * sin(start + turn * angle))
    found = about_pole(first, last, (5.0, 7.0), turn)
    assert found == pytest.approx((radius, turn * angle), abs=1e-6)
    points = np.array([first, *points_on(first, (5.0, 7.0), turn * angle)])
    assert points[-1] == pytest.approx(last, abs=1e-9)
    assert np.hypot(*(points - [5.0, 7.0]).T) == pytest.approx(radius, abs=1e-9)
    middles = 0.5 * (points[1:] + points[:-1]) - [5.0, 7.0]
    assert (radius - np.hypot(*middles.T)).max() <= CHORD * (1.0 + 1e-6)


@pytest.mark.parametrize("turn", [1, -1])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_arcs_by_radius(turn: int, sign: float) -> None:
    """R > 0 is the smaller arc, R < 0 the larger one."""
    pole = pole_of_radius((0.0, 0.0), (6.0, 0.0), sign * 5.0, turn)
    assert pole is not None
    assert hypot(*pole) == pytest.approx(5.0)
    arc = about_pole((0.0, 0.0), (6.0, 0.0), pole, turn)
    assert arc is not None
    assert (abs(arc[1]) < pi) == (sign > 0.0)
    assert pole_of_radius((0.0, 0.0), (11.0, 0.0), 5.0, 1) is None


def test_arcs_by_their_tangent() -> None:
    pole, turn = pole_of_tangent((0.0, 0.0), (3.0, 3.0), (1.0, 0.0)) or ((0.0, 0.0), 0)
    assert (pole, turn) == ((pytest.approx(0.0), pytest.approx(3.0)), 1)
    assert pole_of_tangent((0.0, 0.0), (3.0, 0.0), (1.0, 0.0)) is None


@given(st.floats(0.2, 3.0), st.floats(0.1, 2.0), st.sampled_from([1, -1]))
def test_roundings_touch_both_lines(bend: float, radius: float, side: int) -> None:
    after = (20.0 * cos(bend), side * 20.0 * sin(bend))
    length = radius / tan(0.5 * (pi - bend))
    found = rounded((-20.0, 0.0), (0.0, 0.0), after, radius)
    if length > 20.0:
        assert found is None
        return
    assert found is not None
    start, points = found
    assert start == pytest.approx((-length, 0.0), abs=1e-9)
    assert points[-1] == pytest.approx((length * cos(bend), side * length * sin(bend)), abs=1e-9)
    centre = np.array([-length, side * radius])
    assert np.hypot(*(np.array(points) - centre).T) == pytest.approx(radius, abs=1e-7)


def test_chamfers() -> None:
    assert chamfered((-5.0, 0.0), (0.0, 0.0), (0.0, 5.0), 2.0) == ((-2.0, 0.0), [(0.0, 2.0)])
    assert chamfered((-1.0, 0.0), (0.0, 0.0), (0.0, 5.0), 2.0) is None


def test_radians_are_meant() -> None:
    assert spatial(radians(90.0), 0.0, 0.0) == pytest.approx(np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]]), abs=1e-12)
