"""The swept gap of a motion: the least signed distance from points to ball and cone over the whole motion."""

from __future__ import annotations

import numpy as np
from numba import njit

from conflank_cli.geometry.kernels.footpoint import find_span

# The search for the nearest pose ends when it is known to this share of the bracket, about 2 mm of travel: at
# a kink of the distance the gap is then off by less than 1e-6 mm, elsewhere by nothing that shows.
KNOWN, MOST_STEPS = 3e-7, 60
GOLDEN = 0.3819660112501051


@njit(forceinline=True)
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
def distance_at(polynomials, breaks, t, x, y, z, cutter, axis):
    """Signed distance from a point to the cutter at time t; axis (6,) is overwritten."""
    pose(polynomials, breaks, t, axis)
    return cutter_distance(
        x, y, z, axis[0], axis[1], axis[2], axis[3], axis[4], axis[5],
        cutter[0], cutter[1], cutter[2], cutter[3], cutter[4], cutter[5],
    )  # fmt: skip


@njit(cache=True, nogil=True)
def nearest_between(polynomials, breaks, low, high, t, f, f_low, f_high, x, y, z, cutter, axis):
    """(least distance, time) of a point over poses from low to high, t among them, where it is f, f_low and f_high.

    Parabolas through the last three poses where they converge, golden section where not; axis (6,) is overwritten.

    Source: Brent, Algorithms for Minimization without Derivatives (1973), chapter 5.
    """
    known = KNOWN * (high - low)
    first, f_first = (low, f_low) if f_low < f_high else (high, f_high)
    # Best, second best and the one before.
    step = last = 0.0
    t2, f2 = first, f_first
    if f <= f_first and low < t < high:
        # In the valley already: the parabola through all three is the first guess.
        t3, f3 = (high, f_high) if first == low else (low, f_low)
        step = last = high - low
    else:
        # Where the distance does not fall from the nearer end on, that is the minimum: a motion that is too short.
        t = low + 2.0 * known if first == low else high - 2.0 * known
        if distance_at(polynomials, breaks, t, x, y, z, cutter, axis) >= f_first:
            return f_first, first
        t = low + GOLDEN * (high - low)
        f = distance_at(polynomials, breaks, t, x, y, z, cutter, axis)
        t2, f2 = t, f
        t3, f3 = t, f
    for _ in range(MOST_STEPS):
        middle = 0.5 * (low + high)
        if abs(t - middle) <= 2.0 * known - 0.5 * (high - low):
            break
        parabola = False
        if abs(last) > known:
            r = (t - t2) * (f - f3)
            q = (t - t3) * (f - f2)
            p = (t - t3) * q - (t - t2) * r
            q = 2.0 * (q - r)
            if q > 0.0:
                p = -p
            q = abs(q)
            # Inside the bracket, and less than half of the step before the last.
            parabola = abs(p) < abs(0.5 * q * last) and p > q * (low - t) and p < q * (high - t)
        if parabola:
            last = step
            step = p / q
            if t + step - low < 2.0 * known or high - t - step < 2.0 * known:
                step = known if t < middle else -known
        else:
            last = high - t if t < middle else low - t
            step = GOLDEN * last
        if abs(step) < known:
            step = known if step > 0.0 else -known
        s = t + step
        d = distance_at(polynomials, breaks, s, x, y, z, cutter, axis)
        if d <= f:
            if s < t:
                high = t
            else:
                low = t
            t3, f3, t2, f2, t, f = t2, f2, t, f, s, d
        else:
            if s < t:
                low = s
            else:
                high = s
            if d <= f2 or t2 == t:
                t3, f3, t2, f2 = t2, f2, s, d
            elif d <= f3 or t3 in (t, t2):
                t3, f3 = s, d
    # No step goes to the ends.
    return (f_first, first) if f_first < f else (f, t)


@njit(forceinline=True)
def look(axes, k, x, y, z, cutter):
    """Signed distance from a point to the cutter at the sampled pose k of axes (M, 6)."""
    return cutter_distance(
        x, y, z, axes[k, 0], axes[k, 1], axes[k, 2], axes[k, 3], axes[k, 4], axes[k, 5],
        cutter[0], cutter[1], cutter[2], cutter[3], cutter[4], cutter[5],
    )  # fmt: skip


