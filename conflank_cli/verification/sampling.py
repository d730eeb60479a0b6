"""Points to judge a part at: on the trimmed design faces, and on the mesh of everything around them.

Surfaces are evaluated with SciPy's B-splines, independently of the project's own kernels.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt
from scipy.interpolate import BSpline, NdBSpline

from conflank_cli.geometry.face import CheckMesh, DesignFace
from conflank_cli.geometry.surface import BSplineSurface
from conflank_cli.scene import Scene
from conflank_cli.verification.gap import spatial_order

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

POINTS_PER_FACE = 30_000
"""Points of the grid on a face: about 0.3 mm apart on a blade of 50 x 50 mm."""

BORDER_SPACING = 0.5
"""Spacing of the points on a face's border, mm."""

DESIGN_SPACING = 1.0
"""Spacing of the points of a design face that shank and holder are held against, mm."""

_COARSE = 48
"""Cells a side of the coarse grid that tells how the parameters run over a face."""

_WELD = 1e-6
"""Vertices of a mesh nearer than this are one, mm."""

_SMOOTH_EDGE = 0.7
"""Triangles of a face that meet at a smaller cosine (at more than 45 deg) meet at an edge, not along a curved face."""


@dataclass(frozen=True, slots=True)
class FaceSample:
    """Points on one trimmed face: P on the grid, then those of its border, N together.

    Attributes
    ----------
    points: (N, 3) mm, CAD frame.
    normals: (N, 3) unit normals out of the metal.
    area: (N,) area each stands for, mm2; 0 on the border.
    neighbours: pairs of grid points next to each other, (Q, 2).
    """

    points: Array
    normals: Array
    area: Array
    neighbours: Integers


def _homogeneous(surface: BSplineSurface) -> Array:
    if surface.weights is None:
        return surface.poles
    return np.concatenate([surface.poles * surface.weights[..., None], surface.weights[..., None]], axis=2)


def _cartesian(value: Array, by_u: Array, by_v: Array) -> tuple[Array, Array, Array]:
    """Quotient rule where there is a fourth, homogeneous coordinate."""
    if value.shape[-1] == 3:
        return value, by_u, by_v
    weight = value[..., 3:]
    point = value[..., :3] / weight
    return (
        point,
        (by_u[..., :3] - point * by_u[..., 3:]) / weight,
        (by_v[..., :3] - point * by_v[..., 3:]) / weight,
    )


def evaluate_grid(surface: BSplineSurface, u: Array, v: Array) -> tuple[Array, Array, Array]:
    """S, S_u and S_v on the grid u x v, each (len(u), len(v), 3)."""
    spline = BSpline(surface.knots_u, _homogeneous(surface), surface.degree_u)

    def at(order_u: int, order_v: int) -> Array:
        columns = np.moveaxis(spline(u, nu=order_u), 1, 0)
        rows = BSpline(surface.knots_v, columns, surface.degree_v)(v, nu=order_v)
        return np.ascontiguousarray(np.moveaxis(rows, 0, 1))

    return _cartesian(at(0, 0), at(1, 0), at(0, 1))


def evaluate_points(surface: BSplineSurface, uv: Array) -> tuple[Array, Array, Array]:
    """S, S_u and S_v at parameter points (N, 2), each (N, 3)."""
    u0, u1, v0, v1 = surface.domain
    inside = np.clip(uv, [u0, v0], [u1, v1])
    spline = NdBSpline((surface.knots_u, surface.knots_v), _homogeneous(surface), (surface.degree_u, surface.degree_v))
    return _cartesian(*(np.asarray(spline(inside, nu=order)) for order in ((0, 0), (1, 0), (0, 1))))


def inside_rows(loops: tuple[Array, ...], u: Array, v: Array) -> npt.NDArray[np.bool_]:
    """Even-odd rule on the grid u x v: (len(u), len(v))."""
    start = np.concatenate([loop for loop in loops])
    end = np.concatenate([np.roll(loop, -1, axis=0) for loop in loops])
    result = np.zeros((len(u), len(v)), dtype=np.bool_)
    for column, value in enumerate(v):
        crosses = (start[:, 1] > value) != (end[:, 1] > value)
        first, last = start[crosses], end[crosses]
        where = first[:, 0] + (value - first[:, 1]) / (last[:, 1] - first[:, 1]) * (last[:, 0] - first[:, 0])
        result[:, column] = np.searchsorted(np.sort(where), u) % 2 == 1
    return result


