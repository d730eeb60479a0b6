"""Clearance against brute force, and what the screen leaves of motions that run into something."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from conflank_cli.geometry.face import CheckMesh
from conflank_cli.geometry.outline import FINE, Margins, Outline, offset_radius
from conflank_cli.geometry.screening import (
    BLOCK,
    CELL,
    POINT_SPACING,
    RESERVE,
    SHORTEST,
    STEP,
    PointCells,
    Screen,
    longest_run,
    mesh_points,
)
from conflank_cli.job import Machine, Setup
from conflank_cli.motion import Motion, fitted, uniform_knots
from conflank_cli.tool import CATALOGUE, Section, Tool
from postprocessors.machines import machine as machines
from tests.verification.scenes import plane_face, scene_of, triangles_of

TOOL = Tool("C", 3.0, 3.0, 20.0, (Section(5.0, 5.0, 15.0),), (Section(16.0, 24.0, 20.0),))


def to_segment(point: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Distance of points (N, 2) from the segment a b."""
    s = np.clip((point - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
    return np.linalg.norm(point - a - s[:, None] * (b - a), axis=1)


def frustum(z: np.ndarray, r: np.ndarray, section: Sequence[float]) -> np.ndarray:
    """Signed distance to a frustum: the nearest of its three edges, negative within."""
    low, high, r_low, r_high = section
    point = np.stack([z, r], axis=1)
    corners = np.array([[low, 0.0], [low, r_low], [high, r_high], [high, 0.0]])
    edge = np.min([to_segment(point, corners[k], corners[k + 1]) for k in range(3)], axis=0)
    inside = (z >= low) & (z <= high) & (r <= r_low + (z - low) / (high - low) * (r_high - r_low))
    return np.where(inside, -edge, edge)


lengths = st.floats(0.5, 30.0)
radii = st.floats(0.5, 20.0)


@settings(max_examples=150, deadline=None, derandomize=True)
@given(lengths, radii, radii, st.sampled_from([-0.3, -0.01, 0.0, 0.02, 1.0, 6.0]), st.integers(0, 2**32 - 1))
def test_radius_of_an_offset_frustum_is_where_the_distance_is_the_margin(
    length: float, low: float, high: float, margin: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    section = (0.0, length, low, high)
    z, r = rng.uniform(-8.0, length + 8.0, 60), rng.uniform(0.0, max(low, high) + 8.0, 60)
    distance = frustum(z, r, section)
    clear = np.abs(distance - margin) > 1e-9
    found = offset_radius(z, np.array(section), margin)
    np.testing.assert_array_equal((r < found)[clear], (distance < margin)[clear])
    # On its border the distance is the margin, but for the flat ends, where the border is a disk.
    outside = np.column_stack([z, np.maximum(found, 0.0) + 1e-6])
    assert np.all(frustum(outside[:, 0], outside[:, 1], section) >= margin - 1e-9)


def by_brute_force(tool: Tool, margins: Margins, p: np.ndarray, d: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Least distance minus margin over all points, no pruning, (M,)."""
    out = np.full(len(p), np.inf)
    rows = [((0.0, tool.length, tool.r_min, tool.r_max), margins.cutter)]
    top = tool.length
    for group, margin in ((tool.shank, margins.shank), (tool.holder, margins.holder)):
        for part in group:
            rows.append(((top, top + part.length, part.diameter_low / 2, part.diameter_high / 2), margin))
            top += part.length
    for k in range(len(p)):
        z = (points - p[k]) @ d[k]
        r = np.linalg.norm(points - p[k] - z[:, None] * d[k], axis=1)
        out[k] = (np.hypot(z - tool.ball_centre_height, r) - tool.ball_radius - margins.cutter).min()
        for row, margin in rows:
            out[k] = min(out[k], (frustum(z, r, row) - margin).min())
    return out


def cloud(rng: np.random.Generator, count: int) -> np.ndarray:
    """A few clumps at very different distances, some of one point."""
    centres = rng.uniform(-60.0, 60.0, (6, 3))
    return (
        centres[rng.integers(0, 6, count)] + rng.normal(size=(count, 3)) * rng.choice([0.0, 0.5, 4.0], count)[:, None]
    )


@settings(max_examples=40, deadline=None, derandomize=True)
@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from([TOOL, *CATALOGUE.values()]),
    st.sampled_from([Margins(-0.01, 0.5, 1.0), Margins(0.29, 0.29, 3.0), Margins(-0.01, -0.01, -0.5)]),
)
def test_pruning_misses_no_violation(seed: int, tool: Tool, margins: Margins) -> None:
    rng = np.random.default_rng(seed)
    points = cloud(rng, 120)
    p, d = rng.uniform(-40.0, 40.0, (60, 3)), rng.normal(size=(60, 3))
    d /= np.linalg.norm(d, axis=1)[:, None]
    p -= d * rng.uniform(0.0, 100.0, (60, 1))
    cells = PointCells.of(points)
    expected = by_brute_force(tool, margins, p, d, points)
    free = rng.uniform(size=60) < 0.9
    found = free.copy()
    cells.clear(p, d, tool, margins, found)
    assert not np.any(found & ~free)
    # Where shank and holder end in steps the outline is wider by up to a step of its table, elsewhere it is exact.
    assert not np.any(found[expected < -1e-4])
    assert np.all(found[free & (expected > 1.0 / FINE)])


@pytest.mark.parametrize("tool", CATALOGUE.values(), ids=CATALOGUE)
def test_table_of_an_outline_is_exact_on_the_cutter(tool: Tool) -> None:
    """Between its entries too: a tenth of a micrometre on the ball and on the cone."""
    margins = Margins(-0.01, -0.01, 1.0)
    outline = Outline.of(tool, margins, 1.0, 5.0)
    z = np.random.default_rng(5).uniform(tool.tip_height + 0.011, 0.9 * tool.length, 2000)
    place = (z - outline.lowest) * FINE
    squares = np.interp(place, np.arange(len(outline.squares)), outline.squares)
    ball = (tool.ball_radius - 0.01) ** 2 - (z - tool.ball_centre_height) ** 2
    cone = np.where(z > 0.01, offset_radius(z, np.array([0.0, tool.length, tool.r_min, tool.r_max]), -0.01), 0.0)
    radius = np.sqrt(np.maximum(ball, cone * cone))
    # A square that is off by e puts the border off by e / 2R at the tip of the ball, and e / 2r along the flank.
    assert np.abs(squares - radius * radius).max() / (2.0 * tool.ball_radius) <= 2e-4


def test_point_cells_hold_every_point_once() -> None:
    points = cloud(np.random.default_rng(3), 500)
    cells = PointCells.of(points)
    order = np.lexsort(points.T)
    np.testing.assert_array_equal(cells.points[np.lexsort(cells.points.T)], points[order])
    for c in range(len(cells.radii)):
        own = cells.points[cells.starts[c] : cells.starts[c + 1]]
        away = np.linalg.norm(own - cells.centres[c], axis=1)
        assert away.max() == pytest.approx(cells.radii[c], abs=1e-12)
        assert np.ptp(own, axis=0).max() <= CELL
    assert cells.blocks[0] == 0 and cells.blocks[-1] == len(cells.radii) and np.all(np.diff(cells.blocks) > 0)
    for b in range(len(cells.block_radii)):
        own = cells.points[cells.starts[cells.blocks[b]] : cells.starts[cells.blocks[b + 1]]]
        away = np.linalg.norm(own - cells.block_centres[b], axis=1)
        assert away.max() == pytest.approx(cells.block_radii[b], abs=1e-12)
        assert np.ptp(own, axis=0).max() <= BLOCK
    assert len(PointCells.of(np.zeros((0, 3))).points) == 0


@pytest.mark.parametrize("seed", range(3))
def test_mesh_points_leave_no_hole(seed: int) -> None:
    """Random triangles from slivers to plates: how far any place on them is from the nearest point."""
    rng = np.random.default_rng(seed)
    size = 10.0 ** rng.uniform(-1.5, 1.0, (30, 1, 1))
    corners = rng.uniform(-20.0, 20.0, (30, 1, 3)) + size * rng.normal(size=(30, 3, 3))
    mesh = CheckMesh(corners.reshape(-1, 3), np.arange(90, dtype=np.int32).reshape(-1, 3), np.zeros(30, dtype=np.int32))
    points = mesh_points(mesh, POINT_SPACING)
    weights = rng.dirichlet(np.ones(3), (30, 400))
    places = np.einsum("tpc,tcx->tpx", weights, corners).reshape(-1, 3)
    distance, _ = cKDTree(points).query(places)
    # A lattice of triangles with edges of 0.4 leaves 0.23 in their middles; thinning to cells of 0.2 adds some.
    assert distance.max() <= 0.75 * POINT_SPACING
    # No denser than they have to be.
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum()
    assert len(points) < 90 + 60.0 * area / POINT_SPACING**2


def test_longest_run() -> None:
    assert longest_run(np.array([True, False, True, True, False])) == (2, 3)
    assert longest_run(np.array([True, True, False, True, True])) == (0, 1)
    assert longest_run(np.array([False, False])) is None
    assert longest_run(np.array([True])) == (0, 0)


def straight(axis: Sequence[float] = (0.0, 0.0, 1.0), length: float = 30.0, height: float = 3.0) -> Motion:
    """Along +x over the plane z = 0, the tip of TOOL at height - 3."""
    x = np.linspace(0.0, 1.0, 6)[:, None] * [length, 0.0, 0.0]
    # Greville abscissae make the control points of a uniform motion.
    knots = uniform_knots(6)
    x[:, 0] = length * np.array([knots[k + 1 : k + 4].mean() for k in range(6)])
    p = x + np.array([0.0, 0.0, height])
    return Motion(knots, p, p + TOOL.length * np.asarray(axis))


def wall(x: float, z: tuple[float, float]) -> CheckMesh:
    return triangles_of([(x, -15.0, z[0]), (x, 15.0, z[0]), (x, 15.0, z[1]), (x, -15.0, z[1])])


PLATE = plane_face((-40.0, 80.0), (-40.0, 40.0))


@pytest.mark.parametrize(
    ("z", "reach"),
    [
        ((5.0, 15.0), 3.0 - 0.010),  # the flute: up to the tolerance
        ((26.0, 36.0), 2.5 + 0.5 + RESERVE),  # the shank and its margin
        (
            (45.0, 57.0),
            12.0 - 4.0 / 20.0 + 1.0 + RESERVE,
        ),  # the holder, 16 mm across at 38, 24 at 58, at 57 its radius is 11.8
    ],
    ids=["flute", "shank", "holder"],
)
def test_motion_into_a_wall_ends_in_front_of_it(z: tuple[float, float], reach: float) -> None:
    screen = Screen.of(scene_of(PLATE, tools=(TOOL,), check=wall(20.0, z)))
    motion = screen.allowed(straight(), TOOL)
    assert motion is not None
    end = motion.ends([1.0])[0][0, 0]
    start = motion.ends([0.0])[0][0, 0]
    assert start == pytest.approx(0.0, abs=1e-12)
    limit = 20.0 - reach
    # The nearest sample point is at most 0.3 mm off the height that counts, and the holder's cone rises by 1 in 5.
    assert limit - STEP <= end <= limit + (0.1 if z[0] > 40.0 else 0.02)
    # It is the same motion, shorter.
    share = end / 30.0
    np.testing.assert_allclose(motion.ends([0.5])[1], straight().ends([0.5 * share])[1], atol=1e-9)


def test_clear_motion_is_left_as_it_is() -> None:
    motion = straight()
    assert Screen.of(scene_of(PLATE, tools=(TOOL,))).allowed(motion, TOOL) is motion


def test_overcut_of_the_design_face_is_let_pass_up_to_its_tolerance() -> None:
    """Standing on the plane with its ball: 9 µm too deep is within, 11 µm is not; an allowance shifts both."""
    for allowance in (0.0, 0.2):
        scene = scene_of(PLATE, tools=(TOOL,))
        tolerance = msgspec.structs.replace(scene.job.tolerance, allowance=allowance)
        screen = Screen.of(replace(scene, job=msgspec.structs.replace(scene.job, tolerance=tolerance)))
        # One sample of the face lies right under the tool.
        foot = screen.design.points[np.argmin(np.linalg.norm(screen.design.points, axis=1))]
        up = np.array([[0.0, 0.0, 1.0]])
        for depth, free in ((0.009, True), (0.011, False)):
            place = foot + np.array([0.0, 0.0, 3.0 + allowance - depth])
            assert bool(screen.free(place[None], up, TOOL)[0]) is free
            assert bool(screen.free(place[None], up, TOOL, slack=0.005)[0])
            assert bool(screen.free(place[None], up, TOOL, slack=0.0, parallel=True)[0]) is free


def test_too_short_a_rest_is_not_worth_a_cut() -> None:
    for x, left in ((3.0 + SHORTEST - 0.5, False), (3.0 + SHORTEST + 1.5, True)):
        screen = Screen.of(scene_of(PLATE, tools=(TOOL,), check=wall(x, (5.0, 15.0))))
        # Behind the wall at x there is no more room than in front of it.
        assert (screen.allowed(straight(length=x + 2.0), TOOL) is not None) is left


def test_axes_out_of_reach_are_trimmed_off() -> None:
    """The axis tilts from upright by 60 degrees on the way; the machine's A ends at 30 and the part stands on its C."""
    angle = np.linspace(0.0, 1.0, 40)
    t = np.linspace(0.0, 1.0, 40)
    p = np.stack([30.0 * t, np.zeros(40), np.full(40, 100.0)], axis=1)
    d = np.stack([np.zeros(40), np.sin(angle * np.radians(60.0)), np.cos(angle * np.radians(60.0))], axis=1)
    motion = fitted(t, np.hstack([p, p + TOOL.length * d]), 10)
    scene = scene_of(PLATE, tools=(TOOL,))
    shipped = Path(machines.__file__).with_name("ac-table.toml").read_text("utf-8")
    machine = shipped.replace("[-120.0, 30.0]", "[-30.0, 30.0]")
    job = msgspec.structs.replace(scene.job, machine=Machine(file="narrow.toml", definition=machine))
    allowed = Screen.of(replace(scene, job=job)).allowed(motion, TOOL)
    assert allowed is not None
    assert 15.0 - STEP <= allowed.ends([1.0])[0][0, 0] <= 15.0 + 1e-6
    # Turned by 45 degrees about x on the table, it stands 45 degrees to one side at first and 15 to the other at last.
    turned = msgspec.structs.replace(job, setup=Setup(rotate_deg=(45.0, 0.0, 0.0)))
    allowed = Screen.of(replace(scene, job=turned)).allowed(motion, TOOL)
    assert allowed is not None
    start = allowed.ends([0.0])[0][0, 0]
    assert 7.5 - 1e-6 <= start <= 7.5 + STEP
    assert allowed.ends([1.0])[0][0, 0] == pytest.approx(30.0, abs=1e-9)


def test_many_poses_of_one_direction_are_free_where_each_is() -> None:
    """Some hit the wall, some the plate, and one direction is out of the machine's reach."""
    screen = Screen.of(scene_of(PLATE, tools=(TOOL,), check=wall(20.0, (5.0, 15.0))))
    rng = np.random.default_rng(5)
    p = rng.uniform([10.0, -5.0, 1.0], [30.0, 5.0, 8.0], (6, 40, 3))
    d = np.stack([rng.normal(0.0, 0.1, 6), rng.normal(0.0, 0.1, 6), np.ones(6)], axis=1)
    d[4] = [0.0, 0.3, -1.0]
    d /= np.linalg.norm(d, axis=1)[:, None]
    each = screen.free(p.reshape(-1, 3), np.repeat(d, 40, axis=0), TOOL).reshape(6, 40)
    np.testing.assert_array_equal(screen.free_along(p, d, TOOL), each)
    assert not each[4].any() and 0.1 < each.mean() < 0.9


STEPPED = Tool("R", 3.0, 3.0, 20.0, (Section(5.0, 5.0, 15.0),), (Section(16.0, 16.0, 20.0),))


@pytest.mark.parametrize(
    ("face", "height", "reach"),
    [
        (9, 28.0, 2.5 + 0.5),
        (9, 45.0, 8.0 + 1.0),
        (-1, 10.0, 3.0 + 0.2),
        (-1, 28.0, 2.5 + 0.5),
        (-1, 45.0, 8.0 + 1.0),
    ],
    ids=["shank", "holder", "cutter at an obstacle", "shank at an obstacle", "holder at an obstacle"],
)
def test_the_screen_keeps_two_hundredths_more_than_the_margins(face: int, height: float, reach: float) -> None:
    """What lies between its points and poses is nearer than they are; a spike's tip is one of the points."""
    spike = CheckMesh(
        np.array([[20.0, 0.0, height], [30.0, 0.1, height + 0.1], [30.0, -0.1, height - 0.1]]),
        np.array([[0, 1, 2]], dtype=np.int32), np.array([face], dtype=np.int32),
    )  # fmt: skip
    below = plane_face((-40.0, 80.0), (-40.0, 40.0), z=-10.0)
    screen = Screen.of(scene_of(below, tools=(STEPPED,), check=spike))
    up = np.array([[0.0, 0.0, 1.0]])
    for more, free in ((0.015, False), (0.025, True)):
        place = np.array([[20.0 - reach - more, 0.0, 0.0]])
        assert bool(screen.free(place, up, STEPPED)[0]) is free


def test_what_a_region_leaves_of_its_face_is_screened_like_the_region() -> None:
    rest = plane_face((100.0, 130.0), (-40.0, 40.0))
    screen = Screen.of(replace(scene_of(PLATE, tools=(TOOL,)), rest=(rest,)))
    foot = screen.rest.points[np.argmin(np.linalg.norm(screen.rest.points - [115.0, 0.0, 0.0], axis=1))]
    up = np.array([[0.0, 0.0, 1.0]])
    for depth, free in ((0.009, True), (0.011, False)):
        place = foot + np.array([0.0, 0.0, 3.0 - depth])
        assert bool(screen.free(place[None], up, TOOL)[0]) is free
