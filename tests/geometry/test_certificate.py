"""The certificate against the gap of verification, which shares nothing with it but the shape of the cutter."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.certificate import dense_gap
from benchmarks.envelopes import cylinder
from benchmarks.shapes import smooth_surface
from conflank_cli.geometry.certificate import Certificate, GapCells, certify, gap_cells
from conflank_cli.geometry.gap import cutter_of, polynomials_of
from conflank_cli.geometry.kernels.gap_bound import (
    DOUBT,
    OFF,
    POSE,
    SEARCHED,
    SETTLED,
    WITHIN,
    _nearest_time,
    moving_poses,
)
from conflank_cli.geometry.workface import WorkFace, on_face
from conflank_cli.limits import Limits
from conflank_cli.motion import Motion, fitted, uniform_knots
from conflank_cli.tool import CATALOGUE, Tool
from tests.faces import envelope, interpolated, known, stacked, work
from tests.verification.scenes import plane_face

TOOLS = [*CATALOGUE.values(), cylinder()]
LIMITS = Limits(0.010, 0.010)
# What the authority promises, and what a bound may be above it, mm.
EXACT, CLOSE = 1e-6, 1e-3


def inside_cells(cells: GapCells, count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Points in random cells, among them many on edges and corners: which cell, and parameters (count, 2)."""
    k = rng.integers(0, len(cells.state), count)
    share = np.clip(rng.uniform(-0.2, 1.2, (count, 2)), 0.0, 1.0)
    box = cells.box[k]
    return k, np.stack([box[:, 0] + share[:, 0] * np.ptp(box[:, :2], axis=1),
                        box[:, 2] + share[:, 1] * np.ptp(box[:, 2:], axis=1)], axis=1)  # fmt: skip


def check(
    motion: Motion, tool: Tool, face: WorkFace, limits: Limits = LIMITS, seed: int = 0, count: int = 4000
) -> Certificate:
    """Every cell holds what it promises; the figures are never below dense samples, nor far above what was found."""
    rng = np.random.default_rng(seed)
    cells = gap_cells(motion, tool, face, limits)
    k, uv = inside_cells(cells, count, rng)
    on = on_face(face.face, uv)
    gap = dense_gap(motion, tool, face, uv) - limits.allowance
    assert (gap >= cells.lower[k] - EXACT).all()
    assert (gap <= cells.upper[k] + EXACT).all()
    within = cells.state[k] == WITHIN
    assert (gap[within] >= -limits.over).all() and (gap[within] <= limits.under).all()
    # The cells are the face: no point of it is in none.
    for point in uv[on][:200]:
        box = cells.box
        assert np.any(
            (box[:, 0] <= point[0]) & (point[0] <= box[:, 1]) & (box[:, 2] <= point[1]) & (point[1] <= box[:, 3])
        )
    found = certify(motion, tool, face, limits)
    assert found.overcut >= -gap[on].min() - EXACT
    assert found.gap >= np.abs(gap[within]).max(initial=0.0) - EXACT
    assert found.overcut_sampled <= found.overcut <= max(found.overcut_sampled + CLOSE, 1.02 * found.overcut_sampled)
    assert found.gap_sampled <= found.gap <= found.gap_sampled + CLOSE
    return found


def shaken(motion: Motion, size: float, seed: int) -> Motion:
    rng = np.random.default_rng(seed)
    return replace(
        motion, p=motion.p + size * rng.normal(size=motion.p.shape), q=motion.q + size * rng.normal(size=motion.q.shape)
    )


@pytest.mark.parametrize("tool", TOOLS, ids=lambda tool: tool.name)
def test_exact_envelopes_are_certified_whole(tool: Tool) -> None:
    case = envelope(tool)
    face = work(case.surface, case.sense)
    found = check(known(case), tool, face)
    assert found.doubt == 0.0
    assert found.area == pytest.approx(face.samples(0.5).areas.sum(), rel=1e-4)
    assert found.gap < 0.001 and found.overcut < 0.001


CASES = {tool.name: (tool, envelope(tool)) for tool in TOOLS}


