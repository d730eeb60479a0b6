"""What stands around the cutter: CAD faces as pieces that are halved on the face itself, and meshes from elsewhere."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from conflank_cli.geometry.face import CheckMesh, DesignFace
from conflank_cli.geometry.surface import BSplineSurface
from conflank_cli.verification.evaluation import points_of
from conflank_cli.verification.gap import spatial_order
from conflank_cli.verification.triangles import triangles_over

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

_WELD = 1e-6
"""Vertices of a mesh nearer than this are one, mm."""

_SMOOTH_EDGE = 0.7
"""Triangles of a face that meet at a smaller cosine (at more than 45 deg) meet at an edge, not along a curved face."""

_SAG_OF_BOWS = 1.5
"""A face is off a triangle by at most 4/3 of what it is off the middle of one of its sides, where its second
derivatives are even; this is a little more, since they nearly are."""


@dataclass(frozen=True, slots=True)
class MeshSample:
    """Points on faces and meshes, N of them, and the K pieces of triangles whose corners they are.

    Attributes
    ----------
    points: (N, 3) mm.
    sag: (N,) how far the true face may lie from the point, mm: 0 on known surfaces and at vertices.
    face: (N,) CAD face number, below 0 for meshes from elsewhere.
    surface: (N,) which of the surfaces a point is on, -1 where that is not known.
    uv: (N, 2) where on it.
    pieces: (K, 3) the corners of each piece.
    piece_sag: (K,) how far the true face may lie off a piece, mm.
    sides: (K, 3) lengths of the sides of each piece, from each corner to the next, mm.
    bows: (K, 3) how far the surface is off the middle of each side, mm.
    surfaces: those that there are.
    """

    points: Array
    sag: Array
    face: Integers
    surface: Integers
    uv: Array
    pieces: Integers
    piece_sag: Array
    sides: Array
    bows: Array
    surfaces: tuple[BSplineSurface, ...]

    @property
    def longest(self) -> Array:
        """Length of the longest side of each piece, (K,) mm."""
        return largest(self.sides)

    def halved(self, chosen: npt.NDArray[np.bool_]) -> MeshSample:
        """The chosen pieces (K,), halved across their longest sides; the points are these and then the new ones.

        On a known surface the new point is on it, where the middle of the side is in its parameter plane.
        """
        pieces, own = self.pieces[chosen], self.piece_sag[chosen]
        rows, (one, two, three) = np.arange(len(pieces)), self.sides[chosen].T
        side = np.where((one >= two) & (one >= three), 0, np.where(two >= three, 1, 2))
        a, b, c = (pieces[rows, (side + k) % 3] for k in range(3))
        bows = self.bows[chosen]
        of_bc, of_ca = (bows[rows, (side + k) % 3] for k in (1, 2))
        surface, uv = self.surface[a], 0.5 * (self.uv[a] + self.uv[b])
        straight = 0.5 * (self.points[a] + self.points[b])
        points = self._on_surface(surface, uv, straight)
        bow = np.linalg.norm(points - straight, axis=1)
        across = 0.5 * (points + self.points[c])
        of_mc = np.linalg.norm(self._on_surface(surface, 0.5 * (uv + self.uv[c]), across) - across, axis=1)
        middle = len(self.points) + rows
        every = np.concatenate([self.points, points])
        halves = np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)])
        # Half a side bows a quarter as much.
        new = np.concatenate([np.stack([bow / 4.0, of_mc, of_ca], axis=1), np.stack([bow / 4.0, of_bc, of_mc], axis=1)])
        known = np.tile(surface >= 0, 2)
        return MeshSample(
            every,
            np.concatenate([self.sag, np.where(surface >= 0, 0.0, own)]),
            np.concatenate([self.face, self.face[a]]),
            np.concatenate([self.surface, surface]),
            np.concatenate([self.uv, uv]),
            halves,
            np.where(known, _SAG_OF_BOWS * largest(new), np.tile(own, 2)),
            _side_lengths(every, halves),
            new,
            self.surfaces,
        )

    def only(self, pieces: Integers) -> tuple[MeshSample, Integers]:
        """Some of the pieces, by number, with their corners, and which of the points these are."""
        kept, number = np.unique(self.pieces[pieces], return_inverse=True)
        sample = MeshSample(
            self.points[kept], self.sag[kept], self.face[kept], self.surface[kept], self.uv[kept],
            number.reshape(-1, 3), self.piece_sag[pieces], self.sides[pieces], self.bows[pieces], self.surfaces,
        )  # fmt: skip
        return sample, kept

    def with_pieces(self, pieces: Integers, sag: Array) -> MeshSample:
        """The same points with other pieces (K, 3), and how far the true face may lie off each, (K,) mm."""
        sides = _side_lengths(self.points, pieces)
        return replace(self, pieces=pieces, piece_sag=sag, sides=sides, bows=np.zeros(pieces.shape))

    def _on_surface(self, surface: Integers, uv: Array, otherwise: Array) -> Array:
        """Points (M, 3) of surfaces (M,) at parameters (M, 2); where none is known the given ones."""
        return on_surfaces(self.surfaces, surface, uv, otherwise)


def on_surfaces(surfaces: Sequence[BSplineSurface], surface: Integers, uv: Array, otherwise: Array) -> Array:
    """Points (M, 3) of surfaces, by number (M,), at parameters (M, 2); those of `otherwise` where the number is -1."""
    points = otherwise.copy()
    for number in np.unique(surface[surface >= 0]):
        own = surface == number
        points[own] = points_of(surfaces[number], uv[own])
    return points


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
    """Faces and meshes made ready to be checked against whatever program, V points and M triangles.

    Attributes
    ----------
    corners: as points, each as often as there are faces that it belongs to; those next to each other in the array are
        close together. Its pieces are the triangles.
    """

    corners: MeshSample

    @classmethod
    def of(cls, mesh: CheckMesh, faces: Sequence[DesignFace] = ()) -> Surroundings:
        """Of a mesh and of CAD faces. Triangles of the mesh that belong to one of these faces are left out."""
        mesh = mesh.only(~np.isin(mesh.face, [face.number for face in faces]))
        groups = [_of_mesh(mesh), *(_of_face(face, number) for number, face in enumerate(faces))]
        groups = [group for group in groups if len(group[-2])]
        if not groups:
            groups = [_of_mesh(mesh)]
        points, number, surfaces_of, uv_of, triangles, sag = (list(column) for column in zip(*groups, strict=True))
        first = np.cumsum([0, *(len(each) for each in points[:-1])])
        order = spatial_order(np.concatenate(points))
        place = np.empty(len(order), dtype=np.int64)
        place[order] = np.arange(len(order))
        every = np.concatenate(points)[order]
        pieces = place[np.concatenate([each + start for each, start in zip(triangles, first, strict=True)])]
        surface, uv = np.concatenate(surfaces_of)[order], np.concatenate(uv_of)[order]
        surfaces = tuple(face.surface for face in faces)
        bows = np.zeros((len(pieces), 3))
        for k in range(3):
            a, b = pieces[:, k], pieces[:, (k + 1) % 3]
            straight = 0.5 * (every[a] + every[b])
            curved = on_surfaces(surfaces, surface[a], 0.5 * (uv[a] + uv[b]), straight)
            bows[:, k] = np.linalg.norm(curved - straight, axis=1)
        return cls(
            MeshSample(
                every,
                np.zeros(len(every)),
                np.concatenate(number)[order],
                surface,
                uv,
                pieces,
                np.maximum(np.concatenate(sag), _SAG_OF_BOWS * largest(bows)),
                _side_lengths(every, pieces),
                bows,
                surfaces,
            )
        )

    def near(self, low: Array, high: Array) -> MeshSample:
        """The triangles that reach into a box as pieces, and their corners as points. low, high: its corners, mm."""
        points, triangles = self.corners.points, self.corners.pieces
        near = np.ones(len(triangles), dtype=np.bool_)
        for x in range(3):
            for inside in (points[:, x] <= high[x], points[:, x] >= low[x]):
                near &= inside[triangles[:, 0]] | inside[triangles[:, 1]] | inside[triangles[:, 2]]
        return self.corners.only(np.flatnonzero(near))[0]


_Group = tuple[Array, Integers, Integers, Array, Integers, Array]
"""Points, their faces, surfaces and parameters; triangles, and how far the true face may lie off them, mm."""


def _of_mesh(mesh: CheckMesh) -> _Group:
    """A mesh; triangles of a face share corners, and a corner that belongs to several faces is a point of each."""
    triangles, of_corner = mesh.triangles.astype(np.int64), np.repeat(mesh.face.astype(np.int64), 3).reshape(-1, 3)
    face = np.zeros(len(mesh.vertices), dtype=np.int64)
    face[triangles] = of_corner
    shared = face[triangles] != of_corner
    pairs = np.stack([of_corner[shared], triangles[shared]])
    (more, vertex), number = np.unique(pairs, axis=1, return_inverse=True)
    triangles[shared] = len(mesh.vertices) + number
    points = np.concatenate([mesh.vertices, mesh.vertices[vertex]])
    nowhere = np.full(len(points), -1, dtype=np.int64)
    return points, np.concatenate([face, more]), nowhere, np.zeros((len(points), 2)), triangles, _sags(mesh)


def _of_face(face: DesignFace, number: int) -> _Group:
    """A CAD face, the surface of which has a number."""
    uv, triangles = triangles_over(face)
    points = points_of(face.surface, uv)
    own = np.full(len(uv), face.number, dtype=np.int64)
    return points, own, np.full(len(uv), number, dtype=np.int64), uv, triangles, np.zeros(len(triangles))


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
