"""A design face made ready for the stages: projection with a smooth margin, the trim as a raster, samples."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from conflank_cli.geometry.face import DesignFace
from conflank_cli.geometry.footpoint import Projector
from conflank_cli.geometry.kernels.polygon import inside_even_odd
from conflank_cli.tool import Tool

Array = npt.NDArray[np.float64]

# The raster of the trim resolves a few tenths of a millimetre on a blade; it steers weights only. Whatever is counted
# goes through the polygon itself.
RASTER = 384
# Spacing of the samples that measure the area of a face, mm.
COARSE = 2.0
# How far the surface is continued past the face for a cutter, as a share of its flute: it rarely overhangs by more.
OVERHANG = 0.7


@dataclass(frozen=True, slots=True)
class FaceSamples:
    """Points on a trimmed face, each standing for a piece of its area.

    uv (N, 2), points (N, 3) mm, normals (N, 3) unit and towards the cutter, areas (N,) mm2.
    cell (N, 2): row and column in the parameter grid the samples were drawn from, of `shape`.
    """

    uv: Array
    points: Array
    normals: Array
    areas: Array
    cell: npt.NDArray[np.int64]
    shape: tuple[int, int]


@dataclass(frozen=True, slots=True)
class WorkFace:
    """What detection, optimisation and selection ask of a face.

    Attributes
    ----------
    face: the design face.
    projector: footpoints on the surface and its extension.
    sense: +1 where S_u x S_v points to the cutter, else -1.
    raster: (R, R) share of the trimmed face in each cell of the extended domain, 0 or 1.
    """

    face: DesignFace
    projector: Projector
    sense: float
    raster: Array

    @classmethod
    def under(cls, face: DesignFace, tool: Tool) -> WorkFace:
        """Prepare a face for a cutter that overhangs it."""
        return cls.of(face, OVERHANG * tool.length)

    @classmethod
    def of(cls, face: DesignFace, margin: float) -> WorkFace:
        """Prepare a face; the surface is extended until it reaches about `margin` mm past the trim."""
        plain = Projector.of(face.surface)
        u0, u1, v0, v1 = face.surface.domain
        corners = np.concatenate(face.loops)
        low, high = corners.min(axis=0), corners.max(axis=0)
        middle_u, middle_v = 0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1])
        borders = plain.evaluate([low[0], high[0], middle_u, middle_u], [middle_v, middle_v, low[1], high[1]])
        speed = np.linalg.norm(borders[[0, 1, 2, 3], [1, 1, 2, 2]], axis=1)
        there = np.array([low[0] - u0, u1 - high[0], low[1] - v0, v1 - high[1]])
        missing = np.maximum(margin / np.maximum(speed, 1e-9) - there, 0.0)
        # A quadratic continuation is a fair guess over a part of the face's own size, not beyond.
        most = 0.4 * np.array([u1 - u0, u1 - u0, v1 - v0, v1 - v0])
        extension = np.minimum(missing, most)
        projector = Projector.of(
            face.surface, (float(extension[0]), float(extension[1]), float(extension[2]), float(extension[3]))
        )
        breaks_u, breaks_v = projector.spans.breaks_u, projector.spans.breaks_v
        u = breaks_u[0] + (np.arange(RASTER) + 0.5) / RASTER * (breaks_u[-1] - breaks_u[0])
        v = breaks_v[0] + (np.arange(RASTER) + 0.5) / RASTER * (breaks_v[-1] - breaks_v[0])
        grid = np.stack(np.meshgrid(u, v, indexing="ij"), axis=-1).reshape(-1, 2)
        raster = on_face(face, grid).astype(np.float64).reshape(RASTER, RASTER)
        return cls(face, projector, float(face.sense), raster)

    def spacing(self, count: int) -> float:
        """Spacing in mm at which about `count` samples cover the face."""
        return float(np.sqrt(self.samples(COARSE).areas.sum() / count))

    def samples(self, spacing: float) -> FaceSamples:
        """Points of the trimmed face about `spacing` mm apart, on a regular parameter grid clipped by the trim."""
        corners = np.concatenate(self.face.loops)
        low, high = corners.min(axis=0), corners.max(axis=0)
        probe = np.linspace(0.02, 0.98, 9)
        grid = np.stack(np.meshgrid(*(low[k] + probe * (high[k] - low[k]) for k in (0, 1)), indexing="ij"), axis=-1)
        frame = self.projector.evaluate(grid[..., 0].ravel(), grid[..., 1].ravel())
        length_u = np.percentile(np.linalg.norm(frame[:, 1], axis=1), 90) * (high[0] - low[0])
        length_v = np.percentile(np.linalg.norm(frame[:, 2], axis=1), 90) * (high[1] - low[1])
        count_u = int(np.clip(np.ceil(length_u / spacing), 8, 2000))
        count_v = int(np.clip(np.ceil(length_v / spacing), 8, 2000))
        u = low[0] + (np.arange(count_u) + 0.5) / count_u * (high[0] - low[0])
        v = low[1] + (np.arange(count_v) + 0.5) / count_v * (high[1] - low[1])
        uv = np.stack(np.meshgrid(u, v, indexing="ij"), axis=-1).reshape(-1, 2)
        cell = np.stack(np.meshgrid(np.arange(count_u), np.arange(count_v), indexing="ij"), axis=-1).reshape(-1, 2)
        keep = on_face(self.face, uv)
        uv, cell = uv[keep], cell[keep]
        frame = self.projector.evaluate(uv[:, 0], uv[:, 1])
        cross = np.cross(frame[:, 1], frame[:, 2])
        size = np.linalg.norm(cross, axis=1)
        area = size * (high[0] - low[0]) / count_u * (high[1] - low[1]) / count_v
        normals = self.sense * cross / np.maximum(size, 1e-300)[:, None]
        return FaceSamples(uv, np.ascontiguousarray(frame[:, 0]), normals, area, cell, (count_u, count_v))

    def border(self, spacing: float) -> Array:
        """Points of the trimmed face's border at most about `spacing` mm apart, shape (N, 3)."""
        pieces = []
        for loop in self.face.loops:
            closed = np.vstack([loop, loop[:1]])
            # A long edge of the polyline may bend in space, so its length is taken in parts.
            fine = np.linspace(0.0, 1.0, 17)[:-1, None]
            for start, end in pairwise(closed):
                uv = start + fine * (end - start)
                points = self.projector.evaluate(uv[:, 0], uv[:, 1])[:, 0]
                length = np.linalg.norm(np.diff(points, axis=0), axis=1).sum() * len(fine) / (len(fine) - 1)
                count = max(int(np.ceil(length / spacing)), 1)
                uv = start + np.arange(count)[:, None] / count * (end - start)
                pieces.append(self.projector.evaluate(uv[:, 0], uv[:, 1])[:, 0])
        return np.concatenate(pieces)


def loop_vertices(face: DesignFace) -> tuple[Array, npt.NDArray[np.int64]]:
    """The loops of a trim one after the other, (M, 2), and where each begins, (K + 1,)."""
    starts = np.cumsum([0, *(len(loop) for loop in face.loops)])
    return np.ascontiguousarray(np.concatenate(face.loops)), starts


def on_face(face: DesignFace, uv: Array) -> npt.NDArray[np.bool_]:
    """Which parameter points (N, 2) lie on the trimmed face, by the even-odd rule."""
    vertices, starts = loop_vertices(face)
    out = np.empty(len(uv), dtype=np.bool_)
    inside_even_odd(uv[:, 0].copy(), uv[:, 1].copy(), vertices, starts, out)
    return out
