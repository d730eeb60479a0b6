"""Shapes made with the CAD kernel, files of them, and what the kernel itself says about them."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from OCP.BRep import BRep_Builder, BRep_Tool
from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeFace, BRepBuilderAPI_MakeVertex
from OCP.BRepClass3d import BRepClass3d_SolidClassifier
from OCP.BRepExtrema import BRepExtrema_DistShapeShape
from OCP.BRepGProp import BRepGProp
from OCP.BRepTools import BRepTools
from OCP.collections import Array1_double, Array1_int, Array2_gp_Pnt
from OCP.Geom import Geom_BSplineSurface
from OCP.gp import gp_Pnt, gp_Vec
from OCP.GProp import GProp_GProps
from OCP.IGESControl import IGESControl_Writer
from OCP.Interface import Interface_Static
from OCP.Message import Message
from OCP.STEPControl import STEPControl_AsIs, STEPControl_Reader, STEPControl_Writer
from OCP.TopAbs import TopAbs_FACE, TopAbs_IN, TopAbs_OUT
from OCP.TopExp import TopExp_Explorer
from OCP.TopoDS import TopoDS, TopoDS_Compound, TopoDS_Shape

Message.DefaultMessenger_s().ChangePrinters().Clear()


def write_step(shape: Any, path: Path, unit: str = "MM") -> Path:
    writer = STEPControl_Writer()
    Interface_Static.SetCVal_s("write.step.unit", unit)
    writer.Transfer(shape, STEPControl_AsIs)
    writer.Write(str(path))
    Interface_Static.SetCVal_s("write.step.unit", "MM")
    return path


def write_iges(shape: Any, path: Path, solids: bool = False) -> Path:
    writer = IGESControl_Writer("MM", int(solids))
    writer.AddShape(shape)
    writer.ComputeModel()
    writer.Write(str(path))
    return path


def write_brep(shape: Any, path: Path) -> Path:
    BRepTools.Write_s(shape, str(path))
    return path


def read_back(path: Path) -> Any:
    """The shape in a STEP or BREP file, by the kernel's plain reader."""
    if path.suffix == ".brep":
        shape = TopoDS_Shape()
        BRepTools.Read_s(shape, str(path), BRep_Builder())
        return shape
    reader = STEPControl_Reader()
    reader.ReadFile(str(path))
    reader.TransferRoots()
    return reader.OneShape()


def compound(*shapes: Any) -> Any:
    result = TopoDS_Compound()
    builder = BRep_Builder()
    builder.MakeCompound(result)
    for shape in shapes:
        builder.Add(result, shape)
    return result


def faces_of(shape: Any) -> list[Any]:
    faces = []
    explorer = TopExp_Explorer(shape, TopAbs_FACE)
    while explorer.More():
        faces.append(TopoDS.Face(explorer.Current()))
        explorer.Next()
    return faces


def kernel_area(shape: Any) -> float:
    properties = GProp_GProps()
    BRepGProp.SurfaceProperties_s(shape, properties)
    return float(properties.Mass())


def integrated_area(surface: Any, stops_u: list[float], stops_v: list[float]) -> float:
    """By Gauss' rule from the kernel's tangents; its own area of a B-spline face is good to a thousandth only."""
    nodes, weights = np.polynomial.legendre.leggauss(12)
    area = 0.0
    point, along_u, along_v = gp_Pnt(), gp_Vec(), gp_Vec()
    for u0, u1 in pairwise(stops_u):
        for v0, v1 in pairwise(stops_v):
            for x, wx in zip(nodes, weights, strict=True):
                for y, wy in zip(nodes, weights, strict=True):
                    u, v = u0 + 0.5 * (x + 1) * (u1 - u0), v0 + 0.5 * (y + 1) * (v1 - v0)
                    surface.D1(u, v, point, along_u, along_v)
                    area += 0.25 * (u1 - u0) * (v1 - v0) * wx * wy * along_u.Crossed(along_v).Magnitude()
    return area


def edge_length(shape: Any) -> float:
    properties = GProp_GProps()
    BRepGProp.LinearProperties_s(shape, properties)
    return float(properties.Mass())


def kernel_volume(shape: Any) -> float:
    properties = GProp_GProps()
    BRepGProp.VolumeProperties_s(shape, properties)
    return float(properties.Mass())


def distance_to(shape: Any, point: np.ndarray) -> float:
    vertex = BRepBuilderAPI_MakeVertex(gp_Pnt(*map(float, point))).Vertex()
    return float(BRepExtrema_DistShapeShape(vertex, shape).Value())


def is_inside(solid: Any, point: np.ndarray) -> bool:
    state = BRepClass3d_SolidClassifier(solid, gp_Pnt(*map(float, point)), 1.0e-6).State()
    assert state in (TopAbs_IN, TopAbs_OUT)
    return bool(state == TopAbs_IN)


def bspline(
    poles: np.ndarray,
    knots: list[list[float]],
    repeats: list[list[int]],
    degrees: list[int],
    periodic: tuple[bool, bool] = (False, False),
) -> Geom_BSplineSurface:
    table = Array2_gp_Pnt(1, poles.shape[0], 1, poles.shape[1])
    for i, row in enumerate(poles):
        for j, pole in enumerate(row):
            table.SetValue(i + 1, j + 1, gp_Pnt(*map(float, pole)))
    arrays = []
    for values in knots:
        array = Array1_double(1, len(values))
        for i, x in enumerate(values):
            array.SetValue(i + 1, x)
        arrays.append(array)
    for counts in repeats:
        whole = Array1_int(1, len(counts))
        for i, n in enumerate(counts):
            whole.SetValue(i + 1, n)
        arrays.append(whole)
    return Geom_BSplineSurface(table, *arrays, *degrees, *periodic)


def face_on(surface: Any) -> Any:
    return BRepBuilderAPI_MakeFace(surface, 1.0e-6).Face()


def value(face: Any, u: float, v: float) -> np.ndarray:
    point = BRep_Tool.Surface_s(face).Value(u, v)
    return np.array([point.X(), point.Y(), point.Z()])
