"""Footpoints on a surface given as per-span polynomials: Newton's method, fused with the evaluation.

Spans come as in `conflank_cli.geometry.surface.Spans`: coefficients (ku, kv, m, n, 4) in local parameters, the four
coordinates of each side by side, so that the processor works on them at once.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from conflank_cli.geometry.kernels.lanes import components, dot, lanes, load

# Fused multiply-add is worth a quarter of the time and only drops roundings.
FAST = {"contract"}
# What other kernels call for every point is part of them. It makes no arrays, so that references to those that it is
# passed need no counting, which cores that share a surface would wait for each other with.
INNER = {"forceinline": True, "error_model": "numpy", "fastmath": FAST, "_nrt": False}
# A step of Newton's method is followed by one on the second-order expansion of the surface. What both leave is of
# second order too, in the distance times the third derivatives, but far less; how much shows in the step before, for
# e' / e² stays. They are the last ones where that says they leave less than LAST_ERROR (in units of the span), and the
# expansion gives the foot to rounding, as it does up to LAST_STEP.
LAST_ERROR = 1.0e-11
LAST_STEP = 1.0e-4
# A step of Newton alone leaves one of second order.
LAST_PLAIN_STEP = 3.0e-6
# Without quadratic convergence a small step says little about the distance left, so it has to be tiny.
LAST_LINEAR_STEP = 1.0e-12
# The expansion is of no use further away than this, in spans.
EXPANDED = 0.5
MAX_ITERATIONS = 40
# The Hessian of the half squared distance over the metric has the determinant Π(1 - ρ κ): above this it is taken for
# positive, and Newton's method converges quadratically even close to a centre of curvature.
SAFELY_POSITIVE = 1.0e-6
# Where it is not positive, its eigenvalues 1 - ρ κ are replaced by their moduli, and by no less than this.
LEAST_MODULUS = 0.05
# Squared sine of the angle between tangents below which they count as parallel.
PARALLEL = 1.0e-14
# Squared ratio of tangents below which the shorter one is rounding: a pole, where its parameter has no say.
VANISHED = 1.0e-26

INTERIOR = 1  # the foot is a true orthogonal projection inside the box of the surface proper
CLAMPED = 2  # the foot sits on the boundary of the domain searched; the residual is not along the normal there
OUTSIDE = 4  # the foot lies on the smooth extension, past the boundary of the surface proper
FAILED = 8  # no convergence within MAX_ITERATIONS


@njit(**INNER)
def find_span(breaks, x):
    """Index of the span that holds x, clamped to the first and last."""
    low = 0
    high = breaks.shape[0] - 1
    while high - low > 1:
        middle = (low + high) >> 1
        if breaks[middle] <= x:
            low = middle
        else:
            high = middle
    return low


@njit(**INNER)
def _guess_span(breaks, x):
    """`find_span`, looked for first where equal spans would have it."""
    last = breaks.shape[0] - 1
    k = min(max(int((x - breaks[0]) * (last / (breaks[last] - breaks[0]))), 0), last - 1)
    if (x >= breaks[k] or k == 0) and (x < breaks[k + 1] or k == last - 1):
        return k
    return find_span(breaks, x)


@njit(**INNER)
def _relocated(breaks, k, a, step):
    """Span, local parameter there, and the step that led there, of a place given in span k, or past its ends.

    Where the place is past the ends of the domain, it becomes that end.
    """
    if 0.0 <= a <= 1.0:
        return k, a, step
    width = breaks[k + 1] - breaks[k]
    origin = breaks[k] + (a - step) * width
    x = min(max(breaks[k] + a * width, breaks[0]), breaks[breaks.shape[0] - 1])
    k = find_span(breaks, x)
    width = breaks[k + 1] - breaks[k]
    return k, (x - breaks[k]) / width, (x - origin) / width


@njit(**INNER)
def _parameter(breaks, k, a):
    """Parameter of a place given in span k: its end to the last bit."""
    return breaks[k + 1] if a == 1.0 else breaks[k] + a * (breaks[k + 1] - breaks[k])


@njit(error_model="numpy", fastmath=FAST, _nrt=False)
def _general(coefficients, at, rows, columns, a, b):
    """S, Sa, Sb, Saa, Sab, Sbb, homogeneous, of the block (rows, columns, 4) at a flat index, by Horner's rule."""
    s = sa = saa = sb = sab = sbb = lanes(0.0, 0.0, 0.0, 0.0)
    for i in range(rows - 1, -1, -1):
        g = gb = gbb = lanes(0.0, 0.0, 0.0, 0.0)
        for j in range(columns - 1, -1, -1):
            gbb = gbb * b + gb
            gb = gb * b + g
            g = g * b + load(coefficients, at + 4 * (i * columns + j))
        saa = saa * a + sa
        sa = sa * a + s
        s = s * a + g
        sab = sab * a + sb
        sb = sb * a + gb
        sbb = sbb * a + gbb
    return s, sa, sb, 2.0 * saa, sab, 2.0 * sbb


