"""Least distance from points to a body of revolution in motion. For verification only: nothing else may share it.

A body is an array of nine numbers; heights are measured along the axis from the programmed tip point:

- kind 0, ball + cone: (0, ball radius, centre height, r_min, height of r_min, sin a, cos a, r_max, height of r_max);
- kind 1, frustum: (1, low height, low radius, high height, high radius, sin b, cos b, 0, 0), b its half angle;
- kind 2, ball: (2, radius, centre height, 0, ...).

A cell is a short stretch of motion between two poses: sixteen numbers, tip (3), step of the tip (3), axis (3), turn of
the axis (3), bow of the axis (3), slack. At tau in [0, 1] the tip is tip + tau step (straight, as the control moves it)
and the axis is axis + tau turn + 4 tau (1 - tau) bow, the parabola through its beginning, middle and end.
"""

from __future__ import annotations

import numpy as np
from numba import njit

# The refinement stops when the least distance is known this closely, mm (0.0001 um, a hundredth of what is promised).
_CERTAIN = 1e-7
_MOST_STEPS = 60
# No cell. As a value of a type: numba compiles a function anew for every literal number.
NONE = np.int64(-1)


@njit(cache=True)
def profile(body, rho, h):
    """Signed distance at radius rho and height h in the meridian plane, and its derivatives by rho and h."""
    if body[0] == 0.0:
        radius, centre, r_min, h_min, s, c, r_max, h_top = (
            body[1],
            body[2],
            body[3],
            body[4],
            body[5],
            body[6],
            body[7],
            body[8],
        )
        across = (rho - r_min) * c - (h - h_min) * s
        along = (rho - r_min) * s + (h - h_min) * c
        if h > h_top and rho <= r_max:
            return h - h_top, 0.0, 1.0
        if along * c <= h_top - h_min:
            if along < 0.0:
                # Below the circle where ball and cone touch, the nearest boundary is the ball's.
                reach = np.sqrt(rho * rho + (h - centre) * (h - centre))
                value = reach - radius
                slope_rho, slope_h = 0.0, -1.0
                if reach > 0.0:
                    slope_rho, slope_h = rho / reach, (h - centre) / reach
            else:
                value, slope_rho, slope_h = across, c, -s
            if h - h_top > value:
                return h - h_top, 0.0, 1.0
            return value, slope_rho, slope_h
        # Beyond the rim of the top disc.
        reach = np.sqrt((rho - r_max) * (rho - r_max) + (h - h_top) * (h - h_top))
        if reach > 0.0:
            return reach, (rho - r_max) / reach, (h - h_top) / reach
        return 0.0, c, -s
    if body[0] == 1.0:
        low, r_low, high, r_high, s, c = body[1], body[2], body[3], body[4], body[5], body[6]
        across = (rho - r_low) * c - (h - low) * s
        along = (rho - r_low) * s + (h - low) * c
        length = np.sqrt((high - low) * (high - low) + (r_high - r_low) * (r_high - r_low))
        if across > 0.0 and along >= 0.0 and along <= length:
            return across, c, -s
        if h < low and rho <= r_low:
            return low - h, 0.0, -1.0
        if h > high and rho <= r_high:
            return h - high, 0.0, 1.0
        if across <= 0.0 and h >= low and h <= high:
            value, slope_rho, slope_h = across, c, -s
            if low - h > value:
                value, slope_rho, slope_h = low - h, 0.0, -1.0
            if h - high > value:
                value, slope_rho, slope_h = h - high, 0.0, 1.0
            return value, slope_rho, slope_h
        first = np.sqrt((rho - r_low) * (rho - r_low) + (h - low) * (h - low))
        last = np.sqrt((rho - r_high) * (rho - r_high) + (h - high) * (h - high))
        if first <= last:
            if first > 0.0:
                return first, (rho - r_low) / first, (h - low) / first
            return 0.0, 0.0, -1.0
        if last > 0.0:
            return last, (rho - r_high) / last, (h - high) / last
        return 0.0, 0.0, 1.0
    reach = np.sqrt(rho * rho + (h - body[2]) * (h - body[2]))
    if reach > 0.0:
        return reach - body[1], rho / reach, (h - body[2]) / reach
    return -body[1], 0.0, -1.0


