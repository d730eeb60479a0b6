"""Footpoints of points on a design face: cold starts from a spatial index, warm starts from the caller."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from conflank_cli.cores import spread
from conflank_cli.geometry.kernels import footpoint as kernel
from conflank_cli.geometry.surface import BSplineSurface, Spans, to_spans

Array = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

INTERIOR = kernel.INTERIOR
CLAMPED = kernel.CLAMPED
OUTSIDE = kernel.OUTSIDE
FAILED = kernel.FAILED

# Below this many points a thread costs more than it gives.
WORTH_A_THREAD = 2048
# Seeds a span and direction: Newton converges from anywhere within a third of a cubic span.
SEEDS_PER_SPAN = 3
SEEDS_AT_LEAST = 24
SEEDS_AT_MOST = 400


class Footpoints(NamedTuple):
    """Footpoints of N points.

    u, v (N,): parameters. foot (N, 3): points on the surface, mm. normal (N, 3): unit S_u x S_v. distance (N,): signed
    by the normal, mm. flag (N,): INTERIOR, CLAMPED, OUTSIDE or FAILED.
    """

    u: Array
    v: Array
    foot: Array
    normal: Array
    distance: Array
    flag: IntArray


@dataclass(frozen=True, slots=True)
class Projector:
    """A surface ready for projection.

    Attributes
    ----------
    spans: the surface, possibly extended.
    tree: index over sample points of the surface.
    seeds: (M, 2) parameters of the samples.
    """

    spans: Spans
    tree: cKDTree
    seeds: Array

    @classmethod
    def of(
        cls, surface: BSplineSurface, extension: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    ) -> Projector:
        """Prepare a surface; `extension` as in `to_spans`."""
        spans = to_spans(surface, extension)
        u = _samples(spans.breaks_u)
        v = _samples(spans.breaks_v)
        seeds = np.stack(np.meshgrid(u, v, indexing="ij"), axis=-1).reshape(-1, 2)
        points = np.empty((len(seeds), 6, 3))
        kernel.evaluate(
            spans.breaks_u, spans.breaks_v, spans.coefficients, seeds[:, 0].copy(), seeds[:, 1].copy(), points
        )
        return cls(spans, cKDTree(points[:, 0]), seeds)

    def evaluate(self, u: npt.ArrayLike, v: npt.ArrayLike) -> Array:
        """S, Su, Sv, Suu, Suv, Svv at parameters u, v (N,): shape (N, 6, 3)."""
        u, v = np.broadcast_arrays(np.asarray(u, dtype=np.float64), np.asarray(v, dtype=np.float64))
        out = np.empty((u.size, 6, 3))
        spans = self.spans
        kernel.evaluate(spans.breaks_u, spans.breaks_v, spans.coefficients, u.ravel().copy(), v.ravel().copy(), out)
        return out

    def project(self, points: Array, u: Array | None = None, v: Array | None = None) -> Footpoints:
        """Project points (N, 3); warm from u, v (N,) where given, else cold from the nearest sample.

        Does not promise the globally nearest point where two parts of the surface are about equally near and the seed's
        cell straddles both; nor a foot on a crease (a knot of full multiplicity, where the tangents jump): such points
        are FAILED.
        """
        points = np.ascontiguousarray(points, dtype=np.float64)
        if u is None or v is None:
            start = self.seeds[self.tree.query(points)[1]]
            u, v = start[:, 0].copy(), start[:, 1].copy()
        else:
            u, v = np.array(u, dtype=np.float64), np.array(v, dtype=np.float64)
        count = len(points)
        foot, normal = np.empty((count, 3)), np.empty((count, 3))
        distance, flag = np.empty(count), np.empty(count, dtype=np.int64)
        found = Footpoints(u, v, foot, normal, distance, flag)
        self.project_into(points, found)
        return found

    def project_into(self, points: Array, found: Footpoints) -> None:
        """Project points (N, 3) from the u, v of `found`, into its arrays; new ones can cost half as much again."""

        def run(part: slice) -> None:
            kernel.footpoints(*self.spans, points[part], *(field[part] for field in found))

        spread(run, len(points), WORTH_A_THREAD)


def _samples(breaks: Array) -> Array:
    """Sample parameters: a few in every span, more where there are few spans, thinned where there are very many."""
    spans = len(breaks) - 1
    per_span = max(SEEDS_PER_SPAN, -(-SEEDS_AT_LEAST // spans))
    fractions = np.arange(per_span) / per_span
    inner = (breaks[:-1, None] + np.diff(breaks)[:, None] * fractions).ravel()
    samples = np.append(inner, breaks[-1])
    step = -(-len(samples) // SEEDS_AT_MOST)
    return np.append(samples[:-1:step], samples[-1])
