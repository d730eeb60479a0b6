"""The axis error of a motion on an m x n grid."""

from __future__ import annotations

from numba import njit

from conflank_cli.geometry.kernels.axis import raster_value
from conflank_cli.geometry.kernels.footpoint import CLAMPED, FAILED, project


@njit(cache=True, nogil=True)
def motion_errors(
    breaks_u, breaks_v, coefficients, box, sense, raster, p, q, fractions, radii, u, v, error, normal, on, warm
):
    """Axis error over a grid of poses and spheres.

    p, q (m, 3): axis ends at the sampled times. fractions (n,): s of the sphere centres on pq. radii (n,): sphere
    radius plus allowance. u, v (m, n): starts on input where warm, else only those of the middle sphere of the first
    pose are read; filled. error (m, n), normal (m, n, 3) towards the cutter, on (m, n): 1 on the face, 0 off it, -1
    without a footpoint.
    """
    m = p.shape[0]
    n = fractions.shape[0]
    middle = n // 2
    for i in range(m):
        if not warm and i > 0:
            u[i, middle] = u[i - 1, middle]
            v[i, middle] = v[i - 1, middle]
        for side in range(2):
            j = middle if side == 0 else middle - 1
            step = 1 if side == 0 else -1
            a = u[i, middle]
            b = v[i, middle]
            while 0 <= j < n:
                if warm:
                    a = u[i, j]
                    b = v[i, j]
                s = fractions[j]
                r = project(
                    breaks_u, breaks_v, coefficients, box,
                    (1.0 - s) * p[i, 0] + s * q[i, 0],
                    (1.0 - s) * p[i, 1] + s * q[i, 1],
                    (1.0 - s) * p[i, 2] + s * q[i, 2],
                    a, b,
                )  # fmt: skip
                a = r[0]
                b = r[1]
                u[i, j] = a
                v[i, j] = b
                normal[i, j, 0] = sense * r[5]
                normal[i, j, 1] = sense * r[6]
                normal[i, j, 2] = sense * r[7]
                error[i, j] = sense * r[8] - radii[j]
                if r[9] == CLAMPED or r[9] == FAILED:
                    on[i, j] = -1.0
                else:
                    on[i, j] = raster_value(raster, breaks_u, breaks_v, a, b)
                j += step
