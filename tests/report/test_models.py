"""Exported surfaces, read back by others and held against the cutter itself."""

import csv
import io
from pathlib import Path

import numpy as np
import pytest
import trimesh
from OCP.BRep import BRep_Tool
from OCP.GeomAPI import GeomAPI_ProjectPointOnSurf
from OCP.gp import gp_Pnt

from conflank_cli.cad.reader import read_part
from conflank_cli.errors import NumericalError
from conflank_cli.motion import Motion, uniform_knots
from conflank_cli.report import models
from conflank_cli.report.gap_map import gap_map
from conflank_cli.report.spreadsheets import cuts_csv, poses_csv
from conflank_cli.tool import CATALOGUE
from conflank_cli.verification.gap import distance_to_cutter
from conflank_cli.verification.judge import verify_program
from conflank_cli.verification.posed import pose_program
from tests.report.test_gap_map import FACE, lying_cone
from tests.verification.scenes import T1, lying_on_plane, scene_of

T2 = CATALOGUE["T2"]


def swinging(length: float) -> Motion:
    """A motion that goes across its axis, turns and rises."""
    t = np.linspace(0.0, 1.0, 8)
    p = np.stack([20.0 * t, 3.0 + 2.0 * t**2, 4.0 + np.sin(t)], axis=1)
    d = np.stack([0.3 * t, np.ones(8), 0.2 + 0.1 * t], axis=1)
    return Motion(uniform_knots(8), p, p + length * d / np.linalg.norm(d, axis=1, keepdims=True))


def lying() -> Motion:
    """The cone on the plane z = 0, along x from 5 to 25."""
    _, tip, axis = lying_on_plane(T1)
    p = tip - T1.tip_height * axis + np.linspace(5.0, 25.0, 6)[:, None] * [1.0, 0.0, 0.0]
    return Motion(uniform_knots(6), p, p + T1.length * axis)


def test_the_envelope_of_a_cone_on_a_plane_is_the_plane() -> None:
    points = models.envelope_points(lying(), T1, FACE)
    assert points[..., 2] == pytest.approx(0.0, abs=1e-9)
    assert points[0, 0, 0] == pytest.approx(5.0) and points[-1, 0, 0] == pytest.approx(25.0)
    assert points[0, -1, 1] - points[0, 0, 1] == pytest.approx(T1.length / np.cos(T1.half_angle))


def test_no_pose_cuts_deeper_than_the_envelope_and_one_touches() -> None:
    """Against verification's own distance to the cutter, at the poses of the motion."""
    motion = swinging(T2.length)
    points = models.envelope_points(motion, T2, FACE)
    p, q = motion.ends(np.linspace(0.0, 1.0, 2001))
    axis = (q - p) / np.linalg.norm(q - p, axis=1, keepdims=True)
    tip = p + T2.tip_height * axis
    inner = points[30:-30:14, 4:-4:5].reshape(-1, 3)
    distance = np.array([distance_to_cutter(T2, point, tip, axis).min() for point in inner])
    # The ends of the rigid axis are cubic splines, which keep its length to some micrometres only.
    assert distance == pytest.approx(0.0, abs=2e-3)


def test_ruled_surfaces_are_exact_in_step(tmp_path: Path) -> None:
    motion = swinging(T2.length)
    data = models.encoded_step([("sweep 1", models.ruled_face(motion))])
    assert data == models.encoded_step([("sweep 1", models.ruled_face(motion))])
    assert b"PRODUCT('sweep 1','sweep 1'" in data
    (tmp_path / "ruled.step").write_bytes(data)
    (face,) = read_part(tmp_path / "ruled.step", 1.0).faces
    surface = face.load().surface
    assert (surface.degree_u, surface.degree_v) == (3, 1)
    assert surface.poles[:, 0] == pytest.approx(motion.p) and surface.poles[:, 1] == pytest.approx(motion.q)
    assert surface.knots_u == pytest.approx(motion.knots)


def test_envelopes_in_step_pass_through_their_points(tmp_path: Path) -> None:
    motion = swinging(T2.length)
    points = models.envelope_points(motion, T2, FACE)
    (tmp_path / "envelope.step").write_bytes(models.encoded_step([("sweep 1", models.envelope_face(points))]))
    (face,) = read_part(tmp_path / "envelope.step", 1.0).faces
    surface = face.load().surface
    assert surface.poles[0, 0] == pytest.approx(points[0, 0]) and surface.poles[-1, -1] == pytest.approx(points[-1, -1])
    # The other points of the flute are on it as well, by the CAD kernel's own projection.
    kernel = BRep_Tool.Surface_s(models.envelope_face(points))
    off = [GeomAPI_ProjectPointOnSurf(gp_Pnt(*p), kernel).LowerDistance() for p in points[::19, 1::3].reshape(-1, 3)]
    assert max(off) < 1e-5
    points[5, 5] = np.nan
    with pytest.raises(NumericalError):
        models.envelope_face(points)


def test_meshes_come_back_with_their_colours() -> None:
    scene = scene_of(FACE)
    shown = gap_map(pose_program(lying_cone(0.0), scene), FACE, (31, 29))
    sheet = models.gap_sheet(shown, 0.01, 0.01)
    for kind in ("ply", "glb"):
        data = models.encoded_meshes([sheet], kind)
        assert data == models.encoded_meshes([sheet], kind)
        mesh = trimesh.load(io.BytesIO(data), file_type=kind, force="mesh", process=False)
        assert len(mesh.vertices) == 31 * 29 and len(mesh.faces) == 2 * 30 * 28
        assert mesh.bounds.tolist() == [[0.0, 2.0, 0.0], [30.0, 30.0, 0.0]]
        # Seen from the cutter's side, and green where the cone lies on the plane.
        assert mesh.face_normals[:, 2].min() > 0.99
        under = np.flatnonzero(np.isclose(mesh.vertices[:, 0], 15.0) & np.isclose(mesh.vertices[:, 1], 10.0))
        assert mesh.visual.vertex_colors[under[0]].tolist() == pytest.approx([0x3F, 0xA3, 0x4D, 255], abs=6)
    two = [models.ruled_sheet(f"sweep {k + 1}", lying(), k) for k in range(2)]
    loaded = trimesh.load(io.BytesIO(models.encoded_meshes(two, "glb")), file_type="glb")
    assert sorted(loaded.geometry) == ["sweep 1", "sweep 2"]
    assert trimesh.load(io.BytesIO(models.encoded_meshes(two, "stl")), file_type="stl").area == pytest.approx(
        2 * 20.0 * T1.length, rel=1e-6
    )


def test_tables_say_what_the_verification_says() -> None:
    scene = scene_of(FACE)
    verification = verify_program(lying_cone(-0.002), scene, "TEST.H", 2000)
    (row,) = csv.DictReader(io.StringIO(cuts_csv(verification)))
    assert (row["kind"], row["tool"]) == ("sweep", "T1")
    assert float(row["gap_min_um"]) == pytest.approx(-2.0, abs=1e-3)
    posed = pose_program(lying_cone(-0.002), scene)
    rows = list(csv.DictReader(io.StringIO(poses_csv(posed, scene))))
    assert [int(row["block"]) for row in rows] == posed.poses.moves.block.tolist()
    cutting = [row for row in rows if row["cut"] == "sweep 1"]
    assert float(cutting[-1]["x_mm"]) == 25.0 and float(cutting[-1]["feed_mm_min"]) == 1000.0
    assert rows[-1]["feed_mm_min"] == "" and rows[-1]["motion"] == "rapid"
