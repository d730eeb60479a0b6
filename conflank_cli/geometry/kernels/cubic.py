"""Cubic B-splines on a knot vector: their basis, and the polynomials of a motion."""

from __future__ import annotations

import numpy as np
from numba import njit

from conflank_cli.geometry.kernels.footpoint import find_span


@njit(cache=True, nogil=True)
def basis_rows(knots, t, first, value, slope, bend):
    """The four basis functions that are not zero at times t (m,), and their derivatives.

    knots (n + 4,). Fills first (m,), the index of the first of them, and value, slope and bend (m, 4).

    Source: Piegl and Tiller, The NURBS Book (1997), algorithms A2.2 and A2.3.
    """
    count = knots.shape[0] - 4
    inner = knots[3 : count + 1]
    for i in range(t.shape[0]):
        x = t[i]
        k = 3 + find_span(inner, x)
        # At the end of a span of no length the one before holds it.
        while knots[k + 1] <= knots[k]:
            k -= 1
        first[i] = k - 3
        a0, a1, a2 = knots[k - 2], knots[k - 1], knots[k]
        b0, b1, b2 = knots[k + 1], knots[k + 2], knots[k + 3]
        # Degree 1, then 2: N_{k-1}, N_k, and N_{k-2} to N_k.
        width = b0 - a2
        one0, one1 = (b0 - x) / width, (x - a2) / width
        left, right = b0 - a1, b1 - a2
        two0 = (b0 - x) / left * one0
        two1 = (x - a1) / left * one0 + (b1 - x) / right * one1
        two2 = (x - a2) / right * one1
        # First derivatives of degree 2, from degree 1; then degree 3 in the same way.
        d0 = -2.0 / left * one0
        d1 = 2.0 / left * one0 - 2.0 / right * one1
        d2 = 2.0 / right * one1
        w0, w1, w2 = b0 - a0, b1 - a1, b2 - a2
        value[i, 0] = (b0 - x) / w0 * two0
        value[i, 1] = (x - a0) / w0 * two0 + (b1 - x) / w1 * two1
        value[i, 2] = (x - a1) / w1 * two1 + (b2 - x) / w2 * two2
        value[i, 3] = (x - a2) / w2 * two2
        slope[i, 0] = -3.0 / w0 * two0
        slope[i, 1] = 3.0 / w0 * two0 - 3.0 / w1 * two1
        slope[i, 2] = 3.0 / w1 * two1 - 3.0 / w2 * two2
        slope[i, 3] = 3.0 / w2 * two2
        bend[i, 0] = -3.0 / w0 * d0
        bend[i, 1] = 3.0 / w0 * d0 - 3.0 / w1 * d1
        bend[i, 2] = 3.0 / w1 * d1 - 3.0 / w2 * d2
        bend[i, 3] = 3.0 / w2 * d2


@njit(cache=True, nogil=True)
def span_polynomials(knots, control, breaks, out):
    """Polynomials of a spline in the local parameter of each span.

    knots (n + 4,), control (n, 6), breaks (spans + 1,): the knots without repetition. Fills out (spans, 4, 6), where
    out[k, j] goes with the power j.
    """
    size = control.shape[1]
    k = 3
    for span in range(breaks.shape[0] - 1):
        while knots[k + 1] <= breaks[span]:
            k += 1
        start, width = knots[k], knots[k + 1] - knots[k]
        a0, a1 = knots[k - 2], knots[k - 1]
        b0, b1, b2 = knots[k + 1], knots[k + 2], knots[k + 3]
        # Basis of degree 2 and 3 at the start of the span, where the last function of each is zero.
        two0 = width / (b0 - a1)
        two1 = (start - a1) / (b0 - a1)
        three0 = width / (b0 - a0) * two0
        three1 = (start - a0) / (b0 - a0) * two0 + (b1 - start) / (b1 - a1) * two1
        three2 = (start - a1) / (b1 - a1) * two1
        for a in range(size):
            c0, c1, c2, c3 = control[k - 3, a], control[k - 2, a], control[k - 1, a], control[k, a]
            # Control points of the derivatives.
            d0 = 3.0 * (c1 - c0) / (b0 - a0)
            d1 = 3.0 * (c2 - c1) / (b1 - a1)
            d2 = 3.0 * (c3 - c2) / (b2 - start)
            e0 = 2.0 * (d1 - d0) / (b0 - a1)
            e1 = 2.0 * (d2 - d1) / (b1 - start)
            out[span, 0, a] = three0 * c0 + three1 * c1 + three2 * c2
            out[span, 1, a] = (two0 * d0 + two1 * d1) * width
            out[span, 2, a] = 0.5 * e0 * width**2
            out[span, 3, a] = (e1 - e0) * width**2 / 6.0


@njit(forceinline=True)
def pose(polynomials, breaks, t, out):
    """Axis ends at t: polynomials (spans, 4, 6) in the span's local parameter, breaks (spans + 1,); fills out (6,)."""
    k = find_span(breaks, t)
    x = (t - breaks[k]) / (breaks[k + 1] - breaks[k])
    for a in range(6):
        out[a] = ((polynomials[k, 3, a] * x + polynomials[k, 2, a]) * x + polynomials[k, 1, a]) * x + polynomials[
            k, 0, a
        ]


@njit(forceinline=True)
def course(polynomials, breaks, t, axis, velocity):
    """Axis ends at t and their derivatives; fills axis (6,) and velocity (6,)."""
    k = find_span(breaks, t)
    width = breaks[k + 1] - breaks[k]
    x = (t - breaks[k]) / width
    for a in range(6):
        c1, c2, c3 = polynomials[k, 1, a], polynomials[k, 2, a], polynomials[k, 3, a]
        axis[a] = ((c3 * x + c2) * x + c1) * x + polynomials[k, 0, a]
        velocity[a] = ((3.0 * c3 * x + 2.0 * c2) * x + c1) / width


@njit(cache=True, nogil=True)
def longer_path(polynomials, breaks, steps):
    """Length of the longer of the paths that p and q take, by so many chords, mm."""
    length = np.zeros(2)
    at, before = np.empty(6), np.empty(6)
    for i in range(steps + 1):
        pose(polynomials, breaks, i / steps, at)
        for end in range(2 if i > 0 else 0):
            square = 0.0
            for a in range(3 * end, 3 * end + 3):
                square += (at[a] - before[a]) ** 2
            length[end] += np.sqrt(square)
        before[:] = at
    return max(length[0], length[1])
