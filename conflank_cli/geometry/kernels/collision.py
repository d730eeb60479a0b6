"""Exact signed distance between triangles and a body of revolution, at poses and along motions.

A section of the tool, a solid truncated cone K, is convex, and so is its signed distance over all of space (negative
inside, by the depth). The least of a convex function over a triangle is its least over the triangle's plane where that
is attained within the triangle, and else lies on an edge that separates the two. Seen from the axis a plane is
symmetric, so that its least lies on the line in which it meets the plane through the axis and its own normal. What is
left is a convex function of one variable on a line, with a slope that is known: tangents at both ends of a bracket
bound it from below. So each figure is exact to `TOLERANCE`, and is known to be.

A tree has the triangles' corners (T, 3, 3) and sag (T,) in its own order, and for each node, numbered in preorder,
its first and last triangle, its second child `right` (the first is the next node; -1 for a leaf), the centre of its box
with half the box's sides and the radius of a sphere about it, and the largest sag in it.

Sections come as rows (8,): height of the low and of the high end, radii there, sine and cosine of the half angle, 1
for a ball (height of the centre as low and high, radius), 0 else, and the sign with which the sag of a triangle counts.
"""

from __future__ import annotations

import numpy as np
from numba import njit

# What the least over a line may be off, mm.
TOLERANCE = 1e-5
# Tangents halve a bracket at least every other step, so this many always do.
STEPS = 80
# Triangles in a leaf of the tree.
LEAF = 8
# Deepest stack of a tree that halves the number of triangles at every node.
DEPTH = 64


