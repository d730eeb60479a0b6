"""Slack between a tool assembly, a body of revolution made of truncated cones, and points, pose by pose."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(forceinline=True)
def section_distance(z, r, low, high, r_low, r_high):
    """Signed distance in the half plane (z along the axis, r across) to a solid truncated cone."""
    dz = high - low
    dr = r_high - r_low
    length = np.sqrt(dz * dz + dr * dr)
    lateral = ((r - r_low) * dz - (z - low) * dr) / length
    below = low - z
    above = z - high
    if lateral <= 0.0 and below <= 0.0 and above <= 0.0:
        return max(lateral, max(below, above))
    beside = ((z - low) * dz + (r - r_low) * dr) / length
    if 0.0 <= beside <= length and lateral > 0.0:
        return lateral
    if below > 0.0 and r <= r_low:
        return below
    if above > 0.0 and r <= r_high:
        return above
    if beside < 0.0:
        return np.sqrt(below * below + (r - r_low) * (r - r_low))
    return np.sqrt(above * above + (r - r_high) * (r - r_high))


@njit(forceinline=True)
def assembly_distance(z, r, ball, ball_margin, sections, margins):
    """Least distance minus margin of a place in the half plane to ball and sections."""
    value = np.sqrt((z - ball[0]) * (z - ball[0]) + r * r) - ball[1] - ball_margin
    for s in range(sections.shape[0]):
        value = min(
            value, section_distance(z, r, sections[s, 0], sections[s, 1], sections[s, 2], sections[s, 3]) - margins[s]
        )
    return value


@njit(forceinline=True)
def pose_slack(
    px, py, pz, dx, dy, dz, points, starts, centres, radii, silhouette, lowest, ball, ball_margin, sections, margins,
    best, stop,
):  # fmt: skip
    """Least distance minus margin of one pose, cut off at `best`; the search ends once it is below `stop`.

    A cell is passed over whole where its bounding sphere stays out of the silhouette, or is further away than the best
    so far.
    """
    for c in range(centres.shape[0]):
        x = centres[c, 0] - px
        y = centres[c, 1] - py
        t = centres[c, 2] - pz
        z = x * dx + y * dy + t * dz
        k = int(z - lowest)
        if z < lowest or k >= silhouette.shape[0]:
            continue
        square = max(x * x + y * y + t * t - z * z, 0.0)
        reach = silhouette[k] + radii[c]
        if square > reach * reach:
            continue
        if assembly_distance(z, np.sqrt(square), ball, ball_margin, sections, margins) - radii[c] >= best:
            continue
        for i in range(starts[c], starts[c + 1]):
            x = points[i, 0] - px
            y = points[i, 1] - py
            t = points[i, 2] - pz
            z = x * dx + y * dy + t * dz
            square = max(x * x + y * y + t * t - z * z, 0.0)
            best = min(best, assembly_distance(z, np.sqrt(square), ball, ball_margin, sections, margins))
        if best < stop:
            break
    return best


@njit(cache=True, nogil=True)
def assembly_slack(
    p, d, points, starts, centres, radii, silhouette, lowest, ball, ball_margin, sections, margins, stop, slack
):
    """Least distance minus margin over all points, for every pose.

    p (M, 3): axis points at height 0; d (M, 3): unit directions. points (N, 3) sorted by cell, starts (C + 1,) where
    each cell begins, centres (C, 3) and radii (C,) of their bounding spheres. silhouette (H,): per millimetre of height
    from `lowest` on, the radius beyond which the centre of a cell's sphere, less its own radius, is clear. ball (2,):
    height of its centre and radius, with its margin. sections (S, 4): heights of both ends and radii there, with
    margins (S,). slack (M,) mm: cut off at the value in it on input; not searched further once below `stop`.
    """
    for k in range(p.shape[0]):
        slack[k] = pose_slack(
            p[k, 0], p[k, 1], p[k, 2], d[k, 0], d[k, 1], d[k, 2],
            points, starts, centres, radii, silhouette, lowest, ball, ball_margin, sections, margins, slack[k], stop,
        )  # fmt: skip
