"""The swept gap of a motion: the least signed distance from points to ball and cone over the whole motion."""

from __future__ import annotations

import numpy as np
from numba import njit

from conflank_cli.geometry.kernels.cubic import course, pose

# The search for the nearest pose ends where the distance would fall by no more than this, mm: the first by the parabola
# there, which is then taken off, the second by its slope as far as the bracket goes, were there a kink ahead.
STILL, SURE = 1e-8, 1e-7
# Or where the time is known to this share of the bracket, about 2 mm of travel.
KNOWN, MOST_STEPS = 3e-7, 60
# Steps that do not halve the bracket before it is halved.
PATIENCE = 3


@njit(forceinline=True)
def nearest_place(along, across, r_min, slope_sin, slope_cos, length, ball_height, ball_radius):
    """Signed distance to the cutter of a point so far along its axis and across it, and the place that is nearest.

    That is a height on the axis and a distance from it. On ball and cone the centre of the sphere that touches there
    stands for it.
    """
    # In the half plane (along, across) the generator runs from (0, r_min) with slope tan α.
    beside = along * slope_cos + (across - r_min) * slope_sin
    if beside <= 0.0:
        h = along - ball_height
        return np.sqrt(h * h + across * across) - ball_radius, ball_height, 0.0
    lateral = (across - r_min) * slope_cos - along * slope_sin
    above = along - length
    slope = slope_sin / slope_cos
    # Below the normal to the cone at its rim; inside of it the top disc may be nearer, and above it is.
    if (lateral <= 0.0 and above <= lateral) or (lateral > 0.0 and beside * slope_cos < length):
        return lateral, along + across * slope, 0.0
    rim = across - r_min - length * slope
    if rim <= 0.0:
        return above, length, across
    return np.sqrt(above * above + rim * rim), length, across - rim


@njit(forceinline=True)
def cutter_distance(x, y, z, px, py, pz, dx, dy, dz, r_min, slope_sin, slope_cos, length, ball_height, ball_radius):
    """Signed distance from a point to the cutting body (ball and cone) whose axis runs from p in direction d."""
    rx = x - px
    ry = y - py
    rz = z - pz
    along = rx * dx + ry * dy + rz * dz
    square = rx * rx + ry * ry + rz * rz - along * along
    across = np.sqrt(square) if square > 0.0 else 0.0
    return nearest_place(along, across, r_min, slope_sin, slope_cos, length, ball_height, ball_radius)[0]


@njit(forceinline=True)
def distance_and_slope(x, y, z, axis, velocity, cutter):
    """Signed distance from a point to the cutter in motion, and its derivative by time.

    By the envelope theorem that is what the place that is nearest moves towards the point.
    """
    dx = axis[3] - axis[0]
    dy = axis[4] - axis[1]
    dz = axis[5] - axis[2]
    norm = 1.0 / np.sqrt(dx * dx + dy * dy + dz * dz)
    dx *= norm
    dy *= norm
    dz *= norm
    rx = x - axis[0]
    ry = y - axis[1]
    rz = z - axis[2]
    along = rx * dx + ry * dy + rz * dz
    # From the axis to the point.
    wx = rx - along * dx
    wy = ry - along * dy
    wz = rz - along * dz
    across = np.sqrt(wx * wx + wy * wy + wz * wz)
    f, h, out = nearest_place(along, across, cutter[0], cutter[1], cutter[2], cutter[3], cutter[4], cutter[5])
    # How the direction of the axis turns, but for what it does along itself.
    tx = (velocity[3] - velocity[0]) * norm
    ty = (velocity[4] - velocity[1]) * norm
    tz = (velocity[5] - velocity[2]) * norm
    stretch = tx * dx + ty * dy + tz * dz
    tx -= stretch * dx
    ty -= stretch * dy
    tz -= stretch * dz
    # The normal of the cutter there, n = (up d + beyond w) / length: on the disc it is the axis. Inside a cone there is
    # none on the axis.
    inverse = 1.0 / across if across > 1e-9 else 0.0
    up, beyond, length = 1.0, 0.0, 1.0
    if across != out or h != cutter[3]:
        up = along - h
        beyond = (across - out) * inverse
        length = np.sqrt(up * up + (across - out) ** 2)
        if length < 1e-12:
            return f, 0.0
    mx = velocity[0] + h * tx
    my = velocity[1] + h * ty
    mz = velocity[2] + h * tz
    turn = wx * tx + wy * ty + wz * tz
    forth = up * (mx * dx + my * dy + mz * dz) + beyond * (wx * mx + wy * my + wz * mz)
    return f, (out * up * turn * inverse - forth) / length