@settings(max_examples=8, deadline=None, derandomize=True)
@given(
    name=st.sampled_from(list(CASES)),
    size=st.sampled_from([0.001, 0.004, 0.02, 0.2]),
    allowance=st.sampled_from([0.0, 0.0, 0.3]),
    seed=st.integers(0, 2**31),
)
def test_shaken_motions(name: str, size: float, allowance: float, seed: int) -> None:
    """From a few micrometres off, where all is within tolerance, to gouges deeper than it."""
    tool, case = CASES[name]
    check(
        shaken(known(case, 14), size, seed), tool, work(case.surface, case.sense), Limits(0.01, 0.01, allowance), seed
    )


@settings(max_examples=4, deadline=None, derandomize=True)
@given(seed=st.integers(0, 2**31), rational=st.booleans())
def test_smooth_surfaces_cut_by_a_short_flute(seed: int, rational: bool) -> None:
    """The flute ends on the face at both ends, the motion begins and ends on it: every kind of border there is."""
    rng = np.random.default_rng(seed)
    face = work(smooth_surface(rng, rational=rational, bulge=1.0), 1)
    tool = Tool("S", 2.0, 3.0, 14.0)
    u0, u1, v0, v1 = face.face.surface.domain
    t = np.linspace(0.3, 0.7, 8)
    frame = face.projector.evaluate(u0 + t * (u1 - u0), np.full(8, 0.5 * (v0 + v1)))
    normal = np.cross(frame[:, 1], frame[:, 2])
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    along = frame[:, 2] / np.linalg.norm(frame[:, 2], axis=1)[:, None]
    middle = frame[:, 0] + (0.5 * (tool.r_min + tool.r_max) - 0.02) * normal
    knots = uniform_knots(8)
    lift = 0.5 * tool.length * (along * np.cos(tool.half_angle) + normal * np.sin(tool.half_angle))
    found = check(Motion(knots, middle - lift, middle + lift), tool, face, Limits(0.05, 0.05), seed)
    assert found.area > 0.0 and found.overcut > 0.0


def straight(points: list[list[float]], direction: list[float], length: float) -> Motion:
    """A cubic motion that goes through nothing but the first and last of its control points."""
    p = np.array(points)
    return Motion(uniform_knots(len(p)), p, p + length * np.array(direction))


def test_two_branches_meet_in_a_kink() -> None:
    """Out and back half a millimetre aside: between the two passes of a lying cylinder stands a ridge with an edge.

    The plane lies 5 µm below the tool, so that the ridge is within tolerance beside the passes only.
    """
    tool = Tool("C", 3.0, 3.0, 20.0)
    face = WorkFace.of(plane_face((0.0, 30.0), (0.0, 16.0)), 0.0)
    # Along its own axis the tool goes to and fro at x = 10 and x = 11: where the two are equally near, at x = 10.5, the
    # gap has an edge of (0.5 mm)² / 2 r above the grooves.
    motion = straight(
        [[10.0, y, 3.0] for y in (-3.0, -2.5, -2.0, -2.0)] + [[11.0, y, 3.0] for y in (-2.0, -2.0, -2.5, -3.0)],
        [0.0, 1.0, 0.0],
        20.0,
    )
    found = check(motion, tool, face, Limits(0.001, 0.06))
    assert found.overcut < 0.001 and found.area > 16.0


