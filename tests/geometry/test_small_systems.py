"""Small systems against LAPACK."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from conflank_cli.geometry.kernels.small_systems import factorise, least_eigenvector, substitute


@settings(deadline=None, derandomize=True)
@given(st.integers(1, 6), st.integers(0, 2**32 - 1))
def test_a_positive_system_is_solved(size: int, seed: int) -> None:
    random = np.random.default_rng(seed)
    root = random.normal(size=(size, size))
    matrix = root @ root.T + np.eye(size)
    right = random.normal(size=size)
    factor, out = matrix.copy(), np.empty(size)
    factorise(factor)
    substitute(factor, right, out)
    np.testing.assert_allclose(matrix @ out, right, atol=1e-10)
    assert np.array_equal(np.triu(factor, 1), np.triu(matrix, 1))


def test_the_right_side_may_be_overwritten() -> None:
    matrix, right = np.array([[4.0, 2.0], [2.0, 3.0]]), np.array([8.0, 7.0])
    factorise(matrix)
    substitute(matrix, right, right)
    np.testing.assert_allclose(right, [1.25, 1.5], rtol=1e-15)


@settings(deadline=None, derandomize=True)
@given(st.integers(1, 6), st.integers(0, 2**32 - 1), st.floats(1e-6, 1e6))
def test_least_eigenvector_against_lapack(size: int, seed: int, scale: float) -> None:
    random = np.random.default_rng(seed)
    root = random.normal(size=(size, size))
    matrix = scale * (root + root.T)
    out = np.empty(size)
    value = least_eigenvector(matrix.copy(), np.empty((size, size)), out)
    largest = np.abs(matrix).max()
    assert value == pytest.approx(np.linalg.eigvalsh(matrix)[0], abs=1e-12 * largest)
    assert np.linalg.norm(out) == pytest.approx(1.0, abs=1e-13)
    np.testing.assert_allclose(matrix @ out, value * out, atol=1e-12 * largest)


def test_a_diagonal_matrix_is_left_as_it_is() -> None:
    out = np.empty(3)
    value = least_eigenvector(np.diag([2.0, -1.0, 5.0]), np.empty((3, 3)), out)
    assert value == -1.0
    assert np.array_equal(out, [0.0, 1.0, 0.0])
