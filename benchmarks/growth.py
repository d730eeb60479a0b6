"""How time grows with the amount of work."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

# Slope of log time over log work: above it, growth is worse than linear (the rest is the scatter of a shared machine).
LINEAR = 1.05


def fitted_exponent(work: Sequence[float], seconds: Sequence[float]) -> float:
    """Slope of log seconds over log work, by least squares."""
    return float(np.polyfit(np.log(work), np.log(seconds), 1)[0])
