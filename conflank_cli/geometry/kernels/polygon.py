"""Points in trimmed parameter domains."""

from __future__ import annotations

from numba import njit


@njit(forceinline=True)
def is_inside(x, y, vertices, starts):
    """Even-odd test of one point against closed loops: vertices (M, 2) one loop after the other, starts (K + 1,)."""
    odd = False
    for loop in range(starts.shape[0] - 1):
        j = starts[loop + 1] - 1
        for i in range(starts[loop], starts[loop + 1]):
            yi = vertices[i, 1]
            yj = vertices[j, 1]
            if (yi > y) != (yj > y):
                crossing = vertices[i, 0] + (y - yi) / (yj - yi) * (vertices[j, 0] - vertices[i, 0])
                if x < crossing:
                    odd = not odd
            j = i
    return odd


@njit(cache=True)
def inside_even_odd(u, v, vertices, starts, out):
    """Even-odd test of points u, v (N,) against closed loops.

    vertices (M, 2) holds the loops one after the other, starts (K + 1,) where each begins. Fills out (N,) bool. Does
    not promise which way a point within rounding of an edge falls.
    """
    for k in range(u.shape[0]):
        out[k] = is_inside(u[k], v[k], vertices, starts)
