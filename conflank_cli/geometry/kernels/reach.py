"""The least axis error of lines through a point of a face."""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from conflank_cli.geometry.kernels.axis import across, axis_errors

# Steps of the refinement: after the plain ones the largest errors weigh most, so that it tends to the least maximum;
# the last one only shifts.
PLAIN_STEPS, STEPS = 3, 9
# A line this many times worse than the best so far after the plain steps is given up.
HOPELESS = 6.0
DAMPING = 1e-6


@njit(inline="always")
def best_window(error, on, contact, least):
    """(first sphere, largest |error|) of the best run of `least` spheres on the face that holds `contact`."""
    first = -1
    best = np.inf
    for a in range(max(contact - least + 1, 0), min(contact, error.shape[0] - least) + 1):
        worst = 0.0
        for j in range(a, a + least):
            if on[j] < 0.5:
                worst = np.inf
                break
            worst = max(worst, abs(error[j]))
        if worst < best:
            best = worst
            first = a
    return first, best


@njit(inline="always")
def line_error(error, on, contact, least):
    """(first sphere of the best window, axis error): overcut counts anywhere on the face, stock in the window."""
    first, worst = best_window(error, on, contact, least)
    for j in range(error.shape[0]):
        if on[j] > 0.5:
            worst = max(worst, -error[j])
    return first, worst


@njit(cache=True)
def refine_through(
    breaks_u, breaks_v, coefficients, box, sense, raster, x, n, uv, d, heights, radii, contact, least, hopeless, line
):
    """Least axis error of lines near d that touch the face at x (3,) with unit normal n and the sphere `contact`.

    Gauss-Newton in three freedoms: the shift along n, which the error bounds, and the two of the direction. Residuals
    are the errors of the best window and whatever overcuts outside it. Given up above `hopeless` mm after the plain
    steps. d (3,) is changed. Fills line (6,): p and d of the best. Returns (error, footpoints used); error inf where no
    window lies on the face.
    """
    count = heights.shape[0]
    u = np.empty(count)
    v = np.empty(count)
    error = np.empty(count)
    on = np.empty(count)
    normal = np.empty((count, 3))
    matrix = np.empty((3, 3))
    right = np.empty(3)
    row = np.empty(3)
    p = np.empty(3)
    shift = 0.0
    best = np.inf
    used = 0
    span = heights[count - 1] - heights[0]
    for step in range(STEPS + 1):
        for k in range(3):
            p[k] = x[k] + (radii[contact] + shift) * n[k] - heights[contact] * d[k]
        u[contact] = uv[0]
        v[contact] = uv[1]
        axis_errors(
            breaks_u, breaks_v, coefficients, box, sense, raster, p, d, heights, radii, contact, u, v, error, normal, on
        )
        used += count
        first, worst = line_error(error, on, contact, least)
        if first < 0:
            break
        if worst < best:
            best = worst
            line[:3] = p
            line[3:] = d
        if step == STEPS or (step == PLAIN_STEPS and best > hopeless):
            break
        if step == STEPS - 1:
            # The shift alone moves all errors alike: share what is left between overcut and stock.
            stock = -np.inf
            overcut = np.inf
            for j in range(count):
                if on[j] > 0.5:
                    overcut = min(overcut, error[j])
                    if first <= j < first + least:
                        stock = max(stock, error[j])
            shift -= 0.5 * (stock + overcut)
            continue
        e1, e2 = across(d)
        matrix[:] = 0.0
        right[:] = 0.0
        for j in range(count):
            inside = first <= j < first + least
            if on[j] < 0.5 or not (inside or error[j] < 0.0):
                continue
            w = 1.0
            if step >= PLAIN_STEPS and worst > 0.0:
                w = (error[j] / worst) ** 2 + 0.02
            arm = (heights[j] - heights[contact]) / span
            row[0] = normal[j, 0] * n[0] + normal[j, 1] * n[1] + normal[j, 2] * n[2]
            row[1] = arm * (normal[j, 0] * e1[0] + normal[j, 1] * e1[1] + normal[j, 2] * e1[2])
            row[2] = arm * (normal[j, 0] * e2[0] + normal[j, 1] * e2[1] + normal[j, 2] * e2[2])
            for a in range(3):
                right[a] -= w * row[a] * error[j]
                for b in range(3):
                    matrix[a, b] += w * row[a] * row[b]
        for a in range(3):
            matrix[a, a] += DAMPING * count
        change = np.linalg.solve(matrix, right)
        longest = max(abs(change[1]), abs(change[2])) / span
        if longest > 0.1:
            change *= 0.1 / longest
        shift += change[0]
        for k in range(3):
            d[k] += (change[1] * e1[k] + change[2] * e2[k]) / span
        d /= np.sqrt(d[0] ** 2 + d[1] ** 2 + d[2] ** 2)
    return best, used


@njit(cache=True, parallel=True)
def reach_errors(
    breaks_u,
    breaks_v,
    coefficients,
    box,
    sense,
    raster,
    points,
    normals,
    uv,
    starts,
    directions,
    contacts,
    heights,
    radii,
    least,
    error,
    lines,
    height,
    footpoints,
):
    """`refine_through` from every start direction of every point, the best kept.

    points, normals (N, 3), uv (N, 2). Starts of point i: directions (M, 3) and contacts (M,) from starts[i] to starts[i
    + 1]. Fills error (N,), lines (N, 6), height (N,) and footpoints (N,).
    """
    for i in prange(points.shape[0]):
        line = np.empty(6)
        best = np.inf
        for k in range(starts[i], starts[i + 1]):
            found, used = refine_through(
                breaks_u,
                breaks_v,
                coefficients,
                box,
                sense,
                raster,
                points[i],
                normals[i],
                uv[i],
                directions[k].copy(),
                heights,
                radii,
                contacts[k],
                least,
                HOPELESS * best,
                line,
            )
            footpoints[i] += used
            if found < best:
                best = found
                lines[i] = line
                height[i] = heights[contacts[k]]
        error[i] = best
