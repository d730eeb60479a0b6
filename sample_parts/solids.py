"""Solids with named faces through Open CASCADE: sewing and Booleans that keep track of the names."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import pi

import numpy as np
import numpy.typing as npt
from OCP.BRep import BRep_Builder, BRep_Tool
from OCP.BRepAlgoAPI import BRepAlgoAPI_BooleanOperation, BRepAlgoAPI_Common, BRepAlgoAPI_Fuse
from OCP.BRepBuilderAPI import (
    BRepBuilderAPI_MakeEdge,
    BRepBuilderAPI_MakeFace,
    BRepBuilderAPI_MakePolygon,
    BRepBuilderAPI_MakeSolid,
    BRepBuilderAPI_MakeWire,
    BRepBuilderAPI_Sewing,
    BRepBuilderAPI_Transform,
)
from OCP.BRepCheck import BRepCheck_Analyzer
from OCP.BRepGProp import BRepGProp
from OCP.BRepLib import BRepLib
from OCP.BRepPrimAPI import BRepPrimAPI_MakeRevol
from OCP.BRepTools import BRepTools
from OCP.collections import (
    Array1_double,
    Array1_int,
    Array2_gp_Pnt,
    List_TopoDS_Shape,
)
from OCP.Geom import Geom_BSplineSurface, Geom_Surface
from OCP.gp import gp_Ax1, gp_Dir, gp_Pnt, gp_Trsf
from OCP.GProp import GProp_GProps
from OCP.ShapeFix import ShapeFix_Edge, ShapeFix_Face
from OCP.TopAbs import TopAbs_EDGE, TopAbs_FACE, TopAbs_SOLID, TopAbs_VERTEX
from OCP.TopExp import TopExp_Explorer
from OCP.TopoDS import TopoDS, TopoDS_Edge, TopoDS_Face, TopoDS_Shape, TopoDS_Wire

from conflank_cli.geometry.surface import BSplineSurface

Array = npt.NDArray[np.float64]

SEWING_TOLERANCE = 1e-5
"""Faces share their boundary curves exactly; the sewer only needs room for rounding, in mm."""
FACE_TOLERANCE = 1e-7
"""Open CASCADE's own confusion distance, in mm."""
WHEEL_AXIS = gp_Ax1(gp_Pnt(0.0, 0.0, 0.0), gp_Dir(0.0, 0.0, 1.0))


@dataclass(frozen=True, slots=True)
class NamedSolid:
    """A solid and the names of its faces, in the order of TopExp_Explorer.

    shape: the solid; names: one name a face, "" where it has none.
    """

    shape: TopoDS_Shape
    names: tuple[str, ...]

    def named(self) -> list[tuple[str, TopoDS_Face]]:
        """All faces with their names, in order."""
        return list(zip(self.names, faces_of(self.shape), strict=True))

    def face(self, name: str) -> TopoDS_Face:
        """The only face of that name."""
        (match,) = [face for label, face in self.named() if label == name]
        return match


def faces_of(shape: TopoDS_Shape) -> list[TopoDS_Face]:
    """Faces in the order in which `conflank inspect` numbers them."""
    return [TopoDS.Face(sub) for sub in _explore(shape, TopAbs_FACE)]


def _explore(shape: TopoDS_Shape, kind: object) -> list[TopoDS_Shape]:
    explorer, found = TopExp_Explorer(shape, kind), []
    while explorer.More():
        found.append(explorer.Current())
        explorer.Next()
    return found


def _label(shape: TopoDS_Shape, known: Sequence[tuple[str, TopoDS_Shape]]) -> NamedSolid:
    """Attach names to the faces of a shape; `known` pairs names with faces of that shape."""
    names = [next((name for name, other in known if face.IsSame(other)), "") for face in faces_of(shape)]
    return NamedSolid(shape, tuple(names))


def to_occ(surface: BSplineSurface) -> Geom_BSplineSurface:
    """A polynomial B-spline surface as Open CASCADE's."""
    poles = Array2_gp_Pnt(1, surface.poles.shape[0], 1, surface.poles.shape[1])
    for (i, j), _ in np.ndenumerate(surface.poles[..., 0]):
        poles.SetValue(i + 1, j + 1, gp_Pnt(*(float(value) for value in surface.poles[i, j])))
    knots = []
    for vector in (surface.knots_u, surface.knots_v):
        values, counts = np.unique(vector, return_counts=True)
        real, whole = Array1_double(1, len(values)), Array1_int(1, len(values))
        for k, (value, count) in enumerate(zip(values, counts, strict=True), start=1):
            real.SetValue(k, float(value))
            whole.SetValue(k, int(count))
        knots.append((real, whole))
    (ku, mu), (kv, mv) = knots
    return Geom_BSplineSurface(poles, ku, kv, mu, mv, surface.degree_u, surface.degree_v)


