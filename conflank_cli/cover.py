"""Set cover on the points of a face: which few sweeps leave most of it within tolerance.

Source: greedy choice by area, Calleja et al. (2018), section 5.3.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]

# Gains this near to the largest count as equal; the more accurate sweep is then preferred.
EQUAL = 0.99
# Keeps the mean over no area defined, mm2.
LEAST_AREA = 1e-12
# So many of the largest sets are tried as a first choice.
STARTS = 10


def mean_errors(covers: BoolArray, gaps: Array, areas: Array) -> Array:
    """Mean |g| (K,) of each set over the area that it covers, from gaps (K, N); 0 where it covers nothing."""
    return np.asarray(np.where(covers, np.abs(gaps), 0.0) @ areas / np.maximum(covers @ areas, LEAST_AREA))


def share_covered(covers: BoolArray, areas: Array, chosen: Sequence[int]) -> float:
    """Share of the area that the chosen of the sets (K, N) cover together."""
    return float(areas[covers[list(chosen)].any(axis=0)].sum() / areas.sum())


def greedy_cover(
    covers: BoolArray,
    areas: Array,
    errors: Array,
    target: float,
    least: float,
    first: int | None = None,
    prices: Array | None = None,
) -> list[int]:
    """Indices of sets that cover `target` of the area, each with the largest gain left.

    Parameters
    ----------
    covers: (K, N), which points each set covers.
    areas: (N,), area of each point.
    errors: (K,), mean |g| of each set; decides between gains that are about equal.
    target: fraction of the whole area to reach.
    least: stop where no set adds this fraction of the area any more.
    first: a set to begin with, whatever its gain.
    prices: (K,), where what counts is the gain for its price.

    Sets that later choices made superfluous are taken out again. Does not promise the fewest sets.
    """
    return _greedy(covers, covers.astype(np.float64), areas, errors, target, least, first, prices)


def _greedy(
    covers: BoolArray,
    counts: Array,
    areas: Array,
    errors: Array,
    target: float,
    least: float,
    first: int | None,
    prices: Array | None,
) -> list[int]:
    """The same with the covers as numbers too, which takes longer to make than to use."""
    total = areas.sum()
    chosen: list[int] = []
    left = areas.copy()
    while len(chosen) < len(covers) and left.sum() > (1.0 - target) * total:
        gains = counts @ left
        gains[gains < least * total] = 0.0
        merits = gains if prices is None else gains / prices
        largest = merits.max()
        if largest <= 0.0:
            break
        equal = np.flatnonzero(merits >= EQUAL * largest)
        best = int(equal[np.argmin(errors[equal])]) if chosen or first is None else first
        chosen.append(best)
        left[covers[best]] = 0.0
    reached = areas[covers[chosen].any(axis=0)].sum() if chosen else 0.0
    for k in sorted(chosen, key=lambda k: float(counts[k] @ areas)):
        rest = [other for other in chosen if other != k]
        if rest and areas[covers[rest].any(axis=0)].sum() >= min(reached, target * total):
            chosen = rest
    return chosen


def fewest_cover(covers: BoolArray, areas: Array, errors: Array, target: float, least: float) -> list[int]:
    """The best of greedy covers that begin with each of the larger sets in turn.

    A cover that reaches the target goes before one that does not, then the fewer sets, then the larger area. Never
    worse than `greedy_cover`, whose arguments it takes. Does not promise the fewest sets of all.
    """
    counts = covers.astype(np.float64)
    greedy = _greedy(covers, counts, areas, errors, target, least, None, None)
    if not greedy:
        return greedy
    sizes = counts @ areas
    starts = np.argsort(-sizes, kind="stable")[:STARTS]
    starts = starts[sizes[starts] > 0.0]
    candidates = [greedy, *(_greedy(covers, counts, areas, errors, target, least, int(k), None) for k in starts)]

    def merit(chosen: list[int]) -> tuple[bool, float, float]:
        area = share_covered(covers, areas, chosen)
        if area < target:
            return (False, area, -float(len(chosen)))
        return (True, -float(len(chosen)), area)

    return max(candidates, key=merit)


def shortlist(covers: BoolArray, areas: Array, errors: Array, target: float, count: int, least: float) -> list[int]:
    """About `count` indices that belong to good covers: `fewest_cover` in turn, each without those before."""
    open_ = np.ones(len(covers), dtype=np.bool_)
    chosen: list[int] = []
    while len(chosen) < count and open_.any():
        index = np.flatnonzero(open_)
        found = index[fewest_cover(covers[index], areas, errors[index], target, least)]
        if not len(found):
            break
        chosen.extend(int(k) for k in found)
        open_[found] = False
    return chosen