@njit(**INNER)
def _cubic(coefficients, at, b):
    """Value, derivative and half the second derivative of the cubic at a flat index."""
    c0 = load(coefficients, at)
    c1 = load(coefficients, at + 4)
    c2 = load(coefficients, at + 8)
    c3 = load(coefficients, at + 12)
    steep = (3.0 * b) * c3
    return ((c3 * b + c2) * b + c1) * b + c0, (steep + 2.0 * c2) * b + c1, steep + c2


@njit(**INNER)
def _bicubic(coefficients, at, a, b):
    """`_general` for four rows and columns, written out."""
    g0, h0, k0 = _cubic(coefficients, at, b)
    g1, h1, k1 = _cubic(coefficients, at + 16, b)
    g2, h2, k2 = _cubic(coefficients, at + 32, b)
    g3, h3, k3 = _cubic(coefficients, at + 48, b)
    t = 3.0 * a
    s = ((g3 * a + g2) * a + g1) * a + g0
    sa = (g3 * t + 2.0 * g2) * a + g1
    saa = g3 * t + g2
    sb = ((h3 * a + h2) * a + h1) * a + h0
    sab = (h3 * t + 2.0 * h2) * a + h1
    sbb = ((k3 * a + k2) * a + k1) * a + k0
    return s, sa, sb, 2.0 * saa, sab, 2.0 * sbb


@njit(**INNER)
def _weight(vector):
    """The fourth coordinate."""
    return components(vector)[3]


@njit(**INNER)
def _rational(s, sa, sb, saa, sab, sbb):
    """Quotient rule: the same of the surface itself from those of the homogeneous coordinates."""
    r = 1.0 / _weight(s)
    s = s * r
    wa = _weight(sa)
    wb = _weight(sb)
    waa = _weight(saa)
    wab = _weight(sab)
    wbb = _weight(sbb)
    sa = (sa - s * wa) * r
    sb = (sb - s * wb) * r
    saa = (saa - sa * (2.0 * wa) - s * waa) * r
    sab = (sab - sa * wb - sb * wa - s * wab) * r
    sbb = (sbb - sb * (2.0 * wb) - s * wbb) * r
    return s, sa, sb, saa, sab, sbb


@njit(**INNER)
def _frame(coefficients, at, rows, columns, a, b):
    """S, Sa, Sb, Saa, Sab, Sbb of the block (rows, columns, 4) at a flat index, at local (a, b), as vectors."""
    if rows == 4 and columns == 4:
        frame = _bicubic(coefficients, at, a, b)
    else:
        frame = _general(coefficients, at, rows, columns, a, b)
    if _weight(frame[0]) != 0.0:
        frame = _rational(*frame)
    return frame


@njit(**INNER)
def local_frame(block, a, b):
    """S, Sa, Sb, Saa, Sab, Sbb of a span block (m, n, 4) at local (a, b), coordinate by coordinate."""
    s, sa, sb, saa, sab, sbb = _frame(block, 0, block.shape[0], block.shape[1], a, b)
    x0, y0, z0, _ = components(s)
    x1, y1, z1, _ = components(sa)
    x2, y2, z2, _ = components(sb)
    x3, y3, z3, _ = components(saa)
    x4, y4, z4, _ = components(sab)
    x5, y5, z5, _ = components(sbb)
    return (x0, x1, x2, x3, x4, x5), (y0, y1, y2, y3, y4, y5), (z0, z1, z2, z3, z4, z5)


