"""Slack between a tool assembly, a body of revolution made of truncated cones, and points, pose by pose."""

from __future__ import annotations

import numpy as np
from numba import njit, prange


@njit(inline="always")
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


@njit(inline="always")
def pose_slack(px, py, pz, dx, dy, dz, points, starts, centres, radii, ball, ball_margin, sections, margins, best):
    """Least distance minus margin of one pose, cut off at `best`, and the nearest point's index or -1.

    A cell whose bounding sphere lies beyond the best so far is passed over whole.
    """
    nearest = -1
    for c in range(centres.shape[0]):
        x = centres[c, 0] - px
        y = centres[c, 1] - py
        t = centres[c, 2] - pz
        z = x * dx + y * dy + t * dz
        square = x * x + y * y + t * t - z * z
        r = np.sqrt(square) if square > 0.0 else 0.0
        bound = np.sqrt((z - ball[0]) * (z - ball[0]) + r * r) - ball[1] - ball_margin
        for s in range(sections.shape[0]):
            bound = min(
                bound,
                section_distance(z, r, sections[s, 0], sections[s, 1], sections[s, 2], sections[s, 3]) - margins[s],
            )
        if bound - radii[c] >= best:
            continue
        for i in range(starts[c], starts[c + 1]):
            x = points[i, 0] - px
            y = points[i, 1] - py
            t = points[i, 2] - pz
            z = x * dx + y * dy + t * dz
            square = x * x + y * y + t * t - z * z
            r = np.sqrt(square) if square > 0.0 else 0.0
            value = np.sqrt((z - ball[0]) * (z - ball[0]) + r * r) - ball[1] - ball_margin
            for s in range(sections.shape[0]):
                value = min(
                    value,
                    section_distance(z, r, sections[s, 0], sections[s, 1], sections[s, 2], sections[s, 3]) - margins[s],
                )
            if value < best:
                best = value
                nearest = i
    return best, nearest


@njit(cache=True, nogil=True)
def assembly_slack(p, d, points, starts, centres, radii, ball, ball_margin, sections, margins, slack):
    """Least distance minus margin over all points, for every pose.

    p (M, 3): axis points at height 0; d (M, 3): unit directions. points (N, 3) sorted by cell, starts (C + 1,) where each cell
    begins, centres (C, 3) and radii (C,) of their bounding spheres. ball (2,): height of its centre and radius, with its margin.
    sections (S, 4): heights of both ends and radii there, with margins (S,). slack (M,) mm: cut off at the value in it on input.
    """
    for k in range(p.shape[0]):
        slack[k] = pose_slack(
            p[k, 0], p[k, 1], p[k, 2], d[k, 0], d[k, 1], d[k, 2],
            points, starts, centres, radii, ball, ball_margin, sections, margins, slack[k],
        )[0]  # fmt: skip


@njit(cache=True, parallel=True)
def assembly_slack_parallel(p, d, points, starts, centres, radii, ball, ball_margin, sections, margins, slack):
    """The same on all cores."""
    for k in prange(p.shape[0]):
        slack[k] = pose_slack(
            p[k, 0], p[k, 1], p[k, 2], d[k, 0], d[k, 1], d[k, 2],
            points, starts, centres, radii, ball, ball_margin, sections, margins, slack[k],
        )[0]  # fmt: skip