@njit(forceinline=True)
def longest_step(axes, cutter):
    """By how much no point of the cutter moves from one of the sampled poses (M, 6) to the next, mm.

    A point at height h and r from the axis moves with the axis there, and by r with the turn of the axis; the axis
    between p and q by no more than one of its ends, and beyond p by the turn more.
    """
    away = max(cutter[0] + cutter[3] * cutter[1] / cutter[2], cutter[5]) + cutter[5] - cutter[4]
    longest = 1e-9
    for k in range(axes.shape[0] - 1):
        p = 0.0
        q = 0.0
        turn = 0.0
        for a in range(3):
            p += (axes[k + 1, a] - axes[k, a]) ** 2
            q += (axes[k + 1, 3 + a] - axes[k, 3 + a]) ** 2
            turn += (axes[k + 1, 3 + a] - axes[k, 3 + a] - axes[k + 1, a] + axes[k, a]) ** 2
        longest = max(longest, np.sqrt(max(p, q)) + np.sqrt(turn) * away / cutter[3])
    return 1.001 * longest


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
    way = longest_step(axes, cutter)
    at = np.empty(6)
    where = 0
    for i in range(points.shape[0]):
        x = points[i, 0]
        y = points[i, 1]
        z = points[i, 2]
        # The pose nearest to the point before is near to this one too, and all that are too far for anything nearer to
        # lie between are passed over.
        best = look(axes, where, x, y, z, cutter)
        k = 0
        while k <= samples:
            d = look(axes, k, x, y, z, cutter)
            if d < best:
                best = d
                where = k
            k += 1
            # Of a pose that is not a number nothing follows.
            ahead = (d - (min(best, reach) if d > reach else best)) / way
            if ahead >= samples:
                break
            if ahead > 1.0:
                k += int(ahead)
        time[i] = where / samples
        gap[i] = best
        if best > reach:
            continue
        before = max(where - 1, 0)
        after = min(where + 1, samples)
        gap[i], time[i] = nearest_between(
            polynomials, breaks, before / samples, after / samples, time[i], best,
            look(axes, before, x, y, z, cutter), look(axes, after, x, y, z, cutter), x, y, z, cutter, at,
        )  # fmt: skip


@njit(cache=True, nogil=True)
def swept_gap_near(polynomials, breaks, window, points, cutter, gap, time):
    """Swept gap of points whose time is known to about `window`: time (N,) is read as a start, then filled as gap (N,).

    Does not promise the least gap of the whole motion, only that of the valley it starts in.
    """
    at = np.empty(6)
    for i in range(points.shape[0]):
        x = points[i, 0]
        y = points[i, 1]
        z = points[i, 2]
        low = max(time[i] - window, 0.0)
        high = min(time[i] + window, 1.0)
        gap[i], time[i] = nearest_between(
            polynomials, breaks, low, high, time[i],
            distance_at(polynomials, breaks, time[i], x, y, z, cutter, at),
            distance_at(polynomials, breaks, low, x, y, z, cutter, at),
            distance_at(polynomials, breaks, high, x, y, z, cutter, at), x, y, z, cutter, at,
        )  # fmt: skip


@njit(cache=True, nogil=True)
def gap_gradients(polynomials, breaks, points, time, cutter, rows):
    """Gradient of the swept gap by the axis ends p and q of the pose that gives it, rows (N, 6).

    By the envelope theorem the pose may be held fixed, and so may the nearest place y on the cutter: the gap changes by
    -<n, δy> with n from y to the point. On ball and cone y may be taken for the centre c = p + h d of the sphere that
    touches there, with d along q - p; on top of the cone it is the nearest place on the disc or on its rim.
    """
    axis = np.empty(6)
    d = np.empty(3)
    n = np.empty(3)
    w = np.empty(3)
    slope = cutter[1] / cutter[2]
    for i in range(points.shape[0]):
        pose(polynomials, breaks, time[i], axis)
        length = np.sqrt((axis[3] - axis[0]) ** 2 + (axis[4] - axis[1]) ** 2 + (axis[5] - axis[2]) ** 2)
        along = 0.0
        for k in range(3):
            d[k] = (axis[3 + k] - axis[k]) / length
            along += (points[i, k] - axis[k]) * d[k]
        across = 0.0
        for k in range(3):
            w[k] = points[i, k] - axis[k] - along * d[k]
            across += w[k] * w[k]
        across = np.sqrt(across)
        rows[i] = 0.0
        if across < 1e-9:
            continue
        beside = along * cutter[2] + (across - cutter[0]) * cutter[1]
        lateral = (across - cutter[0]) * cutter[2] - along * cutter[1]
        above = along - cutter[3]
        r_max = cutter[0] + cutter[3] * slope
        # The same regions as in `cutter_distance`; y is at height h, `out` from the axis.
        if beside <= 0.0:
            h, out = cutter[4], 0.0
        elif (lateral <= 0.0 and above <= lateral) or (lateral > 0.0 and beside * cutter[2] < cutter[3]):
            h, out = along + across * slope, 0.0
        else:
            h, out = cutter[3], min(across, r_max)
        norm = 0.0
        for k in range(3):
            w[k] /= across
            n[k] = d[k] if across == out else points[i, k] - axis[k] - h * d[k] - out * w[k]
            norm += n[k] * n[k]
        norm = np.sqrt(norm)
        if norm < 1e-12:
            continue
        nd = 0.0
        for k in range(3):
            n[k] /= norm
            nd += n[k] * d[k]
        # With the axis y turns: by h δd at the centre, and a radius of the top tips by -<w, δd> d.
        for k in range(3):
            turn = (h * (n[k] - nd * d[k]) - out * nd * w[k]) / length
            rows[i, k] = turn - n[k]
            rows[i, 3 + k] = -turn
