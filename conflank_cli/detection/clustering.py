"""One sequence for each family of sweeps."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from conflank_cli.detection.tracing import Traced

Array = npt.NDArray[np.float64]


def represent(traced: Traced, alike: float, smallest: float) -> list[int]:
    """Indices of sequences that represent all families, largest area first.

    Two sequences are of one family where they cover the same part of the face (intersection over union of the areas
    above `alike`) with their axes pointing the same way (mean axes within 25 degrees). The one of a family that covers
    most stands for it. Sequences that cover less than `smallest` mm2 are left out.
    """
    if not traced.sequences:
        return []
    # Single precision halves the time of the products below, and overlaps need two digits.
    weighted = (traced.cells * np.sqrt(traced.cell_areas)).astype(np.float32)
    areas = (weighted**2).sum(axis=1)
    axes = np.array([sequence.d.mean(axis=0) for sequence in traced.sequences])
    axes /= np.linalg.norm(axes, axis=1)[:, None]
    chosen: list[int] = []
    open_ = areas >= smallest
    order = np.argsort(-areas, kind="stable")
    for k in order:
        if not open_[k]:
            continue
        chosen.append(int(k))
        common = weighted @ weighted[k]
        union = areas + areas[k] - common
        same = (common > alike * union) & (axes @ axes[k] > np.cos(np.radians(25.0)))
        open_ &= ~same
    return chosen
