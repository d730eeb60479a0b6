"""Banded normal equations of cubic B-spline control points, p and q of each: what residuals add to them.

Throughout, first (m,) are the first of the four control points that a time acts on, value, slope and bend (m, 4) the
basis there and its derivatives. band (24, 6 n): the lower band of the matrix, band[r, c] = M[c + r, c]; right (6 n,):
minus the gradient.
"""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(nogil=True)
def add_block(band, right, point, basis, i, block, vector):
    """Add what acts on p(t) and q(t), of which block (6, 6) is the lower triangle, to four control points from `point`.

    basis (m, 4): row i counts.
    """
    for c in range(4):
        column = 6 * (point + c)
        for a in range(6):
            right[column + a] += basis[i, c] * vector[a]
        for r in range(c, 4):
            factor = basis[i, c] * basis[i, r]
            offset = 6 * (r - c)
            for b in range(6):
                for a in range(6):
                    if offset + a - b >= 0:
                        band[offset + a - b, column + b] += factor * (block[a, b] if a >= b else block[b, a])


@njit(cache=True, nogil=True)
def add_rows(band, right, first, value, rows, residuals, weights):
    """Add weighted residual rows, k at each of m times.

    Row k at time i has the gradient rows[i, k] (6,) by p(t) and q(t), the residual residuals[i, k] and the weight
    weights[i, k].
    """
    block = np.empty((6, 6))
    vector = np.empty(6)
    for i in range(rows.shape[0]):
        for a in range(6):
            vector[a] = 0.0
            for b in range(6):
                block[a, b] = 0.0
        for k in range(rows.shape[1]):
            w = weights[i, k]
            if w == 0.0:
                continue
            for a in range(6):
                wa = w * rows[i, k, a]
                vector[a] -= wa * residuals[i, k]
                for b in range(a + 1):
                    block[a, b] += wa * rows[i, k, b]
        add_block(band, right, first[i], value, i, block, vector)


@njit(cache=True, nogil=True)
def add_errors(band, right, first, value, fractions, normals, errors, weights):
    """Add axis errors (m, n) of spheres at fractions (n,) of pq, with their normals (m, n, 3) and weights (m, n)."""
    block = np.empty((6, 6))
    vector = np.empty(6)
    for i in range(errors.shape[0]):
        for a in range(6):
            vector[a] = 0.0
            for b in range(6):
                block[a, b] = 0.0
        for j in range(errors.shape[1]):
            w = weights[i, j]
            if w == 0.0:
                continue
            s = fractions[j]
            for a in range(3):
                wa = w * normals[i, j, a]
                vector[a] -= (1.0 - s) * wa * errors[i, j]
                vector[3 + a] -= s * wa * errors[i, j]
                for b in range(3):
                    wab = wa * normals[i, j, b]
                    block[a, b] += (1.0 - s) * (1.0 - s) * wab
                    block[3 + a, b] += s * (1.0 - s) * wab
                    block[3 + a, 3 + b] += s * s * wab
        add_block(band, right, first[i], value, i, block, vector)


@njit(cache=True, nogil=True)
def axis_path(first, value, slope, bend, control, length, curvature, d, excess, velocity, speed, cosine):
    """A motion of control points (n, 6) at m times: fills what `AxisPath` has of it, in the shapes named there.

    length: that of the axis, mm.
    """
    ends = np.empty(6)
    for i in range(first.shape[0]):
        for a in range(6):
            ends[a] = 0.0
            curvature[i, a] = 0.0
        for a in range(3):
            velocity[i, a] = 0.0
        for c in range(4):
            point = first[i] + c
            for a in range(6):
                ends[a] += value[i, c] * control[point, a]
                curvature[i, a] += bend[i, c] * control[point, a]
            for a in range(3):
                velocity[i, a] += 0.5 * slope[i, c] * (control[point, a] + control[point, 3 + a])
        span = 0.0
        fast = 0.0
        along = 0.0
        for a in range(3):
            d[i, a] = ends[3 + a] - ends[a]
            span += d[i, a] * d[i, a]
            fast += velocity[i, a] * velocity[i, a]
        span = np.sqrt(span)
        speed[i] = np.sqrt(fast)
        for a in range(3):
            d[i, a] /= span
            along += d[i, a] * velocity[i, a]
        excess[i] = span - length
        cosine[i] = along / speed[i]


@njit(cache=True, nogil=True)
def add_path(band, right, first, value, slope, bend, curvature, d, excess, speed, cosine, rigid, near, fair, across):
    """Add what keeps a motion a motion, as `axis_path` found it, with the weight of each residual.

    rigid: of |pq| - L. near: of the way of the axis ends in this step. fair: of their second derivatives. across: of
    the cosine between velocity and axis.
    """
    block = np.empty((6, 6))
    vector = np.empty(6)
    for i in range(first.shape[0]):
        for a in range(3):
            w = rigid * d[i, a]
            vector[a] = w * excess[i]
            vector[3 + a] = -w * excess[i]
            for b in range(3):
                block[a, b] = w * d[i, b]
                block[3 + a, b] = -w * d[i, b]
                block[3 + a, 3 + b] = w * d[i, b]
        for a in range(6):
            block[a, a] += near
        add_block(band, right, first[i], value, i, block, vector)
        w = across * 0.25 / (speed[i] * speed[i])
        for a in range(6):
            vector[a] = -across * 0.5 / speed[i] * d[i, a % 3] * cosine[i]
            for b in range(a + 1):
                block[a, b] = w * d[i, a % 3] * d[i, b % 3]
        add_block(band, right, first[i], slope, i, block, vector)
        for c in range(4):
            column = 6 * (first[i] + c)
            for a in range(6):
                right[column + a] -= fair * bend[i, c] * curvature[i, a]
            for r in range(c, 4):
                for a in range(6):
                    band[6 * (r - c), column + a] += fair * bend[i, c] * bend[i, r]


@njit(cache=True, nogil=True)
def solve(band, right, out):
    """Solve the equations of a lower band (B, N) by Cholesky's method into out (N,); whether that can be done."""
    width, size = band.shape
    # By column, so that what is taken off the next columns lies side by side.
    factor = np.empty((size, width))
    for j in range(size):
        for r in range(width):
            factor[j, r] = band[r, j]
    for j in range(size):
        if not factor[j, 0] > 0.0:
            return False
        pivot = np.sqrt(factor[j, 0])
        below = min(width, size - j)
        factor[j, 0] = pivot
        for r in range(1, below):
            factor[j, r] /= pivot
        for c in range(1, below):
            share = factor[j, c]
            for r in range(below - c):
                factor[j + c, r] -= share * factor[j, c + r]
    for j in range(size):
        out[j] = right[j]
    for j in range(size):
        out[j] /= factor[j, 0]
        for r in range(1, min(width, size - j)):
            out[j + r] -= factor[j, r] * out[j]
    for j in range(size - 1, -1, -1):
        for r in range(1, min(width, size - j)):
            out[j] -= factor[j, r] * out[j + r]
        out[j] /= factor[j, 0]
    return True
