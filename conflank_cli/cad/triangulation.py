"""Triangles of faces as the CAD kernel makes them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from conflank_cli.cad.part import Piece, turned
from conflank_cli.errors import InputError

# Of what nothing may touch.
DEFLECTION_MM = 0.02
# Turn of the normal within a triangle: keeps triangles on thin tubes and edge radii from being long needles.
ANGLE_RAD = 0.2


def triangulate(shape: Any, scale: float, file: str, numbers: Sequence[int], deflection: float) -> list[Piece]:
    """Triangles of faces of a shape by their numbers, as `Part.triangulate` promises them.

    Raises
    ------
    InputError: a face that the kernel makes no triangles of.
    """
    from OCP.BRep import BRep_Builder, BRep_Tool
    from OCP.BRepMesh import BRepMesh_IncrementalMesh
    from OCP.BRepTools import BRepTools
    from OCP.TopAbs import TopAbs_FACE, TopAbs_REVERSED
    from OCP.TopExp import TopExp_Explorer
    from OCP.TopLoc import TopLoc_Location
    from OCP.TopoDS import TopoDS, TopoDS_Compound

    faces = []
    explorer = TopExp_Explorer(shape, TopAbs_FACE)
    while explorer.More():
        faces.append(TopoDS.Face(explorer.Current()))
        explorer.Next()
    compound = TopoDS_Compound()
    builder = BRep_Builder()
    builder.MakeCompound(compound)
    for number in numbers:
        builder.Add(compound, faces[number])
    # A triangulation that came with the file has its own accuracy.
    BRepTools.Clean_s(compound)
    BRepMesh_IncrementalMesh(compound, deflection / scale, False, ANGLE_RAD, True)
    pieces = []
    for number in numbers:
        location = TopLoc_Location()
        mesh = BRep_Tool.Triangulation_s(faces[number], location)
        if mesh is None:
            raise InputError(
                f"{file}: face {number}",
                "a face that cannot be triangulated",
                "a face with an area and closed edges",
                "Repair it in CAD, or list the faces to check without it ([part] check_faces).",
            )
        nodes = [mesh.Node(i) for i in range(1, mesh.NbNodes() + 1)]
        if not location.IsIdentity():
            nodes = [node.Transformed(location.Transformation()) for node in nodes]
        vertices = np.array([node.Coord() for node in nodes])
        corners = np.array([mesh.Triangle(i).Get() for i in range(1, mesh.NbTriangles() + 1)], dtype=np.int32)
        orientation = -1 if faces[number].Orientation() == TopAbs_REVERSED else 1
        pieces.append((vertices * scale, turned(corners - np.int32(1), orientation)))
    BRepTools.Clean_s(compound)
    return pieces
