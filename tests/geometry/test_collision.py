"""Exact collision against FCL, a dense search of triangles and poses, and walls at known places."""

from __future__ import annotations

from dataclasses import replace

import msgspec
import numpy as np
import pytest
import trimesh
from scipy.optimize import minimize

from benchmarks.clearance_truth import Truth
from benchmarks.collision import collider_of, compared, random_poses
from conflank_cli.geometry.collision import COARSE, COMPONENTS, HOLDER_RESERVE, REACH, RESERVE, Collider, sections_of
from conflank_cli.geometry.face import CheckMesh, DesignFace
from conflank_cli.geometry.face_mesh import face_mesh, mesh_sags, open_edges
from conflank_cli.geometry.kernels.collision import TOLERANCE, triangle_least
from conflank_cli.geometry.surface import BSplineSurface
from conflank_cli.geometry.workface import WorkFace
from conflank_cli.job import Obstacles
from conflank_cli.motion import Motion, fitted
from conflank_cli.scene import Scene
from conflank_cli.tool import CATALOGUE, Section, Tool
from tests.geometry.test_screening import PLATE, STEPPED, TOOL, frustum, straight, wall
from tests.verification.scenes import cylinder_face, plane_face, scene_of
from tests.verification.test_neighbours import GROOVE_AT, RADIUS, chords, groove, groove_scene

T1 = CATALOGUE["T1"]
ODD = Tool("O", 2.0, 2.0, 10.0, (Section(5.0, 3.0, 10.0),), (Section(30.0, 12.0, 8.0), Section(12.0, 40.0, 30.0)))


def mesh_of(body: trimesh.Trimesh, number: int = 0) -> CheckMesh:
    faces = np.asarray(body.faces, dtype=np.int32)
    return CheckMesh(np.asarray(body.vertices), faces, np.full(len(faces), number, dtype=np.int32))


def lump(seed: int = 1) -> CheckMesh:
    """A ring with bumps, big triangles and small ones."""
    body = trimesh.creation.torus(30.0, 9.0, major_sections=40, minor_sections=16)
    rng = np.random.default_rng(seed)
    return mesh_of(trimesh.Trimesh(body.vertices + rng.normal(size=body.vertices.shape), body.faces, process=False))


@pytest.mark.parametrize("tool", [T1, ODD], ids=lambda tool: tool.name)
def test_clearances_against_fcl(tool: Tool) -> None:
    mesh = lump()
    p, d = random_poses(np.random.default_rng(2), mesh, tool, 60)
    misses, false, worst, meeting = compared(
        collider_of(scene_of(), mesh), Truth.of(mesh.vertices, mesh.triangles, tool), p, d
    )
    assert misses == 0 and false == 0
    assert 40 < meeting < 200
    # The facets of FCL's sections are 0.8 µm within them.
    assert worst < 2e-3


@pytest.mark.parametrize("seed", range(4))
def test_least_over_a_triangle_against_a_search(seed: int) -> None:
    """From outside, through and inside a section; flat on it, along it and degenerate triangles too."""
    rng = np.random.default_rng(seed)
    sections = np.concatenate([sections_of(tool)[0] for tool in (T1, ODD)])
    shares = np.array([(i, j, 30 - i - j) for i in range(31) for j in range(31 - i)]) / 30.0
    for k in range(60):
        section = sections[rng.integers(len(sections))]
        centre = np.array([*(rng.normal(size=2) * rng.uniform(0.0, 15.0)), rng.uniform(section[0] - 8, section[1] + 8)])
        corners = centre + rng.normal(size=(3, 3)) * rng.choice([0.2, 3.0, 20.0])
        if k % 6 == 0:
            corners[:, 2] = rng.choice([corners[0, 2], section[0], section[1]])
        elif k % 6 == 1:
            corners[:, 0] = corners[0, 0]
        elif k % 6 == 2:
            corners[2] = corners[1]

        def distance(weights: np.ndarray, corners: np.ndarray = corners, section: np.ndarray = section) -> np.ndarray:
            place = np.atleast_2d(weights) @ corners
            z, r = place[:, 2], np.hypot(place[:, 0], place[:, 1])
            return np.hypot(z - section[0], r) - section[2] if section[6] else frustum(z, r, section[:4])

        value, *place = triangle_least(corners, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, section, np.inf)
        start = shares[distance(shares).argmin()]
        found = minimize(
            lambda x, f=distance: f(np.array([[abs(x[0]), abs(x[1]), 1 - abs(x[0]) - abs(x[1])]]))[0]
            if abs(x[0]) + abs(x[1]) <= 1.0
            else 1e3,
            start[:2], method="Nelder-Mead", options={"xatol": 1e-8, "fatol": 1e-9},
        ).fun  # fmt: skip
        assert value <= min(found, float(distance(shares).min())) + TOLERANCE
        # It is attained where it says, on the triangle.
        z, r = place[2], float(np.hypot(place[0], place[1]))
        there = (
            np.hypot(z - section[0], r) - section[2] if section[6] else frustum(*np.array([[z], [r]]), section[:4])[0]
        )
        assert there == pytest.approx(value, abs=1e-6)
        weights, *_ = np.linalg.lstsq(np.vstack([corners.T, np.ones(3)]), np.append(place, 1.0), rcond=None)
        np.testing.assert_allclose(weights @ corners, place, atol=1e-6)
        assert weights.min() > -1e-6


