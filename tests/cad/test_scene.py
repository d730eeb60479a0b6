from __future__ import annotations

import json

import numpy as np
import pytest
from OCP.BRepAlgoAPI import BRepAlgoAPI_Cut
from OCP.BRepPrimAPI import BRepPrimAPI_MakeBox, BRepPrimAPI_MakeCylinder, BRepPrimAPI_MakeTorus
from OCP.gp import gp_Ax2, gp_Dir, gp_Pnt

from conflank_cli import job as jobs
from conflank_cli.cad.loops import bounds, inside
from conflank_cli.cad.quadrature import surface_frames, trimmed_area
from conflank_cli.cad.reader import read_part
from conflank_cli.cad.scene import check_mesh, load_scene, resolve_faces, rest_of_faces
from conflank_cli.errors import InputError
from conflank_cli.geometry.surface import to_spans
from tests.cad import shapes
from tests.cad.test_nurbs_json import PATCH


def _part_keys(*designs, check_faces="rest"):
    return jobs.Part(file="part", design=tuple(jobs.Design(**d) for d in designs), check_faces=check_faces)


def _design(part, region=(0.0, 1.0, 0.0, 1.0), face=0, side="outside"):
    (face,) = resolve_faces(part, _part_keys({"face": face, "region": region, "side": side}))
    return face


@pytest.fixture(scope="module")
def tube(tmp_path_factory):
    """A cylinder of radius 5 whose jacket, face 0, goes all the way round; a slanted hole crosses its seam."""
    return read_part(tube_file(tmp_path_factory.mktemp("tube") / "tube.step"))


def tube_file(path):
    body = BRepPrimAPI_MakeCylinder(5.0, 20.0).Shape()
    drill = BRepPrimAPI_MakeCylinder(gp_Ax2(gp_Pnt(2, 0.3, 10), gp_Dir(1, 0.05, 0.3)), 2.0, 10.0).Shape()
    return shapes.write_step(BRepAlgoAPI_Cut(body, drill).Shape(), path)


def _jacket(part):
    return max(
        (face for face in part.faces if face.kind == "cylinder"),
        key=lambda face: trimmed_area(face.load().surface, face.load().loops),
    ).number


def test_regions_round_the_seam_add_up_to_the_face(tube, tmp_path):
    number = _jacket(tube)
    whole = _design(tube, face=number)
    total = trimmed_area(whole.surface, whole.loops)
    original = shapes.faces_of(shapes.read_back(tube_file(tmp_path / "tube.step")))[number]
    assert total == pytest.approx(shapes.kernel_area(original), rel=1e-3)
    for start, end in [(0.9, 0.15), (0.6, 0.3)]:
        first = _design(tube, (start, end, 0.0, 1.0), number)
        rest = _design(tube, (end, start, 0.0, 1.0), number)
        areas = [trimmed_area(d.surface, d.loops) for d in (first, rest)]
        assert sum(areas) == pytest.approx(total, rel=1e-6)
        u0, u1, _, _ = bounds(first.loops)
        low, high, _, _ = first.surface.domain
        assert low < u0 - 0.1 and high > u1 + 0.1
        # The seam is no border: points on either side of it, away from the hole, are inside.
        seam = _box(tube, number)[1]
        points = np.array([[seam - 1e-6, 0.5], [seam, 0.5], [seam + 1e-6, 0.5]])
        assert np.all(inside(first.loops, points))
        radii = surface_frames(to_spans(first.surface), np.linspace(u0, u1, 30), np.full(30, 3.0))[:, 0, :2]
        np.testing.assert_allclose(np.linalg.norm(radii, axis=1), 5.0, atol=1e-12)


def _box(part, number):
    return part.faces[number].load().box


def test_side_turns_the_sense(tube):
    number = _jacket(tube)
    for side, outward in (("outside", 1.0), ("inside", -1.0)):
        face = _design(tube, face=number, side=side)
        u0, _, v0, v1 = face.surface.domain
        frame = surface_frames(to_spans(face.surface), np.array([u0 + 2.0]), np.array([0.5 * (v0 + v1)]))[0]
        normal = face.sense * np.cross(frame[1], frame[2])
        assert np.sign(normal[:2] @ frame[0, :2]) == outward


def test_a_region_of_a_torus_wraps_both_ways(tmp_path):
    part = read_part(shapes.write_brep(BRepPrimAPI_MakeTorus(10.0, 3.0).Shape(), tmp_path / "torus.brep"))
    # The B-spline form has its knots at thirds of a turn: only there and halfway are fractions those of the angle.
    third, two_thirds = 1 / 3, 2 / 3
    areas = [
        trimmed_area(d.surface, d.loops)
        for u in ((two_thirds, third), (third, two_thirds))
        for v in ((two_thirds, third), (third, two_thirds))
        for d in [_design(part, (*u, *v))]
    ]
    assert sum(areas) == pytest.approx(4 * np.pi**2 * 10 * 3, rel=1e-6)
    along = 4 * np.pi / 3
    across = 10 * along + 2 * 3 * np.sin(2 * np.pi / 3)
    assert areas[0] == pytest.approx(along * 3 * across, rel=1e-6)


