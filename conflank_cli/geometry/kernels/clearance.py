"""Whether a tool assembly, a body of revolution, keeps clear of points, pose by pose."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(forceinline=True)
def height_and_square(px, py, pz, dx, dy, dz, x, y, t):
    """Height of a place (x, y, t) on the axis of a pose, and the square of its distance from that."""
    x -= px
    y -= py
    t -= pz
    z = x * dx + y * dy + t * dz
    return z, x * x + y * y + t * t - z * z


@njit(cache=True, nogil=True)
def poses_clear(
    p,
    d,
    points,
    starts,
    centres,
    radii,
    blocks,
    block_centres,
    block_radii,
    lowest,
    fine,
    squares,
    coarse,
    widest,
    free,
):
    """Take poses that are too near to a point out of those that are free.

    p (M, 3): axis points at height 0; d (M, 3): unit directions. points (N, 3) sorted by cell, starts (C + 1,) where
    each cell begins, centres (C, 3) and radii (C,) of their bounding spheres; blocks (B + 1,) where each block of cells
    begins, with spheres of their own. lowest, squares (H,) and widest (2, W): the outline of the assembly, with `fine`
    and `coarse` entries in a millimetre. free (M,): changed in place. A pose that is not a number is near to nothing.
    """
    hit = np.int64(0)
    count = blocks.shape[0] - 1
    last, pieces = squares.shape[0] - 1, widest.shape[1]
    for k in range(p.shape[0]):
        if not free[k]:
            continue
        px, py, pz = p[k, 0], p[k, 1], p[k, 2]
        dx, dy, dz = d[k, 0], d[k, 1], d[k, 2]
        for n in range(count):
            # What was in the way of one pose is most likely in the way of the next.
            b = n + hit
            if b >= count:
                b -= count
            z, square = height_and_square(
                px, py, pz, dx, dy, dz, block_centres[b, 0], block_centres[b, 1], block_centres[b, 2]
            )
            place = (z - lowest) * coarse
            if not 0.0 <= place < pieces:
                continue
            reach = widest[1, np.int64(place)] + block_radii[b]
            if square > reach * reach:
                continue
            for c in range(blocks[b], blocks[b + 1]):
                z, square = height_and_square(px, py, pz, dx, dy, dz, centres[c, 0], centres[c, 1], centres[c, 2])
                place = (z - lowest) * coarse
                if not 0.0 <= place < pieces:
                    continue
                reach = widest[0, np.int64(place)] + radii[c]
                if square > reach * reach:
                    continue
                for i in range(starts[c], starts[c + 1]):
                    z, square = height_and_square(px, py, pz, dx, dy, dz, points[i, 0], points[i, 1], points[i, 2])
                    place = (z - lowest) * fine
                    if not 0.0 <= place < last:
                        continue
                    j = np.int64(place)
                    if square < squares[j] + (place - j) * (squares[j + 1] - squares[j]):
                        free[k] = False
                        hit = b
                        break
                if not free[k]:
                    break
            if not free[k]:
                break