def _cells_of_even_length(edges: Array, lengths: Array, count: int) -> tuple[Array, Array]:
    """Middles and widths of `count` parameter cells of even length, from lengths of coarse cells between edges."""
    travelled = np.concatenate([[0.0], np.cumsum(np.maximum(lengths, 1e-9 * lengths.sum()))])
    borders = np.interp(np.linspace(0.0, travelled[-1], count + 1), travelled, edges)
    return 0.5 * (borders[1:] + borders[:-1]), np.diff(borders)


def sample_face(face: DesignFace, count: int = POINTS_PER_FACE) -> FaceSample:
    """Points on a trimmed face, evenly spread, with the area each stands for.

    Parameters
    ----------
    face: the face.
    count: how many points the grid shall have inside the trimming loops, about.
    """
    surface = face.surface
    loops = np.concatenate(face.loops)
    u0, u1, v0, v1 = surface.domain
    low, high = np.maximum(loops.min(axis=0), [u0, v0]), np.minimum(loops.max(axis=0), [u1, v1])
    edges_u, edges_v = (np.linspace(low[k], high[k], _COARSE + 1) for k in (0, 1))
    middle_u, middle_v = 0.5 * (edges_u[1:] + edges_u[:-1]), 0.5 * (edges_v[1:] + edges_v[:-1])
    _, by_u, by_v = evaluate_grid(surface, middle_u, middle_v)
    coarse = inside_rows(face.loops, middle_u, middle_v)
    filled = max(float(coarse.mean()), 1.0 / _COARSE**2)
    lengths_u = np.linalg.norm(by_u, axis=2).mean(axis=1) * np.diff(edges_u)
    lengths_v = np.linalg.norm(by_v, axis=2).mean(axis=0) * np.diff(edges_v)
    cells = count / filled
    ratio = np.clip(lengths_u.sum() / lengths_v.sum(), 0.01, 100.0)
    nu, nv = max(int(np.sqrt(cells * ratio)), 4), max(int(np.sqrt(cells / ratio)), 4)
    u, du = _cells_of_even_length(edges_u, lengths_u, nu)
    v, dv = _cells_of_even_length(edges_v, lengths_v, nv)
    points, by_u, by_v = evaluate_grid(surface, u, v)
    normals = face.sense * np.cross(by_u, by_v)
    size = np.linalg.norm(normals, axis=2)
    kept = inside_rows(face.loops, u, v) & (size > 1e-9 * max(float(size.max()), 1e-300))
    number = np.full(kept.shape, -1, dtype=np.int64)
    number[kept] = np.arange(int(kept.sum()))
    pairs = [
        np.stack([first[both], last[both]], axis=1)
        for first, last in ((number[:-1], number[1:]), (number[:, :-1], number[:, 1:]))
        for both in [(first >= 0) & (last >= 0)]
    ]
    border_points, border_normals = _sample_border(face)
    return FaceSample(
        points=np.concatenate([points[kept], border_points]),
        normals=np.concatenate([normals[kept] / size[kept][:, None], border_normals]),
        area=np.concatenate([(size * du[:, None] * dv[None, :])[kept], np.zeros(len(border_points))]),
        neighbours=np.concatenate(pairs),
    )


def _sample_border(face: DesignFace) -> tuple[Array, Array]:
    """Points and normals along the trimming loops."""
    pieces = []
    for loop in face.loops:
        ends = np.roll(loop, -1, axis=0)
        way = np.linalg.norm(evaluate_points(face.surface, ends)[0] - evaluate_points(face.surface, loop)[0], axis=1)
        parts = np.maximum(np.ceil(way / BORDER_SPACING).astype(np.int64), 1)
        owner = np.repeat(np.arange(len(loop)), parts)
        share = (np.arange(len(owner)) - np.repeat(np.cumsum(parts) - parts, parts)) / parts[owner]
        pieces.append(loop[owner] + share[:, None] * (ends - loop)[owner])
    points, by_u, by_v = evaluate_points(face.surface, np.concatenate(pieces))
    normals = face.sense * np.cross(by_u, by_v)
    size = np.linalg.norm(normals, axis=1)
    # At a pole of the surface the normal is not defined by its derivatives; the point next to it speaks for it.
    kept = size > 1e-9 * max(float(size.max()), 1e-300)
    return points[kept], normals[kept] / size[kept][:, None]


