"""Triangles of faces: what nothing may touch."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from conflank_cli.cad.loops import bounds, inside
from conflank_cli.cad.part import Part, PartFace, Triangles, turned
from conflank_cli.cad.quadrature import surface_frames
from conflank_cli.geometry.face import CheckMesh
from conflank_cli.geometry.surface import to_spans

Array = npt.NDArray[np.float64]

# Grid lines a direction on a face that the CAD kernel does not mesh.
LINES_AT_LEAST, LINES_AT_MOST = 5, 200


def empty_mesh() -> CheckMesh:
    """Nothing to check."""
    return CheckMesh(np.empty((0, 3)), np.empty((0, 3), dtype=np.int32), np.empty(0, dtype=np.int32))


def mesh_faces(part: Part, faces: Sequence[PartFace], deflection: float) -> CheckMesh:
    """Triangulate faces within `deflection` mm; triangles counter-clockwise seen from outside."""
    if not faces:
        return empty_mesh()
    if part.triangulate is None:
        pieces = [_mesh_grid(face, deflection) for face in faces]
    else:
        pieces = part.triangulate([face.number for face in faces], deflection)
    offsets = np.cumsum([0] + [len(vertices) for vertices, _ in pieces[:-1]])
    return CheckMesh(
        np.concatenate([vertices for vertices, _ in pieces]),
        np.concatenate([triangles + np.int32(offset) for (_, triangles), offset in zip(pieces, offsets, strict=True)]),
        np.concatenate(
            [
                np.full(len(triangles), face.number, dtype=np.int32)
                for (_, triangles), face in zip(pieces, faces, strict=True)
            ]
        ),
    )


def _mesh_grid(face: PartFace, deflection: float) -> tuple[Array, Triangles]:
    """Triangles over a grid in the parameter plane and the points of the trim loops.

    Does not promise the deflection where trim loops are coarser than it.
    """
    from scipy.spatial import Delaunay

    geometry = face.load()
    spans = to_spans(geometry.surface)
    u0, u1, v0, v1 = bounds(geometry.loops)
    probe_u, probe_v = (axis.ravel() for axis in np.meshgrid(np.linspace(u0, u1, 33), np.linspace(v0, v1, 33)))
    frames = surface_frames(spans, probe_u, probe_v)
    # A chord of parameter length h leaves |S''| h^2 / 8; diagonals of a cell see both directions.
    bend_u, bend_v = (float(np.linalg.norm(frames[:, k], axis=1).max()) for k in (3, 5))
    counts = [
        int(np.clip(np.ceil(span * np.sqrt(bend / (4.0 * deflection))) + 1, LINES_AT_LEAST, LINES_AT_MOST))
        for span, bend in ((u1 - u0, bend_u), (v1 - v0, bend_v))
    ]
    scale = np.array([u1 - u0, v1 - v0])
    grid = np.stack(
        np.meshgrid(np.linspace(0.0, 1.0, counts[0]), np.linspace(0.0, 1.0, counts[1]), indexing="ij"), axis=-1
    ).reshape(-1, 2)
    loops = [(loop - (u0, v0)) / scale for loop in geometry.loops]
    border = [_dense(loop, 1.0 / np.array(counts)) for loop in loops]
    # Grid points on the border itself are among the border points.
    inner = grid[inside(loops, grid)]
    corners = np.concatenate(border)
    gap = 0.25 / max(counts)
    distance = np.array([np.min(np.linalg.norm(corners - point, axis=1)) for point in inner])
    points = np.concatenate([corners, inner[distance > gap]] if len(inner) else [corners])
    triangles = Delaunay(points).simplices.astype(np.int32)
    triangles = triangles[inside(loops, points[triangles].mean(axis=1))]
    a, b, c = (points[triangles[:, k]] for k in range(3))
    double_area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    triangles = triangles[np.abs(double_area) > 1.0e-12]
    backward = double_area[np.abs(double_area) > 1.0e-12] < 0.0
    triangles[backward] = triangles[backward][:, ::-1]
    parameters = points * scale + (u0, v0)
    vertices = surface_frames(spans, parameters[:, 0], parameters[:, 1])[:, 0]
    return np.ascontiguousarray(vertices), turned(triangles, face.orientation)


def _dense(loop: Array, step: Array) -> Array:
    """A loop with points added so that no stretch is longer than a grid cell."""
    pieces = []
    for a, b in zip(loop, np.roll(loop, -1, axis=0), strict=True):
        count = max(1, int(np.ceil(np.max(np.abs(b - a) / step))))
        pieces.append(a + (b - a) * (np.arange(count) / count)[:, None])
    return np.concatenate(pieces)
