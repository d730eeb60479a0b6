"""Where passes are needed: what the sweeps leave on a face, on a grid of its parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.ndimage import distance_transform_edt, label, maximum_filter, minimum_filter1d, uniform_filter
from scipy.spatial import cKDTree

from conflank_cli.geometry.gap import motion_gap
from conflank_cli.geometry.workface import WorkFace, on_face
from conflank_cli.sweep import Sweep
from conflank_cli.tool import Tool

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]
IntArray = npt.NDArray[np.int64]

# Nodes of the grid stand this far apart, mm, as verification looks at a blade; a large face has at most so many.
SPACING = 0.22
MOST_NODES = 60_000
# A crest and a cut this close to each other make a step, mm, or as close as points at which verification judges a face:
# so many on it, neighbours so much further apart than if they were even.
BESIDE = 0.35
JUDGED, NEIGHBOURS = 30_000, 2.0
# Depths are blended over this way, mm.
BLEND = 0.4
# Nodes on the border of the box belong to the face: the rule of the trim decides for places this share further in.
INWARD = 1e-6


@dataclass(frozen=True, slots=True)
class Grid:
    """Nodes on the box of a face's trim, its border included.

    u (U,), v (V,): parameters. points, normals (U, V, 3): mm, unit and towards the cutter. curvature (U, V): largest
    normal curvature, 1/mm, positive where the face bends towards the cutter. inside (U, V): on the trimmed face.
    pitch: mean distance of nodes along u and along v, mm. area (U, V): mm2 that each stands for, 0 outside.
    border (B, 3): points on the border of the trim, mm, which no node need be near; border_node (B,): the flat index of
    the node inside that is nearest to each.
    """

    u: Array
    v: Array
    points: Array
    normals: Array
    curvature: Array
    inside: Flags
    pitch: tuple[float, float]
    area: Array
    border: Array
    border_node: IntArray

    @classmethod
    def of(cls, face: WorkFace, spacing: float = SPACING) -> Grid:
        """The grid of a face, nodes about `spacing` mm apart."""
        corners = np.concatenate(face.face.loops)
        low, high = corners.min(axis=0), corners.max(axis=0)
        probe = np.linspace(0.0, 1.0, 17)
        frame = face.projector.evaluate(
            *(g.ravel() for g in np.meshgrid(*(low[k] + probe * (high[k] - low[k]) for k in (0, 1)), indexing="ij"))
        )
        lengths = [float(np.linalg.norm(frame[:, 1 + k], axis=1).mean() * (high[k] - low[k])) for k in (0, 1)]
        spacing = max(spacing, float(np.sqrt(lengths[0] * lengths[1] / MOST_NODES)))
        counts = [max(int(np.ceil(length / spacing)), 4) + 1 for length in lengths]
        u, v = (np.linspace(low[k], high[k], counts[k]) for k in (0, 1))
        places = np.stack(np.meshgrid(u, v, indexing="ij"), axis=-1).reshape(-1, 2)
        frame = face.projector.evaluate(places[:, 0], places[:, 1])
        cross = np.cross(frame[:, 1], frame[:, 2])
        size = np.linalg.norm(cross, axis=1)
        normals = face.sense * cross / np.maximum(size, 1e-300)[:, None]
        middle = 0.5 * (low + high)
        inside = on_face(face.face, middle + (places - middle) * (1.0 - INWARD)) & (size > 0.0)
        shape = (len(u), len(v))
        weight = np.outer(_ends_halved(len(u)), _ends_halved(len(v))).ravel()
        area = np.where(inside, size * weight * (u[1] - u[0]) * (v[1] - v[0]), 0.0)
        points = frame[:, 0].copy()
        border = face.border(spacing)
        within = np.flatnonzero(inside)
        border_node = (
            within[cKDTree(points[within]).query(border)[1]] if len(within) else np.zeros(len(border), np.int64)
        )
        return cls(
            u,
            v,
            points.reshape(*shape, 3),
            normals.reshape(*shape, 3),
            largest_curvature(frame, normals).reshape(shape),
            inside.reshape(shape),
            (lengths[0] / (len(u) - 1), lengths[1] / (len(v) - 1)),
            area.reshape(shape),
            border,
            border_node,
        )

    def swept(self, sweeps: Sequence[Sweep], tools: dict[str, Tool], allowance: float) -> tuple[Array, Array]:
        """Gap less allowance that sweeps leave at the nodes (U, V) and on the border (B,), mm.

        Infinite without sweeps, and at nodes off the face.
        """
        points = np.concatenate([self.points[self.inside], self.border])
        least = np.full(len(points), np.inf)
        for sweep in sweeps:
            least = np.minimum(least, motion_gap(sweep.motion, tools[sweep.tool], points, allowance)[0])
        gap = np.full(self.inside.shape, np.inf)
        count = len(points) - len(self.border)
        gap[self.inside] = least[:count]
        return gap, least[count:]

    def needed(self, gap: Array, border: Array, limit: float) -> Flags:
        """Nodes where more than `limit` mm is left, and those beside a place on the border where there is, (U, V)."""
        found = self.inside & (gap > limit)
        found.flat[self.border_node[border > limit]] = True
        return found

    @property
    def beside(self) -> float:
        """Places no further apart than this are neighbours, mm: a difference of their gaps is a step."""
        return max(BESIDE, NEIGHBOURS * float(np.sqrt(self.area.sum() / JUDGED)))

    def steps(self, gap: Array, limit: float) -> Flags:
        """Nodes with stock left beside which the gap is lower by more than `limit` mm, (U, V)."""
        known = np.where(self.inside, gap, np.inf)
        lowest = np.minimum(*(minimum_filter1d(known, self._window(self.beside)[k], axis=k) for k in (0, 1)))
        with np.errstate(invalid="ignore"):
            return np.asarray(self.inside & (known > 0.0) & (known - lowest > limit))

    def sink(self, gap: Array, cut: Flags, height: float, limit: float, most: float) -> Array:
        """How much deeper than aimed at passes go beside deep cuts, (U, V) mm, so that no step is higher than `limit`.

        Where a sweep cuts below the face, a crest of `height` beside its border would stand high over it: the passes
        sink by what is too much, by no more than `most`, nor so deep that stock beside what they cut (`cut`) would
        stand high over them. They come up again over `BLEND` mm.
        """
        known = self.inside & np.isfinite(gap)
        near, blend = self._window(self.beside + BLEND), self._window(BLEND)
        deepest = maximum_filter(np.where(known, np.maximum(-gap, 0.0), 0.0), size=near)
        highest = maximum_filter(np.where(known & ~cut, gap, 0.0), size=self._window(self.beside))
        over = np.clip(deepest + height - limit, 0.0, np.clip(limit - highest, 0.0, most))
        # The mean of maxima over windows that all hold a node's own surroundings is no less than what it needs.
        return np.asarray(uniform_filter(over, size=blend))

    def _window(self, way: float) -> tuple[int, int]:
        """Nodes of a window that goes this way to either side, mm."""
        return 2 * int(np.ceil(way / self.pitch[0])) + 1, 2 * int(np.ceil(way / self.pitch[1])) + 1

    def spots(self, needed: Flags, overlap: float) -> list[Flags]:
        """What is needed, nodes of each spot apart, (U, V) each; spots that meet within twice the overlap are one."""
        if not needed.any():
            return []
        near = self.distance(needed) <= overlap
        labels, count = label(near & self.inside, structure=np.ones((3, 3)))
        return [needed & (labels == number) for number in range(1, count + 1)]

    def distance(self, nodes: Flags) -> Array:
        """Distance of every node to the nearest of the given ones, mm, (U, V)."""
        return np.asarray(distance_transform_edt(~nodes, sampling=self.pitch))


def _ends_halved(count: int) -> Array:
    weight = np.ones(count)
    weight[[0, -1]] = 0.5
    return weight


def largest_curvature(frame: Array, normals: Array) -> Array:
    """Largest normal curvature (N,), 1/mm, from S, Su, Sv, Suu, Suv, Svv (N, 6, 3) and unit normals (N, 3)."""
    e, f, g = (np.einsum("ni,ni->n", frame[:, a], frame[:, b]) for a, b in ((1, 1), (1, 2), (2, 2)))
    l, m, n = (np.einsum("ni,ni->n", frame[:, k], normals) for k in (3, 4, 5))  # noqa: E741
    det = np.maximum(e * g - f * f, 1e-300)
    mean = (e * n - 2.0 * f * m + g * l) / (2.0 * det)
    gauss = (l * n - m * m) / det
    return np.asarray(mean + np.sqrt(np.maximum(mean**2 - gauss, 0.0)))