@njit(**INNER)
def _keep(vector, out, k, m):
    """Write the coordinates of a vector into out[k, m] (3,)."""
    out[k, m, 0], out[k, m, 1], out[k, m, 2], _ = components(vector)


@njit(error_model="numpy", fastmath=FAST, cache=True)
def evaluate(breaks_u, breaks_v, coefficients, u, v, out):
    """Fill out (N, 6, 3) with S, Su, Sv, Suu, Suv, Svv at the parameters u, v (N,)."""
    rows = coefficients.shape[2]
    columns = coefficients.shape[3]
    for k in range(u.shape[0]):
        i = find_span(breaks_u, u[k])
        j = find_span(breaks_v, v[k])
        hu = 1.0 / (breaks_u[i + 1] - breaks_u[i])
        hv = 1.0 / (breaks_v[j + 1] - breaks_v[j])
        a = (u[k] - breaks_u[i]) * hu
        b = (v[k] - breaks_v[j]) * hv
        at = (i * coefficients.shape[1] + j) * (4 * rows * columns)
        s, sa, sb, saa, sab, sbb = _frame(coefficients, at, rows, columns, a, b)
        _keep(s, out, k, 0)
        _keep(sa * hu, out, k, 1)
        _keep(sb * hv, out, k, 2)
        _keep(saa * (hu * hu), out, k, 3)
        _keep(sab * (hu * hv), out, k, 4)
        _keep(sbb * (hv * hv), out, k, 5)


@njit(**INNER)
def _tangents(sa, sb, saa, sab, sbb, a, b):
    """Both tangents a step (a, b) away, by the second-order expansion of the surface."""
    return sa + saa * a + sab * b, sb + sab * a + sbb * b


@njit(**INNER)
def _cross(one, other):
    """Components of the vector product."""
    ax, ay, az, _ = components(one)
    bx, by, bz, _ = components(other)
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


@njit(**INNER)
def _line_step(gradient, second, metric):
    """Step along one parameter alone, and the size below which it is the last one."""
    if second > SAFELY_POSITIVE * metric:
        return -gradient / second, LAST_PLAIN_STEP * min(1.0, second / metric)
    return -gradient / max(abs(second), LEAST_MODULUS * metric), LAST_LINEAR_STEP


@njit(error_model="numpy", fastmath=FAST, _nrt=False)
def _descent_step(ga, gb, haa, hab, hbb, e, f, g):
    """Step with the eigenvalues of the Hessian, relative to the metric, replaced by their moduli."""
    if not e * g - f * f > PARALLEL * e * g:
        # Parallel tangents: half of each parameter's own step.
        return -0.5 * ga / e, -0.5 * gb / g
    # Cholesky factors of the metric turn the Hessian into the symmetric matrix (p, q; q, r), the gradient into (x, y).
    l11 = np.sqrt(e)
    l21 = f / l11
    l22 = np.sqrt(g - l21 * l21)
    p = haa / e
    q = (hab - p * f) / (l11 * l22)
    r = (hbb - 2.0 * l21 * hab / l11 + l21 * l21 * p) / (l22 * l22)
    x = ga / l11
    y = (gb - l21 * x) / l22
    angle = 0.5 * np.arctan2(2.0 * q, p - r)
    c = np.cos(angle)
    s = np.sin(angle)
    first = max(abs(p * c * c + 2.0 * q * s * c + r * s * s), LEAST_MODULUS)
    second = max(abs(p * s * s - 2.0 * q * s * c + r * c * c), LEAST_MODULUS)
    along = -(c * x + s * y) / first
    across = -(c * y - s * x) / second
    x = c * along - s * across
    y = s * along + c * across
    db = y / l22
    return (x - l21 * db) / l11, db


