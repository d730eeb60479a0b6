"""Growth on a cylinder and a cone, where the motion that covers more is known in closed form."""

from __future__ import annotations

from math import cos, sin, tan

import numpy as np
import pytest

from conflank_cli.geometry.gap import motion_gap, travel
from conflank_cli.geometry.growth import (
    CLEAR_STEP,
    FURTHEST,
    INSET,
    NODES,
    STEP,
    best_slide,
    clear_slide,
    greville,
    lengthened,
    slid,
    steadiness,
)
from conflank_cli.geometry.workface import WorkFace
from conflank_cli.limits import Limits
from conflank_cli.motion import Motion, fitted
from conflank_cli.tool import CATALOGUE, Tool
from tests.detection.test_tracing import touching
from tests.faces import round_face, work

LIMITS = Limits(0.010, 0.010)
RADIUS, TAPER = 25.0, 0.15
CYLINDER = Tool("cylinder", 3.0, 3.0, 20.0)
CASES = {"cylinder": (CYLINDER, 0.0), "cone": (CATALOGUE["T3"], TAPER)}


def circular(tool: Tool, taper: float, z: float, turn: tuple[float, float] = (-0.62, 0.62), count: int = 24) -> Motion:
    """The tool on `round_face`, its r_min circle at height z, rolled round from one angle to another."""
    t = np.linspace(0.0, 1.0, 300)
    ends = []
    for angle in turn[0] + t * (turn[1] - turn[0]):
        p, d = touching(tool, taper, angle, z, RADIUS)
        ends.append(np.concatenate([p, p + tool.length * d]))
    return fitted(t, np.array(ends), count)


def outwards(motion: Motion, taper: float) -> np.ndarray:
    """Normals of the cone at the control points' angles."""
    p, q = motion.ends(greville(motion))
    middle = 0.5 * (p + q)[:, :2]
    middle /= np.linalg.norm(middle, axis=1)[:, None]
    return np.column_stack([cos(taper) * middle, np.full(len(middle), -sin(taper))])


@pytest.fixture(scope="module", params=CASES, ids=list(CASES))
def case(request: pytest.FixtureRequest) -> tuple[Tool, float, WorkFace]:
    tool, taper = CASES[request.param]
    return tool, taper, work(round_face(RADIUS, taper, 30.0), 1)


def test_slides_to_where_the_flute_is_all_on_the_face() -> None:
    """Flute 20, face 30: hanging over by 4 mm below or 3 mm above, it slides by that, and hardly further."""
    face = work(round_face(RADIUS, 0.0, 30.0), 1)
    samples = face.samples(0.2)
    for z, slide in ((-4.0, 4.0), (13.0, -3.0), (4.0, 0.0)):
        found = best_slide(circular(CYLINDER, 0.0, z), CYLINDER, samples, LIMITS)
        assert found.shape == (NODES,)
        # A little inside what is just enough, and to the step of the search.
        np.testing.assert_allclose(found, slide + np.sign(slide) * INSET, atol=2.0 * STEP)
    # No further than is looked at in one go.
    assert np.all(best_slide(circular(CYLINDER, 0.0, -9.0), CYLINDER, samples, LIMITS) <= FURTHEST + 1e-9)


def test_slides_along_the_sweep_as_each_part_of_it_needs() -> None:
    """A motion that climbs from 4 mm below the face to the middle of it has to slide at the start, not at the end."""
    face = work(round_face(RADIUS, 0.0, 30.0), 1)
    level, t = circular(CYLINDER, 0.0, 0.0), np.linspace(0.0, 1.0, 300)
    climb = np.stack([0.0 * t, 0.0 * t, -4.0 + 9.0 * t], axis=1)
    p, q = level.ends(t)
    motion = fitted(t, np.hstack([p + climb, q + climb]), 24)
    slides = best_slide(motion, CYLINDER, face.samples(0.2), LIMITS)
    assert slides[0] > 3.0 and slides[-1] == 0.0
    assert np.all(np.diff(slides) <= 0.0)


