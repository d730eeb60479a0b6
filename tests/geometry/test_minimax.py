"""The least maximum of linear errors against SciPy's linear programs."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import linprog

from conflank_cli.geometry.kernels.minimax import BOTH, IGNORED, LOWER, RELATIVE_GAP, least_maximum

SPHERES = 24


def largest(error: np.ndarray, kind: np.ndarray) -> float:
    return float(max(np.abs(error[kind == BOTH]).max(initial=0.0), (-error[kind == LOWER]).max(initial=0.0)))


@pytest.mark.parametrize("limit", [0.001, 0.1, 10.0])
@pytest.mark.parametrize("seed", range(12))
def test_least_maximum_against_linprog(seed: int, limit: float) -> None:
    """Rows as a line has them: level, slope, and a third one that hardly differs from nothing."""
    rng = np.random.default_rng(seed)
    arm = np.linspace(-0.3, 0.7, SPHERES)
    bend = arm**2 * rng.normal() * rng.choice([1e-4, 0.1])
    rows = np.stack([1.0 + 0.01 * rng.normal(size=SPHERES), arm, bend], axis=1)
    error = rng.choice([1e-3, 0.05]) * (rng.normal() * arm**3 + rng.normal() * arm**2 + rng.normal() * arm)
    kind = rng.choice([IGNORED, LOWER, BOTH, BOTH, BOTH], size=SPHERES)
    both, counts = kind == BOTH, kind != IGNORED
    left = np.concatenate(
        [np.hstack([-rows, -np.ones((SPHERES, 1))])[counts], np.hstack([rows, -np.ones((SPHERES, 1))])[both]]
    )
    right = np.concatenate([error[counts], -error[both]])
    expected = linprog([0, 0, 0, 1], left, right, bounds=[(-limit, limit)] * 3 + [(None, None)])
    change = np.empty(3)
    promised = least_maximum(rows, error, kind, limit, change)
    allowed = 2.0 * RELATIVE_GAP * largest(error, kind)
    assert largest(error + rows @ change, kind) <= expected.fun + allowed
    assert abs(promised - expected.fun) <= allowed
    assert np.abs(change).max() <= limit


def test_nothing_to_do_changes_nothing() -> None:
    change = np.ones(3)
    rows, error = np.ones((SPHERES, 3)), np.linspace(0.0, 1.0, SPHERES)
    assert least_maximum(rows, error, np.full(SPHERES, LOWER), 1.0, change) == 0.0
    np.testing.assert_array_equal(change, 0.0)