@njit(cache=True)
def _at_pose(body, x, y, z, pose):
    """Signed distance at a fixed pose: tip (3), axis (3)."""
    a, b, c = x - pose[0], y - pose[1], z - pose[2]
    h = a * pose[3] + b * pose[4] + c * pose[5]
    a, b, c = a - h * pose[3], b - h * pose[4], c - h * pose[5]
    value, _, _ = profile(body, np.sqrt(a * a + b * b + c * c), h)
    return value


@njit(cache=True)
def _in_cell(body, x, y, z, cell, tau):
    """Signed distance at tau in a cell, and its derivative by tau."""
    bend = 4.0 * tau * (1.0 - tau)
    swing = 4.0 - 8.0 * tau
    a = x - cell[0] - tau * cell[3]
    b = y - cell[1] - tau * cell[4]
    c = z - cell[2] - tau * cell[5]
    d0 = cell[6] + tau * cell[9] + bend * cell[12]
    d1 = cell[7] + tau * cell[10] + bend * cell[13]
    d2 = cell[8] + tau * cell[11] + bend * cell[14]
    e0 = cell[9] + swing * cell[12]
    e1 = cell[10] + swing * cell[13]
    e2 = cell[11] + swing * cell[14]
    h = a * d0 + b * d1 + c * d2
    rise = -(cell[3] * d0 + cell[4] * d1 + cell[5] * d2) + a * e0 + b * e1 + c * e2
    # Not from |y|^2 - h^2: near the axis that would lose all digits, and the parabola is a unit vector to 1e-10 only.
    a, b, c = a - h * d0, b - h * d1, c - h * d2
    rho = np.sqrt(a * a + b * b + c * c)
    value, by_rho, by_h = profile(body, rho, h)
    slope = by_h * rise
    if rho > 0.0:
        slope -= by_rho * (a * (cell[3] + h * e0) + b * (cell[4] + h * e1) + c * (cell[5] + h * e2)) / rho
    return value, slope


@njit(cache=True)
def _least_in_cell(body, x, y, z, cell, fa, ga, fb, gb, best):
    """Least distance inside a cell whose ends fall towards its inside, and where; gives up once it cannot beat best.

    The body is convex, so under pure translation the distance is a convex function of tau and the tangents at the two
    ends bound it from below; the cell's slack covers what a turning axis takes from that.
    """
    ta, tb = 0.0, 1.0
    least, where = fa, ta
    if fb < fa:
        least, where = fb, tb
    side = 0
    wa, wb = ga, gb
    for step in range(_MOST_STEPS):
        width = tb - ta
        crossing = (fb - fa - gb * width) / (ga - gb)
        bound = fa + ga * crossing - cell[15] * width * width
        if bound >= best or least - bound < _CERTAIN:
            break
        # Regula falsi on the derivative, halving the weight of an end that stays (Illinois); every third step halves
        # the interval, for where the point crosses the axis of the tool the derivative jumps.
        t = ta - wa * width / (wb - wa)
        if step % 3 == 2:
            t = ta + 0.5 * width
        elif not (t > ta + 1e-3 * width and t < tb - 1e-3 * width):
            t = min(max(t, ta + 1e-3 * width), tb - 1e-3 * width)
        f, g = _in_cell(body, x, y, z, cell, t)
        if f < least:
            least, where = f, t
        if g == 0.0:
            break
        if g < 0.0:
            ta, fa, ga, wa = t, f, g, g
            if side == -1:
                wb *= 0.5
            else:
                wb = gb
            side = -1
        else:
            tb, fb, gb, wb = t, f, g, g
            if side == 1:
                wa *= 0.5
            else:
                wa = ga
            side = 1
    return least, where


