"""The deepest overcut, the highest stock and the largest step of a face, found between the points of its grid.

The largest of samples is less than the largest there is. So the worst places among them are looked at ever more closely
on the surface itself: the best of eight points around each takes its place, and where none is better the eight come
nearer by half.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from conflank_cli.geometry.face import DesignFace
from conflank_cli.verification.evaluation import inside_loops
from conflank_cli.verification.sampling import FaceSample, points_and_normals
from conflank_cli.verification.swept import SweptGap, SweptMotions

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]

_WORST = 12
"""Places of a face, of its grid and of its border each, that are looked at more closely, for overcut and for stock."""

_PAIRS = 12
"""Pairs of points across the border of two patches that are looked at more closely."""

_ROUNDS, _SMALLEST = 40, 5e-4
"""What is looked at is halved wherever nothing around is better, to this share of the distance of points, 0.00015 mm on
a blade, by which nothing changes by 0.05 um; and so many times it is looked around at most."""

_SIFTED, _KEPT = 3, 3
"""After so many rounds only so many places are followed, of each kind."""

_AROUND = np.array([(i, j) for i in (-1.0, 0.0, 1.0) for j in (-1.0, 0.0, 1.0) if i or j])
"""Where around a place points are looked at."""

Gap = Callable[[DesignFace, Array], tuple[SweptGap, Array, Flags]]
"""From parameters (N, 2) on a face to the gap there, the points, and which of them are on the trimmed face."""


def gap_on(motions: SweptMotions, allowance: float) -> Gap:
    """The gap at places of faces, by the motions of a program; what is to be left is `allowance` mm."""

    def gap(face: DesignFace, uv: Array) -> tuple[SweptGap, Array, Flags]:
        points, normals, sound = points_and_normals(face, uv)
        return motions.gap(points + allowance * normals), points, sound

    return gap


@dataclass(frozen=True, slots=True)
class Extremes:
    """The worst places of all faces, K of them.

    Attributes
    ----------
    points: (K, 3) mm.
    face: (K,) index of the face each is on.
    swept: the gap there.
    step: largest difference of the gap across the border of two patches, mm; None where there is no border.
    """

    points: Array
    face: Integers
    swept: SweptGap
    step: float | None


def face_extremes(
    faces: Sequence[DesignFace],
    samples: Sequence[FaceSample],
    swept: SweptGap,
    covers: Callable[[Array], Flags],
    gap_at: Gap,
) -> Extremes:
    """Overcut, stock and step of all faces at their worst; `swept` is the gap at all points of all samples."""
    first, points, numbers, steps = 0, [], [], []
    worst: SweptGap | None = None
    for number, (face, sample) in enumerate(zip(faces, samples, strict=True)):
        own = swept.only(slice(first, first + len(sample.points)))
        first += len(sample.points)
        found, places, _ = gap_at(face, worst_places(face, sample, own.gap, gap_at))
        worst = found if worst is None else worst.then(found)
        points.append(places)
        numbers.append(np.full(len(places), number, dtype=np.int64))
        step = largest_step(face, sample, own, covers, gap_at)
        steps += [] if step is None else [step]
    assert worst is not None, "a scene has a face"
    return Extremes(np.concatenate(points), np.concatenate(numbers), worst, max(steps, default=None))


def worst_places(face: DesignFace, sample: FaceSample, gap: Array, gap_at: Gap) -> Array:
    """Parameters (K, 2) of the deepest overcut and the highest stock near the worst points of a face.

    gap: (N,) at the points of the sample.
    """
    inner = sample.area > 0.0
    seeds, signs = [], []
    for sign in (-1.0, 1.0):
        value = sign * gap
        top = _summits(value, np.concatenate([sample.neighbours, sample.along]))
        for group in (inner, ~inner):
            own = np.flatnonzero(top & group)
            own = own[np.argsort(-value[own], kind="stable")[:_WORST]]
            seeds.append(own)
            signs.append(np.full(len(own), sign))
    seed, sign_of = np.concatenate(seeds), np.concatenate(signs)
    on_border = ~inner[seed]

    def value_at(uv: Array, owner: Integers) -> Array:
        swept, _, sound = gap_at(face, uv)
        on_face = on_border[owner]
        on_face[~on_face] = inside_loops(face.loops, uv[~on_face])
        return np.where(sound & on_face, sign_of[owner] * swept.gap, -np.inf)

    # On the border a point stands for what is ahead of it.
    low, high = np.where(on_border, 0.0, -np.inf), np.where(on_border, 1.0, np.inf)
    climbers = _Climbers(sample.uv[seed], sample.reach[seed], low, high, sign_of)
    return climbers.climbed(sign_of * gap[seed], value_at)[0]


@dataclass(frozen=True, slots=True)
class _Climbers:
    """Places in a parameter plane from which something is to be made as large as it gets, K of them.

    start (K, 2); ways (K, 2, 2) along which they go; low, high (K,): least and largest share of the first way that is
    taken; kind (K,): which of them are compared.
    """

    start: Array
    ways: Array
    low: Array
    high: Array
    kind: Array

    def climbed(self, best: Array, value_at: Callable[[Array, Integers], Array]) -> tuple[Array, Array]:
        """Where the best of each kind get to, (L, 2), and what it is there, (L,); `best` is what it is at first, (K,).

        value_at: from places (M, 2) and the numbers (M,) of those they belong to, what it is there.
        """
        best, share, half = best.copy(), np.zeros((len(best), 2)), np.full(len(best), 0.5)
        alive = np.arange(len(best))
        for turn in range(_ROUNDS):
            if turn == _SIFTED:
                alive = np.concatenate(
                    [own[np.argsort(-best[own], kind="stable")[:_KEPT]] for own in self._by_kind(alive)]
                )
            moving = alive[half[alive] > _SMALLEST]
            if not len(moving):
                break
            around = share[moving, None] + half[moving, None, None] * _AROUND
            around[..., 0] = np.clip(around[..., 0], self.low[moving, None], self.high[moving, None])
            places = self.start[moving, None] + np.einsum("knw,kwx->knx", around, self.ways[moving])
            owner = np.repeat(moving, len(_AROUND))
            value = value_at(np.ascontiguousarray(places.reshape(-1, 2)), owner).reshape(len(moving), -1)
            pick = value.argmax(axis=1)
            found = value[np.arange(len(moving)), pick]
            better = found > best[moving]
            best[moving] = np.where(better, found, best[moving])
            share[moving] = np.where(better[:, None], around[np.arange(len(moving)), pick], share[moving])
            # Along a crest that runs across the grid the same step may be taken again.
            half[moving] = np.where(better, 1.0, 0.5) * half[moving]
        return self.start[alive] + np.einsum("kw,kwx->kx", share[alive], self.ways[alive]), best[alive]

    def _by_kind(self, chosen: Integers) -> list[Integers]:
        return [chosen[self.kind[chosen] == kind] for kind in np.unique(self.kind[chosen])]


def _summits(value: Array, pairs: Integers) -> Flags:
    """Which points (N,) are no lower than all those beside them."""
    highest = np.full(len(value), -np.inf)
    np.maximum.at(highest, pairs[:, 0], value[pairs[:, 1]])
    np.maximum.at(highest, pairs[:, 1], value[pairs[:, 0]])
    return np.asarray(value >= highest)


def largest_step(
    face: DesignFace, sample: FaceSample, swept: SweptGap, covers: Callable[[Array], Flags], gap_at: Gap
) -> float | None:
    """Largest difference of the gap across the border of two patches of a face, mm; None where there is no border.

    swept: at the points of the sample. The gap itself is continuous; a step is what it changes by over the distance of
    two points of the grid, wherever that is laid across the border.
    """
    if len(swept.by_cut) < 2:
        return None
    a, b = sample.neighbours[:, 0], sample.neighbours[:, 1]
    step = _steps(swept.only(a), swept.only(b), covers)
    if not (step >= 0.0).any():
        return None
    chosen = np.argsort(-step, kind="stable")[:_PAIRS]
    chosen = chosen[step[chosen] >= 0.0]
    start, across = sample.uv[a[chosen]], sample.uv[b[chosen]] - sample.uv[a[chosen]]

    def step_at(uv: Array, owner: Integers) -> Array:
        beyond = uv + across[owner]
        swept, _, sound = gap_at(face, np.concatenate([uv, beyond]))
        sound &= inside_loops(face.loops, np.concatenate([uv, beyond]))
        found = _steps(swept.only(slice(0, len(uv))), swept.only(slice(len(uv), None)), covers)
        return np.where(sound[: len(uv)] & sound[len(uv) :], found, -1.0)

    anywhere = np.full(len(chosen), np.inf)
    climbers = _Climbers(start, sample.reach[a[chosen]], -anywhere, anywhere, np.zeros(len(chosen)))
    return float(climbers.climbed(step[chosen], step_at)[1].max())


def _steps(one: SweptGap, other: SweptGap, covers: Callable[[Array], Flags]) -> Array:
    """Differences of the gap at pairs of points (N,), -1 where these are not covered by two different cuts."""
    first, last = _nearest_cut(one), _nearest_cut(other)
    border = (first != last) & (first >= 0) & (last >= 0) & covers(one.gap) & covers(other.gap)
    return np.where(border, np.abs(one.gap - other.gap), -1.0)


def _nearest_cut(swept: SweptGap) -> Integers:
    """Which cut comes nearest to each point (N,), -1 for none."""
    least = swept.by_cut.min(axis=0)
    return np.where(np.isfinite(least), swept.by_cut.argmin(axis=0), -1)
