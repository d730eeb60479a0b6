from __future__ import annotations

import math

import numpy as np
import pytest
from OCP.BRepAlgoAPI import BRepAlgoAPI_Cut
from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeEdge, BRepBuilderAPI_MakeFace, BRepBuilderAPI_NurbsConvert
from OCP.BRepPrimAPI import (
    BRepPrimAPI_MakeBox,
    BRepPrimAPI_MakeCone,
    BRepPrimAPI_MakeCylinder,
    BRepPrimAPI_MakePrism,
    BRepPrimAPI_MakeSphere,
    BRepPrimAPI_MakeTorus,
)
from OCP.BRepTools import BRepTools
from OCP.Geom import (
    Geom_Circle,
    Geom_CylindricalSurface,
    Geom_Hyperbola,
    Geom_OffsetSurface,
    Geom_SphericalSurface,
    Geom_SurfaceOfLinearExtrusion,
    Geom_SurfaceOfRevolution,
)
from OCP.gp import gp_Ax1, gp_Ax2, gp_Ax3, gp_Dir, gp_Pnt, gp_Trsf, gp_Vec
from OCP.Interface import Interface_Static
from OCP.Quantity import Quantity_Color, Quantity_TOC_sRGB
from OCP.STEPCAFControl import STEPCAFControl_Writer
from OCP.TCollection import TCollection_ExtendedString
from OCP.TDataStd import TDataStd_Name
from OCP.TDocStd import TDocStd_Document
from OCP.TopLoc import TopLoc_Location
from OCP.XCAFDoc import XCAFDoc_ColorSurf, XCAFDoc_DocumentTool

from conflank_cli.cad.loops import inside
from conflank_cli.cad.quadrature import surface_frames, trim_nodes, trimmed_area
from conflank_cli.cad.reader import read_part
from conflank_cli.errors import InputError
from conflank_cli.geometry.surface import to_spans
from tests.cad import shapes

AXIS = gp_Ax2(gp_Pnt(3, -2, 5), gp_Dir(1, 2, 2))


def _drilled_block():
    block = BRepPrimAPI_MakeBox(gp_Pnt(0, 0, 0), 20.0, 30.0, 10.0).Shape()
    slanted = gp_Ax2(gp_Pnt(8, 12, -20), gp_Dir(0.2, 0.1, 1))
    return BRepAlgoAPI_Cut(block, BRepPrimAPI_MakeCylinder(slanted, 4.0, 60.0).Shape()).Shape()


def _spherical_pocket():
    block = BRepPrimAPI_MakeBox(gp_Pnt(0, 0, 0), 20.0, 30.0, 10.0).Shape()
    return BRepAlgoAPI_Cut(block, BRepPrimAPI_MakeSphere(gp_Pnt(9, 14, 12), 6.0).Shape()).Shape()


SOLIDS = {
    "box": lambda: BRepPrimAPI_MakeBox(gp_Pnt(1, 2, 3), 5.0, 7.0, 11.0).Shape(),
    "cylinder": lambda: BRepPrimAPI_MakeCylinder(AXIS, 5.0, 17.0).Shape(),
    "cylinder_part": lambda: BRepPrimAPI_MakeCylinder(AXIS, 5.0, 17.0, 4.0).Shape(),
    "cone": lambda: BRepPrimAPI_MakeCone(AXIS, 5.0, 2.0, 17.0).Shape(),
    "pointed_cone": lambda: BRepPrimAPI_MakeCone(AXIS, 5.0, 0.0, 17.0).Shape(),
    "sphere": lambda: BRepPrimAPI_MakeSphere(AXIS, 6.0).Shape(),
    "torus": lambda: BRepPrimAPI_MakeTorus(AXIS, 10.0, 3.0).Shape(),
    "torus_part": lambda: BRepPrimAPI_MakeTorus(AXIS, 10.0, 3.0, -1.0, 0.8, 2.5).Shape(),
    "drilled_block": _drilled_block,
    "spherical_pocket": _spherical_pocket,
}


def _area(face):
    geometry = face.load()
    return trimmed_area(geometry.surface, geometry.loops)


