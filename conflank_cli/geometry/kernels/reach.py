"""The least axis error of lines through a point of a face."""

from __future__ import annotations

import numpy as np
from numba import njit

from conflank_cli.geometry.kernels.axis import across, axis_errors, copy, normalise
from conflank_cli.geometry.kernels.minimax import BOTH, IGNORED, LOWER, least_maximum
from conflank_cli.geometry.kernels.polygon import is_inside
from conflank_cli.geometry.kernels.small_systems import factorise, substitute

# `on` is above the one where a foot is on the face, above the other on the surface or its continuation.
ON_FACE, ON_SURFACE = 0.5, -0.5
# In a raster of the trim: a cell that a loop may pass through, where the loops have to be asked.
NEAR_LOOP = 2.0

# Steps of least squares, which lead far, then of the least maximum, which end there.
PLAIN_STEPS, FINE_STEPS = 3, 5
# A line this many times worse than the best so far after the plain steps is given up: least squares leave a maximum
# about twice the least one.
HOPELESS = 4.0
DAMPING = 1e-6
# A plain step turns the axis by this at most, radians; a fine step moves no sphere by more than its radius of trust,
# mm, which starts here and follows the success of the steps.
LARGEST_TURN, TRUST = 0.1, 0.3
# A fine step has to promise less than this share of the error. No step is made from an error below EXACT, and no
# further start where one is below ENOUGH, mm: nobody can cut that well.
GAIN, EXACT, ENOUGH = 0.98, 1e-6, 1e-4
# A step within this share of its radius of trust is not held back by it.
INNER = 0.9
# Cosine of one degree: directions closer than that lead to the same line.
SAME = 0.99985


@njit(forceinline=True)
def best_window(error, on, contact, least, border):
    """(first sphere, largest |error|) of the best run of `least` spheres that holds `contact`, `on` above `border`."""
    first = -1
    best = np.inf
    for a in range(max(contact - least + 1, 0), min(contact, error.shape[0] - least) + 1):
        worst = 0.0
        for j in range(a, a + least):
            if on[j] < border:
                worst = np.inf
                break
            worst = max(worst, abs(error[j]))
        if worst < best:
            best = worst
            first = a
    return first, best


@njit(forceinline=True)
def line_error(error, on, contact, least):
    """(first sphere of the best window, axis error): overcut counts anywhere on the face, stock in the window."""
    first, worst = best_window(error, on, contact, least, ON_FACE)
    for j in range(error.shape[0]):
        if on[j] > 0.5:
            worst = max(worst, -error[j])
    return first, worst


@njit(forceinline=True)
def move(x, n, radius, height, e1, e2, change, span, shift, d, p):
    """Apply a change (3,) of the shift and of the end's motion along e1 and e2, mm; fills p (3,), returns the shift.

    d (3,) is changed. The sphere at `height` on the axis, of `radius`, stays above x (3,) on the normal n (3,).
    """
    shift += change[0]
    for k in range(3):
        d[k] += (change[1] * e1[k] + change[2] * e2[k]) / span
    normalise(d)
    for k in range(3):
        p[k] = x[k] + (radius + shift) * n[k] - height * d[k]
    return shift


@njit(cache=True)
def plain_step(rows, error, on, first, least, change):
    """Gauss-Newton on the errors of the window and whatever overcuts outside it; fills change (3,)."""
    matrix = np.zeros((3, 3))
    right = np.zeros(3)
    count = error.shape[0]
    for j in range(count):
        if first <= j < first + least or (on[j] > 0.5 and error[j] < 0.0):
            for a in range(3):
                right[a] -= rows[j, a] * error[j]
                for b in range(3):
                    matrix[a, b] += rows[j, a] * rows[j, b]
    for a in range(3):
        matrix[a, a] += DAMPING * count
    factorise(matrix)
    substitute(matrix, right, change)


@njit(forceinline=True)
def largest(change):
    """The largest modulus of three numbers."""
    return max(abs(change[0]), max(abs(change[1]), abs(change[2])))


@njit(forceinline=True)
def promise(rows, error, on, border, first, least, trust, kind, change):
    """Fill change (3,) with what makes the error of the window from `first` on least, to first order; that error.

    It is inf where the window is not `on` above `border`. kind (J,) is room to work in.
    """
    for j in range(error.shape[0]):
        inside = first <= j < first + least
        if inside and on[j] < border:
            return np.inf
        kind[j] = BOTH if inside else LOWER if on[j] > 0.5 else IGNORED
    return least_maximum(rows, error, kind, trust, change)


