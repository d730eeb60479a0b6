"""Which cells of a face a traced sequence covers."""

from __future__ import annotations

from numba import njit

# Points put into every mesh of the (line, sphere) grid, along the sweep and along the axis: a mesh is 1.5 by 2 mm.
ALONG, ACROSS = 4, 3


@njit(cache=True, nogil=True)
def mark_cells(breaks_u, breaks_v, error, u, v, on, spans, over, under, marks):
    """Mark the cells of an R x R raster over the extended domain that sequences cover within tolerance.

    error, u, v, on (N, T, J) as traced; spans (N, 2) rows in use. marks (N, R, R) bool, False on input. Between lines
    and spheres the error and the foot are interpolated bilinearly.
    """
    size = marks.shape[1]
    u0 = breaks_u[0]
    v0 = breaks_v[0]
    fu = size / (breaks_u[-1] - u0)
    fv = size / (breaks_v[-1] - v0)
    for k in range(error.shape[0]):
        for i in range(spans[k, 0], spans[k, 1] - 1):
            for j in range(error.shape[2] - 1):
                if on[k, i, j] < 0.0 or on[k, i + 1, j] < 0.0 or on[k, i, j + 1] < 0.0 or on[k, i + 1, j + 1] < 0.0:
                    continue
                for a in range(ALONG):
                    x = (a + 0.5) / ALONG
                    for b in range(ACROSS):
                        y = (b + 0.5) / ACROSS
                        c0 = (1.0 - x) * (1.0 - y)
                        c1 = x * (1.0 - y)
                        c2 = (1.0 - x) * y
                        c3 = x * y
                        e = (
                            c0 * error[k, i, j]
                            + c1 * error[k, i + 1, j]
                            + c2 * error[k, i, j + 1]
                            + c3 * error[k, i + 1, j + 1]
                        )
                        if e < -over or e > under:
                            continue
                        p = c0 * u[k, i, j] + c1 * u[k, i + 1, j] + c2 * u[k, i, j + 1] + c3 * u[k, i + 1, j + 1]
                        q = c0 * v[k, i, j] + c1 * v[k, i + 1, j] + c2 * v[k, i, j + 1] + c3 * v[k, i + 1, j + 1]
                        row = int((p - u0) * fu)
                        column = int((q - v0) * fv)
                        if 0 <= row < size and 0 <= column < size:
                            marks[k, row, column] = True