@dataclass(frozen=True, slots=True)
class MeshSample:
    """Points on a mesh, N of them, and the K pieces of its triangles whose corners they are.

    Attributes
    ----------
    points: (N, 3) mm.
    sag: (N,) how far the true face may lie from the point, mm: 0 at vertices; estimated from the angle to the next
        triangle elsewhere; 0 on meshes that are no image of a CAD face.
    face: (N,) CAD face number, below 0 for meshes from elsewhere.
    pieces: (K, 3) the corners of each piece; empty where there are only points.
    piece_sag: (K,) the sag within a piece, mm.
    sides: (K, 3) lengths of the sides of each piece, from each corner to the next, mm.
    """

    points: Array
    sag: Array
    face: Integers
    pieces: Integers
    piece_sag: Array
    sides: Array

    @classmethod
    def of(cls, points: Array, sag: Array, face: Integers, pieces: Integers, piece_sag: Array) -> MeshSample:
        """Measure the sides."""
        return cls(points, sag, face, pieces, piece_sag, _side_lengths(points, pieces))

    @classmethod
    def of_points(cls, points: Array, face: Integers) -> MeshSample:
        """Points (N, 3) on faces (N,) themselves, in an order of their own."""
        nothing, order = np.zeros((0, 3), dtype=np.int64), spatial_order(points)
        return cls(points[order], np.zeros(len(points)), face[order], nothing, np.zeros(0), np.zeros((0, 3)))

    @property
    def longest(self) -> Array:
        """Length of the longest side of each piece, (K,) mm."""
        return largest(self.sides)

    def halved(self, chosen: npt.NDArray[np.bool_]) -> MeshSample:
        """The chosen pieces, halved across their longest sides; the points are these and then those in the middles."""
        pieces = self.pieces[chosen]
        rows, (first, second, third) = np.arange(len(pieces)), self.sides[chosen].T
        side = np.where((first >= second) & (first >= third), 0, np.where(second >= third, 1, 2))
        a, b, c = (pieces[rows, (side + k) % 3] for k in range(3))
        middle = len(self.points) + rows
        return MeshSample.of(
            np.concatenate([self.points, 0.5 * (self.points[a] + self.points[b])]),
            np.concatenate([self.sag, self.piece_sag[chosen]]),
            np.concatenate([self.face, self.face[a]]),
            np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)]),
            np.tile(self.piece_sag[chosen], 2),
        )


def _sags(mesh: CheckMesh) -> Array:
    """How far the curved face behind each triangle may lie off it, (M,) mm, from the angle to the triangles beside it.

    Across a chord w over which the normal turns by an angle, an arc rises by w angle / 8.
    """
    vertices, triangles = mesh.vertices, mesh.triangles.astype(np.int64)
    corners = _welded(vertices)[triangles]
    at = [vertices[triangles[:, k]] for k in range(3)]
    sides = [at[(k + 1) % 3] - at[k] for k in range(3)]
    normals = np.cross(sides[0], sides[1])
    double_area = np.linalg.norm(normals, axis=1)
    normals /= np.maximum(double_area, 1e-300)[:, None]
    edges = np.concatenate([_pair(corners[:, k], corners[:, (k + 1) % 3], len(vertices)) for k in range(3)])
    owner = np.tile(np.arange(len(triangles)), 3)
    # The chord across an edge is the triangle's height over it.
    height = np.concatenate([double_area / np.maximum(np.linalg.norm(side, axis=1), 1e-300) for side in sides])
    order = np.lexsort((mesh.face[owner], edges))
    first, last = order[:-1], order[1:]
    paired = (edges[first] == edges[last]) & (mesh.face[owner[first]] == mesh.face[owner[last]])
    first, last = first[paired], last[paired]
    cosine = np.einsum("ij,ij->i", normals[owner[first]], normals[owner[last]])
    smooth = cosine > _SMOOTH_EDGE
    first, last = first[smooth], last[smooth]
    rise = np.maximum(height[first], height[last]) * np.arccos(np.clip(cosine[smooth], -1.0, 1.0)) / 8.0
    sag = np.zeros(len(triangles))
    for side in (first, last):
        np.maximum.at(sag, owner[side], rise)
    # A triangle at the border of a face may meet its only neighbour flat; that one knows the curvature.
    spread = sag.copy()
    np.maximum.at(spread, owner[first], sag[owner[last]])
    np.maximum.at(spread, owner[last], sag[owner[first]])
    return np.where(mesh.face >= 0, spread, 0.0)