def _area_tolerance(shape):
    """Trim polylines are true to 5 um: an area to 5 um times the length of its trim."""
    return 0.005 * shapes.edge_length(shape) + 1e-6


@pytest.mark.parametrize("write,suffix", [(shapes.write_step, ".step"), (shapes.write_brep, ".brep")])
@pytest.mark.parametrize("name", SOLIDS)
def test_areas_and_outside_against_the_kernel(name, write, suffix, tmp_path):
    path = write(SOLIDS[name](), tmp_path / (name + suffix))
    part, solid = read_part(path), shapes.read_back(path)
    originals = shapes.faces_of(solid)
    assert len(originals) == len(part.faces) > 0
    assert part.name == name
    for face, original in zip(part.faces, originals, strict=True):
        assert abs(_area(face) - shapes.kernel_area(original)) < _area_tolerance(original)
        geometry = face.load()
        nodes = trim_nodes(geometry.loops, np.empty(0), np.empty(0))
        # Well inside the face: next to an edge that juts inwards the kernel's classifier errs.
        share_u = (nodes.u - geometry.box[0]) / (geometry.box[1] - geometry.box[0])
        share_v = (nodes.v - geometry.box[2]) / (geometry.box[3] - geometry.box[2])
        middle = np.flatnonzero((np.abs(share_u - 0.5) < 0.35) & (np.abs(share_v - 0.5) < 0.35))
        pick = middle[np.linspace(0, len(middle) - 1, 7).astype(int)]
        frames = surface_frames(to_spans(geometry.surface), nodes.u[pick], nodes.v[pick])
        assert np.all(inside(geometry.loops, np.stack([nodes.u, nodes.v], axis=1)[pick]))
        for frame in frames:
            assert shapes.distance_to(original, frame[0]) < 6e-3
            normal = np.cross(frame[1], frame[2])
            normal *= face.orientation / np.linalg.norm(normal)
            assert face.outside_known
            assert not shapes.is_inside(solid, frame[0] + 1e-3 * normal)
            assert shapes.is_inside(solid, frame[0] - 1e-3 * normal)


def test_rational_faces_against_the_analytic_ones(tmp_path):
    analytic = SOLIDS["cylinder_part"]()
    rational = BRepBuilderAPI_NurbsConvert(analytic).Shape()
    part = read_part(shapes.write_step(rational, tmp_path / "rational.step"))
    assert {face.kind for face in part.faces} == {"bspline"}
    for face, original in zip(part.faces, shapes.faces_of(analytic), strict=True):
        assert abs(_area(face) - shapes.kernel_area(original)) < _area_tolerance(original)


@pytest.mark.parametrize("solids", [False, True])
@pytest.mark.parametrize("name", ["cylinder", "torus", "drilled_block", "sphere"])
def test_iges_areas_against_the_kernel(name, solids, tmp_path):
    solid = SOLIDS[name]()
    part = read_part(shapes.write_iges(solid, tmp_path / "part.igs", solids))
    assert all(face.outside_known == solids for face in part.faces)
    area = sum(_area(face) for face in part.faces)
    assert abs(area - shapes.kernel_area(solid)) < _area_tolerance(solid)


SURFACES = {
    "hyperbola": lambda: (
        Geom_SurfaceOfLinearExtrusion(Geom_Hyperbola(AXIS, 4.0, 2.0), gp_Dir(1, 0, 0.2)),
        (-0.8, 1.1, -3.0, 5.0),
    ),
    "offset_bspline": lambda: (Geom_OffsetSurface(_wavy(), 1.0), (0.1, 0.9, 0.2, 0.8)),
    "revolution": lambda: (
        Geom_SurfaceOfRevolution(
            Geom_Circle(gp_Ax2(gp_Pnt(14, 0, 0), gp_Dir(0, 1, 0)), 4.0), gp_Ax1(gp_Pnt(0, 0, 0), gp_Dir(0, 0, 1))
        ),
        (5.5, 7.5, 5.0, 7.0),
    ),
    "cylinder_across_the_seam": lambda: (
        Geom_CylindricalSurface(gp_Ax3(gp_Pnt(0, 0, 0), gp_Dir(0, 0, 1)), 5.0),
        (6.0, 6.8, 0.0, 9.0),
    ),
    "most_of_a_sphere": lambda: (
        Geom_SphericalSurface(gp_Ax3(gp_Pnt(0, 0, 0), gp_Dir(0, 0, 1)), 5.0),
        (1.0, 7.0, -1.0, 1.2),
    ),
}