def test_slides_past_a_hill_as_far_as_it_has_to() -> None:
    """Flute and face are equally long, so that each slide costs area; a hill of 3 mm stands in the tip's way."""
    samples = work(round_face(RADIUS, 0.0, CYLINDER.length), 1).samples(0.2)
    motion = circular(CYLINDER, 0.0, 0.0)
    away = outwards(motion, 0.0)

    def hill(angle: np.ndarray) -> np.ndarray:
        return 3.0 * np.exp(-((angle / 0.3) ** 2)) - 0.3

    def free(p: np.ndarray, d: np.ndarray) -> np.ndarray:
        np.testing.assert_allclose(d[:, 2], 1.0, atol=1e-9)
        return p[..., 2] > hill(np.arctan2(p[..., 1], p[..., 0]))

    slides = clear_slide(motion, CYLINDER, samples, LIMITS, away, free)
    height = np.maximum(hill(np.linspace(-0.62, 0.62, len(slides))), 0.0)
    # A step away from it, and to the step of the search.
    assert np.all(slides >= height) and np.all(slides <= height + 2.5 * CLEAR_STEP)
    moved = slid(motion, CYLINDER, slides, away)
    p, q = moved.ends(np.linspace(0.0, 1.0, 200))
    assert free(p, (q - p) / np.linalg.norm(q - p, axis=1)[:, None]).all()


def test_stays_where_nothing_is_in_the_way_or_everything_is() -> None:
    samples = work(round_face(RADIUS, 0.0, 30.0), 1).samples(0.4)
    motion = circular(CYLINDER, 0.0, 4.0)
    for able in (True, False):
        slides = clear_slide(
            motion, CYLINDER, samples, LIMITS, outwards(motion, 0.0), lambda p, d, able=able: np.full(p.shape[:2], able)
        )
        assert not slides.any()


def test_slides_up_a_cone() -> None:
    """T3 hangs over the lower border by 4 mm; its flute is as long as the face, so it slides by all of that."""
    tool, taper = CASES["cone"]
    face = work(round_face(RADIUS, taper, 30.0), 1)
    slides = best_slide(circular(tool, taper, -4.0), tool, face.samples(0.2), LIMITS)
    # A mm along the axis is 1 / cos α along the ruling, and that times cos(taper) in height.
    np.testing.assert_allclose(slides, 4.0 * cos(tool.half_angle) / cos(taper), atol=0.45)


def test_a_tool_that_has_the_whole_face_stays(case: tuple[Tool, float, WorkFace]) -> None:
    tool, taper, _ = case
    low = work(round_face(RADIUS, taper, 0.8 * tool.length), 1)
    assert not best_slide(circular(tool, taper, -1.5), tool, low.samples(0.4), LIMITS).any()


def test_a_motion_that_touches_nothing_does_not_slide(case: tuple[Tool, float, WorkFace]) -> None:
    tool, taper, face = case
    motion = circular(tool, taper, 2.0)
    away = Motion(motion.knots, motion.p + 50.0, motion.q + 50.0)
    assert not best_slide(away, tool, face.samples(1.0), LIMITS).any()


def test_sliding_keeps_the_flank_where_it_was(case: tuple[Tool, float, WorkFace]) -> None:
    """On a cone whose rulings are the contact the slid tool is as exact as before, and its ends are δ further up."""
    tool, taper, face = case
    motion = circular(tool, taper, 3.0)
    points = face.samples(1.0).points
    # Rows that the flute reaches before and after, and that the sweep does not end on.
    rows = (points[:, 2] > 8.0) & (points[:, 2] < 18.0) & (np.abs(np.arctan2(points[:, 1], points[:, 0])) < 0.5)
    for distance in (-3.0, 2.0):
        moved = slid(motion, tool, np.full(NODES, distance), outwards(motion, taper))
        before, _ = motion_gap(motion, tool, points[rows])
        after, _ = motion_gap(moved, tool, points[rows])
        assert np.abs(before).max() < 1e-4
        # Shifting control points shifts the curve by their average: 24 of them follow the circle to 1 µm.
        assert np.abs(after).max() < 2e-3
        p0, q0 = motion.ends([0.5])
        p1, q1 = moved.ends([0.5])
        d = (q0 - p0)[0] / tool.length
        assert (p1 - p0)[0] @ d == pytest.approx(distance, abs=5e-3)
        assert np.linalg.norm((p1 - p0)[0] - distance * d) == pytest.approx(
            abs(distance) * tan(tool.half_angle), abs=2e-2
        )
        np.testing.assert_allclose(q1 - q0, p1 - p0, atol=5e-3)


