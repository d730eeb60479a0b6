"""Footpoints on a surface given as per-span polynomials: Newton's method, fused with the evaluation.

Spans come as in `conflank_cli.geometry.surface.Spans`: coefficients (ku, kv, D, pu + 1, pv + 1) in local parameters.
"""

from __future__ import annotations

import numpy as np
from numba import njit

# Fused multiply-add is worth a quarter of the time and only drops roundings.
FAST = {"contract"}
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


@njit(forceinline=True)
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


@njit(forceinline=True)
def same_span(breaks, x, k):
    """`find_span`, looked for at span k first."""
    if (x >= breaks[k] or k == 0) and (x < breaks[k + 1] or k == breaks.shape[0] - 2):
        return k
    return find_span(breaks, x)


@njit(forceinline=True)
def guess_span(breaks, x):
    """`find_span`, looked for first where equal spans would have it."""
    last = breaks.shape[0] - 1
    k = int((x - breaks[0]) / (breaks[last] - breaks[0]) * last)
    return same_span(breaks, x, min(max(k, 0), last - 1))


@njit(forceinline=True)
def _component(c, a, b):
    """Value and derivatives f, fa, fb, faa, fab, fbb of one coordinate by Horner's rule."""
    f = 0.0
    fa = 0.0
    faa = 0.0
    fb = 0.0
    fab = 0.0
    fbb = 0.0
    for i in range(c.shape[0] - 1, -1, -1):
        g = 0.0
        gb = 0.0
        gbb = 0.0
        for j in range(c.shape[1] - 1, -1, -1):
            gbb = gbb * b + gb
            gb = gb * b + g
            g = g * b + c[i, j]
        faa = faa * a + fa
        fa = fa * a + f
        f = f * a + g
        fab = fab * a + fb
        fb = fb * a + gb
        fbb = fbb * a + gbb
    return f, fa, fb, 2.0 * faa, fab, 2.0 * fbb


@njit(forceinline=True)
def _bicubic(c, a, b):
    """The same for a bicubic block, written out: half as long again in points a second as the loops."""
    t = 3.0 * b
    g3 = ((c[3, 3] * b + c[3, 2]) * b + c[3, 1]) * b + c[3, 0]
    g2 = ((c[2, 3] * b + c[2, 2]) * b + c[2, 1]) * b + c[2, 0]
    g1 = ((c[1, 3] * b + c[1, 2]) * b + c[1, 1]) * b + c[1, 0]
    g0 = ((c[0, 3] * b + c[0, 2]) * b + c[0, 1]) * b + c[0, 0]
    h3 = (c[3, 3] * t + 2.0 * c[3, 2]) * b + c[3, 1]
    h2 = (c[2, 3] * t + 2.0 * c[2, 2]) * b + c[2, 1]
    h1 = (c[1, 3] * t + 2.0 * c[1, 2]) * b + c[1, 1]
    h0 = (c[0, 3] * t + 2.0 * c[0, 2]) * b + c[0, 1]
    k3 = c[3, 3] * t + c[3, 2]
    k2 = c[2, 3] * t + c[2, 2]
    k1 = c[1, 3] * t + c[1, 2]
    k0 = c[0, 3] * t + c[0, 2]
    t = 3.0 * a
    f = ((g3 * a + g2) * a + g1) * a + g0
    fa = (g3 * t + 2.0 * g2) * a + g1
    faa = g3 * t + g2
    fb = ((h3 * a + h2) * a + h1) * a + h0
    fab = (h3 * t + 2.0 * h2) * a + h1
    fbb = ((k3 * a + k2) * a + k1) * a + k0
    return f, fa, fb, 2.0 * faa, fab, 2.0 * fbb


@njit(forceinline=True)
def _rational(f, w):
    """Quotient rule: derivatives of f / w from those of the homogeneous coordinates."""
    r = 1.0 / w[0]
    s = f[0] * r
    sa = (f[1] - s * w[1]) * r
    sb = (f[2] - s * w[2]) * r
    saa = (f[3] - 2.0 * sa * w[1] - s * w[3]) * r
    sab = (f[4] - sa * w[2] - sb * w[1] - s * w[4]) * r
    sbb = (f[5] - 2.0 * sb * w[2] - s * w[5]) * r
    return s, sa, sb, saa, sab, sbb


@njit(forceinline=True)
def local_frame(block, a, b):
    """S, Sa, Sb, Saa, Sab, Sbb of a span block (D, pu + 1, pv + 1) at local (a, b), coordinate by coordinate."""
    if block.shape[0] == 3 and block.shape[1] == 4 and block.shape[2] == 4:
        return _bicubic(block[0], a, b), _bicubic(block[1], a, b), _bicubic(block[2], a, b)
    x = _component(block[0], a, b)
    y = _component(block[1], a, b)
    z = _component(block[2], a, b)
    if block.shape[0] == 4:
        w = _component(block[3], a, b)
        x = _rational(x, w)
        y = _rational(y, w)
        z = _rational(z, w)
    return x, y, z