@njit(**INNER)
def project(breaks_u, breaks_v, coefficients, box, px, py, pz, u, v):
    """Footpoint of (px, py, pz) from the start (u, v).

    Returns (u, v, foot x, y, z, normal x, y, z, distance, flag). The normal is the unit S_u x S_v at the foot. The
    distance is signed by it; where the foot is clamped it is the component of the residual along the normal.

    Newton on the gradient of the half squared distance; where the Hessian is not positive, with the moduli of its
    eigenvalues (always a descent direction), with step halving. Box-constrained: a parameter at a bound whose gradient
    points outwards is held there and the other one is solved alone.
    """
    last_u = breaks_u.shape[0] - 2
    last_v = breaks_v.shape[0] - 2
    rows = coefficients.shape[2]
    columns = coefficients.shape[3]
    u = min(max(u, breaks_u[0]), breaks_u[last_u + 1])
    v = min(max(v, breaks_v[0]), breaks_v[last_v + 1])
    i = _guess_span(breaks_u, u)
    j = _guess_span(breaks_v, v)
    # Everything in local parameters of the span until the foot is found.
    a = (u - breaks_u[i]) / (breaks_u[i + 1] - breaks_u[i])
    b = (v - breaks_v[j]) / (breaks_v[j + 1] - breaks_v[j])
    p = lanes(px, py, pz, 0.0)
    foot = p
    nx = ny = nz = 0.0
    flag = FAILED
    previous = np.inf
    before = 1e-30  # nothing is known from a step before the first
    da = 0.0
    db = 0.0
    for _ in range(MAX_ITERATIONS):
        if not (0.0 <= a <= 1.0 and 0.0 <= b <= 1.0):
            i, a, da = _relocated(breaks_u, i, a, da)
            j, b, db = _relocated(breaks_v, j, b, db)
        at = (i * (last_v + 1) + j) * (4 * rows * columns)
        s, sa, sb, saa, sab, sbb = _frame(coefficients, at, rows, columns, a, b)
        r = s - p
        value = dot(r, r)
        if value > previous * (1.0 + 1e-12) + 1e-24 and abs(da) + abs(db) > 1e-7:
            # The step overshot: halve it.
            da *= 0.5
            db *= 0.5
            a -= da
            b -= db
            continue
        previous = value
        ga = dot(r, sa)
        gb = dot(r, sb)
        e = dot(sa, sa)
        f = dot(sa, sb)
        g = dot(sb, sb)
        haa = e + dot(r, saa)
        hab = f + dot(r, sab)
        hbb = g + dot(r, sbb)
        hold_u = (i == 0 and a <= 0.0 and ga > 0.0) or (i == last_u and a >= 1.0 and ga < 0.0) or e <= VANISHED * g
        hold_v = (j == 0 and b <= 0.0 and gb > 0.0) or (j == last_v and b >= 1.0 and gb < 0.0) or g <= VANISHED * e
        da = 0.0
        db = 0.0
        last = LAST_PLAIN_STEP
        if hold_u and not hold_v:
            db, last = _line_step(gb, hbb, g)
        elif hold_v and not hold_u:
            da, last = _line_step(ga, haa, e)
        elif not hold_u:
            determinant = haa * hbb - hab * hab
            metric = e * g - f * f
            if determinant > SAFELY_POSITIVE * metric and haa > 0.0:
                inverse = 1.0 / determinant
                da = (gb * hab - ga * hbb) * inverse
                db = (ga * hab - gb * haa) * inverse
                if abs(da) < EXPANDED and abs(db) < EXPANDED:
                    # Once more, with the gradient there of the second-order expansion of the surface: the error left
                    # is of third order, for a fourth of an evaluation.
                    ta, tb = _tangents(sa, sb, saa, sab, sbb, da, db)
                    r = r + (0.5 * da) * (sa + ta) + (0.5 * db) * (sb + tb)
                    ga = dot(r, ta)
                    gb = dot(r, tb)
                    more_a = (gb * hab - ga * hbb) * inverse
                    more_b = (ga * hab - gb * haa) * inverse
                    step = abs(da) + abs(db)
                    more = abs(more_a) + abs(more_b)
                    if more < 0.5 * step:
                        da += more_a
                        db += more_b
                        # The expansion ends with its span.
                        inside = 0.0 <= a + da <= 1.0 and 0.0 <= b + db <= 1.0
                        left = max(more * more / step, step * step * step / (before * before))
                        if inside and left < LAST_ERROR:
                            last = LAST_STEP
                if determinant < metric:
                    # The error left grows with 1 / (1 - ρ κ).
                    last *= determinant / metric
            else:
                last = LAST_LINEAR_STEP
                da, db = _descent_step(ga, gb, haa, hab, hbb, e, f, g)
        # A step of more than two spans is outside the reach of the local polynomial.
        longest = max(abs(da), abs(db))
        if longest > 2.0:
            da *= 2.0 / longest
            db *= 2.0 / longest
        end_a = a + da
        end_b = b + db
        if end_a < 0.0 and i == 0:
            end_a = 0.0
        elif end_a > 1.0 and i == last_u:
            end_a = 1.0
        if end_b < 0.0 and j == 0:
            end_b = 0.0
        elif end_b > 1.0 and j == last_v:
            end_b = 1.0
        da = end_a - a
        db = end_b - b
        a = end_a
        b = end_b
        before = abs(da) + abs(db)
        if abs(da) < last and abs(db) < last:
            flag = CLAMPED if hold_u or hold_v else INTERIOR
            foot = s + da * sa + db * sb + (0.5 * da * da) * saa + (0.5 * db * db) * sbb + (da * db) * sab
            ta, tb = _tangents(sa, sb, saa, sab, sbb, da, db)
            e = dot(ta, ta)
            g = dot(tb, tb)
            if min(e, g) <= VANISHED * max(e, g):
                # A pole: the tangent that vanishes is replaced by its derivative towards the inside.
                if e < g:
                    ta = (-1.0 if j == last_v and b >= 1.0 else 1.0) * sab
                else:
                    tb = (-1.0 if i == last_u and a >= 1.0 else 1.0) * sab
            nx, ny, nz = _cross(ta, tb)
            break
    if flag == FAILED:
        i, a, da = _relocated(breaks_u, i, a, da)
        j, b, db = _relocated(breaks_v, j, b, db)
        at = (i * (last_v + 1) + j) * (4 * rows * columns)
        s, sa, sb, saa, sab, sbb = _frame(coefficients, at, rows, columns, a, b)
        foot = s
        nx, ny, nz = _cross(sa, sb)
    u = _parameter(breaks_u, i, a)
    v = _parameter(breaks_v, j, b)
    if flag == INTERIOR and (u < box[0] or u > box[1] or v < box[2] or v > box[3]):
        flag = OUTSIDE
    fx, fy, fz, _ = components(foot)
    length = np.sqrt(nx * nx + ny * ny + nz * nz)
    if length > 0.0:
        length = 1.0 / length
        nx *= length
        ny *= length
        nz *= length
    distance = (px - fx) * nx + (py - fy) * ny + (pz - fz) * nz
    return u, v, fx, fy, fz, nx, ny, nz, distance, flag


@njit(error_model="numpy", fastmath=FAST, cache=True, nogil=True)
def footpoints(breaks_u, breaks_v, coefficients, box, points, u, v, foot, normal, distance, flag):
    """Project points (N, 3), warm started from u, v (N,), which are overwritten; fills foot, normal, distance, flag."""
    for k in range(points.shape[0]):
        r = project(breaks_u, breaks_v, coefficients, box, points[k, 0], points[k, 1], points[k, 2], u[k], v[k])
        u[k] = r[0]
        v[k] = r[1]
        foot[k, 0] = r[2]
        foot[k, 1] = r[3]
        foot[k, 2] = r[4]
        normal[k, 0] = r[5]
        normal[k, 1] = r[6]
        normal[k, 2] = r[7]
        distance[k] = r[8]
        flag[k] = r[9]
