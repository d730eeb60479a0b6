"""Families of lines that the line field does not lead to, and why it does not.

A line of the blind search is known to the field where some direction of the field at the same point, as it is or
refined, is within `SAME` of it, or the line that the reachability map has there. Lines that are not are put into
families: neighbouring samples, directions within `LINKED`. Each family gets the explanation that fits most of its
lines.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from benchmarks.blind_search import SPHERES, BlindLines, BlindSearch
from conflank_cli.detection.line_field import seed_lines
from conflank_cli.detection.reachability import Reachability
from conflank_cli.geometry.workface import FaceSamples

Array = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

SAME = np.radians(10.0)
# From one sample to the next a family may turn by this much.
LINKED = np.radians(20.0)
# Two asymptotic directions closer than this are about to merge, which is where second order says least.
MERGING = np.radians(25.0)
# Room that is left where the offset is about to fold, as a share: the field leaves such points out.
NO_ROOM = 0.02

NO_SPHERE = "sphere does not fit"
EDGE = "overhang"
FLAT = "bend within tolerance"
MERGE = "directions merge"
ELLIPTIC = "elliptic offset"
THIRD = "beyond second order"


@dataclass(frozen=True, slots=True)
class Family:
    """Lines that belong together.

    Attributes
    ----------
    why: the explanation of most of them.
    lines: how many.
    through: the samples they go through. alone: those of them that no line of the map reaches.
    area: mm2 of the samples they go through; area_alone: of those alone.
    curvature: median of |second derivative of the distance along the line|, 1/mm.
    """

    why: str
    lines: int
    through: IntArray
    alone: IntArray
    area: float
    area_alone: float
    curvature: float

    def row(self) -> dict[str, Any]:
        """As JSON has it."""
        return {
            "why": self.why,
            "lines": self.lines,
            "area_mm2": round(self.area, 2),
            "alone_mm2": round(self.area_alone, 2),
            "curvature_1_m": round(1e3 * self.curvature, 3),
        }


def blind_families(
    search: BlindSearch, samples: FaceSamples, lines: BlindLines, found: Reachability, tolerance: float
) -> list[Family]:
    """Families of lines within `tolerance` mm that only the blind search finds, largest area first."""
    index, place, rank = np.nonzero(lines.every <= tolerance)
    d, on = lines.d[index, place, rank], lines.on[index, place, rank]
    heights = search.heights[lines.contacts]
    field = seed_lines(search.face, search.tool, samples.uv, heights, 0.0)
    open_ = np.ones(len(index), dtype=np.bool_)
    near = _nearest(index, d, field.sample, field.d)
    open_ &= near > SAME
    reached = np.flatnonzero(np.isfinite(found.error))
    open_ &= _nearest(index, d, reached, found.d[reached]) > SAME
    # Refining the field costs footpoints, so only where there is something left to explain.
    asked = np.isin(field.sample, np.unique(index[open_]))
    error, refined = search.refined(samples, field.sample[asked], field.d[asked], field.height[asked])
    good = error <= tolerance
    open_ &= _nearest(index, d, field.sample[asked][good], refined[good]) > SAME
    index, place, d, on = index[open_], place[open_], d[open_], on[open_]
    if not len(index):
        return []
    why, curvature = explain(search, samples, index, heights[place], d, on, tolerance)
    labels = _components(samples, index, d)
    families = []
    for label in range(labels.max() + 1):
        mine = labels == label
        through = np.unique(index[mine])
        alone = through[found.error[through] > tolerance]
        families.append(
            Family(
                Counter(np.array(why)[mine].tolist()).most_common(1)[0][0],
                int(mine.sum()),
                through,
                alone,
                float(samples.areas[through].sum()),
                float(samples.areas[alone].sum()),
                float(np.median(curvature[mine])),
            )
        )
    return sorted(families, key=lambda family: -family.area)


def _nearest(index: IntArray, d: Array, other: IntArray, directions: Array) -> Array:
    """Angle (N,) from each direction d (N, 3) at a sample to the nearest of `directions` (M, 3) at the same sample."""
    angle = np.full(len(index), np.pi)
    order = np.argsort(other, kind="stable")
    low = np.searchsorted(other[order], index, side="left")
    high = np.searchsorted(other[order], index, side="right")
    for k in range(len(index)):
        if high[k] > low[k]:
            cosine = directions[order[low[k] : high[k]]] @ d[k]
            angle[k] = np.arccos(np.clip(cosine.max(), -1.0, 1.0))
    return angle


def _components(samples: FaceSamples, index: IntArray, d: Array) -> IntArray:
    """Number of the family of each line: neighbours in the grid of samples with directions within `LINKED`."""
    by_cell: dict[tuple[int, int], list[int]] = {}
    cells = samples.cell[index]
    for k, (i, j) in enumerate(cells):
        by_cell.setdefault((int(i), int(j)), []).append(k)
    pairs = []
    for (i, j), mine in by_cell.items():
        for di, dj in ((0, 0), (0, 1), (1, -1), (1, 0), (1, 1)):
            others = by_cell.get((i + di, j + dj), [])
            if others:
                a, b = np.nonzero(d[mine] @ d[others].T > np.cos(LINKED))
                pairs.append(np.stack([np.array(mine)[a], np.array(others)[b]]))
    links = np.concatenate(pairs, axis=1)
    graph = coo_matrix((np.ones(links.shape[1]), (links[0], links[1])), shape=(len(index), len(index)))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.int64)


def explain(
    search: BlindSearch,
    samples: FaceSamples,
    index: IntArray,
    height: Array,
    d: Array,
    on: IntArray,
    tolerance: float,
) -> tuple[Sequence[str], Array]:
    """Why the field does not lead to lines d (M, 3) at samples `index`, and the curvature left along them (M,).

    By second order: with the Hessian H of the distance at the offset of the sphere, the error along the line bends by
    k = wᵀ H w for its tangential part w. In this order: no sphere fits; the field has no direction to offer; two are
    about to merge; the bend over the run that has to touch stays within tolerance; part of the flute is off the face,
    so that the middle of what touches is elsewhere; else higher orders make up for the second.
    """
    curvatures, e1, e2 = principal(search, samples.uv[index])
    radius = search.radii[np.searchsorted(search.heights, height - 1e-9)]
    room = 1.0 - radius[:, None] * curvatures
    hessian = -curvatures / np.where(room > NO_ROOM, room, np.nan)
    along = np.stack([np.sum(d * e1, axis=1), np.sum(d * e2, axis=1)], axis=1)
    left = np.abs(np.sum(hessian * along**2, axis=1))
    ratio = -hessian[:, 0] / np.where(hessian[:, 1] == 0.0, 1e-30, hessian[:, 1])
    with np.errstate(invalid="ignore"):
        opening = 2.0 * np.arctan(np.sqrt(ratio))
    opening = np.minimum(opening, np.pi - opening)
    # A parabola over a run of length 2 a, shifted to leave least, is off by k a² / 4.
    half_run = 0.5 * (search.least - 1) * (search.heights[1] - search.heights[0])
    why = []
    for k in range(len(index)):
        if not np.all(room[k] > NO_ROOM):
            why.append(NO_SPHERE)
        elif ratio[k] < 0.0:
            why.append(ELLIPTIC)
        elif opening[k] < MERGING:
            why.append(MERGE)
        elif left[k] * half_run**2 / 4.0 <= tolerance:
            why.append(FLAT)
        elif on[k] < SPHERES:
            why.append(EDGE)
        else:
            why.append(THIRD)
    return why, np.where(np.isfinite(left), left, 0.0)


def principal(search: BlindSearch, uv: Array) -> tuple[Array, Array, Array]:
    """Principal curvatures (N, 2), positive where the face bends towards the cutter, and their directions (N, 3)."""
    frame = search.face.projector.evaluate(uv[:, 0], uv[:, 1])
    su, sv = frame[:, 1], frame[:, 2]
    normal = np.cross(su, sv)
    normal *= (search.face.sense / np.linalg.norm(normal, axis=1))[:, None]
    tangents = np.stack([su, sv], axis=1)
    metric = tangents @ np.swapaxes(tangents, 1, 2)
    second = np.einsum("nki,ni->nk", frame[:, 3:], normal)
    form = np.stack([second[:, [0, 1]], second[:, [1, 2]]], axis=1)
    # In the basis that the Cholesky factor of the metric makes orthonormal the form is symmetric.
    factor = np.linalg.inv(np.linalg.cholesky(metric))
    values, vectors = np.linalg.eigh(factor @ form @ np.swapaxes(factor, 1, 2))
    directions = np.swapaxes(vectors, 1, 2) @ factor @ tangents
    return values, directions[:, 0], directions[:, 1]
