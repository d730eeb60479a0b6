"""Bounds on the swept gap over pieces of a surface: branch and bound over cells of its parameters.

The derivation stands in docs/method.md, "The certificate". In short, with D(x, t) the signed distance to the cutter at
time t and g = min over t of D:

- every D is at most so strongly curved along u as a multiple of 1/R across the generator and the surface's own S_uu
  allow, and so is their minimum g, kinks included: between two nodes g sinks below the chord by at most M h²/8;
- the pose that is nearest at a node bounds g from above around the node, by D's own second-order expansion.

Both bounds hold for any cell; a cell is halved until they are as close as asked for.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from conflank_cli.geometry.kernels.footpoint import find_span, local_frame
from conflank_cli.geometry.kernels.polygon import is_inside
from conflank_cli.geometry.kernels.swept_gap import cutter_distance

# What became of a cell.
OFF, WITHIN, DOUBT = 0, 1, 2
# Columns of the table of cells.
U0, U1, V0, V1, LOWER, UPPER, STATE, AREA = range(8)
COLUMNS = 8
# Columns of a pose: p, unit axis d, and their derivatives by t.
POSE = 12
# A window of time as short as FINE samples is sampled anew: with as many steps, or where the top of the cutter passes,
# which comes and goes at once, with FINER.
FINE, FINER = 4, 16
# The search for a stationary time stops where what is left to gain is below this, mm.
STATIONARY = 1.0e-9
SEARCH_STEPS = 40
# A node's distance is the least of all times but for this, mm. So many halvings of time are spent on it at most: a few
# do, but a point that the cutter goes round is equally far for long and takes hundreds.
SETTLED = 2.0e-5
SEARCHED = 2000
# A node: gap to the true cutter, gap to the cutter without its top, time, unit normal (from the axis to the surface),
# distance from the axis along the normal, height on the generator, height of the sphere's centre, curvature terms
# across the generator, slopes of the normal, place and derivatives of the surface.
GAP, LOW, TIME, NX, NY, NZ, RADIUS, BESIDE, CENTRE, QUU, QUV, QVV, FU, FV, GU, GV = range(16)
PLACE = 16
NODE = PLACE + 18
# Halving never goes deeper: 2^-60 of a span is below rounding.
STACK = 160
# Extents and curvatures are taken at the corners of a cell; inside they may be larger by this share.
SPARE = 1.02


@njit(forceinline=True)
def _moving_pose(polynomials, breaks, t, out):
    """p, unit axis d and their derivatives at t into out (12,); the motion as in `cubic.pose`."""
    k = find_span(breaks, t)
    scale = 1.0 / (breaks[k + 1] - breaks[k])
    x = (t - breaks[k]) * scale
    norm = 0.0
    for a in range(3):
        c = polynomials[k]
        p = ((c[3, a] * x + c[2, a]) * x + c[1, a]) * x + c[0, a]
        q = ((c[3, a + 3] * x + c[2, a + 3]) * x + c[1, a + 3]) * x + c[0, a + 3]
        ps = ((3.0 * c[3, a] * x + 2.0 * c[2, a]) * x + c[1, a]) * scale
        qs = ((3.0 * c[3, a + 3] * x + 2.0 * c[2, a + 3]) * x + c[1, a + 3]) * scale
        out[a] = p
        out[a + 3] = q - p
        out[a + 6] = ps
        out[a + 9] = qs - ps
        norm += (q - p) * (q - p)
    norm = 1.0 / np.sqrt(norm)
    along = 0.0
    for a in range(3):
        out[a + 3] *= norm
        out[a + 9] *= norm
        along += out[a + 3] * out[a + 9]
    for a in range(3):
        out[a + 9] -= along * out[a + 3]


@njit(cache=True, nogil=True)
def moving_poses(polynomials, breaks, samples, out):
    """Poses at samples + 1 equal times into out (samples + 1, 12)."""
    for k in range(samples + 1):
        _moving_pose(polynomials, breaks, k / samples, out[k])


@njit(forceinline=True)
def _topless(x, y, z, a, cutter):
    """Signed distance to ball and cone without a top, its derivative by t, height and distance from the axis."""
    r_min, sine, cosine, ball_height, ball_radius = cutter[0], cutter[1], cutter[2], cutter[4], cutter[5]
    rx, ry, rz = x - a[0], y - a[1], z - a[2]
    along = rx * a[3] + ry * a[4] + rz * a[5]
    square = rx * rx + ry * ry + rz * rz
    across = np.sqrt(max(square - along * along, 1e-30))
    rise = rx * a[9] + ry * a[10] + rz * a[11] - (a[6] * a[3] + a[7] * a[4] + a[8] * a[5])
    spread = -(rx * a[6] + ry * a[7] + rz * a[8]) - along * rise  # across times its derivative
    if along * cosine + (across - r_min) * sine <= 0.0:
        h = along - ball_height
        r = np.sqrt(h * h + across * across)
        return r - ball_radius, (h * rise + spread) / r, along, across
    return (
        (across - r_min) * cosine - along * sine,
        spread / across * cosine - rise * sine,
        along,
        across,
    )


@njit(forceinline=True)
def _contact(x, y, z, a, along, across, cutter):
    """Unit normal from the axis to a point, and the distance from the axis along it."""
    r_min, sine, cosine, ball_height = cutter[0], cutter[1], cutter[2], cutter[4]
    if along * cosine + (across - r_min) * sine <= 0.0:
        h = along - ball_height
        radius = np.sqrt(h * h + across * across)
        out = 1.0 / radius
        up = -ball_height / radius
    else:
        # cos α away from the axis, -sin α along it.
        radius = across / cosine
        out = cosine / across
        up = -sine - out * along
    return out * (x - a[0]) + up * a[3], out * (y - a[1]) + up * a[4], out * (z - a[2]) + up * a[5], radius


@njit(forceinline=True)
def _least_between(d0, s0, d1, s1, step, bend):
    """Lower bound of a function between values d0, d1 with slopes s0, s1, whose second derivative is at least -bend.

    With bend t²/2 added it is convex, hence above both its tangents.
    """
    s0 -= 0.5 * bend * step
    s1 += 0.5 * bend * step
    if s0 >= 0.0:
        return d0
    if s1 <= 0.0:
        return d1
    return d0 + s0 * (d1 - d0 - s1 * step) / (s0 - s1)


@njit
def _nearest_time(x, y, z, start, step, poses, polynomials, breaks, bend, cutter, look, at):
    """(time at which the topless cutter is nearest, floor), given its poses (K, 12) at times start, start + step, ...

    look (K + SEARCHED or more, 6) is scratch. A piece of time is searched and halved until its lower bound says that it
    is not nearer by more than SETTLED; floor is the lowest bound of the pieces that are left after SEARCHED halvings,
    inf if there are none.
    """
    last = poses.shape[0] - 1
    best = np.inf
    time = start
    for k in range(last + 1):
        d, s, _, _ = _topless(x, y, z, poses[k], cutter)
        if k > 0:
            look[k - 1, 3] = d
            look[k - 1, 5] = s
        if k < last:
            look[k, 0] = start + k * step
            look[k, 1] = start + (k + 1) * step
            look[k, 2] = d
            look[k, 4] = s
        if d < best:
            best = d
            time = start + k * step
    # First the valleys between samples, then all that may hide another.
    pieces = last
    for k in range(last):
        s0 = look[k, 4]
        s1 = look[k, 5]
        if s0 >= 0.0 or s1 <= 0.0:
            continue
        a = look[k, 0]
        b = look[k, 1]
        if _least_between(look[k, 2], s0, look[k, 3], s1, b - a, bend) >= best:
            continue
        # Regula falsi on the slope; an end that stays twice has its slope halved (Illinois).
        stayed = 0
        t = a
        d = look[k, 2]
        s = s0
        for _ in range(SEARCH_STEPS):
            t = b - s1 * (b - a) / (s1 - s0)
            _moving_pose(polynomials, breaks, t, at)
            d, s, _, _ = _topless(x, y, z, at, cutter)
            if s * s * (b - a) <= STATIONARY * (s1 - s0):
                break
            if s > 0.0:
                b = t
                s1 = s
                if stayed == 1:
                    s0 *= 0.5
                stayed = 1
            else:
                a = t
                s0 = s
                if stayed == -1:
                    s1 *= 0.5
                stayed = -1
        if d < best:
            best = d
            time = t
        # On either side of it the piece is searched like the others.
        look[pieces, 0] = t
        look[pieces, 1] = look[k, 1]
        look[pieces, 2] = d
        look[pieces, 3] = look[k, 3]
        look[pieces, 4] = s
        look[pieces, 5] = look[k, 5]
        look[k, 1] = t
        look[k, 3] = d
        look[k, 5] = s
        pieces += 1
    tries = SEARCHED
    while pieces > 0 and tries > 0:
        pieces -= 1
        a = look[pieces, 0]
        b = look[pieces, 1]
        d0 = look[pieces, 2]
        d1 = look[pieces, 3]
        s0 = look[pieces, 4]
        s1 = look[pieces, 5]
        if _least_between(d0, s0, d1, s1, b - a, bend) >= best - SETTLED:
            continue
        tries -= 1
        t = 0.5 * (a + b)
        _moving_pose(polynomials, breaks, t, at)
        d, s, _, _ = _topless(x, y, z, at, cutter)
        if d < best:
            best = d
            time = t
        look[pieces, 1] = t
        look[pieces, 3] = d
        look[pieces, 5] = s
        pieces += 1
        look[pieces, 0] = t
        look[pieces, 1] = b
        look[pieces, 2] = d
        look[pieces, 3] = d1
        look[pieces, 4] = s
        look[pieces, 5] = s1
        pieces += 1
    floor = np.inf
    for k in range(pieces):
        piece = look[k]
        floor = min(floor, _least_between(piece[2], piece[4], piece[3], piece[5], piece[1] - piece[0], bend))
    return time, floor


@njit
def _fill_node(block, a, b, start, step, poses, polynomials, breaks, bend, cutter, look, at, node):
    """Everything the bounds need at local (a, b) of a span."""
    x, y, z = local_frame(block, a, b)
    for m in range(6):
        node[PLACE + 3 * m] = x[m]
        node[PLACE + 3 * m + 1] = y[m]
        node[PLACE + 3 * m + 2] = z[m]
    time, floor = _nearest_time(x[0], y[0], z[0], start, step, poses, polynomials, breaks, bend, cutter, look, at)
    _moving_pose(polynomials, breaks, time, at)
    low, _, along, across = _topless(x[0], y[0], z[0], at, cutter)
    r_min, sine, cosine, ball_height, ball_radius = cutter[0], cutter[1], cutter[2], cutter[4], cutter[5]
    beside = along * cosine + (across - r_min) * sine
    node[TIME] = time
    node[LOW] = min(low - SETTLED, floor)
    node[GAP] = cutter_distance(
        x[0], y[0], z[0], at[0], at[1], at[2], at[3], at[4], at[5],
        r_min, sine, cosine, cutter[3], ball_height, ball_radius,
    )  # fmt: skip
    node[BESIDE] = beside
    # Unit vector away from the axis.
    fx = (x[0] - at[0] - along * at[3]) / across
    fy = (y[0] - at[1] - along * at[4]) / across
    fz = (z[0] - at[2] - along * at[5]) / across
    node[CENTRE] = ball_height if beside <= 0.0 else along + across * sine / cosine
    node[NX], node[NY], node[NZ], node[RADIUS] = _contact(x[0], y[0], z[0], at, along, across, cutter)
    ud = x[1] * at[3] + y[1] * at[4] + z[1] * at[5]
    vd = x[2] * at[3] + y[2] * at[4] + z[2] * at[5]
    uf = x[1] * fx + y[1] * fy + z[1] * fz
    vf = x[2] * fx + y[2] * fy + z[2] * fz
    node[FU] = uf
    node[FV] = vf
    node[GU] = x[1] * node[NX] + y[1] * node[NY] + z[1] * node[NZ]
    node[GV] = x[2] * node[NX] + y[2] * node[NY] + z[2] * node[NZ]
    node[QUU] = x[1] * x[1] + y[1] * y[1] + z[1] * z[1] - ud * ud - uf * uf
    node[QUV] = x[1] * x[2] + y[1] * y[2] + z[1] * z[2] - ud * vd - uf * vf
    node[QVV] = x[2] * x[2] + y[2] * y[2] + z[2] * z[2] - vd * vd - vf * vf


@njit(forceinline=True)
def _inner(node, m, x, y, z):
    """<S_m, (x, y, z)> with S_m the m-th of S, Su, Sv, Suu, Suv, Svv at a node."""
    k = PLACE + 3 * m
    return node[k] * x + node[k + 1] * y + node[k + 2] * z


@njit(forceinline=True)
def _size(node, m):
    k = PLACE + 3 * m
    return np.sqrt(node[k] * node[k] + node[k + 1] * node[k + 1] + node[k + 2] * node[k + 2])


@njit
def _upper(nodes, ha, hb, du, dv, bend_uu, bend_uv, bend_vv, cutter):
    """Upper bound of g over a cell: the pose of each corner over its quarter of the cell."""
    cosine, length = cutter[2], cutter[3]
    a = 0.5 * ha
    b = 0.5 * hb
    far = 0.5 * (du + dv)
    bow = 0.5 * (bend_uu * a * a + 2.0 * bend_uv * a * b + bend_vv * b * b)
    reach = far + bow
    worst = -np.inf
    for i in range(4):
        node = nodes[i]
        bound = node[GAP] + reach
        beside = node[BESIDE]
        radius = node[RADIUS]
        if beside < length / cosine - reach and radius > 2.0 * reach:
            uu = -np.inf
            uv = 0.0
            vv = -np.inf
            for j in range(4):
                uu = max(uu, _inner(nodes[j], 3, node[NX], node[NY], node[NZ]))
                uv = max(uv, abs(_inner(nodes[j], 4, node[NX], node[NY], node[NZ])))
                vv = max(vv, _inner(nodes[j], 5, node[NX], node[NY], node[NZ]))
            if beside > reach:
                # cos α (across - r) <= cos α <e, Δ>² / (2 (r + <f, Δ>)), r the distance from the axis.
                r = radius * cosine
                rest = r - abs(node[FU]) * a - abs(node[FV]) * b - bow
                c = cosine / rest
                uu += c * node[QUU]
                uv += c * abs(node[QUV])
                vv += c * node[QVV]
            else:
                # |x - c| <= R + <n, Δ> + |Δ|² / 2R: the sphere inscribed at the contact, or the ball.
                c = 1.0 / radius
                uu += c * _inner(node, 1, node[PLACE + 3], node[PLACE + 4], node[PLACE + 5])
                uv += c * abs(_inner(node, 1, node[PLACE + 6], node[PLACE + 7], node[PLACE + 8]))
                vv += c * _inner(node, 2, node[PLACE + 6], node[PLACE + 7], node[PLACE + 8])
            along_u = node[GU] if i < 2 else -node[GU]
            along_v = node[GV] if i % 2 == 0 else -node[GV]
            smooth = (
                node[GAP]
                + max(0.0, along_u * a + 0.5 * max(uu, 0.0) * a * a)
                + max(0.0, along_v * b + 0.5 * max(vv, 0.0) * b * b)
                + uv * a * b
                + 0.5 * c * bow * (2.0 * far + bow)
            )
            bound = min(bound, smooth)
        worst = max(worst, bound)
    return worst


@njit(forceinline=True)
def _crossed(u0, u1, v0, v1, vertices, starts):
    """Whether an edge of the loops passes through the inside of a box, a millionth of its size within."""
    eps = 1e-6 * (u1 - u0)
    u0 += eps
    u1 -= eps
    eps = 1e-6 * (v1 - v0)
    v0 += eps
    v1 -= eps
    for loop in range(starts.shape[0] - 1):
        j = starts[loop + 1] - 1
        for i in range(starts[loop], starts[loop + 1]):
            x0 = vertices[j, 0]
            y0 = vertices[j, 1]
            x1 = vertices[i, 0]
            y1 = vertices[i, 1]
            j = i
            if (x0 < u0 and x1 < u0) or (x0 > u1 and x1 > u1) or (y0 < v0 and y1 < v0) or (y0 > v1 and y1 > v1):
                continue
            dx = x1 - x0
            dy = y1 - y0
            c0 = dx * (v0 - y0) - dy * (u0 - x0)
            c1 = dx * (v0 - y0) - dy * (u1 - x0)
            c2 = dx * (v1 - y0) - dy * (u0 - x0)
            c3 = dx * (v1 - y0) - dy * (u1 - x0)
            if min(min(c0, c1), min(c2, c3)) <= 0.0 <= max(max(c0, c1), max(c2, c3)):
                return True
    return False


@njit(cache=True, nogil=True)
def bounded_cells(
    breaks_u, breaks_v, coefficients, roots, places, vertices, starts, polynomials, breaks, poses, bends,
    motion_bounds, cutter, limits, aims, figures,
):  # fmt: skip
    """Bounds on the swept gap over a trimmed face, cell by cell.

    breaks_u, breaks_v, coefficients: the surface (`Spans`). roots (N, 2) int: span of each root cell, places (N, 4):
    its local a0, a1, b0, b1. vertices (M, 2), starts (K + 1,): the loops, as in `polygon.is_inside`.
    polynomials, breaks: the motion as in `cubic.pose`; poses (samples + 1, 12): at equal times; bends (samples,):
    between two of them the second derivative of a distance by t is at least minus that. motion_bounds (3,): largest
    speeds by t of the contact, of heights on the axis, and turn of the axis. cutter (6,) as in `swept_gap`. limits
    (3,): over, under, allowance. aims (5,): how much a bound may be above what has been found, mm, and as a share of a
    deep overcut; sizes in mm below which a cell is not halved for the overcut and for its being covered; the most
    nodes to be evaluated.

    Fills figures (3,): deepest overcut and largest |g| found at nodes, number of nodes. Returns the table of cells
    (N, 8): parameters, bounds of g less allowance, state, area on the face in mm2.
    """
    over, under, allowance = limits[0], limits[1], limits[2]
    aim, share, floor_over, floor_cover, most = aims[0], aims[1], aims[2], aims[3], aims[4]
    speed, drift, turn = motion_bounds[0], motion_bounds[1], motion_bounds[2]
    r_min, sine, cosine, length, ball_height = cutter[0], cutter[1], cutter[2], cutter[3], cutter[4]
    samples = poses.shape[0] - 1
    step = 1.0 / samples
    look = np.empty((2 * max(samples, FINER) + SEARCHED + 2, 6))
    high = np.empty(max(samples, FINER) + 1)
    at = np.empty(POSE)
    middle = np.empty(NODE)
    table = np.empty((4096, COLUMNS))
    rows = 0
    stack = np.empty((STACK, 4, NODE))
    box = np.empty((STACK, 4))
    flags = np.empty((STACK, 2), np.int64)
    window = np.empty((STACK, 2))
    fine = np.empty((FINER + 1, POSE))
    nodes = np.empty((4, NODE))
    deepest = 0.0
    largest = 0.0
    count = 0

    # What the middles of the roots show: without it the first cells would be halved for nothing.
    for n in range(roots.shape[0]):
        i = roots[n, 0]
        j = roots[n, 1]
        a = 0.5 * (places[n, 0] + places[n, 1])
        b = 0.5 * (places[n, 2] + places[n, 3])
        u = breaks_u[i] + a * (breaks_u[i + 1] - breaks_u[i])
        v = breaks_v[j] + b * (breaks_v[j + 1] - breaks_v[j])
        if is_inside(u, v, vertices, starts):
            _fill_node(
                coefficients[i, j], a, b, 0.0, step, poses, polynomials, breaks, bends.max(), cutter, look, at, middle
            )
            count += 1
            g = middle[GAP] - allowance
            deepest = max(deepest, -g)
            if -over + aim <= g <= under - aim:
                largest = max(largest, abs(g))

    for n in range(roots.shape[0]):
        i = roots[n, 0]
        j = roots[n, 1]
        wu = breaks_u[i + 1] - breaks_u[i]
        wv = breaks_v[j + 1] - breaks_v[j]
        block = coefficients[i, j]
        for m in range(4):
            box[0, m] = places[n, m]
        window[0, 0] = 0.0
        window[0, 1] = 1.0
        flags[0, 0] = -1  # 1 on the face, 0 across its border, -1 not looked at
        flags[0, 1] = 0  # 1 once times were left out because the cell is above the flute
        depth = 1
        fresh = True  # the corners have not been evaluated
        while depth > 0:
            depth -= 1
            a0, a1, b0, b1 = box[depth, 0], box[depth, 1], box[depth, 2], box[depth, 3]
            trim, above = flags[depth, 0], flags[depth, 1]
            start, end = window[depth, 0], window[depth, 1]
            ha = a1 - a0
            hb = b1 - b0
            u0 = breaks_u[i] + a0 * wu
            u1 = breaks_u[i] + a1 * wu
            v0 = breaks_v[j] + b0 * wv
            v1 = breaks_v[j] + b1 * wv
            if trim != 1:
                crossed = _crossed(u0, u1, v0, v1, vertices, starts)
                if not crossed:
                    if not is_inside(0.5 * (u0 + u1), 0.5 * (v0 + v1), vertices, starts):
                        continue
                    trim = 1
                else:
                    trim = 0

            # Times that matter: those at which the cutter may be nearest somewhere in the cell and is not wholly
            # below it.
            x, y, z = local_frame(block, 0.5 * (a0 + a1), 0.5 * (b0 + b1))
            long_u = np.sqrt(x[1] * x[1] + y[1] * y[1] + z[1] * z[1])
            long_v = np.sqrt(x[2] * x[2] + y[2] * y[2] + z[2] * z[2])
            long_uu = np.sqrt(x[3] * x[3] + y[3] * y[3] + z[3] * z[3])
            long_uv = np.sqrt(x[4] * x[4] + y[4] * y[4] + z[4] * z[4])
            long_vv = np.sqrt(x[5] * x[5] + y[5] * y[5] + z[5] * z[5])
            bow = 0.125 * SPARE * (long_uu * ha * ha + 2.0 * long_uv * ha * hb + long_vv * hb * hb)
            half = 0.5 * (long_u * ha + long_v * hb) + bow
            if end - start > FINE * step:
                first = int(np.round(start / step))
                near = poses[first : int(np.round(end / step)) + 1]
                pace = step
            else:
                steps = FINE if above == 0 else FINER
                pace = (end - start) / steps
                for k in range(steps + 1):
                    _moving_pose(polynomials, breaks, start + k * pace, fine[k])
                near = fine[: steps + 1]
            last = near.shape[0] - 1
            bend = 0.0
            for k in range(int(start / step), min(int(end / step) + 1, samples)):
                bend = max(bend, bends[k])
            # At one time the distance lies above its tangent plane, and below the sphere at the contact.
            most_near = np.inf
            for k in range(last + 1):
                d, s, along, across = _topless(x[0], y[0], z[0], near[k], cutter)
                look[k, 0] = d
                look[k, 1] = s
                nx, ny, nz, radius = _contact(x[0], y[0], z[0], near[k], along, across, cutter)
                look[k, 2] = nx
                look[k, 3] = ny
                look[k, 4] = nz
                tilt = (
                    0.5 * abs(x[1] * nx + y[1] * ny + z[1] * nz) * ha
                    + 0.5 * abs(x[2] * nx + y[2] * ny + z[2] * nz) * hb
                    + bow
                )
                look[k, 5] = tilt
                high[k] = along
                # Near its top the cutter is further away than it would be without.
                contact = (along * cosine + (across - r_min) * sine) * cosine
                if contact + half < length and along - length + 2.0 * half < d:
                    rise = min(half, tilt + 0.5 * half * half / radius)
                else:
                    rise = half
                    axis = near[k]
                    d = cutter_distance(
                        x[0], y[0], z[0], axis[0], axis[1], axis[2], axis[3], axis[4], axis[5],
                        r_min, sine, cosine, length, ball_height, cutter[5],
                    )  # fmt: skip
                most_near = min(most_near, d + rise)
            low_k = last
            high_k = -1
            least = np.inf
            least_topped = np.inf
            for k in range(last):
                bound = _least_between(look[k, 0], look[k, 1], look[k + 1, 0], look[k + 1, 1], pace, bend)
                # The normal goes from one sample's to the next, in an arc that bulges by an eighth of its square.
                nx = look[k, 2] - look[k + 1, 2]
                ny = look[k, 3] - look[k + 1, 3]
                nz = look[k, 4] - look[k + 1, 4]
                tilt = max(look[k, 5], look[k + 1, 5]) + 0.25 * half * (nx * nx + ny * ny + nz * nz)
                bound -= min(half, tilt)
                least = min(least, bound)
                if bound > most_near:
                    continue
                lowest = min(high[k], high[k + 1]) - 0.125 * bend * pace * pace - length - half
                least_topped = min(least_topped, max(bound, lowest))
                if lowest > allowance:
                    above = 1
                    continue
                low_k = min(low_k, k)
                high_k = k + 1
            if high_k < 0 or least - allowance > under:
                # Above the flute at all times, or far away: nothing is cut here.
                bound = least - allowance
                if rows + 1 > table.shape[0]:
                    table = np.concatenate((table, np.empty_like(table)))
                table[rows, U0] = u0
                table[rows, U1] = u1
                table[rows, V0] = v0
                table[rows, V1] = v1
                table[rows, LOWER] = bound if above == 0 else 0.0
                table[rows, UPPER] = np.inf
                table[rows, STATE] = OFF
                table[rows, AREA] = 0.0
                rows += 1
                continue
            near = near[low_k : high_k + 1]
            start += low_k * pace
            end = start + (high_k - low_k) * pace

            for m in range(4):
                stale = fresh
                if not fresh:
                    for k in range(NODE):
                        nodes[m, k] = stack[depth, m, k]
                    stale = nodes[m, TIME] < start - 1e-12 or nodes[m, TIME] > end + 1e-12
                if stale:
                    a = a0 if m < 2 else a1
                    b = b0 if m % 2 == 0 else b1
                    _fill_node(block, a, b, start, pace, near, polynomials, breaks, bend, cutter, look, at, nodes[m])
                    count += 1
            fresh = False

            # Extents, bends of the surface, values at the corners.
            long_u = 0.0
            long_v = 0.0
            long_uu = 0.0
            long_uv = 0.0
            long_vv = 0.0
            low = np.inf
            lowest_centre = np.inf
            lowest_beside = np.inf
            steep_u = 0.0
            steep_v = 0.0
            area = 0.0
            for m in range(4):
                node = nodes[m]
                long_u = max(long_u, _size(node, 1))
                long_v = max(long_v, _size(node, 2))
                long_uu = max(long_uu, _size(node, 3))
                long_uv = max(long_uv, _size(node, 4))
                long_vv = max(long_vv, _size(node, 5))
                low = min(low, node[LOW])
                lowest_centre = min(lowest_centre, node[CENTRE])
                lowest_beside = min(lowest_beside, node[BESIDE])
                steep_u = max(steep_u, abs(node[GU]))
                steep_v = max(steep_v, abs(node[GV]))
                k = PLACE + 3
                nx = node[k + 1] * node[k + 5] - node[k + 2] * node[k + 4]
                ny = node[k + 2] * node[k + 3] - node[k] * node[k + 5]
                nz = node[k] * node[k + 4] - node[k + 1] * node[k + 3]
                area += 0.25 * np.sqrt(nx * nx + ny * ny + nz * nz) * ha * hb
            du = SPARE * long_u * ha
            dv = SPARE * long_v * hb
            upper = _upper(nodes, ha, hb, du, dv, SPARE * long_uu, SPARE * long_uv, SPARE * long_vv, cutter)

            # Lower bound. Contacts of the cell at any of its times are at most so far below those at its corners:
            away = du + dv + drift * (end - start)
            centre = max(lowest_centre - away, ball_height)
            ball = lowest_beside - away <= 0.0
            sphere = r_min * cosine + centre * sine
            across_u = 0.0
            across_v = 0.0
            normal_u = -np.inf
            normal_v = -np.inf
            slack = 0.5 * turn * pace
            for m in range(4):
                node = nodes[m]
                k = PLACE + 3
                least_u = np.inf
                most_u = -np.inf
                least_v = np.inf
                most_v = -np.inf
                for t in range(near.shape[0]):
                    c = _inner(node, 1, near[t, 3], near[t, 4], near[t, 5])
                    least_u = min(least_u, c)
                    most_u = max(most_u, c)
                    c = _inner(node, 2, near[t, 3], near[t, 4], near[t, 5])
                    least_v = min(least_v, c)
                    most_v = max(most_v, c)
                c = _size(node, 1)
                d = max(0.0, max(least_u, -most_u) - slack * c)
                across_u = max(across_u, c * c - (0.0 if ball else d * d))
                c = _size(node, 2)
                d = max(0.0, max(least_v, -most_v) - slack * c)
                across_v = max(across_v, c * c - (0.0 if ball else d * d))
                for t in range(4):
                    normal_u = max(normal_u, _inner(nodes[t], 3, node[NX], node[NY], node[NZ]))
                    normal_v = max(normal_v, _inner(nodes[t], 5, node[NX], node[NY], node[NZ]))
            lower = low - 0.5 * (du + dv)
            curved_u = 0.0
            curved_v = 0.0
            for _ in range(2):
                radius = sphere + lower
                if radius <= 0.1 * sphere:
                    break
                wander = min(1.0, (du + dv + speed * (end - start)) / radius)
                curved_u = SPARE * max(0.0, normal_u + wander * long_uu + across_u / radius)
                curved_v = SPARE * max(0.0, normal_v + wander * long_vv + across_v / radius)
                lower = max(lower, low - 0.125 * (curved_u * ha * ha + curved_v * hb * hb))
            # The top of the cutter is flat: it is no nearer than a point is above it.
            lower = max(lower, least_topped) - allowance
            upper -= allowance

            # What the corners show, as far as they are on the face.
            corner = 0.0
            for m in range(4):
                g = nodes[m, GAP] - allowance
                corner = max(corner, abs(g))
                if -g > deepest and (
                    trim == 1 or is_inside(u0 if m < 2 else u1, v0 if m % 2 == 0 else v1, vertices, starts)
                ):
                    deepest = -g
            size = max(du, dv)
            full = count >= most
            allowed = deepest + max(aim, share * deepest)
            if deepest <= over:
                allowed = min(allowed, over)
            split = -lower > allowed and size > floor_over
            state = DOUBT
            if lower > under or upper < -over:
                state = OFF
            elif upper <= under and lower >= -over:
                state = WITHIN
                bound = max(upper, -lower)
                seen = max(largest, corner if trim == 1 else 0.0)
                if bound > seen + aim and size > floor_over:
                    split = True
                elif not split:
                    largest = seen
            elif size > floor_cover:
                split = True
            if split and not full and depth + 2 <= STACK:
                grow_u = curved_u * ha * ha + steep_u * ha
                grow_v = curved_v * hb * hb + steep_v * hb
                by_u = grow_u > grow_v if curved_u + curved_v > 0.0 else du > dv
                if by_u and du < 0.02 * dv:
                    by_u = False
                elif not by_u and dv < 0.02 * du:
                    by_u = True
                half_a = 0.5 * (a0 + a1)
                half_b = 0.5 * (b0 + b1)
                for part in range(2):
                    slot = depth + part
                    window[slot, 0] = start
                    window[slot, 1] = end
                    flags[slot, 0] = trim
                    flags[slot, 1] = above
                    box[slot, 0] = half_a if by_u and part == 1 else a0
                    box[slot, 1] = half_a if by_u and part == 0 else a1
                    box[slot, 2] = half_b if not by_u and part == 1 else b0
                    box[slot, 3] = half_b if not by_u and part == 0 else b1
                # Corners 0 .. 3 are (a0, b0), (a0, b1), (a1, b0), (a1, b1); the two new ones belong to both parts.
                for m in range(2):
                    if by_u:
                        kept0, kept1, new = m, m + 2, (half_a, b0 if m == 0 else b1)
                        slot0, slot1 = m + 2, m
                    else:
                        kept0, kept1, new = 2 * m, 2 * m + 1, (a0 if m == 0 else a1, half_b)
                        slot0, slot1 = 2 * m + 1, 2 * m
                    _fill_node(
                        block, new[0], new[1], start, pace, near, polynomials, breaks, bend, cutter, look, at, middle
                    )
                    count += 1
                    for k in range(NODE):
                        stack[depth, kept0, k] = nodes[kept0, k]
                        stack[depth, slot0, k] = middle[k]
                        stack[depth + 1, kept1, k] = nodes[kept1, k]
                        stack[depth + 1, slot1, k] = middle[k]
                depth += 2
                continue

            if trim == 0:
                inside = 0
                for m in range(16):
                    u = u0 + (m // 4 + 0.5) / 4 * (u1 - u0)
                    v = v0 + (m % 4 + 0.5) / 4 * (v1 - v0)
                    if is_inside(u, v, vertices, starts):
                        inside += 1
                area *= inside / 16
            if rows + 1 > table.shape[0]:
                table = np.concatenate((table, np.empty_like(table)))
            table[rows, U0] = u0
            table[rows, U1] = u1
            table[rows, V0] = v0
            table[rows, V1] = v1
            # Where times were left out, the cutter is only known to be below.
            table[rows, LOWER] = lower if above == 0 else min(lower, 0.0)
            table[rows, UPPER] = upper
            table[rows, STATE] = state
            table[rows, AREA] = area
            rows += 1
    figures[0] = deepest
    figures[1] = largest
    figures[2] = count
    return table[:rows]
