"""Shaded pictures of triangles: an orthographic camera, a depth buffer, and light that comes with the viewer."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]

SAMPLES = 3
"""Samples along each side of a pixel: edges are smooth, and every pixel is the same on every machine."""

AMBIENT, KEY, FILL = 0.55, 0.42, 0.10
"""Light from everywhere, from the upper left of the viewer, and from the right."""

SECTION = (0.42, 0.44, 0.47)
"""Colour of what a cut through a body shows: the inside of its surface, unlit."""


@dataclass(frozen=True, slots=True)
class Mesh:
    """Triangles with a colour at each vertex.

    Attributes
    ----------
    vertices, normals, colours: (N, 3).
    triangles: (M, 3).
    cut: (N,) where there is a section through the body: what has a positive value is cut away, and the inside of the
        surface that comes to sight shows as the section. Triangles must then be counter-clockwise seen from outside.
    """

    vertices: Array
    normals: Array
    colours: Array
    triangles: Integers
    cut: Array | None = None


def grid_mesh(points: Array, normals: Array, colours: Array, keep: Flags | None = None) -> Mesh:
    """A grid of points (U, V, 3) as a mesh; cells with a corner that is not in `keep` (U, V) are left out."""
    rows, columns = points.shape[:2]
    index = np.arange(rows * columns).reshape(rows, columns)
    corners = np.stack([index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]], axis=-1).reshape(-1, 4)
    if keep is not None:
        corners = corners[keep.reshape(-1)[corners].all(axis=1)]
    triangles = np.concatenate([corners[:, [0, 1, 2]], corners[:, [0, 2, 3]]])
    return Mesh(points.reshape(-1, 3), normals.reshape(-1, 3), colours.reshape(-1, 3), triangles)


def facet_mesh(vertices: Array, triangles: npt.NDArray[np.int32], colour: Array) -> Mesh:
    """Triangles of one colour; where facets meet at less than 30 degrees the surface is shaded smoothly."""
    corners = vertices[triangles]
    facets = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(facets, axis=1)
    unit = facets / np.maximum(size, 1e-300)[:, None]
    _, place = np.unique(np.round(vertices, 5), axis=0, return_inverse=True)
    owner = place.reshape(-1)[triangles]
    normals = np.empty((len(triangles), 3, 3))
    order = np.argsort(owner.reshape(-1), kind="stable")
    facet_of = order // 3
    starts = np.flatnonzero(np.diff(owner.reshape(-1)[order], prepend=-1))
    for first, last in zip(starts, [*starts[1:], len(order)], strict=True):
        around = facet_of[first:last]
        alike = unit[around] @ unit[around].T > np.cos(np.radians(30.0))
        smooth = alike @ facets[around]
        normals.reshape(-1, 3)[order[first:last]] = smooth / np.maximum(np.linalg.norm(smooth, axis=1), 1e-300)[:, None]
    count = 3 * len(triangles)
    colours = np.broadcast_to(colour, (count, 3)).copy()
    return Mesh(corners.reshape(-1, 3), normals.reshape(-1, 3), colours, np.arange(count).reshape(-1, 3))


def revolved_mesh(tip: Array, axis: Array, heights: Array, radii: Array, colours: Array, sides: int = 48) -> Mesh:
    """A body of revolution: radii (K,) and colours (K, 3) at heights (K,) above the tip along the axis."""
    helper = np.eye(3)[np.argmin(np.abs(axis))]
    across = np.cross(axis, helper)
    across /= np.linalg.norm(across)
    angle = np.linspace(0.0, 2.0 * np.pi, sides + 1)
    ring = np.cos(angle)[:, None] * across + np.sin(angle)[:, None] * np.cross(axis, across)
    points = tip + heights[:, None, None] * axis + radii[:, None, None] * ring
    slope = np.arctan2(np.gradient(radii), np.maximum(np.gradient(heights), 1e-9))[:, None, None]
    normals = np.cos(slope) * ring - np.sin(slope) * axis
    return grid_mesh(points, normals, np.broadcast_to(colours[:, None, :], points.shape))


@dataclass(frozen=True, slots=True)
class Camera:
    """An orthographic camera.

    Attributes
    ----------
    towards: unit vector from the scene to the viewer.
    up: what is up in the picture, (3,).
    low, high: corners of the picture in (right, up), mm.
    pixels: pixels for one mm.
    """

    towards: Array
    up: Array
    low: Array
    high: Array
    pixels: float

    @property
    def rotation(self) -> Array:
        """Rows: right, up, towards the viewer."""
        right = np.cross(self.up, self.towards)
        right /= np.linalg.norm(right)
        return np.stack([right, np.cross(self.towards, right), self.towards])

    def place(self, points: Array) -> Array:
        """Points (N, 3) in the picture: (N, 2) pixels from its upper left corner."""
        flat = points @ self.rotation[:2].T
        return np.stack([flat[:, 0] - self.low[0], self.high[1] - flat[:, 1]], axis=1) * self.pixels


@dataclass(frozen=True, slots=True)
class Picture:
    """Samples of a picture: colours (H, W, 3) with depth (H, W), -inf where there is nothing."""

    colours: Array
    depth: Array

    def over(self, other: Picture, alpha: float) -> Picture:
        """This picture laid over another, see-through, wherever it is nearer."""
        nearer = self.depth > other.depth
        share = np.where(nearer, alpha, 0.0)[..., None]
        return Picture(share * self.colours + (1.0 - share) * other.colours, other.depth)

    def pixels(self) -> Array:
        """Averaged over the samples of each pixel, 0 to 1, (H, W, 3)."""
        rows, columns = (n // SAMPLES for n in self.depth.shape)
        return np.asarray(self.colours.reshape(rows, SAMPLES, columns, SAMPLES, 3).mean(axis=(1, 3)))


@njit(cache=True)  # type: ignore[untyped-decorator, unused-ignore]
def _rasterise(corners, attributes, cut, section, colours, depth):  # type: ignore[no-untyped-def]
    """Draw triangles (M, 3, 3) in samples and depth into colours (H, W, 3) and depth (H, W).

    attributes (M, 3, 3): colours. cut (M, 3): as in `Mesh`, or empty. section (3,): colour of the inside of cut bodies.
    """
    height, width = depth.shape
    for k in range(corners.shape[0]):
        ax, ay, bx, by = corners[k, 0, 0], corners[k, 0, 1], corners[k, 1, 0], corners[k, 1, 1]
        cx, cy = corners[k, 2, 0], corners[k, 2, 1]
        double = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if abs(double) < 1e-12:
            continue
        for row in range(max(int(np.ceil(min(ay, by, cy))), 0), min(int(np.floor(max(ay, by, cy))), height - 1) + 1):
            left = max(int(np.ceil(min(ax, bx, cx))), 0)
            for column in range(left, min(int(np.floor(max(ax, bx, cx))), width - 1) + 1):
                wb = ((column - ax) * (cy - ay) - (row - ay) * (cx - ax)) / double
                wc = ((bx - ax) * (row - ay) - (by - ay) * (column - ax)) / double
                wa = 1.0 - wb - wc
                if wa < -1e-9 or wb < -1e-9 or wc < -1e-9:
                    continue
                z = wa * corners[k, 0, 2] + wb * corners[k, 1, 2] + wc * corners[k, 2, 2]
                if z <= depth[row, column]:
                    continue
                if len(cut) and wa * cut[k, 0] + wb * cut[k, 1] + wc * cut[k, 2] > 0.0:
                    continue
                depth[row, column] = z
                for m in range(3):
                    # Rows run downwards, so that the outside is clockwise here.
                    if len(cut) and double > 0.0:
                        colours[row, column, m] = section[m]
                    else:
                        colours[row, column, m] = (
                            wa * attributes[k, 0, m] + wb * attributes[k, 1, m] + wc * attributes[k, 2, m]
                        )


def render(camera: Camera, meshes: list[Mesh], background: tuple[float, float, float] = (1.0, 1.0, 1.0)) -> Picture:
    """Draw meshes as the camera sees them; both sides of a triangle are lit."""
    size = np.round((camera.high - camera.low) * camera.pixels).astype(int)
    colours = np.empty((size[1] * SAMPLES, size[0] * SAMPLES, 3))
    colours[:] = background
    depth = np.full(colours.shape[:2], -np.inf)
    key, fill = (np.array(light) / np.linalg.norm(light) for light in ((-0.5, 0.7, 1.0), (1.0, 0.1, 0.6)))
    for mesh in meshes:
        facing = mesh.normals @ camera.rotation.T
        facing = np.where(facing[:, 2:] < 0.0, -facing, facing)
        bright = AMBIENT + KEY * np.maximum(facing @ key, 0.0) + FILL * np.maximum(facing @ fill, 0.0)
        lit = np.clip(mesh.colours * bright[:, None], 0.0, 1.0)
        placed = np.concatenate(
            [camera.place(mesh.vertices) * SAMPLES - 0.5, mesh.vertices @ camera.towards[:, None]], 1
        )
        cut = np.empty((0, 3)) if mesh.cut is None else mesh.cut[mesh.triangles]
        _rasterise(placed[mesh.triangles], lit[mesh.triangles], cut, np.array(SECTION), colours, depth)
    return Picture(colours, depth)