@njit(error_model="numpy", fastmath=FAST, cache=True)
def evaluate(breaks_u, breaks_v, coefficients, u, v, out):
    """Fill out (N, 6, 3) with S, Su, Sv, Suu, Suv, Svv at the parameters u, v (N,)."""
    for k in range(u.shape[0]):
        i = find_span(breaks_u, u[k])
        j = find_span(breaks_v, v[k])
        hu = 1.0 / (breaks_u[i + 1] - breaks_u[i])
        hv = 1.0 / (breaks_v[j + 1] - breaks_v[j])
        x, y, z = local_frame(coefficients[i, j], (u[k] - breaks_u[i]) * hu, (v[k] - breaks_v[j]) * hv)
        scale = (1.0, hu, hv, hu * hu, hu * hv, hv * hv)
        for m in range(6):
            out[k, m, 0] = x[m] * scale[m]
            out[k, m, 1] = y[m] * scale[m]
            out[k, m, 2] = z[m] * scale[m]


@njit(forceinline=True)
def _tangents(x, y, z, a, b):
    """Both tangents a step (a, b) away, by the second-order expansion of a `local_frame`."""
    return (
        x[1] + x[3] * a + x[4] * b,
        y[1] + y[3] * a + y[4] * b,
        z[1] + z[3] * a + z[4] * b,
        x[2] + x[4] * a + x[5] * b,
        y[2] + y[4] * a + y[5] * b,
        z[2] + z[4] * a + z[5] * b,
    )


@njit(forceinline=True)
def _line_step(gradient, second, metric):
    """Step along one parameter alone, and the size below which it is the last one."""
    if second > SAFELY_POSITIVE * metric:
        return -gradient / second, LAST_PLAIN_STEP * min(1.0, second / metric)
    return -gradient / max(abs(second), LEAST_MODULUS * metric), LAST_LINEAR_STEP


@njit(error_model="numpy", fastmath=FAST, cache=True)
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