def _oriented_solid(shell: TopoDS_Shape) -> TopoDS_Shape:
    solid = BRepBuilderAPI_MakeSolid(TopoDS.Shell(shell)).Solid()
    if not BRepLib.OrientClosedSolid_s(solid):
        raise RuntimeError("The faces do not close a volume; check that neighbours share their boundary rows.")
    return solid


def whole_face(surface: BSplineSurface) -> TopoDS_Face:
    """The face with a surface's natural boundary."""
    return BRepBuilderAPI_MakeFace(to_occ(surface), FACE_TOLERANCE).Face()


def border_loop(surfaces: Sequence[BSplineSurface], end: bool) -> TopoDS_Wire:
    """The closed wire of the curves at the first (or, with `end`, the last) v of surfaces in a ring."""
    edges = List_TopoDS_Shape()
    for surface in surfaces:
        edges.Append(BRepBuilderAPI_MakeEdge(to_occ(surface).VIso(surface.domain[3 if end else 2])).Edge())
    wire = BRepBuilderAPI_MakeWire()
    wire.Add(edges)
    return wire.Wire()


def trimmed_face(carrier: Geom_Surface, loops: Sequence[TopoDS_Wire]) -> TopoDS_Face:
    """The face cut out of a surface by closed wires that lie on it, outer loop and holes in any order or direction."""
    builder = BRepBuilderAPI_MakeFace(carrier, FACE_TOLERANCE)
    face = TopoDS.Face(builder.Face().EmptyCopied())
    for loop in loops:
        for edge in _explore(loop, TopAbs_EDGE):
            ShapeFix_Edge().FixAddPCurve(TopoDS.Edge(edge), face, False)
        BRep_Builder().Add(face, loop)
    fix = ShapeFix_Face(face)
    fix.FixOrientation()
    BRepLib.SameParameter_s(fix.Face(), FACE_TOLERANCE, True)
    return fix.Face()


def outer_loop(face: TopoDS_Face) -> TopoDS_Wire:
    """The wire around a face."""
    return BRepTools.OuterWire_s(face)


def sewn_solid(faces: Sequence[tuple[str, TopoDS_Face]]) -> NamedSolid:
    """The solid enclosed by faces that share their boundary curves."""
    sewing = BRepBuilderAPI_Sewing(SEWING_TOLERANCE)
    for _, face in faces:
        sewing.Add(face)
    sewing.Perform()
    return _label(_oriented_solid(sewing.SewedShape()), [(name, sewing.Modified(face)) for name, face in faces])


def plane_face(corners: Sequence[tuple[float, float]], angle: float) -> TopoDS_Face:
    """The polygon through points (radius, z), in the half plane at `angle` radians about Z."""
    polygon = BRepBuilderAPI_MakePolygon()
    for radius, z in corners:
        polygon.Add(gp_Pnt(radius, 0.0, z))
    polygon.Close()
    return TopoDS.Face(rotated_shape(BRepBuilderAPI_MakeFace(polygon.Wire(), True).Face(), angle))


def revolved_solid(
    profile: Sequence[tuple[str, TopoDS_Edge]], start_angle: float = 0.0, sweep: float = 2.0 * pi
) -> NamedSolid:
    """The solid of revolution about Z of a closed profile of named edges in the half plane y = 0, x > 0.

    profile: (name of the face it sweeps, edge) in order around the profile; start_angle, sweep in radians.
    """
    wire = BRepBuilderAPI_MakeWire()
    edges = []
    for name, edge in profile:
        wire.Add(TopoDS.Edge(rotated_shape(edge, start_angle)))
        edges.append((name, wire.Edge()))
    plane = BRepBuilderAPI_MakeFace(wire.Wire(), True).Face()
    maker = (
        BRepPrimAPI_MakeRevol(plane, WHEEL_AXIS, sweep)
        if sweep < 2.0 * pi
        else BRepPrimAPI_MakeRevol(plane, WHEEL_AXIS)
    )
    shape = maker.Shape()
    known = [(name, face) for name, edge in edges for face in maker.Generated(edge)]
    # The sweep does not report the flat rings of a full turn; no two flat rings of a profile share a height.
    for name, edge in edges:
        heights = _heights(edge)
        if heights[0] == heights[-1] and not list(maker.Generated(edge)):
            known += [(name, face) for face in faces_of(shape) if _heights(face)[0] == _heights(face)[-1] == heights[0]]
    BRepLib.OrientClosedSolid_s(TopoDS.Solid(shape))
    return _label(shape, known)


