"""Clearances of verification, from points on meshes, against the exact ones, from whole triangles."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from conflank_cli.geometry.collision import COMPONENTS, Body, Collider
from conflank_cli.geometry.face import CheckMesh
from conflank_cli.geometry.outline import Margins
from conflank_cli.job import Margin
from conflank_cli.verification.judge import verify_program
from conflank_cli.verification.program import RETRACT_CHECKED
from tests.verification.scenes import T1, TCPM, lying_on_plane, plane_face, program, scene_of

WITHIN = 0.010


def spiked(seed: int) -> CheckMesh:
    """A fixture of sharp things near a tool that passes over it along x, lying along y: edges, tips, plates."""
    rng = np.random.default_rng(seed)
    bodies = []
    for _ in range(5):
        body = trimesh.creation.cone(rng.uniform(0.5, 6.0), rng.uniform(4.0, 15.0), sections=int(rng.integers(3, 9)))
        body.apply_transform(trimesh.transformations.random_rotation_matrix(rng.random(3)))
        body.apply_translation([rng.uniform(0.0, 40.0), rng.uniform(0.0, 120.0), rng.uniform(-12.0, -3.0)])
        bodies.append(body)
    plate = trimesh.creation.box((60.0, 200.0, 2.0))
    plate.apply_translation([20.0, 60.0, -41.3])
    body = trimesh.util.concatenate([*bodies, plate])
    faces = np.asarray(body.faces, dtype=np.int32)
    return CheckMesh(np.asarray(body.vertices), faces, np.full(len(faces), -1, dtype=np.int32))


@pytest.mark.parametrize("seed", range(6))
def test_clearances_over_sharp_fixtures(seed: int) -> None:
    tilt, tip, axis = lying_on_plane(T1, 1.0)
    words = f"A{tilt:+.9f} C+0"
    places = np.array([[-10.0, tip[1], tip[2] + 3.0], [0.0, tip[1], tip[2]], [17.0, tip[1] + 4.0, tip[2] - 0.5]])
    places = np.vstack([places, [[44.0, tip[1], tip[2] + 2.0]]])
    blocks = [f"L X{x:+.9f} Y{y:+.9f} Z{z:+.9f} {words} F1000" for x, y, z in places]
    text = program([f"L {words} R0 FMAX M3", TCPM, *blocks, "L M140 MB MAX"])
    mesh = spiked(seed)
    scene = scene_of(plane_face((10.0, 30.0), (1.0, 20.0)), check=mesh, margin=Margin(0.2, 0.5, 1.0))
    result = verify_program(text, scene, "", 3000)
    limits = Margins(0.2, 0.5, 1.0)
    collider = Collider(scene, (Body.of("obstacle", mesh, limits),), ("fixture.stl",))
    # The retract of M140 goes up the axis.
    p = np.vstack([places, places[-1] + RETRACT_CHECKED * axis]) - T1.tip_height * axis
    direct = np.tile(axis, (len(p), 1))
    exact = {reason.component: reason for reason in collider.least_on_path(p, direct, T1)}
    assert len(exact) >= 2 and set(exact) <= set(COMPONENTS)
    for name, reason in exact.items():
        figures = getattr(result.clearance_mm, name)
        assert figures.least is not None
        # The exact one is the least within 5 µm; points can only be further away.
        assert -0.0051 <= figures.least - reason.clearance <= WITHIN, name
        code = {"ball": "CF301", "cone": "CF302", "shank": "CF303", "holder": "CF304"}[name]
        found = [finding for finding in result.findings if finding.code == code]
        assert bool(found) is (figures.least < reason.limit)
        if found:
            assert found[0].amount == pytest.approx(figures.least, abs=1e-6)
            assert "an obstacle" in found[0].text


def test_a_tip_between_points_a_millimetre_apart_is_found() -> None:
    """A corner that points up at the flute, and the ridge of a roof half a millimetre below the limit."""
    tilt, tip, _ = lying_on_plane(T1)
    words = f"A{tilt:+.9f} C+0"
    blocks = [f"L X{x:+.4f} Y{tip[1]:+.9f} Z{tip[2]:+.9f} {words} F1000" for x in (0.0, 40.0)]
    text = program([f"L {words} R0 FMAX M3", TCPM, *blocks, "L M140 MB MAX"])
    ridge = np.array([[20.3, -40.0, -0.195], [20.3, 90.0, -0.195], [14.0, 90.0, -9.0], [14.0, -40.0, -9.0]])
    far = ridge * [-1.0, 1.0, 1.0] + [40.6, 0.0, 0.0]
    vertices = np.vstack([ridge, far])
    faces = np.array([[0, 1, 2], [0, 2, 3], [4, 6, 5], [4, 7, 6]], dtype=np.int32)
    scene = scene_of(plane_face((10.0, 30.0), (1.0, 20.0)), check=CheckMesh(vertices, faces, np.full(4, -1, np.int32)))
    result = verify_program(text, scene, "", 3000)
    # The cone lies on the plane z = 0 along its generator, all along the ridge at once.
    assert result.clearance_mm.cone.least == pytest.approx(0.195, abs=0.003)
    assert [finding.code for finding in result.findings if finding.code == "CF302"] == ["CF302"]
    open_air = scene.checking(CheckMesh(vertices - [0.0, 0.0, 0.02], faces, np.full(4, -1, np.int32)))
    assert "CF302" not in [finding.code for finding in verify_program(text, open_air, "", 3000).findings]
