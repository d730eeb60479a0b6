"""Greedy set cover by area (Calleja et al. 2018, section 5.3)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]


def greedy_cover(covers: BoolArray, areas: Array, target: float, least: float) -> list[int]:
    """Indices of sets that cover `target` of the area, each the largest gain left.

    Parameters
    ----------
    covers: (K, N), which points each set covers.
    areas: (N,), area of each point.
    target: fraction of the whole area to reach.
    least: stop where no set adds this fraction of the area any more.

    Sets that later choices made superfluous are taken out again. Does not promise the fewest sets.
    """
    total = areas.sum()
    chosen: list[int] = []
    left = areas.copy()
    while len(chosen) < len(covers) and left.sum() > (1.0 - target) * total:
        gains = covers @ left
        best = int(np.argmax(gains))
        if gains[best] < least * total:
            break
        chosen.append(best)
        left[covers[best]] = 0.0
    reached = areas[covers[chosen].any(axis=0)].sum() if chosen else 0.0
    for k in sorted(chosen, key=lambda k: float(covers[k] @ areas)):
        rest = [other for other in chosen if other != k]
        if rest and areas[covers[rest].any(axis=0)].sum() >= min(reached, target * total):
            chosen = rest
    return chosen