def _wavy():
    u, v = np.meshgrid(np.linspace(0, 30, 6), np.linspace(0, 20, 5), indexing="ij")
    poles = np.stack([u, v, 3 * np.sin(u / 8) * np.cos(v / 9)], axis=-1)
    return shapes.bspline(poles, [[0, 0.4, 0.7, 1], [0, 0.5, 1]], [[4, 1, 1, 4], [4, 1, 4]], [3, 3])


@pytest.mark.parametrize("name", SURFACES)
def test_trimmed_surfaces_keep_points_and_area(name, tmp_path):
    surface, box = SURFACES[name]()
    face = BRepBuilderAPI_MakeFace(surface, *map(float, box), 1e-6).Face()
    part = read_part(shapes.write_brep(face, tmp_path / "face.brep"))
    geometry = part.faces[0].load()
    assert trimmed_area(geometry.surface, geometry.loops) == pytest.approx(shapes.kernel_area(face), rel=1e-4)
    u, v = np.meshgrid(np.linspace(*geometry.box[:2], 5), np.linspace(*geometry.box[2:], 5))
    for frame in surface_frames(to_spans(geometry.surface), u.ravel(), v.ravel()):
        assert shapes.distance_to(face, frame[0]) < 1e-5
    # Real surface past the trim wherever the kernel has some.
    u0, u1, v0, v1 = geometry.surface.domain
    assert u0 < geometry.box[0] and u1 > geometry.box[1] and v0 < geometry.box[2] and v1 > geometry.box[3]


def test_trim_polylines_are_true_to_five_micrometres(tmp_path):
    path = shapes.write_step(_drilled_block(), tmp_path / "part.step")
    originals = shapes.faces_of(shapes.read_back(path))
    for face in read_part(path).faces:
        geometry = face.load()
        spans = to_spans(geometry.surface)
        edges = originals[face.number]
        outline = BRepTools.OuterWire_s(edges)
        loops = geometry.loops if len(geometry.loops) == 1 else geometry.loops[:1]
        for loop in loops:
            middle = 0.5 * (loop + np.roll(loop, -1, axis=0))
            points = surface_frames(spans, middle[::5, 0], middle[::5, 1])[:, 0]
            for point in points:
                assert shapes.distance_to(outline, point) < 5e-3
        assert sum(len(loop) for loop in geometry.loops) < 600


def test_periodic_surface_is_unwrapped_true_to_the_kernel(tmp_path):
    count = 9
    angle = 2 * np.pi * np.arange(count) / count
    v = np.linspace(0, 20, 4)
    poles = np.stack(
        [
            np.outer(12 * np.cos(angle), 1 + 0 * v),
            np.outer(5 * np.sin(angle), 1 + 0.02 * v),
            np.outer(np.cos(2 * angle), v / 30) + v,
        ],
        axis=-1,
    )
    knots = [0.0, 0.1, 0.25, 0.4, 0.5, 0.6, 0.8, 1.0]
    surface = shapes.bspline(poles, [knots, [0.0, 1.0]], [[2, 1, 1, 1, 2, 1, 1, 2], [4, 4]], [3, 3], (True, False))
    face = shapes.face_on(surface)
    part = read_part(shapes.write_brep(face, tmp_path / "ring.brep"))
    geometry = part.faces[0].load()
    assert geometry.sheet.period_u == pytest.approx(1.0)
    assert geometry.surface.domain[:2] == pytest.approx((-0.05, 1.05))
    rng = np.random.default_rng(3)
    u, w = rng.uniform(-0.05, 1.05, 40), rng.uniform(0, 1, 40)
    found = surface_frames(to_spans(geometry.surface), u, w)[:, 0]
    expected = np.array([shapes.value(face, a % 1.0, b) for a, b in zip(u, w, strict=True)])
    np.testing.assert_allclose(found, expected, atol=1e-11)
    assert _area(part.faces[0]) == pytest.approx(shapes.integrated_area(surface, knots, [0.0, 1.0]), rel=1e-6)


