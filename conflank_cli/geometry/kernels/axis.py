"""The axis error along one tool axis, the refinement of a line, and the tracing of a line over a face.

A line is (p, d): its point in the plane of r_min and its unit direction towards the spindle. Spheres of radius radii[j]
sit on it at heights[j]; the axis error there is sense * distance - radius - allowance.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from conflank_cli.geometry.kernels.footpoint import CLAMPED, FAILED, project
from conflank_cli.geometry.kernels.small_systems import factorise, least_eigenvector, substitute

# Weight of samples whose foot is off the face: enough to keep the line steady there, too little to pull it.
OFF_FACE_WEIGHT = 0.01
# A line is settled when a step would change its axis error by less than this, root mean square, mm.
SETTLED = 2e-4
# Cost of turning while a line is followed: it decides where contact does not, and must not where contact does.
STIFFNESS = 1e-3
# Steps of refinement: of a seed, and of a line that has been moved on. As values of a type: numba compiles a function
# anew for every literal number.
SEED_STEPS, NEXT_STEPS = np.int64(10), np.int64(3)


@njit(forceinline=True)
def raster_value(raster, breaks_u, breaks_v, u, v):
    """Nearest cell of a raster over the extended domain."""
    i = int((u - breaks_u[0]) / (breaks_u[-1] - breaks_u[0]) * raster.shape[0])
    j = int((v - breaks_v[0]) / (breaks_v[-1] - breaks_v[0]) * raster.shape[1])
    i = min(max(i, 0), raster.shape[0] - 1)
    j = min(max(j, 0), raster.shape[1] - 1)
    return raster[i, j]


@njit(cache=True)
def axis_errors(
    breaks_u, breaks_v, coefficients, box, sense, raster, p, d, heights, radii, start, u, v, error, normal, on
):
    """Axis error at every sphere of a line; feet are warm started from `start` outwards.

    u, v (J,): on input a start at index `start`; filled. error (J,) mm, normal (J, 3) towards the cutter, on (J,): 1 on
    the face, 0 off it but on the surface or its extension, -1 where there is no footpoint.
    """
    count = heights.shape[0]
    for side in range(2):
        a = u[start]
        b = v[start]
        step = 1 if side == 0 else -1
        j = start if side == 0 else start - 1
        while 0 <= j < count:
            h = heights[j]
            r = project(breaks_u, breaks_v, coefficients, box, p[0] + h * d[0], p[1] + h * d[1], p[2] + h * d[2], a, b)
            a = r[0]
            b = r[1]
            u[j] = a
            v[j] = b
            normal[j, 0] = sense * r[5]
            normal[j, 1] = sense * r[6]
            normal[j, 2] = sense * r[7]
            error[j] = sense * r[8] - radii[j]
            if r[9] == CLAMPED or r[9] == FAILED:
                on[j] = -1.0
            else:
                on[j] = raster_value(raster, breaks_u, breaks_v, a, b)
            j += step


@njit(forceinline=True)
def sample_weight(error, on, scale):
    """Weight of a sample: overcut counts in full, stock left beyond `scale` fades (another sweep takes it).

    The fading is Geman and McClure's, whose influence vanishes far out.
    """
    if on < 0.0:
        return 0.0
    w = 1.0
    if error > 0.0:
        q = error / scale
        w = 1.0 / ((1.0 + q * q) * (1.0 + q * q))
    if on < 0.5:
        return w * OFF_FACE_WEIGHT
    return w


@njit(forceinline=True)
def across(d, e1, e2):
    """Two unit vectors across the unit vector d (3,), and across each other, into e1 and e2 (3,)."""
    if abs(d[0]) < 0.6:
        e1[0], e1[1], e1[2] = 0.0, d[2], -d[1]
    else:
        e1[0], e1[1], e1[2] = -d[2], 0.0, d[0]
    normalise(e1)
    e2[0] = d[1] * e1[2] - d[2] * e1[1]
    e2[1] = d[2] * e1[0] - d[0] * e1[2]
    e2[2] = d[0] * e1[1] - d[1] * e1[0]


@njit(forceinline=True)
def normalise(d):
    """Make the vector d (3,) a unit vector, in place."""
    length = np.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
    for k in range(3):
        d[k] /= length


@njit(forceinline=True)
def copy(values, into):
    """Copy (N,) numbers: numba compiles a slice assignment to far more than this loop."""
    for k in range(values.shape[0]):
        into[k] = values[k]


@njit(cache=True, nogil=True)
def copy_line(p, d, u, v, error, on, into_p, into_d, into_u, into_v, into_error, into_on):
    """Copy what belongs to a line: p, d (3,) and u, v, error, on (J,)."""
    copy(p, into_p)
    copy(d, into_d)
    copy(u, into_u)
    copy(v, into_v)
    copy(error, into_error)
    copy(on, into_on)


@njit(cache=True)
def refine_line(
    breaks_u,
    breaks_v,
    coefficients,
    box,
    sense,
    raster,
    p,
    d,
    heights,
    radii,
    start,
    u,
    v,
    error,
    normal,
    on,
    scale_first,
    scale_last,
    iterations,
    damping,
):
    """Least squares in the five freedoms of a line, in place: p, d and the arrays of `axis_errors`.

    Gauss-Newton on the weighted axis error with a small Levenberg term, which leaves the soft freedoms (sliding along
    the contact and along the sweep) where they were. `scale` shrinks from first to last over the iterations; at the
    last it ends early where a step would change the axis error by less than `SETTLED`.
    Returns False where the line lost the face.
    """
    count = heights.shape[0]
    matrix = np.empty((5, 5))
    right = np.empty(5)
    row = np.empty(5)
    step = np.empty(5)
    cx = np.empty(3)
    e1, e2 = np.empty(3), np.empty(3)
    middle = 0.5 * (heights[0] + heights[count - 1])
    half = 0.5 * (heights[count - 1] - heights[0])
    for iteration in range(iterations):
        axis_errors(
            breaks_u, breaks_v, coefficients, box, sense, raster, p, d, heights, radii, start, u, v, error, normal, on
        )
        # Two unit vectors across the axis; rotations are measured as displacement at the ends of the flute.
        across(d, e1, e2)
        fraction = iteration / max(iterations - 1, 1)
        scale = scale_last if fraction >= 1.0 else scale_first * (scale_last / scale_first) ** fraction
        total = 0.0
        for a in range(5):
            right[a] = 0.0
            for b in range(5):
                matrix[a, b] = 0.0
        for j in range(count):
            w = sample_weight(error[j], on[j], scale)
            if w == 0.0:
                continue
            total += w
            arm = (heights[j] - middle) / half
            n1 = normal[j, 0] * e1[0] + normal[j, 1] * e1[1] + normal[j, 2] * e1[2]
            n2 = normal[j, 0] * e2[0] + normal[j, 1] * e2[1] + normal[j, 2] * e2[2]
            row[0] = n1
            row[1] = n2
            row[2] = normal[j, 0] * d[0] + normal[j, 1] * d[1] + normal[j, 2] * d[2]
            row[3] = n1 * arm
            row[4] = n2 * arm
            for a in range(5):
                right[a] -= w * row[a] * error[j]
                for b in range(5):
                    matrix[a, b] += w * row[a] * row[b]
        if total < 1e-6:
            return False
        for a in range(5):
            matrix[a, a] += damping * total + 1e-9
        factorise(matrix)
        substitute(matrix, right, step)
        gain = 0.0
        square = 0.0
        for a in range(5):
            gain += step[a] * right[a]
            square += step[a] * step[a]
        if scale <= scale_last and gain < SETTLED * SETTLED * total:
            return True
        if square > 1.0:
            for a in range(5):
                step[a] /= np.sqrt(square)
        # Centre of the flute moves by step[0:3], the ends by +- step[3:5] across the axis.
        for k in range(3):
            cx[k] = p[k] + middle * d[k] + step[0] * e1[k] + step[1] * e2[k] + step[2] * d[k]
        for k in range(3):
            d[k] += (step[3] * e1[k] + step[4] * e2[k]) / half
        normalise(d)
        for k in range(3):
            p[k] = cx[k] - middle * d[k]
    axis_errors(
        breaks_u, breaks_v, coefficients, box, sense, raster, p, d, heights, radii, start, u, v, error, normal, on
    )
    return True


@njit(cache=True, nogil=True)
def refine_sequence(
    breaks_u,
    breaks_v,
    coefficients,
    box,
    sense,
    raster,
    p,
    d,
    heights,
    radii,
    start,
    u0,
    v0,
    scale,
    iterations,
    damping,
    error,
    normal,
    on,
    weight,
):
    """`refine_line` for lines p, d (K, 3) in order, in place; the feet of sphere `start` start from u0, v0 (K,).

    error, on, weight (K, J) and normal (K, J, 3) are filled as `axis_errors` and `sample_weight` have them.
    """
    count = heights.shape[0]
    u = np.empty(count)
    v = np.empty(count)
    for k in range(p.shape[0]):
        u[start] = u0[k]
        v[start] = v0[k]
        refine_line(
            breaks_u,
            breaks_v,
            coefficients,
            box,
            sense,
            raster,
            p[k],
            d[k],
            heights,
            radii,
            start,
            u,
            v,
            error[k],
            normal[k],
            on[k],
            scale,
            scale,
            iterations,
            damping,
        )
        for j in range(count):
            weight[k, j] = sample_weight(error[k, j], on[k, j], scale)


@njit(cache=True)
def sweep_direction(p, d, heights, normal, error, on, scale, stiffness, out):
    """Velocity of the axis that changes the axis error least: paper Eq. 5-6 as a generalised eigenproblem.

    The velocity across the axis is linear along it, v(h) = (1 - s) v0 + s v1 with s from the lowest to the highest
    sphere; motion along the axis and spin are excluded by the parametrisation. Minimises sum w <v, n>^2 over the mean
    of |v|^2, plus `stiffness` times the squared turning, which decides where contact does not.
    Fills out (2, 3) with v0, v1, normalised to unit mean square speed; returns the eigenvalue.
    """
    count = heights.shape[0]
    e1, e2 = np.empty(3), np.empty(3)
    across(d, e1, e2)
    matrix, reduced, room = np.zeros((4, 4)), np.zeros((4, 4)), np.empty((4, 4))
    row, best = np.empty(4), np.empty(4)
    total = 0.0
    for j in range(count):
        w = sample_weight(error[j], on[j], scale)
        s = (heights[j] - heights[0]) / (heights[count - 1] - heights[0])
        n1 = normal[j, 0] * e1[0] + normal[j, 1] * e1[1] + normal[j, 2] * e1[2]
        n2 = normal[j, 0] * e2[0] + normal[j, 1] * e2[1] + normal[j, 2] * e2[2]
        row[0] = (1.0 - s) * n1
        row[1] = (1.0 - s) * n2
        row[2] = s * n1
        row[3] = s * n2
        total += w
        for a in range(4):
            for b in range(4):
                matrix[a, b] += w * row[a] * row[b]
    for a in range(4):
        for b in range(4):
            matrix[a, b] /= max(total, 1e-9)
    for k in range(2):
        matrix[k, k] += stiffness
        matrix[k + 2, k + 2] += stiffness
        matrix[k, k + 2] -= stiffness
        matrix[k + 2, k] -= stiffness
    # Mass matrix of a linear velocity: [[1/3, 1/6], [1/6, 1/3]] in each direction; its Cholesky factor is explicit.
    l11 = np.sqrt(1.0 / 3.0)
    l21 = (1.0 / 6.0) / l11
    l22 = np.sqrt(1.0 / 3.0 - l21 * l21)
    # Its inverse has the blocks i11, 0; i21, i22, each times the unit matrix.
    i11, i21, i22 = 1.0 / l11, -l21 / (l11 * l22), 1.0 / l22
    for k in range(2):
        for m in range(2):
            m00, m01, m10, m11 = matrix[k, m], matrix[k, m + 2], matrix[k + 2, m], matrix[k + 2, m + 2]
            reduced[k, m] = i11 * i11 * m00
            reduced[k, m + 2] = i11 * (i21 * m00 + i22 * m01)
            reduced[k + 2, m] = i11 * (i21 * m00 + i22 * m10)
            reduced[k + 2, m + 2] = i21 * (i21 * m00 + i22 * m01) + i22 * (i21 * m10 + i22 * m11)
    least = least_eigenvector(reduced, room, best)
    for k in range(3):
        out[0, k] = (i11 * best[0] + i21 * best[2]) * e1[k] + (i11 * best[1] + i21 * best[3]) * e2[k]
        out[1, k] = i22 * best[2] * e1[k] + i22 * best[3] * e2[k]
    return least


@njit(cache=True)
def line_quality(error, on, tolerance_over, tolerance_under):
    """(samples on the face, samples within tolerance, worst overcut) of a line."""
    there = 0
    good = 0
    worst = 0.0
    for j in range(error.shape[0]):
        if on[j] > 0.5:
            there += 1
            worst = min(worst, error[j])
            if -tolerance_over <= error[j] <= tolerance_under:
                good += 1
    return there, good, worst


@njit(cache=True, nogil=True)
def refine_all(
    breaks_u, breaks_v, coefficients, box, sense, raster, p, d, heights, radii, start, u, v, over, under, faded, found
):
    """`refine_line` for every seed, in place, from a coarse scale to that of tracing.

    p, d (N, 3), start (N,) the sphere that touches, u, v (N,) its foot; found (N,) says which lines fit well enough to
    be followed.
    """
    count = heights.shape[0]
    for k in range(p.shape[0]):
        feet_u = np.empty(count)
        feet_v = np.empty(count)
        error = np.empty(count)
        normal = np.empty((count, 3))
        on = np.empty(count)
        feet_u[start[k]] = u[k]
        feet_v[start[k]] = v[k]
        found[k] = False
        if refine_line(
            breaks_u, breaks_v, coefficients, box, sense, raster, p[k], d[k], heights, radii, start[k],
            feet_u, feet_v, error, normal, on, 20.0 * under, faded * under, SEED_STEPS, 1e-3,
        ):  # fmt: skip
            there, good, worst = line_quality(error, on, over, under)
            found[k] = there >= 4 and good >= 0.3 * there and good >= 4 and worst >= -1.5 * over
        u[k] = feet_u[start[k]]
        v[k] = feet_v[start[k]]


@njit(cache=True)
def trace_line(
    breaks_u,
    breaks_v,
    coefficients,
    box,
    sense,
    raster,
    p0,
    d0,
    heights,
    radii,
    start0,
    u0,
    v0,
    step,
    over,
    under,
    faded,
    sequence_p,
    sequence_d,
    sequence_error,
    sequence_u,
    sequence_v,
    sequence_on,
):
    """Follow a line of `refine_all` over the face both ways by prediction and correction.

    The line is moved `step` mm along the direction that changes the axis error least, refined, and kept while enough of
    it is within tolerance; it ends where it leaves the face, loses tolerance, or turns back. The last lines just off
    the face are kept, so that a patch reaches the edge.
    sequence_* have room for T lines: p, d (T, 3), error, u, v, on (T, J). Returns (first, last + 1) of the rows used.
    """
    room = sequence_p.shape[0]
    count = heights.shape[0]
    u = np.empty(count)
    v = np.empty(count)
    error = np.empty(count)
    normal = np.empty((count, 3))
    on = np.empty(count)
    velocity = np.empty((2, 3))
    last = np.empty((2, 3))
    bend = np.empty((2, 3))
    before_middle, start_low, start_high = np.empty(3), np.empty(3), np.empty(3)
    p, d = np.empty(3), np.empty(3)
    copy(p0, p)
    copy(d0, d)
    start = start0
    u[start] = u0
    v[start] = v0
    scale = faded * under
    length = heights[count - 1] - heights[0]
    axis_errors(
        breaks_u, breaks_v, coefficients, box, sense, raster, p, d, heights, radii, start, u, v, error, normal, on
    )
    centre = room // 2
    first_normal = np.empty((count, 3))
    for j in range(count):
        copy(normal[j], first_normal[j])
    low = centre
    high = centre + 1
    copy_line(
        p, d, u, v, error, on, sequence_p[centre], sequence_d[centre],
        sequence_u[centre], sequence_v[centre], sequence_error[centre], sequence_on[centre],
    )  # fmt: skip
    for side in range(2):
        copy_line(
            sequence_p[centre], sequence_d[centre], sequence_u[centre], sequence_v[centre],
            sequence_error[centre], sequence_on[centre], p, d, u, v, error, on,
        )  # fmt: skip
        for j in range(count):
            copy(first_normal[j], normal[j])
        sign = 1.0 if side == 0 else -1.0
        off = 0
        for k in range(1, centre):
            sweep_direction(p, d, heights, normal, error, on, scale, STIFFNESS, velocity)
            if k > 1:
                turn = 0.0
                for m in range(3):
                    turn += (velocity[0, m] + velocity[1, m]) * (last[0, m] + last[1, m])
                sign = 1.0 if turn > 0.0 else -1.0
            for m in range(3):
                before_middle[m] = p[m] + 0.5 * length * d[m]
                start_low[m] = p[m] + heights[0] * d[m]
                start_high[m] = p[m] + heights[count - 1] * d[m]
                for end in range(2):
                    velocity[end, m] *= sign
                    # Half of how the velocity has changed since the last step: second order, as the path bends.
                    bend[end, m] = 0.5 * (velocity[end, m] - last[end, m]) if k > 1 else 0.0
                start_low[m] += step * (velocity[0, m] + bend[0, m])
                start_high[m] += step * (velocity[1, m] + bend[1, m])
            for m in range(3):
                last[0, m] = velocity[0, m]
                last[1, m] = velocity[1, m]
                d[m] = start_high[m] - start_low[m]
            normalise(d)
            for m in range(3):
                middle = 0.5 * (start_low[m] + start_high[m])
                p[m] = middle - 0.5 * (heights[0] + heights[count - 1]) * d[m]
            start = count // 2
            for j in range(count):
                # Start where the face is.
                if on[j] > 0.5 and abs(j - count // 2) < abs(start - count // 2) + count * (on[start] < 0.5):
                    start = j
            ok = refine_line(
                breaks_u,
                breaks_v,
                coefficients,
                box,
                sense,
                raster,
                p,
                d,
                heights,
                radii,
                start,
                u,
                v,
                error,
                normal,
                on,
                2.0 * scale,
                scale,
                NEXT_STEPS,
                1e-3,
            )
            if not ok:
                break
            forward = 0.0
            for m in range(3):
                forward += (p[m] + 0.5 * length * d[m] - before_middle[m]) * (last[0, m] + last[1, m]) * 0.5
            if forward < 0.3 * step:
                break
            there, good, worst = line_quality(error, on, over, under)
            if worst < -2.0 * over:
                break
            if there < 2:
                off += 1
            elif good < 0.25 * there or good < 2:
                break
            row = centre + k if side == 0 else centre - k
            copy_line(
                p, d, u, v, error, on, sequence_p[row], sequence_d[row],
                sequence_u[row], sequence_v[row], sequence_error[row], sequence_on[row],
            )  # fmt: skip
            if side == 0:
                high = row + 1
            else:
                low = row
            if off >= 2:
                break
    return low, high


@njit(cache=True, nogil=True)
def trace_all(
    breaks_u,
    breaks_v,
    coefficients,
    box,
    sense,
    raster,
    p,
    d,
    heights,
    radii,
    start,
    u,
    v,
    step,
    over,
    under,
    faded,
    sequence_p,
    sequence_d,
    sequence_error,
    sequence_u,
    sequence_v,
    sequence_on,
    spans,
):
    """`trace_line` for every line; spans (N, 2) gets the rows used."""
    for k in range(p.shape[0]):
        low, high = trace_line(
            breaks_u,
            breaks_v,
            coefficients,
            box,
            sense,
            raster,
            p[k],
            d[k],
            heights,
            radii,
            start[k],
            u[k],
            v[k],
            step,
            over,
            under,
            faded,
            sequence_p[k],
            sequence_d[k],
            sequence_error[k],
            sequence_u[k],
            sequence_v[k],
            sequence_on[k],
        )
        spans[k, 0] = low
        spans[k, 1] = high