def _welded(vertices: Array) -> Integers:
    """A number for each vertex (V,), the same for those at the same place, since a mesher may repeat them."""
    places = np.round(vertices / _WELD).astype(np.int64)
    order = np.lexsort(places.T)
    new = (np.diff(places[order], axis=0, prepend=places[order[:1]]) != 0).any(axis=1)
    number = np.empty(len(vertices), dtype=np.int64)
    number[order] = np.cumsum(new)
    return number


def _pair(one: Integers, other: Integers, count: int) -> Integers:
    """One number (N,) for each two of `count`, in whichever order."""
    return np.asarray(np.minimum(one, other) * count + np.maximum(one, other))


@dataclass(frozen=True, slots=True)
class Surroundings:
    """A mesh made ready to be held against whatever program, V points and M triangles.

    Attributes
    ----------
    points: (V, 3) mm, the corners, each as often as there are faces that it belongs to; those next to each other in
        the array are close together.
    face: (V,) CAD face number, below 0 for meshes from elsewhere.
    triangles: (M, 3) their corners.
    sag: (M,) how far the curved face behind each may lie off it, mm.
    sides: (M, 3) lengths of their sides, mm.
    """

    points: Array
    face: Integers
    triangles: Integers
    sag: Array
    sides: Array

    @classmethod
    def of(cls, mesh: CheckMesh) -> Surroundings:
        """Of a mesh."""
        triangles, of_corner = mesh.triangles.astype(np.int64), np.repeat(mesh.face.astype(np.int64), 3).reshape(-1, 3)
        # Triangles of a face share their corners; a corner that belongs to several faces is a point of each.
        face = np.zeros(len(mesh.vertices), dtype=np.int64)
        face[triangles] = of_corner
        shared = face[triangles] != of_corner
        pairs = np.stack([of_corner[shared], triangles[shared]])
        (more, vertex), number = np.unique(pairs, axis=1, return_inverse=True)
        triangles[shared] = len(mesh.vertices) + number
        points, face = np.concatenate([mesh.vertices, mesh.vertices[vertex]]), np.concatenate([face, more])
        order = spatial_order(points)
        place = np.empty(len(order), dtype=np.int64)
        place[order] = np.arange(len(order))
        points, triangles = points[order], place[triangles]
        return cls(points, face[order], triangles, _sags(mesh), _side_lengths(points, triangles))

    def near(self, low: Array, high: Array) -> MeshSample:
        """The triangles that reach into a box as pieces, and their corners as points. low, high: its corners, mm."""
        near = np.ones(len(self.triangles), dtype=np.bool_)
        for x in range(3):
            for inside in (self.points[:, x] <= high[x], self.points[:, x] >= low[x]):
                near &= inside[self.triangles[:, 0]] | inside[self.triangles[:, 1]] | inside[self.triangles[:, 2]]
        triangles = self.triangles[near]
        used = np.zeros(len(self.points), dtype=np.bool_)
        used[triangles] = True
        number = np.cumsum(used) - 1
        points = self.points[used]
        return MeshSample(
            points, np.zeros(len(points)), self.face[used], number[triangles], self.sag[near], self.sides[near]
        )


def _side_lengths(points: Array, pieces: Integers) -> Array:
    """Lengths (K, 3) of the sides of pieces (K, 3), from each corner to the next."""
    corners = [points[pieces[:, k]] for k in range(3)]
    sides = np.empty(pieces.shape)
    for k in range(3):
        along = corners[k] - corners[(k + 1) % 3]
        sides[:, k] = np.sqrt(np.einsum("kx,kx->k", along, along))
    return sides


def largest(table: Array) -> Array:
    """The largest number of each row of a table (K, 3)."""
    return np.asarray(np.maximum(np.maximum(table[:, 0], table[:, 1]), table[:, 2]))


@dataclass(frozen=True, slots=True)
class Places:
    """Where a scene is judged, whatever the program.

    Attributes
    ----------
    samples: points on each design face.
    around: what stands around the faces.
    """

    samples: tuple[FaceSample, ...]
    around: Surroundings

    @classmethod
    @lru_cache(maxsize=1)
    def of(cls, scene: Scene, points_per_face: int) -> Places:
        """Those of a scene; kept for whoever asks next."""
        samples = tuple(sample_face(face, points_per_face) for face in scene.faces)
        return cls(samples, Surroundings.of(scene.check))