@njit(cache=True)
def _search_cells(body, x, y, z, cells, ways, joined, low, high, best, index, tau):
    """Search cells low .. high, passing over those that the body does not move far enough for."""
    i = low
    while i < high:
        cell = cells[i]
        fa, ga = _in_cell(body, x, y, z, cell, 0.0)
        if fa < best:
            best, index, tau = fa, i, 0.0
        left = fa - best
        if left < ways[i]:
            if ga >= 0.0 and joined[i]:
                # What follows inside is further away, and the end is where the next cell begins.
                i += 1
                continue
            fb, gb = _in_cell(body, x, y, z, cell, 1.0)
            if fb < best:
                best, index, tau = fb, i, 1.0
            if ga < 0.0 and gb > 0.0:
                f, t = _least_in_cell(body, x, y, z, cell, fa, ga, fb, gb, best)
                if f < best:
                    best, index, tau = f, i, t
            i += 1
            continue
        while i < high and ways[i] <= left:
            left -= ways[i]
            i += 1
    return best, index, tau


@njit(cache=True)
def _near_groups(body, x, y, z, radius, most, poses, reaches, wide_poses, wide_reaches, size, near):
    """Which groups may be nearest to a point within `radius` of x, y, z, or nearer than `most`; returns how many."""
    for w in range(wide_poses.shape[0]):
        most = min(most, _at_pose(body, x, y, z, wide_poses[w]) + radius + _CERTAIN)
    count = 0
    for w in range(wide_poses.shape[0]):
        if _at_pose(body, x, y, z, wide_poses[w]) - wide_reaches[w] - radius >= most:
            continue
        for g in range(w * size, min((w + 1) * size, poses.shape[0])):
            away = _at_pose(body, x, y, z, poses[g])
            most = min(most, away + radius + _CERTAIN)
            if away - reaches[g] - radius < most:
                near[count] = g
                count += 1
    return count


@njit(cache=True, nogil=True)
def least_distance(
    points,
    start,
    block,
    cells,
    ways,
    joined,
    poses,
    reaches,
    wide_poses,
    wide_reaches,
    size,
    body,
    distance,
    where,
    tau,
):
    """Least signed distance from each point to the body over all cells, where it is below `start`.

    Parameters
    ----------
    points: (N, 3) mm, those of a block close together.
    start: (N,) distances that count; a point that no pose brings below its own keeps it.
    block: how many successive points are taken together. What is found does not depend on it.
    cells: (M, 16), see the module.
    ways: (M,) the most any point of the body moves from the beginning of a cell within it and to the next, mm.
    joined: (M,) whether a cell ends where the next begins.
    poses, reaches: (G, 6) and (G,): a pose in each group of `size` successive cells, and the most any point of the body
        is away from where that pose puts it, anywhere in the group, mm.
    wide_poses, wide_reaches: the same for groups of `size` successive groups.
    body: (9,), see the module.
    distance, where, tau: (N,), filled with the least distance, its cell (-1 where `start` was not beaten), and tau.
    """
    near = np.empty(poses.shape[0], np.int64)
    for first in range(0, points.shape[0], block):
        last = min(first + block, points.shape[0])
        x, y, z = 0.0, 0.0, 0.0
        most = -np.inf
        for n in range(first, last):
            x += points[n, 0] / (last - first)
            y += points[n, 1] / (last - first)
            z += points[n, 2] / (last - first)
            most = max(most, start[n])
        radius = 0.0
        for n in range(first, last):
            radius = max(radius, (points[n, 0] - x) ** 2 + (points[n, 1] - y) ** 2 + (points[n, 2] - z) ** 2)
        radius = np.sqrt(radius)
        count = _near_groups(body, x, y, z, radius, most, poses, reaches, wide_poses, wide_reaches, size, near)
        hint = NONE
        for n in range(first, last):
            x, y, z = points[n, 0], points[n, 1], points[n, 2]
            best, index, at = start[n], NONE, 0.0
            # What was nearest to the point before is mostly near to this one.
            if hint >= 0:
                best, index, at = _search_cells(body, x, y, z, cells, ways, joined, hint, hint + 1, best, index, at)
            for k in range(count):
                g = near[k]
                if _at_pose(body, x, y, z, poses[g]) - reaches[g] < best:
                    best, index, at = _search_cells(
                        body,
                        x,
                        y,
                        z,
                        cells,
                        ways,
                        joined,
                        g * size,
                        min((g + 1) * size, cells.shape[0]),
                        best,
                        index,
                        at,
                    )
            distance[n], where[n], tau[n] = best, index, at
            if index >= 0:
                hint = index