def test_inches_become_millimetres_and_scale_comes_on_top(tmp_path):
    box = BRepPrimAPI_MakeBox(25.4, 50.8, 76.2).Shape()
    path = shapes.write_step(box, tmp_path / "inch.step", "INCH")
    assert "INCH" in path.read_text().upper()
    assert sorted(_area(f) for f in read_part(path).faces)[-1] == pytest.approx(50.8 * 76.2)
    assert sorted(_area(f) for f in read_part(path, 0.5).faces)[-1] == pytest.approx(25.4 * 38.1)


def test_assembly_placements_and_numbering(tmp_path):
    cylinder = BRepPrimAPI_MakeCylinder(2.0, 5.0).Shape()
    move = gp_Trsf()
    move.SetTranslation(gp_Vec(100, 0, 0))
    turn = gp_Trsf()
    turn.SetRotation(gp_Ax1(gp_Pnt(0, 0, 0), gp_Dir(1, 0, 0)), math.pi / 2)
    whole = shapes.compound(cylinder, cylinder.Moved(TopLoc_Location(move * turn)))
    part = read_part(shapes.write_step(whole, tmp_path / "assembly.step"))
    assert [face.number for face in part.faces] == list(range(6))
    middles = []
    for face in part.faces:
        geometry = face.load()
        nodes = trim_nodes(geometry.loops, np.empty(0), np.empty(0))
        frames = surface_frames(to_spans(geometry.surface), nodes.u, nodes.v)
        patch = nodes.weight * np.linalg.norm(np.cross(frames[:, 1], frames[:, 2]), axis=1)
        middles.append(patch @ frames[:, 0] / patch.sum())
    expected = [(0, 0, 2.5), (0, 0, 5), (0, 0, 0), (100, -2.5, 0), (100, -5, 0), (100, 0, 0)]
    for place in expected:
        assert min(np.linalg.norm(np.array(place) - middle) for middle in middles) < 5e-3


def test_names_and_colours(tmp_path):
    box = BRepPrimAPI_MakeBox(5.0, 7.0, 11.0).Shape()
    document = TDocStd_Document(TCollection_ExtendedString("part"))
    tool = XCAFDoc_DocumentTool.ShapeTool_s(document.Main())
    colours = XCAFDoc_DocumentTool.ColorTool_s(document.Main())
    label = tool.AddShape(box, False)
    blue = Quantity_Color(0.0, 0.0, 1.0, Quantity_TOC_sRGB)
    red = Quantity_Color(1.0, 0.0, 0.0, Quantity_TOC_sRGB)
    colours.SetColor(label, blue, XCAFDoc_ColorSurf)
    faces = shapes.faces_of(box)
    flank = tool.AddSubShape(label, faces[3])
    TDataStd_Name.Set_s(flank, TCollection_ExtendedString("FLANK"))
    colours.SetColor(flank, red, XCAFDoc_ColorSurf)
    writer = STEPCAFControl_Writer()
    Interface_Static.SetIVal_s("write.stepcaf.subshapes.name", 1)
    writer.Transfer(document)
    path = tmp_path / "named.step"
    writer.Write(str(path))
    part = read_part(path)
    named = [face for face in part.faces if face.name]
    assert [face.name for face in named] == ["FLANK"]
    assert named[0].colour == "#ff0000"
    assert {face.colour for face in part.faces if face is not named[0]} == {"#0000ff"}
    assert part.face("FLANK", "test") is part.face("#ff0000", "test") is part.face(named[0].number, "test")
    geometry = named[0].load()
    point = surface_frames(to_spans(geometry.surface), *(np.array([np.mean(geometry.box[k : k + 2])]) for k in (0, 2)))
    assert shapes.distance_to(faces[3], point[0, 0]) < 1e-9
    with pytest.raises(InputError, match=r"5 faces called '#0000ff'"):
        part.face("#0000ff", "test")


def test_a_solid_turned_inside_out_does_not_know_outside(tmp_path):
    box = BRepPrimAPI_MakeBox(5.0, 7.0, 11.0).Shape()
    part = read_part(shapes.write_brep(box.Reversed(), tmp_path / "turned.brep"))
    assert not any(face.outside_known for face in part.faces)
    straight = read_part(shapes.write_brep(box, tmp_path / "straight.brep"))
    assert [f.orientation for f in part.faces] == [-f.orientation for f in straight.faces]