@njit(cache=True)
def refine_through(
    breaks_u,
    breaks_v,
    coefficients,
    box,
    sense,
    raster,
    vertices,
    loops,
    x,
    n,
    uv,
    d,
    heights,
    radii,
    contact,
    least,
    best,
    known,
    line,
):
    """Least axis error of lines near d that touch the face at x (3,) with unit normal n and the sphere `contact`.

    Three freedoms: the shift along n, which the error bounds, and the two of the direction. First least squares over
    the errors of the best window and whatever overcuts outside it, then their least maximum, each by linearisation.
    While no window lies on the face, what lies on its continuation counts like the face; the second part starts from a
    line on the face if there has been one, and stays on it. Given up where `best` mm will not be beaten, or where the
    plain steps end at one of the directions `known` (K, 3). d (3,) is changed. Fills line (6,): p and d of the best.
    Returns (error, footpoints used); error inf where no window lies on the face, or nothing came of it.
    """
    count = heights.shape[0]
    u = np.empty(count)
    v = np.empty(count)
    error, error_now = np.empty(count), np.empty(count)
    on, on_now = np.empty(count), np.empty(count)
    normal, rows = np.empty((count, 3)), np.empty((count, 3))
    kind = np.empty(count, dtype=np.int64)
    change, other_change = np.zeros(3), np.empty(3)
    p = np.empty(3)
    d_now = np.empty(3)
    copy(d, d_now)
    span = heights[count - 1] - heights[0]
    e1, e2 = np.empty(3), np.empty(3)
    across(d, e1, e2)
    shift = shift_now = found_shift = 0.0
    found = worst_now = promised = np.inf
    first_now = -1
    strict_now = False
    trust = TRUST
    used = 0
    for step in range(PLAIN_STEPS + FINE_STEPS + 1):
        shift = move(x, n, radii[contact], heights[contact], e1, e2, change, span, shift_now, d, p)
        u[contact] = uv[0]
        v[contact] = uv[1]
        axis_errors(
            breaks_u, breaks_v, coefficients, box, sense, raster, p, d, heights, radii, contact, u, v, error, normal, on
        )
        used += count
        for j in range(count):
            if on[j] > NEAR_LOOP - 0.5:
                on[j] = 1.0 if is_inside(u[j], v[j], vertices, loops) else 0.0
        first, worst = line_error(error, on, contact, least)
        strict = first >= 0
        if strict:
            if worst < found:
                found = worst
                found_shift = shift
                copy(p, line[:3])
                copy(d, line[3:])
        else:
            first, worst = best_window(error, on, contact, least, ON_SURFACE)
            if first < 0:
                worst = np.inf
        if step <= PLAIN_STEPS or (strict and not strict_now) or (strict == strict_now and worst < worst_now):
            if first < 0:
                break
            if step > PLAIN_STEPS and worst_now - worst > 0.5 * (worst_now - promised):
                trust = min(2.0 * trust, TRUST)
            shift_now, worst_now, first_now, strict_now = shift, worst, first, strict
            copy(d, d_now)
            copy(error, error_now)
            copy(on, on_now)
            across(d, e1, e2)
            for j in range(count):
                arm = (heights[j] - heights[contact]) / span
                for k in range(3):
                    rows[j, k] = 0.0
                for k in range(3):
                    rows[j, 0] += normal[j, k] * n[k]
                    rows[j, 1] += arm * normal[j, k] * e1[k]
                    rows[j, 2] += arm * normal[j, k] * e2[k]
        else:
            trust = 0.25 * largest(change)
        if step < PLAIN_STEPS:
            plain_step(rows, error_now, on_now, first_now, least, change)
            longest = max(abs(change[1]), abs(change[2])) / span
            if longest > LARGEST_TURN:
                for k in range(3):
                    change[k] *= LARGEST_TURN / longest
        else:
            if step == PLAIN_STEPS:
                if worst_now > HOPELESS * best:
                    break
                same = False
                for k in range(known.shape[0]):
                    same = same or d[0] * known[k, 0] + d[1] * known[k, 1] + d[2] * known[k, 2] > SAME
                if same:
                    break
                if not strict_now and found < np.inf:
                    # The plain steps have left the face: back to the best line on it. A fine step from there that
                    # leaves it again is refused, and the radius of trust shrinks.
                    shift_now = found_shift
                    copy(line[3:], d_now)
                    copy(d_now, d)
                    for k in range(3):
                        change[k] = 0.0
                    continue
            if worst_now < EXACT:
                break
            border = ON_FACE if strict_now else ON_SURFACE
            promised = promise(rows, error_now, on_now, border, first_now, least, trust, kind, change)
            if promised > GAIN * worst_now:
                # Another window may promise more.
                for a in (first_now - 1, first_now + 1):
                    if max(contact - least + 1, 0) <= a <= min(contact, count - least):
                        other = promise(rows, error_now, on_now, border, a, least, trust, kind, other_change)
                        if other < promised:
                            promised = other
                            copy(other_change, change)
            if promised > GAIN * worst_now:
                break
            if promised > GAIN * best and largest(change) < INNER * trust:
                break
        copy(d_now, d)
    return found, used


@njit(cache=True, nogil=True)
def reach_errors(
    breaks_u,
    breaks_v,
    coefficients,
    box,
    sense,
    raster,
    vertices,
    loops,
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
    """`refine_through` from every start direction of every point, the best kept if better than what is there.

    points, normals (N, 3), uv (N, 2). Starts of point i: directions (M, 3) and contacts (M,) from starts[i] to starts[i
    + 1]. Improves error (N,), lines (N, 6), height (N,), and adds to footpoints (N,).
    """
    for i in range(points.shape[0]):
        line, d = np.empty(6), np.empty(3)
        known = np.empty((starts[i + 1] - starts[i], 3))
        count = 0
        for k in range(starts[i], starts[i + 1]):
            if k > starts[i] and contacts[k] != contacts[k - 1]:
                count = 0
            if error[i] < ENOUGH:
                break
            copy(directions[k], d)
            found, used = refine_through(
                breaks_u, breaks_v, coefficients, box, sense, raster, vertices, loops, points[i], normals[i], uv[i], d,
                heights, radii, contacts[k], least, error[i], known[:count], line,
            )  # fmt: skip
            footpoints[i] += used
            if found < np.inf:
                copy(line[3:], known[count])
                count += 1
            if found < error[i]:
                error[i] = found
                copy(line, lines[i])
                height[i] = heights[contacts[k]]