@pytest.mark.parametrize("seed", range(6))
def test_nothing_hides_between_poses(seed: int) -> None:
    rng = np.random.default_rng(seed)
    mesh, tool = lump(), (T1, ODD)[seed % 2]
    collider = collider_of(scene_of(), mesh)
    p, d = random_poses(rng, mesh, tool, 1)
    t = np.linspace(0.0, 1.0, 9)[:, None]
    low = p + t * rng.normal(size=3) * 15.0 + t**2 * rng.normal(size=3) * 10.0
    axis = d + t * rng.normal(size=3) * 0.4
    axis /= np.linalg.norm(axis, axis=1)[:, None]
    motion = fitted(t[:, 0], np.hstack([low, low + tool.length * axis]), 6)
    times = np.linspace(0.0, 1.0, 1500)
    start, end = motion.ends(times)
    dense = collider.poses(start, (end - start) / np.linalg.norm(end - start, axis=1)[:, None], tool)
    free = collider.motion(motion, tool).free
    said = np.any([(times >= a) & (times <= b) for a, b in free], axis=0) if len(free) else times < 0.0
    assert not np.any(said & (dense.slack.min(axis=1) < -1e-5))
    # What is called a hit is one, but for what is trimmed at its ends.
    assert np.mean(~said & (dense.slack.min(axis=1) > 2.0 * COARSE)) < 0.01
    for reason in collider.least(motion, tool):
        component = COMPONENTS.index(reason.component)
        assert reason.clearance <= dense.clearance[:, component].min() + 0.005 + 1e-6
        one = collider.poses(*(x[None] for x in _pose(motion, reason.time)), tool)
        assert one.clearance[0, component] == pytest.approx(reason.clearance, abs=1e-5)


def _pose(motion: Motion, t: float) -> tuple[np.ndarray, np.ndarray]:
    p, q = motion.ends([t])
    return p[0], (q - p)[0] / np.linalg.norm(q - p)


@pytest.mark.parametrize(
    ("z", "reach", "component"),
    [
        ((5.0, 15.0), 3.0 - 0.010 + RESERVE, "cone"),
        ((26.0, 36.0), 2.5 + 0.5 + RESERVE, "shank"),
        ((45.0, 57.0), 8.0 + 4.0 * 19.0 / 20.0 + 1.0 * np.hypot(1.0, 0.2) + HOLDER_RESERVE, "holder"),
    ],
)
def test_a_motion_ends_where_its_limit_is(z: tuple[float, float], reach: float, component: str) -> None:
    """In front of a wall; the holder's flank rises by 1 in 5, so its distance is taken across it."""
    collider = Collider.of(scene_of(PLATE, tools=(TOOL,), check=wall(20.0, z)))
    motion = collider.allowed(straight(), TOOL)
    assert motion is not None
    assert 20.0 - reach - 2.0 * COARSE - 0.002 <= motion.ends([1.0])[0][0, 0] <= 20.0 - reach + 1e-5
    worst = min(collider.least(straight(), TOOL, design=False), key=lambda reason: reason.slack)
    assert worst.face == 9 and worst.body == "part" and worst.place[0] == pytest.approx(20.0)
    hit = next(item for item in collider.least(straight(), TOOL, design=False) if item.component == component)
    assert "face 9" in collider.describe(hit) and component in collider.describe(hit)