@njit(cache=True, nogil=True)
def nearest_between(polynomials, breaks, low, high, t, bend, x, y, z, cutter, axis, velocity):
    """(least distance, its time, second derivative there) of a point over poses from low to high, from t among them.

    bend: about what the second derivative of the distance by time is; 0, there and in what is returned, where it is not
    known. The derivative is brought to 0 by secants within the times where it has either sign, which are halved where
    those converge slowly. axis (6,) and velocity (6,) are overwritten.
    """
    first, last = low, high
    looked_low = looked_high = False
    known = KNOWN * (high - low)
    best, where = np.inf, t
    before = slope_before = 0.0
    width, patience = high - low, PATIENCE
    for step in range(MOST_STEPS):
        course(polynomials, breaks, t, axis, velocity)
        f, slope = distance_and_slope(x, y, z, axis, velocity, cutter)
        if f < best:
            best, where = f, t
        if slope > 0.0:
            high, looked_high = t, True
        else:
            low, looked_low = t, True
        # At an end it does not fall any further, or it is known well enough where it is least.
        if high == first or low == last or slope == 0.0 or high - low <= known:
            break
        if step > 0 and (slope - slope_before) * (t - before) > 0.0:
            bend = (slope - slope_before) / (t - before)
        elif step > 0 or bend <= 0.0:
            # Nothing is known, or not here: a step that may well end on the other side.
            bend = abs(slope) / (0.1 * (last - first))
        ahead = t - low if slope > 0.0 else high - t
        before, slope_before = t, slope
        t -= slope / bend
        fall = 0.5 * slope * slope / bend
        if fall < STILL and abs(slope) * ahead < SURE and low < t < high:
            return (f - fall, t, bend) if f - fall < best else (best, where, 0.0)
        patience -= 1
        if patience == 0:
            if looked_low and looked_high and high - low > 0.5 * width:
                t = 0.5 * (low + high)
            width, patience = high - low, PATIENCE
        # An end that has not been looked at may be the nearest of all.
        if t <= low:
            t = 0.5 * (low + high) if looked_low else low
        elif t >= high:
            t = 0.5 * (low + high) if looked_high else high
    return best, where, 0.0


@njit(forceinline=True)
def look(axes, k, x, y, z, cutter):
    """Signed distance from a point to the cutter at the sampled pose k of axes (M, 6), p and direction of each."""
    return cutter_distance(
        x, y, z, axes[k, 0], axes[k, 1], axes[k, 2], axes[k, 3], axes[k, 4], axes[k, 5],
        cutter[0], cutter[1], cutter[2], cutter[3], cutter[4], cutter[5],
    )  # fmt: skip


@njit(forceinline=True)
def looks(polynomials, breaks, samples, cutter, axes):
    """Poses at equal steps, p and direction of each, and by how much no point of the cutter moves in one, mm.

    A point at height h and r from the axis moves with the axis there, and by r with the turn of the axis; the axis
    between p and q by no more than one of its ends, and beyond p by the turn more. Fills axes (samples + 1, 6).
    """
    away = max(cutter[0] + cutter[3] * cutter[1] / cutter[2], cutter[5]) + cutter[5] - cutter[4]
    longest = 1e-9
    at, before = np.empty(6), np.empty(6)
    for k in range(samples + 1):
        pose(polynomials, breaks, k / samples, at)
        if k > 0:
            p = q = turn = 0.0
            for a in range(3):
                p += (at[a] - before[a]) ** 2
                q += (at[3 + a] - before[3 + a]) ** 2
                turn += (at[3 + a] - before[3 + a] - at[a] + before[a]) ** 2
            longest = max(longest, np.sqrt(max(p, q)) + np.sqrt(turn) * away / cutter[3])
        norm = 1.0 / np.sqrt((at[3] - at[0]) ** 2 + (at[4] - at[1]) ** 2 + (at[5] - at[2]) ** 2)
        for a in range(3):
            axes[k, a] = at[a]
            axes[k, 3 + a] = (at[3 + a] - at[a]) * norm
        before[:] = at
    return 1.001 * longest


@njit(cache=True, nogil=True)
def swept_gap(polynomials, breaks, samples, points, reach, cutter, gap, time):
    """Swept gap of points over one motion.

    polynomials, breaks: the motion as in `pose`. samples: number of equal steps of the first look.
    points (N, 3). reach: distances above this many mm are not refined. cutter (6,): r_min, sin α, cos α, length, ball
    centre height, ball radius. Fills gap (N,) mm and time (N,) where the minimum is.

    The first look takes the nearest sampled pose; from the parabola through it and its neighbours the minimum of the
    exact motion between these is found. Does not promise the lesser of two minima that differ by less than the first
    look can tell.
    """
    axes = np.empty((samples + 1, 6))
    way = looks(polynomials, breaks, samples, cutter, axes)
    axis, velocity = np.empty(6), np.empty(6)
    step = 1.0 / samples
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
        here, low, high = min(where * step, 1.0), before * step, min(after * step, 1.0)
        # At an end how the distance bends is not known.
        start, bend = here, 0.0
        if 0 < where < samples:
            f_before = look(axes, before, x, y, z, cutter)
            f_after = look(axes, after, x, y, z, cutter)
            bend = f_before - 2.0 * best + f_after
            if bend > 0.0:
                start = min(here + 0.5 * (f_before - f_after) / bend * step, 1.0)
        for t in (start, here):
            gap[i], time[i], _ = nearest_between(
                polynomials, breaks, low, high, t, bend / (step * step), x, y, z, cutter, axis, velocity
            )
            # It is another valley than that of the sampled pose, and not as deep.
            if gap[i] <= best:
                break


@njit(cache=True, nogil=True)
def swept_gap_near(polynomials, breaks, window, points, cutter, gap, time):
    """Swept gap of points whose time is known to about `window`: time (N,) is read as a start, then filled as gap (N,).

    Does not promise the least gap of the whole motion, only that of the valley it starts in.
    """
    axis, velocity = np.empty(6), np.empty(6)
    bend = 0.0
    for i in range(points.shape[0]):
        # It bends there about as it does for the point before, which most likely is near.
        gap[i], time[i], bend = nearest_between(
            polynomials, breaks, max(time[i] - window, 0.0), min(time[i] + window, 1.0), time[i], bend,
            points[i, 0], points[i, 1], points[i, 2], cutter, axis, velocity,
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
        _, h, out = nearest_place(along, across, cutter[0], cutter[1], cutter[2], cutter[3], cutter[4], cutter[5])
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
