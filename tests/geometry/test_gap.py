"""The swept gap against brute force: over the profile of the cutter, and over many poses of a motion."""

from __future__ import annotations

from math import cos, sin

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.envelopes import cylinder
from benchmarks.envelopes import swept_gap as by_golden_sections
from conflank_cli.geometry.footpoint import Projector
from conflank_cli.geometry.gap import gap_field, motion_gap, travel
from conflank_cli.geometry.kernels.swept_gap import cutter_distance
from conflank_cli.motion import Motion, uniform_knots
from conflank_cli.tool import CATALOGUE, Tool
from tests.faces import envelope, known

TOOLS = [*CATALOGUE.values(), cylinder()]


def profile(tool: Tool, steps: int = 6000) -> np.ndarray:
    """The outline of ball, cone and top disc in the half plane (height, radius), densely sampled, (N, 2)."""
    x = np.linspace(0.0, 1.0, steps)
    angle = x * (0.5 * np.pi - tool.half_angle)  # from the tip to where the ball meets the cone
    centre, ball = tool.ball_centre_height, tool.ball_radius
    return np.concatenate(
        [
            np.stack([centre - ball * np.cos(angle), ball * np.sin(angle)], axis=1),
            np.stack([x * tool.length, tool.r_min + x * (tool.r_max - tool.r_min)], axis=1),
            np.stack([np.full(steps, tool.length), x * tool.r_max], axis=1),
        ]
    )


def brute(tool: Tool, z: float, r: float, outline: np.ndarray) -> float:
    """Signed distance of a place in the half plane, to about the square of the sampling."""
    distance = float(np.min(np.hypot(outline[:, 0] - z, outline[:, 1] - r)))
    if z >= 0.0:
        inside = z < tool.length and r < tool.r_min + z / tool.length * (tool.r_max - tool.r_min)
    else:
        inside = np.hypot(z - tool.ball_centre_height, r) < tool.ball_radius
    return -distance if inside else distance


def distance_at(tool: Tool, z: float, r: float, turn: float = 0.4) -> float:
    """The kernel's distance at (z, r) of a tool somewhere in space."""
    p, d = np.array([3.0, -2.0, 5.0]), np.array([2.0, -1.0, 2.0]) / 3.0
    e1 = np.array([1.0, 2.0, 0.0]) / np.sqrt(5.0)
    x = p + z * d + r * (cos(turn) * e1 + sin(turn) * np.cross(d, e1))
    alpha = tool.half_angle
    return float(
        cutter_distance(
            *x, *p, *d, tool.r_min, sin(alpha), cos(alpha), tool.length, tool.ball_centre_height, tool.ball_radius
        )
    )


@pytest.mark.parametrize("tool", TOOLS, ids=lambda tool: tool.name)
@settings(max_examples=60, deadline=None, derandomize=True)
@given(z=st.floats(-8.0, 42.0), r=st.floats(0.0, 12.0))
def test_distance_to_the_cutter_is_the_distance_to_its_outline(tool: Tool, z: float, r: float) -> None:
    """Samples are 6 µm apart: at 1 mm they are 5 nm too far, in contact 3 µm."""
    outline = profile(tool)
    assert distance_at(tool, z, r) == pytest.approx(brute(tool, z, r, outline), abs=4e-3)


@pytest.mark.parametrize("tool", TOOLS, ids=lambda tool: tool.name)
def test_just_above_the_top_disc_is_outside(tool: Tool) -> None:
    """Between the top disc and the normal to the cone at its rim lie points that the prolonged cone contains."""
    for r in (0.0, 0.5 * tool.r_max, 0.99 * tool.r_max):
        for height in (0.002, 0.1, 0.3):
            assert distance_at(tool, tool.length + height, r) == pytest.approx(height, abs=1e-12)