@njit(error_model="numpy", fastmath=FAST, cache=True)
def project(breaks_u, breaks_v, coefficients, box, px, py, pz, u, v):
    """Footpoint of (px, py, pz) from the start (u, v).

    Returns (u, v, foot x, y, z, normal x, y, z, distance, flag). The normal is the unit S_u x S_v at the foot. The
    distance is signed by it; where the foot is clamped it is the component of the residual along the normal.

    Newton on the gradient of the half squared distance; where the Hessian is not positive, with the moduli of its
    eigenvalues (always a descent direction), with step halving. Box-constrained: a parameter at a bound whose gradient
    points outwards is held there and the other one is solved alone.
    """
    nu = breaks_u.shape[0] - 1
    nv = breaks_v.shape[0] - 1
    u_low = breaks_u[0]
    u_high = breaks_u[nu]
    v_low = breaks_v[0]
    v_high = breaks_v[nv]
    u = min(max(u, u_low), u_high)
    v = min(max(v, v_low), v_high)
    i = guess_span(breaks_u, u)
    j = guess_span(breaks_v, v)
    flag = FAILED
    previous = np.inf
    before = 1e-30  # nothing is known from a step before the first
    du = 0.0
    dv = 0.0
    held = 0
    fx = fy = fz = nx = ny = nz = 0.0
    for _ in range(MAX_ITERATIONS):
        i = same_span(breaks_u, u, i)
        j = same_span(breaks_v, v, j)
        wu = breaks_u[i + 1] - breaks_u[i]
        wv = breaks_v[j + 1] - breaks_v[j]
        per_u = 1.0 / wu
        per_v = 1.0 / wv
        a = (u - breaks_u[i]) * per_u
        b = (v - breaks_v[j]) * per_v
        x, y, z = local_frame(coefficients[i, j], a, b)
        rx = x[0] - px
        ry = y[0] - py
        rz = z[0] - pz
        value = rx * rx + ry * ry + rz * rz
        if value > previous * (1.0 + 1e-12) + 1e-24 and abs(du) * per_u + abs(dv) * per_v > 1e-7:
            # The step overshot: halve it.
            du *= 0.5
            dv *= 0.5
            u -= du
            v -= dv
            continue
        previous = value
        # Everything in local parameters of the span from here on.
        ga = rx * x[1] + ry * y[1] + rz * z[1]
        gb = rx * x[2] + ry * y[2] + rz * z[2]
        e = x[1] * x[1] + y[1] * y[1] + z[1] * z[1]
        f = x[1] * x[2] + y[1] * y[2] + z[1] * z[2]
        g = x[2] * x[2] + y[2] * y[2] + z[2] * z[2]
        haa = e + rx * x[3] + ry * y[3] + rz * z[3]
        hab = f + rx * x[4] + ry * y[4] + rz * z[4]
        hbb = g + rx * x[5] + ry * y[5] + rz * z[5]
        hold_u = (u <= u_low and ga > 0.0) or (u >= u_high and ga < 0.0) or e <= VANISHED * g
        hold_v = (v <= v_low and gb > 0.0) or (v >= v_high and gb < 0.0) or g <= VANISHED * e
        da = 0.0
        db = 0.0
        last = LAST_PLAIN_STEP
        held = 1 if hold_u or hold_v else 0
        if hold_u and not hold_v:
            db, last = _line_step(gb, hbb, g)
        elif hold_v and not hold_u:
            da, last = _line_step(ga, haa, e)
        elif held == 0:
            determinant = haa * hbb - hab * hab
            metric = e * g - f * f
            if determinant > SAFELY_POSITIVE * metric and haa > 0.0:
                inverse = 1.0 / determinant
                da = (gb * hab - ga * hbb) * inverse
                db = (ga * hab - gb * haa) * inverse
                if abs(da) < EXPANDED and abs(db) < EXPANDED:
                    # Once more, with the gradient there of the second-order expansion of the surface: the error left
                    # is of third order, for a fourth of an evaluation.
                    ax, ay, az, bx, by, bz = _tangents(x, y, z, da, db)
                    rx += 0.5 * (da * (x[1] + ax) + db * (x[2] + bx))
                    ry += 0.5 * (da * (y[1] + ay) + db * (y[2] + by))
                    rz += 0.5 * (da * (z[1] + az) + db * (z[2] + bz))
                    ga = rx * ax + ry * ay + rz * az
                    gb = rx * bx + ry * by + rz * bz
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
        du = da * wu
        dv = db * wv
        un = u + du
        vn = v + dv
        if un < u_low:
            un = u_low
        elif un > u_high:
            un = u_high
        if vn < v_low:
            vn = v_low
        elif vn > v_high:
            vn = v_high
        du = un - u
        dv = vn - v
        u = un
        v = vn
        da = du * per_u
        db = dv * per_v
        before = abs(da) + abs(db)
        if abs(da) < last and abs(db) < last:
            flag = CLAMPED if held == 1 else INTERIOR
            fx = x[0] + x[1] * da + x[2] * db + 0.5 * (x[3] * da * da + x[5] * db * db) + x[4] * da * db
            fy = y[0] + y[1] * da + y[2] * db + 0.5 * (y[3] * da * da + y[5] * db * db) + y[4] * da * db
            fz = z[0] + z[1] * da + z[2] * db + 0.5 * (z[3] * da * da + z[5] * db * db) + z[4] * da * db
            ax, ay, az, bx, by, bz = _tangents(x, y, z, da, db)
            nx = ay * bz - az * by
            ny = az * bx - ax * bz
            nz = ax * by - ay * bx
            tangents = (ax * ax + ay * ay + az * az, bx * bx + by * by + bz * bz)
            if min(tangents[0], tangents[1]) <= VANISHED * max(tangents[0], tangents[1]):
                # A pole: the tangent that vanishes is replaced by its derivative towards the inside.
                if tangents[0] < tangents[1]:
                    side = -1.0 if v >= v_high else 1.0
                    ax, ay, az = side * x[4], side * y[4], side * z[4]
                else:
                    side = -1.0 if u >= u_high else 1.0
                    bx, by, bz = side * x[4], side * y[4], side * z[4]
                nx = ay * bz - az * by
                ny = az * bx - ax * bz
                nz = ax * by - ay * bx
            break
    if flag == FAILED:
        i = find_span(breaks_u, u)
        j = find_span(breaks_v, v)
        x, y, z = local_frame(
            coefficients[i, j],
            (u - breaks_u[i]) / (breaks_u[i + 1] - breaks_u[i]),
            (v - breaks_v[j]) / (breaks_v[j + 1] - breaks_v[j]),
        )
        fx = x[0]
        fy = y[0]
        fz = z[0]
        nx = y[1] * z[2] - z[1] * y[2]
        ny = z[1] * x[2] - x[1] * z[2]
        nz = x[1] * y[2] - y[1] * x[2]
    elif flag == INTERIOR and (u < box[0] or u > box[1] or v < box[2] or v > box[3]):
        flag = OUTSIDE
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