@njit(forceinline=True)
def _part(order, low, high, middle, middles, axis):
    """Rearrange order[low:high] so that no triangle before `middle` lies further along an axis than one from there on.

    Source: Hoare's selection.
    """
    first, last = low, high - 1
    while first < last:
        pivot = middles[order[(first + last) // 2], axis]
        i, j = first, last
        while i <= j:
            while middles[order[i], axis] < pivot:
                i += 1
            while middles[order[j], axis] > pivot:
                j -= 1
            if i <= j:
                order[i], order[j] = order[j], order[i]
                i += 1
                j -= 1
        if middle <= j:
            last = j
        elif middle >= i:
            first = i
        else:
            return


@njit(cache=True, nogil=True)
def grow_tree(corners, middles, sag, order, first, last, right, centre, half, radius, sags):
    """Sort `order` (T,) of the triangles `corners` (T, 3, 3) with their `middles` (T, 3) into a tree; returns its size.

    sag (T,) of the triangles. first, last, right, centre, half, radius, sags are those of its nodes, with room for 2 T.
    """
    stack_low = np.empty(DEPTH, np.int64)
    stack_high = np.empty(DEPTH, np.int64)
    stack_parent = np.empty(DEPTH, np.int64)
    least, most = np.empty(3), np.empty(3)
    inner_least, inner_most = np.empty(3), np.empty(3)
    stack_low[0] = 0
    stack_high[0] = order.shape[0]
    stack_parent[0] = -1
    waiting = 1
    count = 0
    while waiting > 0:
        waiting -= 1
        low = stack_low[waiting]
        high = stack_high[waiting]
        if stack_parent[waiting] >= 0:
            right[stack_parent[waiting]] = count
        for x in range(3):
            least[x], most[x] = np.inf, -np.inf
            inner_least[x], inner_most[x] = np.inf, -np.inf
        for i in range(low, high):
            n = order[i]
            for x in range(3):
                inner_least[x] = min(inner_least[x], middles[n, x])
                inner_most[x] = max(inner_most[x], middles[n, x])
                for k in range(3):
                    least[x] = min(least[x], corners[n, k, x])
                    most[x] = max(most[x], corners[n, k, x])
        square = 0.0
        for x in range(3):
            centre[count, x] = 0.5 * (least[x] + most[x])
            half[count, x] = 0.5 * (most[x] - least[x])
        sags[count] = 0.0
        for i in range(low, high):
            sags[count] = max(sags[count], sag[order[i]])
            for k in range(3):
                away = 0.0
                for x in range(3):
                    away += (corners[order[i], k, x] - centre[count, x]) ** 2
                square = max(square, away)
        radius[count] = np.sqrt(square)
        first[count] = low
        last[count] = high
        right[count] = -1
        if high - low > LEAF:
            axis = 0
            for x in range(1, 3):
                if inner_most[x] - inner_least[x] > inner_most[axis] - inner_least[axis]:
                    axis = x
            middle = (low + high) // 2
            _part(order, low, high, middle, middles, axis)
            stack_low[waiting] = middle
            stack_high[waiting] = high
            stack_parent[waiting] = count
            waiting += 1
            stack_low[waiting] = low
            stack_high[waiting] = middle
            stack_parent[waiting] = -1
            waiting += 1
        count += 1
    return count


@njit(forceinline=True)
def section_slope(z, r, section):
    """Signed distance in the half plane (z along the axis, r across), and its derivatives by z and r."""
    low = section[0]
    high = section[1]
    if section[6] > 0.5:
        dz = z - low
        distance = np.sqrt(dz * dz + r * r)
        if distance < 1e-12:
            return -section[2], 0.0, 0.0
        return distance - section[2], dz / distance, r / distance
    r_low = section[2]
    r_high = section[3]
    sine = section[4]
    cosine = section[5]
    lateral = (r - r_low) * cosine - (z - low) * sine
    below = low - z
    above = z - high
    if lateral <= 0.0 and below <= 0.0 and above <= 0.0:
        if lateral >= below and lateral >= above:
            return lateral, -sine, cosine
        if below >= above:
            return below, -1.0, 0.0
        return above, 1.0, 0.0
    beside = (z - low) * cosine + (r - r_low) * sine
    if lateral > 0.0 and beside >= 0.0 and beside <= (high - low) / cosine:
        return lateral, -sine, cosine
    if below > 0.0 and r <= r_low:
        return below, -1.0, 0.0
    if above > 0.0 and r <= r_high:
        return above, 1.0, 0.0
    if beside < 0.0:
        distance = np.sqrt(below * below + (r - r_low) * (r - r_low))
        return distance, -below / distance, (r - r_low) / distance
    distance = np.sqrt(above * above + (r - r_high) * (r - r_high))
    return distance, above / distance, (r - r_high) / distance


@njit(forceinline=True)
def line_slope(z, ez, square, b, c, t, section):
    """Signed distance at t of a line and its slope; it is z + ez t along the axis and square + 2 b t + c t² across."""
    r = np.sqrt(max(square + t * (2.0 * b + c * t), 0.0))
    value, by_z, by_r = section_slope(z + ez * t, r, section)
    # On the axis the radius has a kink, and every slope between those of both sides is one.
    return value, by_z * ez + (by_r * (b + c * t) / r if r > 1e-9 else 0.0)


@njit(cache=True, nogil=True)
def line_least(z, ez, square, b, c, length, section, cutoff):
    """Least signed distance on a line for t in [0, length], and its t; not looked for once known to be above cutoff."""
    low = 0.0
    low_value, low_slope = line_slope(z, ez, square, b, c, low, section)
    if low_slope >= 0.0:
        return low_value, low
    high = length
    high_value, high_slope = line_slope(z, ez, square, b, c, high, section)
    if high_slope <= 0.0:
        return high_value, high
    for step in range(STEPS):
        # Where the tangents at both ends meet: nothing in between is lower.
        meet = (high_value - low_value + low_slope * low - high_slope * high) / (low_slope - high_slope)
        bound = low_value + low_slope * (meet - low)
        if bound >= cutoff or min(low_value, high_value) - bound <= TOLERANCE:
            break
        if step % 3 == 2 or not low < meet < high:
            meet = 0.5 * (low + high)
        value, slope = line_slope(z, ez, square, b, c, meet, section)
        if slope < 0.0:
            low, low_value, low_slope = meet, value, slope
        elif slope > 0.0:
            high, high_value, high_slope = meet, value, slope
        else:
            return value, meet
    if low_value <= high_value:
        return low_value, low
    return high_value, high


@njit(forceinline=True)
def edge_least(ax, ay, az, bx, by, bz, dx, dy, dz, section, cutoff):
    """Least signed distance on an edge from a to b, relative to the pose's point, and the share of it."""
    ex = bx - ax
    ey = by - ay
    ez = bz - az
    length = np.sqrt(ex * ex + ey * ey + ez * ez)
    z = ax * dx + ay * dy + az * dz
    ox = ax - z * dx
    oy = ay - z * dy
    oz = az - z * dz
    if length < 1e-12:
        return section_slope(z, np.sqrt(ox * ox + oy * oy + oz * oz), section)[0], 0.0
    ex /= length
    ey /= length
    ez /= length
    along = ex * dx + ey * dy + ez * dz
    fx = ex - along * dx
    fy = ey - along * dy
    fz = ez - along * dz
    value, t = line_least(
        z, along, ox * ox + oy * oy + oz * oz, ox * fx + oy * fy + oz * fz, fx * fx + fy * fy + fz * fz,
        length, section, cutoff,
    )  # fmt: skip
    return value, t / length


@njit(cache=True, nogil=True)
def triangle_least(corners, px, py, pz, dx, dy, dz, section, cutoff):
    """Least signed distance of a triangle (3, 3) to a section at a pose, and its place; above cutoff anything above."""
    ax = corners[0, 0] - px
    ay = corners[0, 1] - py
    az = corners[0, 2] - pz
    bx = corners[1, 0] - px
    by = corners[1, 1] - py
    bz = corners[1, 2] - pz
    cx = corners[2, 0] - px
    cy = corners[2, 1] - py
    cz = corners[2, 2] - pz
    nx = (by - ay) * (cz - az) - (bz - az) * (cy - ay)
    ny = (bz - az) * (cx - ax) - (bx - ax) * (cz - az)
    nz = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    size = np.sqrt(nx * nx + ny * ny + nz * nz)
    side_ab = -1.0
    side_bc = -1.0
    side_ca = -1.0
    if size > 1e-12:
        nx /= size
        ny /= size
        nz /= size
        height = nx * ax + ny * ay + nz * az
        along = nx * dx + ny * dy + nz * dz
        ux = nx - along * dx
        uy = ny - along * dy
        uz = nz - along * dz
        across = np.sqrt(ux * ux + uy * uy + uz * uz)
        if across > 1e-9:
            ux /= across
            uy /= across
            uz /= across
        else:
            # The plane lies across the axis: any direction in it will do.
            across = 0.0
            ux = bx - ax
            uy = by - ay
            uz = bz - az
            length = np.sqrt(ux * ux + uy * uy + uz * uz)
            ux /= length
            uy /= length
            uz /= length
        if section[6] > 0.5:
            middle = section[0]
            reach = section[2]
        else:
            middle = 0.5 * (section[0] + section[1])
            reach = np.sqrt(0.25 * (section[1] - section[0]) ** 2 + max(section[2], section[3]) ** 2)
        # Along the line the height is height along + t across, the signed radius height across - t along. What is
        # nearest to the section is within the section's own size of where its middle falls on the line.
        start = middle * across - reach
        z = height * along + start * across
        r = height * across - start * along
        value, t = line_least(z, across, r * r, -r * along, along * along, 2.0 * reach, section, cutoff)
        if value >= cutoff:
            return value, 0.0, 0.0, 0.0
        z += t * across
        r -= t * along
        x = z * dx + r * ux
        y = z * dy + r * uy
        w = z * dz + r * uz
        side_ab = nx * ((by - ay) * (w - az) - (bz - az) * (y - ay)) + ny * (
            (bz - az) * (x - ax) - (bx - ax) * (w - az)
        ) + nz * ((bx - ax) * (y - ay) - (by - ay) * (x - ax))  # fmt: skip
        side_bc = nx * ((cy - by) * (w - bz) - (cz - bz) * (y - by)) + ny * (
            (cz - bz) * (x - bx) - (cx - bx) * (w - bz)
        ) + nz * ((cx - bx) * (y - by) - (cy - by) * (x - bx))  # fmt: skip
        side_ca = nx * ((ay - cy) * (w - cz) - (az - cz) * (y - cy)) + ny * (
            (az - cz) * (x - cx) - (ax - cx) * (w - cz)
        ) + nz * ((ax - cx) * (y - cy) - (ay - cy) * (x - cx))  # fmt: skip
        if side_ab >= 0.0 and side_bc >= 0.0 and side_ca >= 0.0:
            return value, px + x, py + y, pz + w
    best = np.inf
    x = 0.0
    y = 0.0
    w = 0.0
    if side_ab < 0.0:
        value, share = edge_least(ax, ay, az, bx, by, bz, dx, dy, dz, section, min(cutoff, best))
        if value < best:
            best = value
            x = ax + share * (bx - ax)
            y = ay + share * (by - ay)
            w = az + share * (bz - az)
    if side_bc < 0.0:
        value, share = edge_least(bx, by, bz, cx, cy, cz, dx, dy, dz, section, min(cutoff, best))
        if value < best:
            best = value
            x = bx + share * (cx - bx)
            y = by + share * (cy - by)
            w = bz + share * (cz - bz)
    if side_ca < 0.0:
        value, share = edge_least(cx, cy, cz, ax, ay, az, dx, dy, dz, section, min(cutoff, best))
        if value < best:
            best = value
            x = cx + share * (ax - cx)
            y = cy + share * (ay - cy)
            w = cz + share * (az - cz)
    return best, px + x, py + y, pz + w


@njit(forceinline=True)
def section_gradient(x, y, z, dx, dy, dz, section):
    """Signed distance at a place relative to the pose's point, and a unit vector along which it grows at full rate."""
    height = x * dx + y * dy + z * dz
    x -= height * dx
    y -= height * dy
    z -= height * dz
    r = np.sqrt(x * x + y * y + z * z)
    value, by_height, by_r = section_slope(height, r, section)
    # On the axis all directions across are alike, and none of them is as good: the distance is convex.
    by_r = by_r / r if r > 1e-9 else 0.0
    return value, by_height * dx + by_r * x, by_height * dy + by_r * y, by_height * dz + by_r * z


@njit(forceinline=True)
def node_bound(tree, node, px, py, pz, dx, dy, dz, section):
    """What no triangle of a node is nearer than: the distance is convex, so that it lies above its tangent plane."""
    value, nx, ny, nz = section_gradient(
        tree.centre[node, 0] - px, tree.centre[node, 1] - py, tree.centre[node, 2] - pz, dx, dy, dz, section
    )
    fall = abs(nx) * tree.half[node, 0] + abs(ny) * tree.half[node, 1] + abs(nz) * tree.half[node, 2]
    return value - min(fall, tree.radius[node]) + min(section[7] * tree.sags[node], 0.0)


@njit(forceinline=True)
def triangle_bound(corners, x, y, z, value, nx, ny, nz):
    """What a triangle is not nearer than, from the signed distance at x, y, z and its gradient there."""
    fall = np.inf
    for k in range(3):
        fall = min(fall, nx * (corners[k, 0] - x) + ny * (corners[k, 1] - y) + nz * (corners[k, 2] - z))
    return value + fall


@njit(cache=True, nogil=True)
def tree_least(tree, px, py, pz, dx, dy, dz, section, cutoff, stop):
    """Least signed distance of all triangles, sag counted, to a section at a pose; the triangle and its place.

    What is not below `cutoff` is not looked for (then the triangle is -1); once something is below `stop` it will do.
    """
    best = cutoff
    found = -1
    fx = 0.0
    fy = 0.0
    fz = 0.0
    stack = np.empty(DEPTH, np.int64)
    bounds = np.empty(DEPTH, np.float64)
    waiting = 0
    if tree.first.shape[0] > 0:
        stack[0] = 0
        bounds[0] = node_bound(tree, 0, px, py, pz, dx, dy, dz, section)
        waiting = 1
    while waiting > 0:
        waiting -= 1
        if bounds[waiting] >= best:
            continue
        node = stack[waiting]
        if tree.right[node] < 0:
            cx = tree.centre[node, 0]
            cy = tree.centre[node, 1]
            cz = tree.centre[node, 2]
            middle, nx, ny, nz = section_gradient(cx - px, cy - py, cz - pz, dx, dy, dz, section)
            for i in range(tree.first[node], tree.last[node]):
                sag = section[7] * tree.sag[i]
                if triangle_bound(tree.corners[i], cx, cy, cz, middle, nx, ny, nz) + sag >= best:
                    continue
                value, x, y, z = triangle_least(tree.corners[i], px, py, pz, dx, dy, dz, section, best - sag)
                if value + sag < best:
                    best = value + sag
                    found = i
                    fx = x
                    fy = y
                    fz = z
            if best < stop:
                break
            continue
        near = node + 1
        far = tree.right[node]
        near_bound = node_bound(tree, near, px, py, pz, dx, dy, dz, section)
        far_bound = node_bound(tree, far, px, py, pz, dx, dy, dz, section)
        if far_bound < near_bound:
            near, far = far, near
            near_bound, far_bound = far_bound, near_bound
        stack[waiting] = far
        bounds[waiting] = far_bound
        stack[waiting + 1] = near
        bounds[waiting + 1] = near_bound
        waiting += 2
    return best, found, fx, fy, fz


@njit(cache=True, nogil=True)
def poses_least(tree, p, d, sections, component, limits, slack, value, triangle, place):
    """Least slack (signed distance less limit) of each component at each pose, where it is below what `slack` has.

    p, d (M, 3); sections (S, 8); component (S,) of each section; limits (S,) mm. slack, value (M, C) mm, triangle
    (M, C) in the tree's order and place (M, C, 3) are overwritten where something is nearer.
    """
    for k in range(p.shape[0]):
        for s in range(sections.shape[0]):
            c = component[s]
            best, found, x, y, z = tree_least(
                tree, p[k, 0], p[k, 1], p[k, 2], d[k, 0], d[k, 1], d[k, 2], sections[s],
                limits[s] + slack[k, c], -np.inf,
            )  # fmt: skip
            if found >= 0:
                slack[k, c] = best - limits[s]
                value[k, c] = best
                triangle[k, c] = found
                place[k, c, 0] = x
                place[k, c, 1] = y
                place[k, c, 2] = z


@njit(cache=True, nogil=True)
def poses_free(tree, p, d, sections, limits, free):
    """Set `free` (M,) to False at the poses where a section comes nearer than its limit."""
    for k in range(p.shape[0]):
        for s in range(sections.shape[0]):
            if not free[k]:
                break
            found = tree_least(
                tree, p[k, 0], p[k, 1], p[k, 2], d[k, 0], d[k, 1], d[k, 2], sections[s], limits[s], limits[s]
            )[1]
            free[k] = found < 0


@njit(forceinline=True)
def shifted(polynomial, middle, half, out):
    """The cubic of a span about `middle`, in units of `half`: out (4, 6)."""
    for x in range(6):
        c1 = polynomial[1, x]
        c2 = polynomial[2, x]
        c3 = polynomial[3, x]
        out[0, x] = polynomial[0, x] + middle * (c1 + middle * (c2 + middle * c3))
        out[1, x] = half * (c1 + middle * (2.0 * c2 + middle * 3.0 * c3))
        out[2, x] = half * half * (c2 + 3.0 * middle * c3)
        out[3, x] = half * half * half * c3


@njit(forceinline=True)
def axis_of(local):
    """Length of q - p at the middle of a stretch, and its direction."""
    x = local[0, 3] - local[0, 0]
    y = local[0, 4] - local[0, 1]
    z = local[0, 5] - local[0, 2]
    length = np.sqrt(x * x + y * y + z * z)
    return length, x / length, y / length, z / length


@njit(forceinline=True)
def turn_of(local):
    """By how much q - p turns in a stretch and changes its length, at most, mm at its end each.

    local (4, 6): p and q about the middle.
    """
    long = axis_of(local)[0]
    turn = 0.0
    stretch = 0.0
    for k in range(1, 4):
        square = 0.0
        along = 0.0
        for x in range(3):
            w = local[k, 3 + x] - local[k, x]
            square += w * w
            along += w * (local[0, 3 + x] - local[0, x]) / long
        turn += np.sqrt(square)
        stretch += abs(along)
    # |w| <= sqrt((l + a)^2 + b^2) <= l + a + b^2 / 2 (l + a), and not below l - a.
    return turn, stretch + turn * turn / long


@njit(forceinline=True)
def point_travel(local, height):
    """How far the cubic p + (height / l) (q - p), l the length of q - p in the middle, gets from the middle, mm."""
    share = height / axis_of(local)[0]
    way = 0.0
    for k in range(1, 4):
        square = 0.0
        for x in range(3):
            square += (local[k, x] + share * (local[k, 3 + x] - local[k, x])) ** 2
        way += np.sqrt(square)
    return way


@njit(forceinline=True)
def section_travel(local, section, turn, stretch):
    """How far any point of a section gets from where it is at the middle of a stretch, at most, mm.

    turn, stretch: as `turn_of`. A point at height z is p + z w / |w| with w = q - p; with l = |w| at the middle it is
    the cubic p + (z / l) w, off by no more than z times what |w| changes by; what sits a radius r across moves by r
    times the turn of the axis more, spin aside, which a body of revolution does not feel. A ball goes where its centre
    goes. Infinite where the axis turns by more than half a radian.
    """
    long = axis_of(local)[0]
    if turn > 0.5 * long:
        return np.inf
    reach = max(
        point_travel(local, section[0]) + abs(section[0]) * stretch / long,
        point_travel(local, section[1]) + abs(section[1]) * stretch / long,
    )
    if section[6] > 0.5:
        return reach
    return reach + max(section[2], section[3]) * (turn + stretch) / long


@njit(forceinline=True)
def beyond_plane(local, section, turn, stretch, nx, ny, nz, along):
    """How far a section reaches along a unit vector n from the middle's p, at most, anywhere in a stretch, mm.

    along: <n, d> at the middle. With c = <n, d> at any time a disc of radius r at height z reaches <n, p> + z c +
    r sqrt(1 - c^2), and the root is no larger than its tangent: up to the length of q - p that is a cubic in time.
    """
    long = axis_of(local)[0]
    across = np.sqrt(max(1.0 - along * along, 0.0))
    most = -np.inf
    for end in range(2):
        z = section[end]
        r = section[2 + end]
        lever = z
        reach = z * along + r * across
        if section[6] > 0.5:
            reach = z * along + r
        elif across > 0.05:
            lever -= r * along / across
        else:
            reach += r * (turn + stretch) / long
        c1 = 0.0
        c2 = 0.0
        c3 = 0.0
        for x in range(3):
            n = nx if x == 0 else (ny if x == 1 else nz)
            c1 += n * (local[1, x] + lever / long * (local[1, 3 + x] - local[1, x]))
            c2 += n * (local[2, x] + lever / long * (local[2, 3 + x] - local[2, x]))
            c3 += n * (local[3, x] + lever / long * (local[3, 3 + x] - local[3, x]))
        # The largest of c1 t + c2 t^2 + c3 t^3 for |t| <= 1, and what the length of q - p changes.
        c1 = abs(c1)
        reach += abs(c3) + (c1 + c2 if c2 >= -0.5 * c1 else -0.25 * c1 * c1 / c2)
        reach += abs(lever) * (abs(along) + turn / long) * stretch / (long - stretch)
        most = max(most, reach)
    return most


@njit(forceinline=True)
def stays_apart(corners, sag, local, section, limit, turn, stretch, dx, dy, dz, x, y, z):
    """Whether a plane keeps a triangle and a section `limit` apart all through a stretch.

    x, y, z: where the triangle is nearest in the middle. The plane may be across the way from the section to there, or
    the triangle's own: that of a face along which the section slides. Does not promise that there is no other.
    """
    px = local[0, 0]
    py = local[0, 1]
    pz = local[0, 2]
    _, nx, ny, nz = section_gradient(x - px, y - py, z - pz, dx, dy, dz, section)
    if nx * nx + ny * ny + nz * nz < 0.5:
        # On the axis there is no such direction.
        return False
    along = nx * dx + ny * dy + nz * dz
    least = triangle_bound(corners, px, py, pz, 0.0, nx, ny, nz)
    if least + sag - beyond_plane(local, section, turn, stretch, nx, ny, nz, along) >= limit:
        return True
    ux = corners[1, 0] - corners[0, 0]
    uy = corners[1, 1] - corners[0, 1]
    uz = corners[1, 2] - corners[0, 2]
    vx = corners[2, 0] - corners[0, 0]
    vy = corners[2, 1] - corners[0, 1]
    vz = corners[2, 2] - corners[0, 2]
    ox = uy * vz - uz * vy
    oy = uz * vx - ux * vz
    oz = ux * vy - uy * vx
    size = np.sqrt(ox * ox + oy * oy + oz * oz)
    if size < 1e-12:
        return False
    if ox * nx + oy * ny + oz * nz < 0.0:
        size = -size
    ox /= size
    oy /= size
    oz /= size
    least = ox * (corners[0, 0] - px) + oy * (corners[0, 1] - py) + oz * (corners[0, 2] - pz)
    along = ox * dx + oy * dy + oz * dz
    return least + sag - beyond_plane(local, section, turn, stretch, ox, oy, oz, along) >= limit


# What there is to say of a section in a stretch of a motion.
FREE, HIT, OPEN = 0, 1, 2


@njit(cache=True, nogil=True)
def stretch_state(tree, local, dx, dy, dz, section, limit, turn, stretch, coarse, fine):
    """Whether a section keeps its limit all through a stretch (FREE), counts as a HIT, or has to be looked at closer.

    turn, stretch: as `turn_of`; others as `hits_along`.
    """
    way = section_travel(local, section, turn, stretch)
    if way == np.inf:
        return OPEN
    px = local[0, 0]
    py = local[0, 1]
    pz = local[0, 2]
    cutoff = limit + way
    state = FREE
    stack = np.empty(DEPTH, np.int64)
    bounds = np.empty(DEPTH, np.float64)
    waiting = 0
    if tree.first.shape[0] > 0:
        stack[0] = 0
        bounds[0] = node_bound(tree, 0, px, py, pz, dx, dy, dz, section)
        waiting = 1
    while waiting > 0:
        waiting -= 1
        if bounds[waiting] >= cutoff:
            continue
        node = stack[waiting]
        if tree.right[node] < 0:
            cx = tree.centre[node, 0]
            cy = tree.centre[node, 1]
            cz = tree.centre[node, 2]
            middle, nx, ny, nz = section_gradient(cx - px, cy - py, cz - pz, dx, dy, dz, section)
            for i in range(tree.first[node], tree.last[node]):
                sag = section[7] * tree.sag[i]
                if triangle_bound(tree.corners[i], cx, cy, cz, middle, nx, ny, nz) + sag >= cutoff:
                    continue
                value, x, y, z = triangle_least(tree.corners[i], px, py, pz, dx, dy, dz, section, cutoff - sag)
                value += sag
                if value >= cutoff:
                    continue
                if value < limit - way or (value < limit and way <= coarse):
                    return HIT
                if value >= limit and stays_apart(
                    tree.corners[i], sag, local, section, limit, turn, stretch, dx, dy, dz, x, y, z
                ):
                    continue
                if way > coarse:
                    return OPEN
                if way <= fine:
                    return HIT
                # What is too near in the middle of so short a stretch is a hit, and nothing else matters any more.
                state = OPEN
                cutoff = limit
            continue
        near = node + 1
        far = tree.right[node]
        near_bound = node_bound(tree, near, px, py, pz, dx, dy, dz, section)
        far_bound = node_bound(tree, far, px, py, pz, dx, dy, dz, section)
        if far_bound < near_bound:
            near, far = far, near
            near_bound, far_bound = far_bound, near_bound
        stack[waiting] = far
        bounds[waiting] = far_bound
        stack[waiting + 1] = near
        bounds[waiting + 1] = near_bound
        waiting += 2
    return state


@njit(cache=True, nogil=True)
def hits_along(tree, polynomials, breaks, sections, limits, coarse, fine, hits):
    """Times of a motion at which a section comes nearer than its limit, as intervals; returns how many.

    polynomials (N, 4, 6): p and q in the local parameter of each span between breaks (N + 1,). Between the middle of a
    stretch and its ends a section moves by no more than it does: of what is further away than its limit and as much
    again, all of the stretch is free, and so it is of what a plane keeps apart from the section all the time. Else it
    is halved, until a section that is too near moves less than `coarse`, or one that merely cannot be told moves less
    than `fine`. What cannot be told counts as a hit. hits (H, 2): intervals in order, joined where they touch; the last
    row takes up what would be too many.
    """
    count = 0
    local = np.empty((4, 6))
    low = np.empty(DEPTH)
    high = np.empty(DEPTH)
    pending = np.empty((DEPTH, sections.shape[0]), np.bool_)
    for span in range(polynomials.shape[0]):
        width = breaks[span + 1] - breaks[span]
        low[0] = 0.0
        high[0] = 1.0
        pending[0] = True
        waiting = 1
        while waiting > 0:
            waiting -= 1
            a = low[waiting]
            b = high[waiting]
            half = 0.5 * (b - a)
            shifted(polynomials[span], a + half, half, local)
            _, dx, dy, dz = axis_of(local)
            turn, stretch = turn_of(local)
            state = FREE
            for s in range(sections.shape[0]):
                if not pending[waiting, s]:
                    continue
                own = stretch_state(tree, local, dx, dy, dz, sections[s], limits[s], turn, stretch, coarse, fine)
                pending[waiting, s] = own != FREE
                if own != FREE:
                    state = own
                if own == HIT:
                    break
            if state == HIT or (state == OPEN and waiting + 2 > DEPTH):
                start = breaks[span] + a * width
                end = breaks[span] + b * width
                if count > 0 and (start <= hits[count - 1, 1] + 1e-12 or count == hits.shape[0]):
                    hits[count - 1, 1] = end
                else:
                    hits[count, 0] = start
                    hits[count, 1] = end
                    count += 1
            elif state == OPEN:
                middle = a + half
                pending[waiting + 1] = pending[waiting]
                low[waiting] = middle
                high[waiting] = b
                low[waiting + 1] = a
                high[waiting + 1] = middle
                waiting += 2
    return count


@njit(cache=True, nogil=True)
def least_along(
    tree, polynomials, breaks, sections, component, limits, resolution, slack, value, time, triangle, place
):
    """Least slack of each component along a motion, where it is below what `slack` (C,) has, within `resolution` mm.

    As `hits_along`; value, time, triangle (C,) and place (C, 3) are those of the least.
    """
    local = np.empty((4, 6))
    low = np.empty(DEPTH)
    high = np.empty(DEPTH)
    spans = polynomials.shape[0]
    for s in range(sections.shape[0]):
        c = component[s]
        # The middles of all spans first: the rest has to beat the best of them.
        for look in range(2):
            for span in range(spans):
                low[0] = 0.0
                high[0] = 1.0
                waiting = 1
                while waiting > 0:
                    waiting -= 1
                    a = low[waiting]
                    b = high[waiting]
                    half = 0.5 * (b - a)
                    shifted(polynomials[span], a + half, half, local)
                    _, dx, dy, dz = axis_of(local)
                    way = section_travel(local, sections[s], *turn_of(local)) if look == 1 else 0.0
                    best, found, x, y, z = tree_least(
                        tree, local[0, 0], local[0, 1], local[0, 2], dx, dy, dz, sections[s],
                        limits[s] + slack[c] + (max(way - resolution, 0.0) if look == 1 else 0.0), -np.inf,
                    )  # fmt: skip
                    if found < 0:
                        continue
                    if best - limits[s] < slack[c]:
                        slack[c] = best - limits[s]
                        value[c] = best
                        time[c] = breaks[span] + (a + half) * (breaks[span + 1] - breaks[span])
                        triangle[c] = found
                        place[c, 0] = x
                        place[c, 1] = y
                        place[c, 2] = z
                    if look == 1 and way > resolution and waiting + 2 <= DEPTH:
                        low[waiting] = a + half
                        high[waiting] = b
                        low[waiting + 1] = a
                        high[waiting + 1] = a + half
                        waiting += 2


@njit(cache=True, nogil=True)
def crossings(tree, x, y, z, dx, dy, dz, body, of, count):
    """How often a ray from a point crosses the triangles of each body; count (B,), body (T,) in the tree's order.

    of: bodies that are asked for, (B,) bool. Does not promise a right answer where the ray meets an edge.
    """
    stack = np.empty(DEPTH, np.int64)
    waiting = 0
    if tree.first.shape[0] > 0:
        stack[0] = 0
        waiting = 1
    while waiting > 0:
        waiting -= 1
        node = stack[waiting]
        cx = tree.centre[node, 0] - x
        cy = tree.centre[node, 1] - y
        cz = tree.centre[node, 2] - z
        along = cx * dx + cy * dy + cz * dz
        radius = tree.radius[node]
        if along < -radius or cx * cx + cy * cy + cz * cz - along * along > radius * radius + 1e-9:
            continue
        if tree.right[node] >= 0:
            stack[waiting] = node + 1
            stack[waiting + 1] = tree.right[node]
            waiting += 2
            continue
        for i in range(tree.first[node], tree.last[node]):
            if not of[body[i]]:
                continue
            # Möller and Trumbore (1997): the ray's parameter and the place in the triangle by Cramer's rule.
            ax = tree.corners[i, 0, 0]
            ay = tree.corners[i, 0, 1]
            az = tree.corners[i, 0, 2]
            ux = tree.corners[i, 1, 0] - ax
            uy = tree.corners[i, 1, 1] - ay
            uz = tree.corners[i, 1, 2] - az
            vx = tree.corners[i, 2, 0] - ax
            vy = tree.corners[i, 2, 1] - ay
            vz = tree.corners[i, 2, 2] - az
            hx = dy * vz - dz * vy
            hy = dz * vx - dx * vz
            hz = dx * vy - dy * vx
            determinant = ux * hx + uy * hy + uz * hz
            if determinant == 0.0:
                continue
            sx = x - ax
            sy = y - ay
            sz = z - az
            first = (sx * hx + sy * hy + sz * hz) / determinant
            if first < 0.0 or first > 1.0:
                continue
            qx = sy * uz - sz * uy
            qy = sz * ux - sx * uz
            qz = sx * uy - sy * ux
            second = (dx * qx + dy * qy + dz * qz) / determinant
            if second < 0.0 or first + second > 1.0:
                continue
            if (vx * qx + vy * qy + vz * qz) / determinant > 0.0:
                count[body[i]] += 1