def _heights(shape: TopoDS_Shape) -> list[float]:
    """Heights z of a shape's vertices, ascending, to the tolerance of a vertex."""
    return sorted(round(BRep_Tool.Pnt_s(TopoDS.Vertex(vertex)).Z(), 6) for vertex in _explore(shape, TopAbs_VERTEX))


def _turned(shape: TopoDS_Shape, angle: float) -> BRepBuilderAPI_Transform:
    turn = gp_Trsf()
    turn.SetRotation(WHEEL_AXIS, angle)
    return BRepBuilderAPI_Transform(shape, turn, True)


def rotated_shape(shape: TopoDS_Shape, angle: float) -> TopoDS_Shape:
    """A copy of a shape turned about Z by `angle` radians, its geometry turned with it."""
    return _turned(shape, angle).Shape()


def rotated(part: NamedSolid, angle: float, suffix: str) -> NamedSolid:
    """A copy turned about Z by `angle` radians, its names with a suffix."""
    copy = _turned(part.shape, angle)
    known = [(name + suffix, copy.ModifiedShape(face)) for name, face in part.named() if name]
    return _label(copy.Shape(), known)


def _single_solid(shape: TopoDS_Shape, what: str) -> TopoDS_Shape:
    solids = _explore(shape, TopAbs_SOLID)
    if len(solids) != 1:
        raise RuntimeError(f"{what} gave {len(solids)} solids instead of one; check that the operands overlap.")
    return solids[0]


def _boolean(
    operation: Callable[[], BRepAlgoAPI_BooleanOperation], body: NamedSolid, tools: Sequence[NamedSolid]
) -> NamedSolid:
    arguments, others = List_TopoDS_Shape(), List_TopoDS_Shape()
    arguments.Append(body.shape)
    for tool in tools:
        others.Append(tool.shape)
    maker = operation()
    maker.SetArguments(arguments)
    maker.SetTools(others)
    # One thread: the order of the faces, and so the file, must not depend on scheduling.
    maker.SetRunParallel(False)
    maker.Build()
    if not maker.IsDone():
        raise RuntimeError("The Boolean operation failed; check that the operands are valid solids.")
    known = []
    for part in (body, *tools):
        for name, face in part.named():
            if not name or maker.IsDeleted(face):
                continue
            images = list(maker.Modified(face)) or [face]
            known += [(name, image) for image in images]
    return _label(_single_solid(maker.Shape(), type(maker).__name__), known)


def common(body: NamedSolid, tool: NamedSolid) -> NamedSolid:
    """What two solids share."""
    return _boolean(BRepAlgoAPI_Common, body, [tool])


def fuse(body: NamedSolid, tools: Sequence[NamedSolid]) -> NamedSolid:
    """One solid out of several that overlap."""
    return _boolean(BRepAlgoAPI_Fuse, body, tools)


def is_valid(shape: TopoDS_Shape) -> bool:
    """Whether Open CASCADE's checks of geometry and topology find no fault."""
    return bool(BRepCheck_Analyzer(shape).IsValid())


def volume(shape: TopoDS_Shape) -> float:
    """Enclosed volume in cubic millimetres, positive where the faces look outwards."""
    properties = GProp_GProps()
    BRepGProp.VolumeProperties_s(shape, properties)
    return float(properties.Mass())


def area(face: TopoDS_Shape) -> float:
    """Area in square millimetres."""
    properties = GProp_GProps()
    BRepGProp.SurfaceProperties_s(face, properties)
    return float(properties.Mass())


def straight_edge(first: tuple[float, float], last: tuple[float, float]) -> TopoDS_Edge:
    """A straight edge between two points (radius, z) of the half plane y = 0."""
    return BRepBuilderAPI_MakePolygon(gp_Pnt(first[0], 0.0, first[1]), gp_Pnt(last[0], 0.0, last[1])).Edge()
