"""Distances of lines and heights of scallops: the closed form against the crest computed from its place."""

from math import asin, hypot, inf

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from conflank_cli.job import Tolerance
from conflank_cli.passes.scallop import POSTING, Aim, line_distance, scallop_height


@given(st.floats(0.5, 8.0), st.floats(1e-4, 0.05), st.floats(-0.95, -0.01) | st.floats(0.01, 3.0))
def test_distance_and_height_are_inverse(radius: float, height: float, bend: float) -> None:
    """From a hollow that the ball all but fills to an edge a third of the ball's radius."""
    curvature = bend / radius
    distance = float(line_distance(height, radius, curvature))
    if distance * abs(curvature) < np.pi:
        assert scallop_height(distance, radius, curvature) == pytest.approx(height, abs=1e-9)


def test_on_a_plane_it_is_pythagoras() -> None:
    assert float(line_distance(0.005, 1.5, 0.0)) == pytest.approx(2.0 * np.sqrt(1.5**2 - 1.495**2), rel=1e-12)
    assert scallop_height(0.4, 1.5, 0.0) == pytest.approx(1.5 - hypot(1.5, 0.0) * np.cos(asin(0.2 / 1.5)), rel=1e-12)
    assert float(line_distance(0.005, 1.5, 1e-9)) == pytest.approx(float(line_distance(0.005, 1.5, 0.0)), rel=1e-8)


@pytest.mark.parametrize("curvature", [0.4, 0.05, -0.05, -0.4])
def test_the_crest_lies_where_two_circles_meet(curvature: float) -> None:
    """Two balls on a round face, drawn: the face's points between them and their distance to the nearer ball."""
    radius, height = 1.5, 0.005
    distance = float(line_distance(height, radius, curvature))
    rho = 1.0 / curvature
    angle = 0.5 * distance / rho
    centre = np.array([np.sin(angle), np.cos(angle)]) * (rho + radius)
    # Along the bisector, from the face outwards, the first place that the balls reach.
    crest = np.linspace(0.0, 2.0 * height, 200_001)
    away = np.hypot(centre[0], rho + crest - centre[1])
    assert crest[np.argmax(away <= radius)] == pytest.approx(height, abs=1e-7)


def test_where_the_ball_does_not_fit_there_is_no_distance() -> None:
    assert line_distance(0.005, 1.5, [-1.0 / 1.5, -2.0]).tolist() == [inf, inf]


@given(st.floats(0.0, 0.02), st.floats(0.0, 0.02), st.floats(0.001, 0.05), st.floats(0.0, 0.3))
def test_the_aim_stays_in_the_band(over: float, under: float, scallop: float, allowance: float) -> None:
    if over + under < 0.002:
        return
    aim = Aim.of(Tolerance(over, under, allowance), scallop)
    assert 0.0 < aim.height <= scallop + 1e-12
    assert aim.contact - allowance >= POSTING - over - 1e-12
    assert aim.crest - allowance <= under - POSTING + 1e-12
    if over >= POSTING and under >= scallop + POSTING:
        assert (aim.contact, aim.height) == (pytest.approx(allowance, abs=1e-12), pytest.approx(scallop))