def test_a_gouge_between_coarse_samples() -> None:
    """A dip 30 µm deep and a tenth of a millimetre wide: a bump on the face that a grid steps over."""

    def bump(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return stacked(x, y, 0.03 * np.exp(-((x - 5.13) ** 2 + (y - 4.07) ** 2) / 0.3**2))

    face = work(interpolated(bump, (0.0, 10.0), (0.0, 8.0), 100), 1)
    tool = Tool("C", 3.0, 3.0, 20.0)
    motion = straight([[x, -6.0, 3.0] for x in (-2.0, 2.0, 5.0, 8.0, 12.0)], [0.0, 1.0, 0.0], 20.0)
    found = check(motion, tool, face)
    assert 0.0299 < found.overcut < 0.0312
    # Those who look every two millimetres see nothing.
    coarse = face.samples(2.0)
    assert dense_gap(motion, tool, face, coarse.uv).min() > -0.001


def test_the_border_of_a_trimmed_face_is_not_crossed() -> None:
    """A slanting border, and a tool that digs in just beyond it: what lies outside of the loops does not count."""
    plane = plane_face((0.0, 20.0), (0.0, 12.0))
    u0, u1, v0, v1 = plane.surface.domain
    corner = np.array([[u0, v0], [u1, v0], [0.5 * (u0 + u1), v1], [u0, v1]])
    face = WorkFace.of(replace(plane, loops=(corner,)), 0.0)
    # Over the plane the tool sinks by 20 µm on 20 mm: along the border it is at most so deep as at its far corner.
    p = np.array([[x, -6.0, 3.005 - 0.001 * x] for x in np.linspace(-2.0, 22.0, 6)])
    motion = Motion(uniform_knots(6), p, p + np.array([0.0, 20.0, 0.0]))
    found = check(motion, Tool("C", 3.0, 3.0, 20.0), face, Limits(0.02, 0.02))
    assert found.area == pytest.approx(12.0 * 15.0, rel=0.01)


def test_no_time_is_left_out_where_the_cutter_goes_round_a_point() -> None:
    """All times are equally near there: each is searched, or what is left of them is bounded."""
    tool = Tool("C", 3.0, 3.0, 20.0)
    angle = np.linspace(0.0, 1.5, 200)
    p = 5.0 * np.stack([np.cos(angle), np.sin(angle), np.zeros(200)], axis=1)
    motion = fitted(np.linspace(0.0, 1.0, 200), np.hstack([p, p + np.array([0.0, 0.0, 20.0])]), 20)
    polynomials, breaks = polynomials_of(motion)
    samples = 16
    poses = np.empty((samples + 1, POSE))
    moving_poses(polynomials, breaks, samples, poses)
    look, at = np.empty((2 * samples + SEARCHED + 2, 6)), np.empty(POSE)
    # |v̇| on the circle; and a bound on it that so many halvings cannot get the better of.
    for bend, searched in ((5.0 * 1.5**2, True), (1e6, False)):
        time, floor = _nearest_time(
            0.0, 0.0, 10.0, 0.0, 1.0 / samples, poses, polynomials, breaks, bend, cutter_of(tool), look, at
        )
        centre = motion.ends([time])[0][0]
        assert np.hypot(*centre[:2]) - 3.0 == pytest.approx(2.0, abs=1e-5)
        assert floor == np.inf if searched else floor < 2.0 - SETTLED


def test_far_away_and_above_the_flute() -> None:
    """Nothing is cut, and nothing is claimed; little is looked at."""
    face = WorkFace.of(plane_face((0.0, 20.0), (0.0, 12.0)), 0.0)
    tool = Tool("C", 3.0, 3.0, 20.0)
    away = straight([[x, -4.0, 5.0] for x in np.linspace(-2.0, 22.0, 5)], [0.0, 1.0, 0.0], 20.0)
    found = certify(away, tool, face, LIMITS)
    assert (found.overcut, found.gap, found.area, found.doubt) == (0.0, 0.0, 0.0, 0.0)
    assert found.nodes < 500
    # In reach of the prolonged cylinder, 1 mm too deep, but below the face's edge.
    below = straight([[x, -25.0, 2.0] for x in np.linspace(-2.0, 22.0, 5)], [0.0, 1.0, 0.0], 20.0)
    found = certify(below, tool, face, LIMITS)
    assert (found.overcut, found.area) == (0.0, 0.0)


def test_states_tell_what_is_within_tolerance() -> None:
    """A tool that rises steadily from -20 to 20 µm along the way: half of the plate is within 10 µm, to 0.06 mm."""
    face = WorkFace.of(plane_face((0.0, 40.0), (0.0, 12.0)), 0.0)
    p = np.array([[x, -4.0, 3.0 + 0.001 * (x - 20.0)] for x in np.linspace(-5.0, 45.0, 6)])
    motion = Motion(uniform_knots(6), p, p + np.array([0.0, 20.0, 0.0]))
    cells = gap_cells(motion, Tool("C", 3.0, 3.0, 20.0), face, LIMITS)
    assert cells.area[cells.state == WITHIN].sum() == pytest.approx(20.0 * 12.0, abs=2.0 * 12.0 * 0.12)
    assert cells.area[cells.state == OFF].sum() == pytest.approx(20.0 * 12.0, abs=2.0 * 12.0 * 0.12)
    assert cells.area[cells.state == DOUBT].sum() < 2.0 * 12.0 * 0.12
    assert 479.0 < cells.area.sum() < 480.0 + 1e-9  # far away nobody asks for the area
