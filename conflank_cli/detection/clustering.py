"""One sequence for each family of sweeps."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from conflank_cli.cover import greedy_cover
from conflank_cli.detection.tracing import Traced

Array = npt.NDArray[np.float64]

# Mean axes that are closer than this point the same way.
ONE_WAY_DEG = 25.0


def represent(traced: Traced, alike: float, smallest: float, most: int) -> list[int]:
    """Indices of sequences that represent the `most` largest families, largest area first, and what these miss.

    Two sequences are of one family where they cover the same part of the face (intersection over union of the areas
    above `alike`) with their axes pointing the same way (mean axes within ONE_WAY_DEG). The one of a family that covers
    most stands for it. Sequences that cover less than `smallest` mm2 are left out.

    Where much is in the way of long sweeps a part of the face may be left to short ones, which are not among the
    largest: of these follow those that cover most of what none before them does, as long as that is `smallest` or more.
    """
    if not traced.sequences:
        return []
    axes = np.array([sequence.d.mean(axis=0) for sequence in traced.sequences])
    axes /= np.linalg.norm(axes, axis=1)[:, None]
    areas = traced.cells @ traced.cell_areas
    order = np.argsort(-areas, kind="stable")
    left = order[areas[order] >= smallest]
    # Single precision halves the time of the products below, and overlaps need two digits.
    weighted = traced.cells[left] * np.sqrt(traced.cell_areas).astype(np.float32)
    # Those without a family; the largest of them stands for the next.
    open_ = np.ones(len(left), dtype=np.bool_)
    chosen: list[int] = []
    while open_.any() and len(chosen) < most:
        if 2 * np.count_nonzero(open_) < len(open_):
            left, weighted, open_ = left[open_], weighted[open_], open_[open_]
        first = int(np.argmax(open_))
        k = left[first]
        chosen.append(int(k))
        common = weighted @ weighted[first]
        union = areas[left] + areas[k] - common
        open_ &= (common <= alike * union) | (axes[left] @ axes[k] <= np.cos(np.radians(ONE_WAY_DEG)))
        open_[first] = False
    missed = traced.cell_areas * ~traced.cells[chosen].any(axis=0)
    if not missed.any():
        return chosen
    no_errors = np.zeros(len(traced.cells))
    return chosen + greedy_cover(traced.cells, missed, no_errors, 1.0, smallest / float(missed.sum()))