@pytest.mark.parametrize(
    "region,found",
    [
        ((0.2, 0.2, 0.0, 1.0), "u from 0.2 to 0.2"),
        ((0.0, 1.0, 0.8, 0.1), "v from 0.8 to 0.1"),
        ((0.0, 1.0, float("nan"), 1.0), "v from nan"),
    ],
)
def test_regions_without_extent_or_seam_are_refused(tube, region, found):
    with pytest.raises(InputError) as caught:
        _design(tube, region, _jacket(tube))
    assert found in caught.value.found
    assert "region" in caught.value.where


def test_wrong_faces_are_refused(tube, tmp_path):
    with pytest.raises(InputError, match="face number 99"):
        _design(tube, face=99)
    with pytest.raises(InputError, match="which no face has"):
        _design(tube, face="flank")
    flat = {**PATCH, "poles": [[[x, 0, 0], [2 * x, 0, 0]] for x in (0, 5, 10)]}
    path = tmp_path / "flat.json"
    path.write_text(json.dumps({"faces": [flat]}))
    with pytest.raises(InputError, match="mm2; expected a face with an area"):
        _design(read_part(path))


def _volume(mesh):
    corners = mesh.vertices[mesh.triangles]
    return float(np.einsum("ni,ni->", np.cross(corners[:, 0], corners[:, 1]), corners[:, 2]) / 6.0)


@pytest.mark.parametrize("scale", [1.0, 0.5])
def test_check_mesh_encloses_the_solid(scale, tmp_path):
    block = BRepPrimAPI_MakeBox(gp_Pnt(5, 6, 7), 20.0, 30.0, 10.0).Shape()
    drill = BRepPrimAPI_MakeCylinder(gp_Ax2(gp_Pnt(15, 20, 0), gp_Dir(0.1, 0, 1)), 4.0, 40.0).Shape()
    solid = BRepAlgoAPI_Cut(block, drill).Shape()
    part = read_part(shapes.write_step(solid, tmp_path / "block.step"), scale)
    mesh = check_mesh(part, _part_keys({"face": 0}, check_faces=tuple(range(len(part.faces)))))
    # A closed mesh that looks outwards has the solid's volume: 0.02 mm deep along the wall of the hole at most.
    assert abs(_volume(mesh) - scale**3 * shapes.kernel_volume(solid)) < 0.02 * scale**2 * 2 * np.pi * 4 * 10
    assert mesh.vertices.dtype == np.float64 and mesh.triangles.dtype == np.int32 and mesh.face.dtype == np.int32
    assert set(mesh.face.tolist()) == set(range(len(part.faces)))
    rest = check_mesh(part, _part_keys({"face": 2}))
    assert set(rest.face.tolist()) == set(range(len(part.faces))) - {2}
    none = check_mesh(part, _part_keys({"face": 2}, check_faces="none"))
    assert none.triangles.shape == (0, 3) and none.vertices.shape == (0, 3)


def test_check_mesh_follows_placements(tmp_path):
    from OCP.gp import gp_Trsf, gp_Vec
    from OCP.TopLoc import TopLoc_Location

    box = BRepPrimAPI_MakeBox(2.0, 3.0, 4.0).Shape()
    move = gp_Trsf()
    move.SetTranslation(gp_Vec(50, 0, 0))
    part = read_part(shapes.write_step(shapes.compound(box, box.Moved(TopLoc_Location(move))), tmp_path / "two.step"))
    mesh = check_mesh(part, _part_keys({"face": 0}, check_faces=tuple(range(12))))
    assert _volume(mesh) == pytest.approx(48.0)
    assert mesh.vertices[:, 0].max() == pytest.approx(52.0)


