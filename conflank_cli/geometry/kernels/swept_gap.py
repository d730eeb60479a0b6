"""The swept gap of a motion: the least signed distance from points to ball and cone over the whole motion."""

from __future__ import annotations

import numpy as np
from numba import njit

from conflank_cli.geometry.kernels.footpoint import find_span

# Golden section: 30 steps shrink the bracket by 5e-7, far below what a quadratic minimum can show.
GOLDEN_STEPS = 30
GOLDEN = 0.6180339887498949


@njit(inline="always")
def cutter_distance(x, y, z, px, py, pz, qx, qy, qz, r_min, slope_sin, slope_cos, length, ball_height, ball_radius):
    """Signed distance from a point to the cutting body (ball and cone) whose axis runs from p towards q."""
    dx = qx - px
    dy = qy - py
    dz = qz - pz
    norm = 1.0 / np.sqrt(dx * dx + dy * dy + dz * dz)
    rx = x - px
    ry = y - py
    rz = z - pz
    along = (rx * dx + ry * dy + rz * dz) * norm
    square = rx * rx + ry * ry + rz * rz - along * along
    across = np.sqrt(square) if square > 0.0 else 0.0
    # In the half plane (along, across) the generator runs from (0, r_min) with slope tan α.
    beside = along * slope_cos + (across - r_min) * slope_sin
    lateral = (across - r_min) * slope_cos - along * slope_sin
    if beside <= 0.0:
        h = along - ball_height
        return np.sqrt(h * h + across * across) - ball_radius
    above = along - length
    rim = across - r_min - length * slope_sin / slope_cos
    if lateral <= 0.0 and above <= 0.0:
        # Inside, the top disc may be nearer than the cone.
        return max(lateral, above)
    # Below the normal to the cone at its rim; inside the prolonged cone the top disc is nearest.
    if lateral > 0.0 and beside * slope_cos < length:
        return lateral
    if rim <= 0.0:
        return above
    return np.sqrt(above * above + rim * rim)


@njit(inline="always")
def pose(polynomials, breaks, t, out):
    """Axis ends at t: polynomials (spans, 4, 6) in the span's local parameter, breaks (spans + 1,); fills out (6,)."""
    k = find_span(breaks, t)
    x = (t - breaks[k]) / (breaks[k + 1] - breaks[k])
    for a in range(6):
        out[a] = ((polynomials[k, 3, a] * x + polynomials[k, 2, a]) * x + polynomials[k, 1, a]) * x + polynomials[
            k, 0, a
        ]


@njit(cache=True, nogil=True)
def swept_gap(polynomials, breaks, samples, points, reach, cutter, gap, time):
    """Swept gap of points over one motion.

    polynomials, breaks: the motion as in `pose`. samples: number of equal steps of the first look.
    points (N, 3). reach: distances above this many mm are not refined. cutter (6,): r_min, sin α, cos α, length, ball
    centre height, ball radius. Fills gap (N,) mm and time (N,) where the minimum is.

    The first look takes the nearest sampled pose; golden section on the exact motion then finds the minimum between its
    neighbours. Does not promise the lesser of two minima that differ by less than the first look can tell.
    """
    axes = np.empty((samples + 1, 6))
    for k in range(samples + 1):
        pose(polynomials, breaks, k / samples, axes[k])
    at = np.empty(6)
    for i in range(points.shape[0]):
        x = points[i, 0]
        y = points[i, 1]
        z = points[i, 2]
        best = np.inf
        where = 0
        for k in range(samples + 1):
            a = axes[k]
            d = cutter_distance(
                x,
                y,
                z,
                a[0],
                a[1],
                a[2],
                a[3],
                a[4],
                a[5],
                cutter[0],
                cutter[1],
                cutter[2],
                cutter[3],
                cutter[4],
                cutter[5],
            )
            if d < best:
                best = d
                where = k
        time[i] = where / samples
        gap[i] = best
        if best > reach:
            continue
        low = max(where - 1, 0) / samples
        high = min(where + 1, samples) / samples
        t1 = high - GOLDEN * (high - low)
        t2 = low + GOLDEN * (high - low)
        f1 = np.inf
        f2 = np.inf
        for _ in range(GOLDEN_STEPS):
            if f1 == np.inf:
                pose(polynomials, breaks, t1, at)
                f1 = cutter_distance(
                    x, y, z, at[0], at[1], at[2], at[3], at[4], at[5],
                    cutter[0], cutter[1], cutter[2], cutter[3], cutter[4], cutter[5],
                )  # fmt: skip
            if f2 == np.inf:
                pose(polynomials, breaks, t2, at)
                f2 = cutter_distance(
                    x, y, z, at[0], at[1], at[2], at[3], at[4], at[5],
                    cutter[0], cutter[1], cutter[2], cutter[3], cutter[4], cutter[5],
                )  # fmt: skip
            if f1 < f2:
                high = t2
                t2 = t1
                f2 = f1
                t1 = high - GOLDEN * (high - low)
                f1 = np.inf
            else:
                low = t1
                t1 = t2
                f1 = f2
                t2 = low + GOLDEN * (high - low)
                f2 = np.inf
        middle = 0.5 * (low + high)
        pose(polynomials, breaks, middle, at)
        d = cutter_distance(
            x, y, z, at[0], at[1], at[2], at[3], at[4], at[5],
            cutter[0], cutter[1], cutter[2], cutter[3], cutter[4], cutter[5],
        )  # fmt: skip
        if d < best:
            gap[i] = d
            time[i] = middle