@pytest.mark.parametrize("at_end", [False, True])
def test_lengthening_goes_on_along_the_circle(case: tuple[Tool, float, WorkFace], at_end: bool) -> None:
    """4 mm on: the parabola leaves a circle of radius R by s³ / 6 R² along it, s⁴ / 8 R³ across."""
    tool, taper, _ = case
    motion = circular(tool, taper, 3.0, (-0.3, 0.3))
    longer = lengthened(motion, 4.0, at_end)
    assert travel(longer) == pytest.approx(travel(motion) + 4.0, abs=0.05)
    t = np.linspace(0.0, 1.0, 60)
    p, q = longer.ends(t)
    p0, q0 = motion.ends([0.0])
    for end, start in ((p, p0), (q, q0)):
        radius = float(np.hypot(start[0, 0], start[0, 1]))
        across = np.hypot(end[:, 0], end[:, 1]) - radius
        assert np.abs(across).max() < 4.0**4 / (8.0 * RADIUS**3) * 1.5 + 1e-3
        np.testing.assert_allclose(end[:, 2], start[0, 2], atol=1e-3)
    # At the end that was continued it goes further, at the other it stays.
    angle = np.arctan2(p[:, 1], p[:, 0])
    grown = 4.0 / float(np.hypot(*q0[0, :2]))
    if at_end:
        assert angle[0] == pytest.approx(-0.3, abs=2e-3)
        assert angle[-1] == pytest.approx(0.3 + grown, abs=0.02)
    else:
        assert angle[-1] == pytest.approx(0.3, abs=2e-3)
        assert angle[0] == pytest.approx(-0.3 - grown, abs=0.02)
    assert len(longer.p) > len(motion.p)


@pytest.mark.parametrize("case", CASES)
def test_a_motion_that_rolls_round_is_steady(case: str) -> None:
    """Round a cylinder the axis moves square to itself; round a cone too, each of its points on a circle."""
    tool, taper = CASES[case]
    face = work(round_face(RADIUS, taper), 1, 8.0)
    motion = circular(tool, taper, 2.0)
    assert steadiness(face, motion) == pytest.approx(1.0, abs=1e-3)
    # Run the other way it is as steady.
    assert steadiness(face, Motion(motion.knots, motion.p[::-1], motion.q[::-1])) == pytest.approx(1.0, abs=1e-3)


def test_steadiness_is_the_cosine_of_the_slide_and_negative_where_the_axis_swings_back() -> None:
    tool, taper = CASES["cylinder"]
    face = work(round_face(RADIUS, taper), 1, 8.0)
    motion = circular(tool, taper, 2.0)
    # A helix: per radian the axis moves RADIUS + r across and 12 mm along itself.
    climb = np.array([0.0, 0.0, 12.0 * 1.24]) * greville(motion)[:, None]
    expected = np.cos(np.arctan2(12.0, RADIUS + tool.r_min))
    helix = Motion(motion.knots, motion.p + climb, motion.q + climb)
    assert steadiness(face, helix) == pytest.approx(expected, abs=1e-3)
    there = np.linspace(0.0, 1.0, 400)
    p, q = motion.ends(there + 0.25 * np.sin(2.0 * np.pi * there))
    assert steadiness(face, fitted(there, np.hstack([p, q]), 24)) < -0.9
