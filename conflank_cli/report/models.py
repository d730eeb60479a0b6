"""Surfaces for other programs: ruled surfaces, envelopes and the gap as meshes, the first two as STEP too."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, sin, tan
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.interpolate import make_interp_spline

from conflank_cli.errors import NumericalError
from conflank_cli.geometry.face import DesignFace
from conflank_cli.motion import DEGREE, Motion
from conflank_cli.report.colours import cut_colour, gap_colours
from conflank_cli.report.gap_map import GapMap, face_grid
from conflank_cli.tool import Tool

Array = npt.NDArray[np.float64]
Bytes = npt.NDArray[np.uint8]

POSES, HEIGHTS = 200, 40
"""Points of a surface along its sweep and along the flute."""

ALONG_FLUTE = 3
"""Along the flute every so-many-th point is one of an envelope's B-spline surface: it is smooth there."""

GRID = (40, 40)
"""Points of a face to which the side of an envelope is judged."""


@dataclass(frozen=True, slots=True)
class Sheet:
    """A surface on a grid.

    Attributes
    ----------
    name: what it is.
    points: (U, V, 3) mm.
    colours: (U, V, 3) bytes.
    keep: (U, V), which points there are.
    """

    name: str
    points: Array
    colours: Bytes
    keep: npt.NDArray[np.bool_]


def _sheet(name: str, points: Array, colour: str) -> Sheet:
    channels = np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)], dtype=np.uint8)
    shape = points.shape[:2]
    return Sheet(name, points, np.broadcast_to(channels, (*shape, 3)).copy(), np.ones(shape, dtype=np.bool_))


def ruled_points(motion: Motion) -> Array:
    """The ruled surface that the axis sweeps between its ends p and q, (POSES, 2, 3)."""
    return np.stack(motion.ends(np.linspace(0.0, 1.0, POSES)), axis=1)


def ruled_sheet(name: str, motion: Motion, index: int) -> Sheet:
    """The ruled surface of a sweep, in its colour."""
    return _sheet(name, ruled_points(motion), cut_colour(index))


def envelope_points(motion: Motion, tool: Tool, face: DesignFace) -> Array:
    """Where the moving cone touches its envelope on the side of a face, (POSES, HEIGHTS, 3); nan where it does not.

    A sphere of the cone with centre c and radius d touches the envelope at x = c - d n with ⟨n, axis⟩ = sin α and
    ⟨n, ċ⟩ = 0: one direction on either side of the motion. Heights run over the spheres whose contact is on the cone.
    """
    t = np.linspace(0.0, 1.0, POSES)
    p, q = motion.ends(t)
    dp, dq = motion.ends(t, 1)
    axis = (q - p) / np.linalg.norm(q - p, axis=1, keepdims=True)
    heights = np.linspace(*tool.centre_range, HEIGHTS)
    share = (heights / tool.length)[None, :, None]
    centres = p[:, None] + heights[None, :, None] * axis[:, None]
    speeds = (1.0 - share) * dp[:, None] + share * dq[:, None]
    along = np.einsum("tkx,tx->tk", speeds, axis)
    across = speeds - along[..., None] * axis[:, None]
    size = np.linalg.norm(across, axis=2)
    alpha = tool.half_angle
    with np.errstate(divide="ignore", invalid="ignore"):
        forward = across / size[..., None]
        share_forward = -tan(alpha) * along / size
        share_beside = np.sqrt(1.0 - share_forward**2)
    beside = np.cross(axis[:, None], forward)
    radii = tool.sphere_radius(heights)[None, :, None]

    def side(sign: float) -> Array:
        direction = share_forward[..., None] * forward + sign * share_beside[..., None] * beside
        normal = sin(alpha) * axis[:, None] + cos(alpha) * direction
        return np.asarray(centres - radii * normal)

    return min((side(sign) for sign in (1.0, -1.0)), key=lambda points: _distance(points, face))


def _distance(points: Array, face: DesignFace) -> float:
    """Median distance of points to a face's grid, mm: which side of an envelope is the face's."""
    from scipy.spatial import cKDTree

    grid = face_grid(face, GRID)
    known = points[np.isfinite(points).all(axis=2)]
    return float(np.median(cKDTree(grid.points[grid.about]).query(known)[0])) if len(known) else np.inf


def envelope_sheet(name: str, motion: Motion, tool: Tool, face: DesignFace, index: int) -> Sheet:
    """The envelope of a sweep on the side of its face, in its colour."""
    points = envelope_points(motion, tool, face)
    known = np.asarray(np.isfinite(points).all(axis=2))
    plain = _sheet(name, np.where(known[..., None], points, 0.0), cut_colour(index))
    return Sheet(plain.name, plain.points, plain.colours, known)


def gap_sheet(shown: GapMap, over: float, under: float) -> Sheet:
    """A face with the gap in colours, limits (mm) as everywhere."""
    share = (shown.gap + over) / (over + under)
    colours = np.round(255.0 * np.asarray(gap_colours()(share))[..., :3]).astype(np.uint8)
    # Triangles are counter-clockwise seen from the cutter's side.
    way = slice(None, None, shown.face.sense)
    name = f"face {shown.face.number} {shown.face.name}".strip()
    return Sheet(name, shown.points[way], colours[way], shown.inside[way])