def test_a_needle_between_points_and_poses_is_found() -> None:
    """The screen looks at points 0.2 mm apart and at poses every millimetre: a spike's tip may slip through both."""
    needle = CheckMesh(
        np.array([[10.3, -9.0, 8.0], [10.5, -9.0, 8.0], [10.4, -2.985, 8.0]]),
        np.array([[0, 1, 2]], dtype=np.int32), np.array([9], dtype=np.int32),
    )  # fmt: skip
    collider = Collider.of(scene_of(PLATE, tools=(TOOL,), check=needle))
    course = collider.motion(straight(), TOOL, design=False)
    # The tip of the needle is 0.015 within the flute's radius of 3, 0.005 more than is let pass.
    assert len(course.free) == 2
    assert course.free[0, 1] * 30.0 == pytest.approx(10.4 - np.sqrt(2.9905**2 - 2.985**2), abs=0.1)
    worst = min(collider.least(straight(), TOOL, design=False), key=lambda reason: reason.slack)
    np.testing.assert_allclose(worst.place, [10.4, -2.985, 8.0], atol=1e-6)
    assert worst.clearance == pytest.approx(-0.015, abs=1e-5) and worst.time * 30.0 == pytest.approx(10.4, abs=0.5)


def obstructed(body: CheckMesh, tools: tuple[Tool, ...] = (TOOL,)) -> Scene:
    scene = scene_of(PLATE, tools=tools, check=body)
    return replace(scene, job=msgspec.structs.replace(scene.job, obstacles=Obstacles(("block.stl",))))


def test_inside_of_a_closed_body_is_a_collision_and_of_an_open_one_cannot_be_told() -> None:
    box = trimesh.creation.box((200.0, 200.0, 200.0))
    box.apply_translation([0.0, 0.0, 150.0])
    up, within = np.array([[0.0, 0.0, 1.0]]), np.array([[0.0, 0.0, 150.0]])
    closed, opened = mesh_of(box, -1), mesh_of(box, -1)
    opened = opened.only(np.arange(12) > 1)
    assert open_edges(closed) == 0 and open_edges(opened) == 4
    for mesh, inside in ((closed, True), (opened, False)):
        collider = Collider.of(obstructed(mesh))
        assert bool(collider.free(within, up, TOOL)[0]) is not inside
        found = collider.poses(within, up, TOOL, reach=500.0)
        assert bool(found.slack[0].min() < -40.0) is inside
        assert (
            collider.path(within + np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]), np.vstack([up, up]), TOOL).clear
            is not inside
        )
        # From above it is met where the tip, 3 below the point that is moved, is at the cutter's margin of 0.2.
        course = collider.path(np.array([[0.0, 0.0, 400.0], [0.0, 0.0, 240.0]]), np.vstack([up, up]), TOOL)
        end = 400.0 - 160.0 * course.free[0, 1]
        assert end == pytest.approx(250.0 + 3.0 + 0.2 + RESERVE, abs=0.06)
    near = collider.least_on_path(np.array([[0.0, 0.0, 260.0], [0.0, 0.0, 255.0]]), np.vstack([up, up]), TOOL)
    assert "block.stl" in collider.describe(near[0])


def test_a_path_that_swings_is_looked_at_between_its_poses() -> None:
    """Upright on both sides of a post the tool passes it on the way, and so does one that leans over it."""
    post = mesh_of(
        trimesh.creation.box((1.0, 1.0, 1.0), transform=trimesh.transformations.translation_matrix([0, 0, 30]))
    )
    collider = Collider.of(scene_of(tools=(TOOL,), check=post))
    p = np.array([[-20.0, 0.0, 0.0], [20.0, 0.0, 0.0]])
    up = np.array([[0.0, 0.0, 1.0]] * 2)
    course = collider.path(p, up, TOOL)
    assert not course.clear and len(course.free) == 2
    lean = np.array([[-0.8, 0.0, 0.6], [0.8, 0.0, 0.6]])
    swing = collider.path(np.zeros((2, 3)), lean, TOOL)
    # At height 30 the post is half a millimetre wide, the shank 2.5 and its margin 0.5.
    assert not swing.clear
    limit = np.arctan(3.5 / 29.5)
    assert np.arctan2(*_swung(swing.free[0, 1], lean)) == pytest.approx(-limit, abs=0.02)


def _swung(share: float, lean: np.ndarray) -> tuple[float, float]:
    d = (1.0 - share) * lean[0] + share * lean[1]
    return float(d[0]), float(d[2])


