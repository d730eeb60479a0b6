"""Symmetric systems of a few unknowns inside of loops, where a call of LAPACK costs more than the work."""

from __future__ import annotations

import numpy as np
from numba import njit

# A pivot that rounding has made less than this is taken for it.
LEAST_PIVOT = 1e-30
# Jacobi's method converges quadratically: five sweeps are usual for four unknowns. Off the diagonal, less than this
# share of it is rounding.
SWEEPS = 30
DIAGONAL = 1e-15


@njit(cache=True, nogil=True)
def factorise(matrix):
    """Replace the lower triangle of a symmetric positive matrix (N, N) by its Cholesky factor; the rest is not read."""
    for k in range(matrix.shape[0]):
        for m in range(k + 1):
            total = matrix[k, m]
            for n in range(m):
                total -= matrix[k, n] * matrix[m, n]
            matrix[k, m] = np.sqrt(max(total, LEAST_PIVOT)) if k == m else total / matrix[m, m]


@njit(cache=True, nogil=True)
def substitute(matrix, right, out):
    """Solve for a matrix (N, N) that `factorise` has replaced; right (N,) into out (N,), which may be the same."""
    size = matrix.shape[0]
    for a in range(size):
        total = right[a]
        for b in range(a):
            total -= matrix[a, b] * out[b]
        out[a] = total / matrix[a, a]
    for a in range(size - 1, -1, -1):
        total = out[a]
        for b in range(a + 1, size):
            total -= matrix[b, a] * out[b]
        out[a] = total / matrix[a, a]


@njit(cache=True, nogil=True)
def least_eigenvector(matrix, vectors, out):
    """Unit eigenvector (N,) of the least eigenvalue of a symmetric matrix (N, N) into `out`; returns that eigenvalue.

    The matrix is overwritten; vectors (N, N) is room to work in.

    Source: Jacobi's cyclic method; Golub and Van Loan, Matrix Computations, 8.5.
    """
    size = matrix.shape[0]
    for a in range(size):
        for b in range(size):
            vectors[a, b] = 1.0 if a == b else 0.0
    for _ in range(SWEEPS):
        turned = False
        for a in range(size):
            for b in range(a + 1, size):
                off = matrix[a, b]
                if abs(off) <= DIAGONAL * (abs(matrix[a, a]) + abs(matrix[b, b])):
                    continue
                turned = True
                slope = 0.5 * (matrix[b, b] - matrix[a, a]) / off
                t = 1.0 / (abs(slope) + np.sqrt(1.0 + slope * slope))
                if slope < 0.0:
                    t = -t
                c = 1.0 / np.sqrt(1.0 + t * t)
                s = t * c
                for k in range(size):
                    x, y = matrix[k, a], matrix[k, b]
                    matrix[k, a], matrix[k, b] = c * x - s * y, s * x + c * y
                for k in range(size):
                    x, y = matrix[a, k], matrix[b, k]
                    matrix[a, k], matrix[b, k] = c * x - s * y, s * x + c * y
                    x, y = vectors[k, a], vectors[k, b]
                    vectors[k, a], vectors[k, b] = c * x - s * y, s * x + c * y
        if not turned:
            break
    least = 0
    for a in range(1, size):
        if matrix[a, a] < matrix[least, least]:
            least = a
    for a in range(size):
        out[a] = vectors[a, least]
    return matrix[least, least]