def test_check_mesh_of_a_json_part(tmp_path):
    hump = {**PATCH, "outside": "against", "trim": [[[0.1, 0.0], [0.8, 0.2], [0.9, 1.0], [0.2, 0.7]]]}
    path = tmp_path / "part.json"
    path.write_text(json.dumps({"faces": [PATCH, hump]}))
    part = read_part(path)
    mesh = check_mesh(part, _part_keys({"face": 0}))
    assert set(mesh.face.tolist()) == {1}
    corners = mesh.vertices[mesh.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    geometry = part.faces[1].load()
    assert 0.5 * np.linalg.norm(normals, axis=1).sum() == pytest.approx(
        trimmed_area(geometry.surface, geometry.loops), rel=1e-3
    )
    # S_u x S_v of the patch looks up; its outside is declared against that.
    assert np.all(normals[:, 2] < 0.0)


def test_load_scene_puts_it_together(tmp_path):
    shapes.write_step(BRepPrimAPI_MakeBox(20.0, 30.0, 10.0).Shape(), tmp_path / "block.step")
    text = b'[part]\nfile = "block.step"\n[[part.design]]\nface = 1\n[tools]\nuse = ["T1"]\n'
    text += b'[machine]\nname = "ac-table"\n'
    job = jobs.parse_job(text, "job.toml", tmp_path)
    scene = load_scene(job, tmp_path)
    assert scene.part_name == "block"
    assert [face.number for face in scene.faces] == [1]
    assert [tool.name for tool in scene.tools] == ["T1"]
    assert set(scene.check.face.tolist()) == {0, 2, 3, 4, 5}
    assert list(scene.inputs) == ["block.step"] and len(scene.inputs["block.step"]) == 64


def _areas(faces):
    return sum(trimmed_area(face.surface, face.loops) for face in faces)


@pytest.mark.parametrize(
    "regions",
    [
        [(0.3, 0.7, 0.2, 0.8)],
        [(0.0, 1.0, 0.2, 0.8)],
        [(0.8, 0.25, 0.1, 0.6)],
        [(-0.2, 0.1, 0.0, 0.5), (0.1, 0.5, 0.0, 0.5), (0.0, 1.0, 0.6, 0.9)],
    ],
    ids=["window", "belt", "across the seam", "three"],
)
def test_regions_and_what_they_leave_make_up_the_face(tube, regions):
    number = _jacket(tube)
    wanted = _part_keys(*({"face": number, "region": region} for region in regions))
    rest = rest_of_faces(tube, wanted)
    assert {face.number for face in rest} == {number}
    whole = _design(tube, face=number)
    assert {face.sense for face in rest} == {whole.sense}
    total = trimmed_area(whole.surface, whole.loops)
    own = resolve_faces(tube, wanted)
    assert _areas(own) + _areas(rest) == pytest.approx(total, rel=1e-6)
    # No place of what is left is within a region: angles and heights of the jacket tell.
    inner = np.concatenate([_inner_points(face) for face in rest])
    for face in own:
        for point in _inner_points(face):
            assert np.linalg.norm(inner - point, axis=1).min() > 1e-3


def _inner_points(face):
    u0, u1, v0, v1 = bounds(face.loops)
    grid = np.stack(np.meshgrid(np.linspace(u0, u1, 12)[1:-1], np.linspace(v0, v1, 12)[1:-1]), axis=-1).reshape(-1, 2)
    grid = grid[inside(face.loops, grid)]
    return surface_frames(to_spans(face.surface), grid[:, 0], grid[:, 1])[:, 0]


def test_nothing_is_left_of_whole_faces_and_where_nothing_is_checked(tube):
    number = _jacket(tube)
    assert rest_of_faces(tube, _part_keys({"face": number})) == ()
    half = {"face": number, "region": (0.0, 0.5, 0.0, 1.0)}
    assert rest_of_faces(tube, _part_keys(half, check_faces="none")) == ()
    other = {"face": number, "region": (0.5, 1.0, 0.0, 1.0)}
    assert rest_of_faces(tube, _part_keys(half, other)) == ()


@pytest.mark.parametrize(
    "one,other",
    [
        ((0.0, 1.0, 0.0, 1.0), (0.0, 1.0, 0.0, 1.0)),
        ((0.0, 0.5, 0.0, 0.5), (0.4, 1.0, 0.4, 1.0)),
        ((0.9, 0.1, 0.0, 1.0), (0.05, 0.2, 0.3, 0.4)),
        ((0.2, 0.4, 0.0, 1.0), (1.3, 1.5, 0.0, 1.0)),
    ],
)
def test_the_same_place_of_a_face_twice_is_refused(tube, one, other):
    number = _jacket(tube)
    with pytest.raises(InputError) as caught:
        resolve_faces(tube, _part_keys({"face": number, "region": one}, {"face": number, "region": other}))
    assert "[[part.design]] 1" in caught.value.where
    assert f"face {number}, which [[part.design]] 0 has already" in caught.value.found


def test_regions_that_only_touch_are_two(tube):
    number = _jacket(tube)
    halves = ({"face": number, "region": (a, b, 0.0, 1.0)} for a, b in ((0.0, 0.5), (0.5, 1.0)))
    assert len(resolve_faces(tube, _part_keys(*halves))) == 2


def test_a_scene_has_the_surfaces_of_what_nothing_may_touch(tmp_path):
    shapes.write_step(BRepPrimAPI_MakeBox(20.0, 30.0, 10.0).Shape(), tmp_path / "block.step")
    text = b'[part]\nfile = "block.step"\n[[part.design]]\nface = 1\nregion = [0.0, 0.5, 0.0, 1.0]\n'
    text += b'[tools]\nuse = ["T1"]\n'
    scene = load_scene(jobs.parse_job(text, "job.toml", tmp_path), tmp_path)
    assert [face.number for face in scene.neighbours] == [0, 2, 3, 4, 5]
    assert [face.number for face in scene.rest] == [1]
    assert _areas(scene.rest) == pytest.approx(_areas(scene.faces))