def test_far_away_is_no_clearance() -> None:
    collider = Collider.of(scene_of(tools=(TOOL,), check=wall(500.0, (0.0, 10.0))))
    found = collider.poses(np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]]), TOOL)
    assert np.all(np.isinf(found.clearance)) and np.all(found.body < 0)
    assert collider.least(straight(), TOOL) == ()
    assert REACH < 400.0


@pytest.mark.parametrize("face", [cylinder_face(8.0, (0.0, 30.0)), plane_face((0.0, 20.0), (0.0, 10.0))])
def test_triangles_of_a_face_are_as_near_as_they_say(face) -> None:
    mesh, sag = face_mesh(face, 0.001)
    corners = mesh.vertices[mesh.triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    if face.name == "plane":
        assert 0.5 * np.linalg.norm(normal, axis=1).sum() == pytest.approx(200.0)
        assert np.all(normal[:, 2] > 0.0) and sag.max() == 0.0
        return
    off = 8.0 - np.hypot(*corners.mean(axis=1)[:, [0, 2]].T)
    assert 0.0 < off.max() <= sag.max() + 1e-9 and sag.max() < 0.002
    assert 0.5 * np.linalg.norm(normal, axis=1).sum() == pytest.approx(8.0 * np.pi / 2 * 30.0, rel=1e-4)
    assert np.all(np.einsum("ti,ti->t", normal, corners.mean(axis=1) * [1.0, 0.0, 1.0]) > 0.0)


def test_triangles_follow_a_face_that_is_straight_along_its_lines_and_twisted() -> None:
    """z = x y / 25 over 30 x 20 mm with a hollow border: neither parameter line bends, only the cells between them."""
    poles = np.array([[[x, y, x * y / 25.0] for y in (-10.0, 10.0)] for x in (-15.0, 15.0)])
    knots = np.array([0.0, 0.0, 1.0, 1.0])
    along = np.linspace(0.0, 1.0, 60)
    hollow = np.stack([along, 0.8 * along * (1.0 - along)], axis=1)
    loop = np.vstack([hollow, [[1.0, 1.0], [0.0, 1.0]]])
    face = DesignFace(0, "twist", BSplineSurface(1, 1, knots, knots, poles), (loop,), 1)
    mesh, sag = face_mesh(face, 0.001)
    assert sag.max() < 0.002
    corners = mesh.vertices[mesh.triangles]
    x, y, z = corners.mean(axis=1).T
    assert np.abs(z - x * y / 25.0).max() <= sag.max() + 1e-9
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum()
    assert area == pytest.approx(WorkFace.of(face, 0.0).samples(0.1).areas.sum(), rel=2e-3)


def test_sag_of_a_mesh_is_the_rise_of_its_arcs() -> None:
    body = trimesh.creation.cylinder(20.0, 40.0, sections=72)
    flank = np.abs(body.face_normals[:, 2]) < 0.5
    mesh = mesh_of(body, 3)
    sag = mesh_sags(mesh.only(flank))
    rise = 20.0 * (1.0 - np.cos(np.pi / 72))
    assert sag.min() > 0.99 * rise and sag.max() < 1.05 * rise
    assert mesh_sags(mesh_of(body, -1)).max() == 0.0


BALL = Tool("B", 1.5, 3.0, 24.0, (Section(6.0, 6.0, 40.0),), ())
UP = np.array([[0.0, 0.0, 1.0]])


def in_groove(depth: float) -> np.ndarray:
    """The point of BALL's axis at height 0 where its ball is so deep in the lowest line of the groove, upright."""
    return np.array([[GROOVE_AT, 10.3, -RADIUS - depth - BALL.tip_height]])


@pytest.mark.parametrize(("depth", "free"), [(0.004, True), (0.0098, False), (0.012, False)])
def test_a_neighbour_is_as_deep_as_its_surface(depth: float, free: bool) -> None:
    # The design face lies beside the groove, within the cutter's reach.
    collider = Collider.of(replace(groove_scene(tool=BALL), faces=(plane_face((36.0, 50.0), (0.0, 20.0)),)))
    assert bool(collider.free(in_groove(depth), UP, BALL)[0]) is free
    found = collider.poses(in_groove(depth), UP, BALL)
    # Its triangles are made within 2 um, and what they are off counts against the ball.
    assert -depth - 0.005 <= found.clearance[0, 0] <= -depth + 1e-5


def test_sag_of_triangles_alone_counts_against_the_cutter() -> None:
    """Chords 25 um above the groove's bottom: what is just at the bottom may be as much too deep."""
    collider = Collider.of(groove_scene(known=False, tool=BALL))
    assert not collider.free(in_groove(0.0), UP, BALL)[0]
    chord = RADIUS * (1.0 - np.cos(0.25 * np.pi / 7.0))
    assert collider.poses(in_groove(0.0), UP, BALL).clearance[0, 0] == pytest.approx(-2.0 * chord, abs=0.001)


def test_sag_of_a_design_face_counts_for_the_cutter() -> None:
    """It is meant to touch: a ball at the bottom of a groove that it cuts is no deeper in it than the triangles are."""
    scene = scene_of(groove(RADIUS, (0.0, 20.0)), tools=(BALL,))
    collider = Collider.of(scene)
    across = np.linspace(9.0, 11.0, 41)
    p = np.repeat(in_groove(0.0), 41, axis=0)
    p[:, 1] = across
    clearance = collider.poses(p, np.repeat(UP, 41, axis=0), BALL).clearance[:, 0]
    assert clearance.min() >= -2e-5 and clearance.max() < 0.002


@pytest.mark.parametrize(("component", "radius"), [("shank", 2.5), ("holder", 8.0)])
def test_sag_of_a_design_face_counts_against_shank_and_holder(component: str, radius: float) -> None:
    """Along tangents of a cylinder, over chords and their ends: never further away than its arc."""
    pipe, off, height = 30.0, 0.02 if component == "shank" else 1.2, 28.0 if component == "shank" else 45.0
    collider = Collider.of(scene_of(cylinder_face(pipe, (0.0, 20.0)), tools=(STEPPED,)))
    angle = np.linspace(0.3, 1.2, 101)
    d = np.stack([-np.sin(angle), np.zeros(101), np.cos(angle)], axis=1)
    away = np.stack([np.cos(angle), np.zeros(101), np.sin(angle)], axis=1)
    p = (pipe + off + radius) * away + [0.0, 10.0, 0.0] - height * d
    found = collider.poses(p, d, STEPPED).clearance[:, COMPONENTS.index(component)]
    assert found.max() <= off + 2e-5 and found.min() > off - 0.003


@pytest.mark.parametrize(("component", "radius"), [("shank", 2.0), ("holder", 6.0)])
def test_sag_counts_against_shank_and_holder(component: str, radius: float) -> None:
    """Chords of 13 degrees of a pipe R 4 beside the tool: its arc comes 26 um nearer than they."""
    tool = Tool("S", 1.0, 1.0, 10.0, (Section(4.0, 4.0, 20.0),), (Section(12.0, 12.0, 30.0),))
    low = 10.0 if component == "shank" else 30.0
    pipe = chords(RADIUS, (-30.0, 30.0))
    # The concave quarter turned over and lifted: its back, with the lowest line, faces the tool.
    turned = pipe.vertices[:, [2, 1, 0]] - [0.0, 0.0, GROOVE_AT - low - 9.0]
    off, pipe = 0.8, replace(pipe, vertices=turned)
    place = np.array([[-RADIUS - off - radius, 0.0, 0.0]])
    found = Collider.of(scene_of(tools=(tool,), check=pipe)).poses(place, UP, tool)
    assert found.clearance[0, COMPONENTS.index(component)] == pytest.approx(off, abs=0.002)


def test_what_a_region_leaves_of_its_face_is_no_less_protected() -> None:
    """Between poses too: a cut that dips 25 um beyond the region is free up to there, one that dips 5 um is free."""
    rest = plane_face((40.0, 70.0), (-30.0, 30.0))
    scene = replace(scene_of(plane_face((-40.0, 40.0), (-30.0, 30.0)), tools=(TOOL,)), rest=(rest,))
    collider = Collider.of(scene)
    t = np.linspace(0.0, 1.0, 30)
    for dip, clear in ((0.005, True), (0.025, False)):
        x = np.stack([20.0 + 40.0 * t, np.zeros(30), 3.0 - dip * np.clip(4.0 * t - 2.2, 0.0, 1.0)], axis=1)
        motion = fitted(t, np.hstack([x, x + np.array([0.0, 0.0, TOOL.length])]), 20)
        assert collider.motion(motion, TOOL, design=False).clear is clear
        assert (collider.allowed(motion, TOOL) is motion) is clear
        least = min(collider.least(motion, TOOL, design=False), key=lambda reason: reason.slack)
        assert least.body == "rest" and least.clearance == pytest.approx(-dip, abs=0.005)