@pytest.mark.parametrize("tool", TOOLS, ids=lambda tool: tool.name)
def test_distance_at_places_that_are_easy_to_name(tool: Tool) -> None:
    alpha = tool.half_angle
    assert distance_at(tool, tool.tip_height - 1.5, 0.0) == pytest.approx(1.5, abs=1e-12)
    assert distance_at(tool, tool.length + 0.3, tool.r_max + 0.4) == pytest.approx(0.5, abs=1e-9 if alpha == 0 else 0.1)
    # On the axis itself r² is a difference of squares: rounding of 1e-14 mm² is 1e-7 mm.
    depth = tool.r_min * cos(alpha) + 0.4 * tool.length * sin(alpha)
    assert distance_at(tool, 0.4 * tool.length, 0.0) == pytest.approx(-depth, abs=1e-6)
    # Off the middle of the generator, along its normal.
    for off in (-0.3, 0.0, 0.7):
        z, r = 0.5 * tool.length - off * sin(alpha), 0.5 * (tool.r_min + tool.r_max) + off * cos(alpha)
        assert distance_at(tool, z, r) == pytest.approx(off, abs=1e-12)


def unit_axis(motion: Motion):
    def axis(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        p, q = motion.ends(t)
        return p, (q - p) / np.linalg.norm(q - p, axis=1)[:, None]

    return axis


@pytest.mark.parametrize("tool", TOOLS, ids=lambda tool: tool.name)
def test_gap_of_a_blade_like_motion_against_golden_sections(tool: Tool) -> None:
    """On the face itself and up to 0.2 mm to either side of it, where what counts is decided."""
    case = envelope(tool)
    motion = known(case)
    rng = np.random.default_rng(7)
    u0, u1, v0, v1 = case.surface.domain
    frame = Projector.of(case.surface).evaluate(rng.uniform(u0, u1, 400), rng.uniform(v0, v1, 400))
    normal = np.cross(frame[:, 1], frame[:, 2])
    normal *= case.sense / np.linalg.norm(normal, axis=1)[:, None]
    points = frame[:, 0] + rng.uniform(-0.2, 0.2, 400)[:, None] * normal
    gap, time = motion_gap(motion, tool, points)
    expected, when = by_golden_sections(tool, unit_axis(motion), points, 201)
    np.testing.assert_allclose(gap, expected, atol=1e-9)
    # At a minimum the time is known to the square root of the rounding.
    np.testing.assert_allclose(time, when, atol=1e-4)


def test_gap_against_very_many_poses() -> None:
    """Random points about a random motion, inside the cutter, above it and below its tip."""
    rng = np.random.default_rng(9)
    tool = CATALOGUE["T3"]
    steps = np.linspace(0.0, 1.0, 7)[:, None]
    p = steps * [40.0, 5.0, 0.0] + rng.normal(size=(7, 3))
    d = np.array([0.1, 0.0, 1.0]) + 0.1 * rng.normal(size=(7, 3))
    motion = Motion(uniform_knots(7), p, p + tool.length * d / np.linalg.norm(d, axis=1)[:, None])
    points = rng.uniform([-6.0, -8.0, -4.0], [48.0, 14.0, 34.0], (1500, 3))
    gap, time = motion_gap(motion, tool, points, reach=20.0)
    t = np.linspace(0.0, 1.0, 4001)
    ends = unit_axis(motion)(t)
    alpha = tool.half_angle
    best = np.full(len(points), np.inf)
    for a, b in zip(*ends, strict=True):
        z = (points - a) @ b
        r = np.sqrt(np.maximum(np.sum((points - a) ** 2, axis=1) - z * z, 0.0))
        # Ball and cone as the union of two convex outlines, each by its own half planes and corners.
        ball = np.hypot(z - tool.ball_centre_height, r) - tool.ball_radius
        side = (r - tool.r_min) * cos(alpha) - z * sin(alpha)
        along = (r - tool.r_min) * sin(alpha) + z * cos(alpha)
        rim = np.hypot(z - tool.length, np.maximum(r - tool.r_max, 0.0))
        above = z - tool.length
        cone = np.where(side <= 0.0, np.where(above > 0.0, rim, np.maximum(side, above)),
                        np.where(along > tool.length / cos(alpha), rim, side))  # fmt: skip
        best = np.minimum(best, np.where(along < 0.0, ball, cone))
    # 0.01 mm between poses: 1e-5 mm of sagitta at the radius of the ball, 3e-3 where the distance has a corner.
    off = gap - best
    assert np.quantile(np.abs(off), 0.98) < 1e-3 and np.abs(off).max() < 0.01
    # Too far only where another valley is deeper by less than the first look, 0.5 mm a step, can tell: hardly ever.
    assert np.mean(off > 1e-9) < 2e-3
    # The time given is that of the gap.
    for k in range(0, len(points), 50):
        p, q = (end[0] for end in motion.ends([time[k]]))
        arguments = (tool.r_min, sin(alpha), cos(alpha), tool.length, tool.ball_centre_height, tool.ball_radius)
        assert cutter_distance(*points[k], *p, *((q - p) / np.linalg.norm(q - p)), *arguments) == pytest.approx(
            gap[k], abs=1e-9
        )


def test_gaps_beyond_reach_are_bounds() -> None:
    case = envelope(CATALOGUE["T1"])
    motion = known(case)
    points = Projector.of(case.surface).evaluate([0.5, 0.6], [0.5, 0.4])[:, 0]
    frame = Projector.of(case.surface).evaluate([0.5], [0.5])[0]
    normal = -case.sense * np.cross(frame[1], frame[2]) / np.linalg.norm(np.cross(frame[1], frame[2]))
    points = np.concatenate([points, frame[0] + 0.5 * normal[None]])
    near, _ = motion_gap(motion, case.tool, points, reach=0.25)
    far, _ = motion_gap(motion, case.tool, points, reach=1.0)
    np.testing.assert_array_equal(near[:2], far[:2])
    assert far[2] == pytest.approx(0.5, abs=1e-4)
    assert far[2] <= near[2] < far[2] + 0.05


def test_travel_is_the_longer_path() -> None:
    knots = uniform_knots(6)
    line = np.linspace(0.0, 1.0, 6)[:, None] * [10.0, 0.0, 0.0]
    assert travel(Motion(knots, line, 3.0 * line)) == pytest.approx(30.0, abs=1e-9)
    assert travel(Motion(knots, 2.0 * line, line)) == pytest.approx(20.0, abs=1e-9)


def wandering(rng: np.random.Generator, length: float) -> Motion:
    """25 mm along x, to and fro by tenths of a millimetre and some degrees, the ends of the axis so far apart."""
    count = 7
    p = np.stack([np.linspace(0.0, 25.0, count), *rng.normal(scale=0.4, size=(2, count))], axis=1)
    d = rng.normal(scale=0.06, size=(count, 3)) + np.array([0.0, 0.1, 1.0])
    return Motion(uniform_knots(count), p, p + length * d / np.linalg.norm(d, axis=1)[:, None])


@pytest.mark.parametrize("tool", TOOLS, ids=lambda tool: tool.name)
def test_the_gradient_is_that_of_the_gap(tool: Tool) -> None:
    """Every part of the cutter against central differences, at points that are not at a kink between two parts."""
    rng = np.random.default_rng(11)
    # The ends need not be L apart: the gradient knows what that does to the direction.
    motion = wandering(rng, tool.length + 0.2)
    points = rng.uniform([2.0, -8.0, -5.0], [23.0, 8.0, tool.length + 6.0], (3000, 3))
    field = gap_field(motion, tool, points, reach=10.0)
    change, step = rng.normal(size=(len(motion.p), 6)), 1e-6

    def gap(factor: float) -> np.ndarray:
        moved = Motion(motion.knots, motion.p + factor * change[:, :3], motion.q + factor * change[:, 3:])
        return motion_gap(moved, tool, points, reach=10.0)[0]

    forward, here, backward = gap(step), gap(0.0), gap(-step)
    slope = (forward - backward) / (2.0 * step)
    smooth = np.abs((forward - here) - (here - backward)) < 1e-9
    start, end = motion.ends(field.time)
    axis = (end - start) / np.linalg.norm(end - start, axis=1)[:, None]
    along = np.einsum("nk,nk->n", points - start, axis)
    across = np.linalg.norm(points - start - along[:, None] * axis, axis=1)
    # Deep inside, cone and top may be equally near at the best pose: the other kink.
    cone = (across - tool.r_min) * cos(tool.half_angle) - along * sin(tool.half_angle)
    smooth &= np.abs(cone - (along - tool.length)) > 1e-4
    assert smooth.mean() > 0.95
    p_change, q_change = Motion(motion.knots, change[:, :3], change[:, 3:]).ends(field.time)
    expected = np.einsum("nk,nk->n", field.rows, np.hstack([p_change, q_change]))
    np.testing.assert_allclose(slope[smooth], expected[smooth], atol=5e-4)
    assert np.quantile(np.abs(slope - expected)[smooth], 0.99) < 1e-6
    # Ball, cone and top all had their say.
    for part in (along < 0.0, (along > 2.0) & (along < tool.length - 2.0), along > tool.length):
        assert (part & smooth).sum() > 100


def test_a_gap_looked_for_near_its_time_is_that_of_the_whole_motion() -> None:
    case = envelope(CATALOGUE["T2"])
    motion = known(case)
    points = Projector.of(case.surface).evaluate(*np.random.default_rng(2).uniform(0.0, 1.0, (2, 400)))[:, 0]
    whole = gap_field(motion, case.tool, points)
    shifted = Motion(motion.knots, motion.p + 0.02, motion.q + 0.02)
    near = gap_field(shifted, case.tool, points, start=whole.time)
    np.testing.assert_allclose(near.gap, motion_gap(shifted, case.tool, points)[0], atol=1e-9)
    assert np.abs(near.time - whole.time).max() > 1e-4


@pytest.mark.parametrize("tool", TOOLS, ids=lambda tool: tool.name)
def test_a_gap_is_the_same_whatever_was_looked_for_before(tool: Tool) -> None:
    """Deep inside too, where cone and top take turns: what one search learns may not spoil the next."""
    rng = np.random.default_rng(31)
    motion = wandering(rng, tool.length)
    points = rng.uniform([-2.0, -8.0, -5.0], [27.0, 8.0, tool.length + 3.0], (3000, 3))
    gap, time = motion_gap(motion, tool, points, reach=10.0)
    start = np.clip(time + rng.uniform(-0.01, 0.01, len(time)), 0.0, 1.0)
    near = gap_field(motion, tool, points, start=start)
    order = rng.permutation(len(points))
    again = gap_field(motion, tool, points[order], start=start[order])
    # Two valleys next to each other may be told apart by where a search begins.
    assert np.quantile(np.abs(near.gap - gap)[gap < 10.0], 0.999) < 1e-7
    assert np.quantile(np.abs(again.gap - near.gap[order]), 0.999) < 1e-7


def test_a_tool_that_plunges_comes_nearest_to_what_is_on_its_axis_where_it_is_deepest() -> None:
    tool = CATALOGUE["T1"]
    z = np.array([0.0, -4.0, -9.2, -8.8, -4.0, 0.8])
    p = np.stack([0.0 * z, 0.0 * z, z], axis=1)
    motion = Motion(uniform_knots(6), p, p + np.array([0.0, 0.0, tool.length]))
    deepest = motion.ends(np.linspace(0.0, 1.0, 200_001))[0][:, 2].min()
    gap, time = motion_gap(motion, tool, np.array([[0.0, 0.0, -15.0], [1e-3, 0.0, -15.0]]), reach=50.0)
    assert gap[0] == pytest.approx(deepest + tool.tip_height + 15.0, abs=1e-9)
    assert gap[1] == pytest.approx(gap[0], abs=1e-6)
    assert motion.ends(time)[0][:, 2] == pytest.approx(deepest, abs=1e-9)
