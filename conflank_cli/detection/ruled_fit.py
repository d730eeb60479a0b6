"""From an ordered sequence of lines to a motion: the cubic ruled surface through them."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from conflank_cli.motion import DEGREE, Motion, fitted

Array = npt.NDArray[np.float64]

# A control point every so many millimetres of travel follows any blade that a cone can cut.
SPACING = 6.0
FEWEST, MOST = 6, 32


def fit_motion(p: Array, d: Array, length: float) -> Motion:
    """Least-squares cubic B-splines p(t), q(t) through lines (K, 3) each, K >= 4, in order.

    t runs with the travel of the middle of the axis. Does not promise |pq| = length: the fit is a start for the
    optimisation, which does.
    """
    q = p + length * d
    middle = 0.5 * (p + q)
    travel = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(middle, axis=0), axis=1))])
    t = travel / travel[-1]
    count = int(np.clip(round(travel[-1] / SPACING) + DEGREE, FEWEST, MOST))
    count = min(count, max(len(p) - 1, DEGREE + 1))
    both = np.hstack([p, q])
    # The fit is made on a finer, linearly interpolated sequence, for knot spans would be short of data.
    dense = np.linspace(0.0, 1.0, max(4 * count, len(t)))
    return fitted(dense, np.stack([np.interp(dense, t, both[:, k]) for k in range(6)], axis=1), count)