def encoded_meshes(sheets: Sequence[Sheet], kind: str) -> bytes:
    """Sheets as "stl" or "ply" (one mesh), or "glb" (one object each, by name). Equal sheets give equal bytes."""
    import trimesh

    meshes = [trimesh.Trimesh(*_triangles(sheet), process=False) for sheet in sheets]
    for mesh, sheet in zip(meshes, sheets, strict=True):
        opaque = np.full((*sheet.keep.shape, 1), 255, dtype=np.uint8)
        mesh.visual.vertex_colors = np.concatenate([sheet.colours, opaque], axis=2)[sheet.keep]
    if kind == "glb":
        scene = trimesh.Scene()
        for mesh, sheet in zip(meshes, sheets, strict=True):
            scene.add_geometry(mesh, node_name=sheet.name, geom_name=sheet.name)
        return bytes(scene.export(file_type="glb"))
    # A colour that the format has no place for is left behind.
    return bytes(trimesh.util.concatenate(meshes).export(file_type=kind))


def _triangles(sheet: Sheet) -> tuple[Array, npt.NDArray[np.int64]]:
    """Vertices (N, 3) and triangles (M, 3) of the cells all of whose corners there are."""
    number = np.full(sheet.keep.shape, -1, dtype=np.int64)
    number[sheet.keep] = np.arange(int(sheet.keep.sum()))
    a, b, c, d = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
    whole = (a >= 0) & (b >= 0) & (c >= 0) & (d >= 0)
    corners = [each[whole] for each in (a, b, c, d)]
    halves = [np.stack([corners[0], corners[k], corners[k + 1]], axis=1) for k in (1, 2)]
    return sheet.points[sheet.keep], np.concatenate(halves)


# --- STEP -----------------------------------------------------------------------------------------------------------


def encoded_step(faces: Sequence[tuple[str, Any]]) -> bytes:
    """Named faces of the CAD kernel as a STEP file. Equal faces give equal bytes."""
    from OCP.Interface import Interface_Static
    from OCP.Message import Message
    from OCP.STEPControl import STEPControl_AsIs, STEPControl_Writer

    Message.DefaultMessenger_s().ChangePrinters().Clear()
    writer = STEPControl_Writer()
    Interface_Static.SetCVal_s("write.step.unit", "MM")
    for _, face in faces:
        writer.Transfer(face, STEPControl_AsIs)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "surfaces.step"
        writer.Write(str(path))
        text = path.read_text("utf-8")
    # The kernel writes the time of day, and counts the products of a process: both would make equal inputs differ.
    text = re.sub(r"'\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d'", "'1980-01-01T00:00:00'", text)
    names = (name for name, _ in faces)
    return re.sub(r"PRODUCT\(\s*'[^']*',\s*'[^']*'", lambda _: "PRODUCT('{0}','{0}'".format(next(names)), text).encode()


def ruled_face(motion: Motion) -> Any:
    """The ruled surface of a motion as a face of the CAD kernel: exactly, of degree 3 by 1."""
    from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeFace

    poles = np.stack([motion.p, motion.q], axis=1)
    surface = _surface(poles, [motion.knots, np.array([0.0, 0.0, 1.0, 1.0])], (DEGREE, 1))
    return BRepBuilderAPI_MakeFace(surface, 1e-6).Face()


def envelope_face(points: Array) -> Any:
    """A B-spline surface through the points of an envelope as a face of the CAD kernel.

    Raises
    ------
    NumericalError: there are poses at which the cutter does not touch its envelope.
    """
    from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeFace

    if not np.isfinite(points).all():
        raise NumericalError(
            "envelope", "a motion that runs along its own axis somewhere", "one across it", "Export a mesh instead."
        )
    through = points[:, ::ALONG_FLUTE]
    splines = []
    poles = through
    for axis in (0, 1):
        # Interpolation along one direction, then of its control points along the other.
        spline = make_interp_spline(np.linspace(0.0, 1.0, poles.shape[axis]), poles, k=DEGREE, axis=axis)
        poles = np.moveaxis(spline.c, 0, axis)
        splines.append(spline)
    return BRepBuilderAPI_MakeFace(_surface(poles, [spline.t for spline in splines], (DEGREE, DEGREE)), 1e-6).Face()


def _surface(poles: Array, knots: Sequence[Array], degrees: tuple[int, int]) -> Any:
    """A B-spline surface of the CAD kernel."""
    from OCP.Geom import Geom_BSplineSurface

    each = [np.unique(values, return_counts=True) for values in knots]
    tables = [_reals(values) for values, _ in each] + [_integers(counts) for _, counts in each]
    return Geom_BSplineSurface(_points(poles), *tables, *degrees)


def _points(points: Array) -> Any:
    from OCP.collections import Array2_gp_Pnt
    from OCP.gp import gp_Pnt

    table = Array2_gp_Pnt(1, points.shape[0], 1, points.shape[1])
    for i, j in np.ndindex(points.shape[:2]):
        table.SetValue(i + 1, j + 1, gp_Pnt(*points[i, j].tolist()))
    return table


def _reals(values: Sequence[float] | Array) -> Any:
    from OCP.collections import Array1_double

    table = Array1_double(1, len(values))
    for k, value in enumerate(values):
        table.SetValue(k + 1, float(value))
    return table


def _integers(values: Sequence[int] | npt.NDArray[np.int64]) -> Any:
    from OCP.collections import Array1_int

    table = Array1_int(1, len(values))
    for k, value in enumerate(values):
        table.SetValue(k + 1, int(value))
    return table
