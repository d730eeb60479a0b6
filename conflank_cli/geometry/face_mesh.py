"""Triangles of trimmed design faces, and how far a curved face may lie off triangles that came from elsewhere."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
from scipy.spatial import Delaunay

from conflank_cli.geometry.face import CheckMesh, DesignFace
from conflank_cli.geometry.workface import WorkFace, on_face

Array = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

# Grid lines in either direction: enough to see how a face bends, and not more than is worth the time.
PROBES, LINES_AT_LEAST, LINES_AT_MOST = 65, 9, 500
# Edges of triangles are shorter than this, in distances of grid lines.
LONGEST = 3.0
# Vertices of a mesh nearer than this are one, mm.
WELD = 1e-6
# Triangles of a face that meet at a smaller cosine (at more than 45 degrees) meet at an edge, not along a curved face.
SMOOTH_EDGE = 0.7


def face_mesh(face: DesignFace, deflection: float) -> tuple[CheckMesh, Array]:
    """Triangles of a trimmed face, about `deflection` mm off it at most, and how far each is off, (M,) mm.

    Grid lines are as dense as the face bends, and the trim's border is sampled as densely; the triangles are Delaunay's
    in the parameter plane, where it is drawn so that lines are evenly spaced.
    """
    work = WorkFace.of(face, 0.0)
    corners = np.concatenate(face.loops)
    low, high = corners.min(axis=0), corners.max(axis=0)
    lines = [_lines(work, low, high, axis, deflection) for axis in (0, 1)]
    # In units of grid lines, where cells are squares.
    count = [len(line) - 1 for line in lines]

    def even(uv: Array) -> Array:
        return np.stack([np.interp(uv[:, k], lines[k], np.arange(count[k] + 1.0)) for k in (0, 1)], axis=1)

    border = np.concatenate([_dense(loop, even) for loop in face.loops])
    grid = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 2)
    grid = grid[on_face(face, grid)]
    # A grid point right beside the border would make needles.
    spots = even(border)
    taken = np.zeros((2 * count[0] + 2, 2 * count[1] + 2), dtype=np.bool_)
    taken[tuple((2.0 * spots + 0.5).astype(np.int64).T)] = True
    grid = grid[~taken[tuple((2.0 * even(grid) + 0.5).astype(np.int64).T)]]
    uv = np.concatenate([border, grid])
    triangles = Delaunay(even(uv)).simplices.astype(np.int64)
    triangles = triangles[on_face(face, np.ascontiguousarray(uv[triangles].mean(axis=1)))]
    # Points are a line apart, on the border too, so what reaches further lies along a hollow of the border, outside.
    flat = even(uv)[triangles]
    near = np.linalg.norm(flat - np.roll(flat, 1, axis=1), axis=2).max(axis=1) < LONGEST
    triangles, flat = triangles[near], flat[near]
    first, second = flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0]
    turn = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    triangles, turn = triangles[np.abs(turn) > 1e-9], turn[np.abs(turn) > 1e-9]
    backward = turn * face.sense < 0.0
    triangles[backward] = triangles[backward][:, ::-1]
    vertices = np.ascontiguousarray(work.projector.evaluate(uv[:, 0], uv[:, 1])[:, 0])
    sag = np.zeros(len(triangles))
    for weights in ((1 / 3, 1 / 3, 1 / 3), (0.5, 0.5, 0.0), (0.0, 0.5, 0.5), (0.5, 0.0, 0.5)):
        inner = np.einsum("k,tkx->tx", weights, uv[triangles])
        frame = work.projector.evaluate(inner[:, 0], inner[:, 1])
        normal = np.cross(frame[:, 1], frame[:, 2])
        normal /= np.maximum(np.linalg.norm(normal, axis=1), 1e-300)[:, None]
        chord = np.einsum("k,tkx->tx", weights, vertices[triangles]) - frame[:, 0]
        sag = np.maximum(sag, np.abs(np.einsum("tx,tx->t", chord, normal)))
    mesh = CheckMesh(vertices, triangles.astype(np.int32), np.full(len(triangles), face.number, dtype=np.int32))
    return mesh, sag


def _lines(work: WorkFace, low: Array, high: Array, axis: int, deflection: float) -> Array:
    """Parameters of the grid lines across an axis: an arc between two of them rises by `deflection` at most."""
    probe = np.linspace(low, high, PROBES)
    u, v = (x.ravel() for x in np.meshgrid(probe[:, 0], probe[:, 1], indexing="ij"))
    frame = work.projector.evaluate(u, v)
    along, across = frame[:, 1 + axis], frame[:, 2 - axis]
    tangent = along.reshape(PROBES, PROBES, 3)
    normal = np.cross(along, across)
    twist = np.abs(np.einsum("ni,ni->n", frame[:, 4], normal)) / np.maximum(np.linalg.norm(normal, axis=1), 1e-300)
    twist = twist.reshape(PROBES, PROBES)
    if axis == 1:
        tangent, twist = tangent.transpose(1, 0, 2), twist.T
    step = (high[axis] - low[axis]) / (PROBES - 1)
    bend = np.linalg.norm(np.diff(tangent, axis=0), axis=2).max(axis=1) / step
    # A twisted cell lies |<S_uv, n>| h k / 4 off its diagonal; with lines as far apart one way as the other on the face
    # that is as if it bent by as much along either.
    square = np.linalg.norm(along, axis=1).mean() / max(float(np.linalg.norm(across, axis=1).mean()), 1e-300)
    bend = np.maximum(bend, 0.5 * (twist[1:] + twist[:-1]).max(axis=1) * square)
    # A chord of parameter length h leaves |S''| h² / 8; with half of it diagonals of a cell see both directions.
    density = np.sqrt(bend / (4.0 * deflection))
    density = np.maximum(density, max(LINES_AT_LEAST / (high[axis] - low[axis]), 0.05 * float(density.max())))
    load = np.concatenate([[0.0], np.cumsum(density * step)])
    count = int(np.clip(np.ceil(load[-1]), LINES_AT_LEAST, LINES_AT_MOST))
    return np.asarray(np.interp(np.linspace(0.0, load[-1], count + 1), load, probe[:, axis]))


def _dense(loop: Array, even: Callable[[Array], Array]) -> Array:
    """A loop (N, 2) with points added so that no stretch is longer than a grid cell."""
    ends = np.roll(loop, -1, axis=0)
    parts = np.maximum(np.ceil(np.abs(even(ends) - even(loop)).max(axis=1)).astype(np.int64), 1)
    owner = np.repeat(np.arange(len(loop)), parts)
    share = (np.arange(len(owner)) - np.repeat(np.cumsum(parts) - parts, parts)) / parts[owner]
    return np.asarray(loop[owner] + share[:, None] * (ends - loop)[owner])


def welded(mesh: CheckMesh) -> IntArray:
    """The triangles (M, 3) with vertices at the same place made one, since a mesher may repeat them."""
    places = np.round(mesh.vertices / WELD).astype(np.int64)
    order = np.lexsort(places.T)
    number = np.empty(len(places), dtype=np.int64)
    number[order] = np.cumsum((np.diff(places[order], axis=0, prepend=places[order[:1]]) != 0).any(axis=1))
    return np.asarray(number[mesh.triangles.astype(np.int64)])


def mesh_sags(mesh: CheckMesh) -> Array:
    """How far the curved face behind each triangle may lie off it, (M,) mm; 0 for meshes from elsewhere.

    Across a chord w over which the normal turns by an angle, an arc rises by w angle / 8; the angle is that to the
    triangle on the other side of an edge, and the chord the larger height over it. A triangle at the border of its
    face may meet its only neighbour flat, so each also takes what its neighbours have.
    """
    sag = np.zeros(len(mesh.triangles))
    if not np.any(mesh.face >= 0):
        return sag
    corners = welded(mesh)
    place = mesh.vertices[mesh.triangles.astype(np.int64)]
    normal = np.cross(place[:, 1] - place[:, 0], place[:, 2] - place[:, 0])
    area = np.linalg.norm(normal, axis=1)
    normal /= np.maximum(area, 1e-300)[:, None]
    ends = [(corners[:, k], corners[:, (k + 1) % 3]) for k in range(3)]
    edge = np.concatenate([np.minimum(a, b) * len(mesh.vertices) + np.maximum(a, b) for a, b in ends])
    owner = np.tile(np.arange(len(corners)), 3)
    length = np.concatenate([np.linalg.norm(place[:, (k + 1) % 3] - place[:, k], axis=1) for k in range(3)])
    height = area[owner] / np.maximum(length, 1e-300)
    order = np.lexsort((mesh.face[owner], edge))
    a, b = order[:-1], order[1:]
    beside = (edge[a] == edge[b]) & (mesh.face[owner[a]] == mesh.face[owner[b]])
    a, b = a[beside], b[beside]
    cosine = np.einsum("ij,ij->i", normal[owner[a]], normal[owner[b]])
    a, b, cosine = a[cosine > SMOOTH_EDGE], b[cosine > SMOOTH_EDGE], cosine[cosine > SMOOTH_EDGE]
    rise = np.maximum(height[a], height[b]) * np.arccos(np.clip(cosine, -1.0, 1.0)) / 8.0
    for side in (a, b):
        np.maximum.at(sag, owner[side], rise)
    spread = sag.copy()
    np.maximum.at(spread, owner[a], sag[owner[b]])
    np.maximum.at(spread, owner[b], sag[owner[a]])
    return np.where(mesh.face >= 0, spread, 0.0)


def open_edges(mesh: CheckMesh) -> int:
    """How many edges have an odd number of triangles; where there is none the mesh has an inside."""
    corners = welded(mesh)
    whole = corners[[len(set(row)) == 3 for row in corners.tolist()]]
    edge = np.sort(np.concatenate([whole[:, [k, (k + 1) % 3]] for k in range(3)]), axis=1)
    _, count = np.unique(edge, axis=0, return_counts=True)
    return int(np.sum(count % 2))