@pytest.mark.parametrize(
    "write,suffix",
    [
        (shapes.write_step, ".step"),
        (shapes.write_iges, ".iges"),
        (shapes.write_brep, ".brep"),
    ],
)
def test_truncated_files_are_refused(write, suffix, tmp_path):
    data = write(_drilled_block(), tmp_path / ("whole" + suffix)).read_bytes()
    for share in (0.02, 0.3, 0.6, 0.9, 0.99):
        path = tmp_path / ("cut" + suffix)
        path.write_bytes(data[: int(share * len(data))])
        with pytest.raises(InputError) as caught:
            read_part(path)
        assert "cut" + suffix in caught.value.where


def test_a_step_file_with_a_hole_in_it_is_refused(tmp_path):
    lines = shapes.write_step(SOLIDS["cylinder"](), tmp_path / "whole.step").read_text().splitlines(keepends=True)
    for word in ("CYLINDRICAL_SURFACE", "EDGE_LOOP", "ADVANCED_FACE", "VERTEX_POINT"):
        at = next(i for i, line in enumerate(lines) if word in line)
        path = tmp_path / "holed.step"
        path.write_text("".join(lines[:at] + lines[at + 1 :]))
        with pytest.raises(InputError):
            read_part(path)


def test_other_bad_files(tmp_path):
    with pytest.raises(InputError, match="no readable file"):
        read_part(tmp_path / "nowhere.step")
    for name, data, found in [
        ("part.stl", b"solid", r"suffix '\.stl'"),
        ("empty.step", b"", "an empty file"),
        ("words.step", b"not a part", "no STEP header"),
        ("words.iges", b"not a part", "terminate section"),
        ("words.brep", b"not a part", "no BREP header"),
    ]:
        path = tmp_path / name
        path.write_bytes(data)
        with pytest.raises(InputError, match=found):
            read_part(path)
    path = shapes.write_brep(SOLIDS["box"](), tmp_path / "box.brep")
    for scale in (0.0, -1.0, math.nan, math.inf):
        with pytest.raises(InputError, match="expected a positive number"):
            read_part(path, scale)
    with pytest.raises(InputError, match="a number from 0 to 5"):
        read_part(path).face(6, "test")
    edge = BRepBuilderAPI_MakeEdge(gp_Pnt(0, 0, 0), gp_Pnt(1, 0, 0)).Edge()
    with pytest.raises(InputError, match="found no faces"):
        read_part(shapes.write_brep(edge, tmp_path / "edge.brep"))


def test_a_pole_that_is_no_number_is_refused(tmp_path):
    path = shapes.write_brep(shapes.face_on(_wavy()), tmp_path / "wavy.brep")
    text = path.read_text()
    assert "30 20 1.03" in text
    path.write_text(text.replace("30 20 1.03", "nan 20 1.03"))
    with pytest.raises(InputError):
        read_part(path).faces[0].load()


def test_reading_prints_nothing(tmp_path, capfd):
    path = shapes.write_step(SOLIDS["box"](), tmp_path / "box.step")
    broken = tmp_path / "broken.step"
    broken.write_text(path.read_text().replace("CARTESIAN_POINT", "CARTESIAN_POINT(((", 3))
    capfd.readouterr()
    read_part(path)
    with pytest.raises(InputError):
        read_part(broken)
    assert capfd.readouterr().out == ""


def test_prism_of_a_curved_profile_is_an_extrusion(tmp_path):
    arc = BRepBuilderAPI_MakeEdge(Geom_Hyperbola(AXIS, 4.0, 2.0), -0.5, 0.9).Edge()
    face = BRepPrimAPI_MakePrism(arc, gp_Vec(0, 0, 6)).Shape()
    part = read_part(shapes.write_step(face, tmp_path / "prism.step"))
    assert part.faces[0].kind in ("extrusion", "bspline")
    assert _area(part.faces[0]) == pytest.approx(shapes.kernel_area(face), rel=1e-5)
