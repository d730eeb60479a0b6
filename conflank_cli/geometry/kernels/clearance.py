"""Slack between a tool assembly, a body of revolution made of truncated cones, and points, pose by pose."""

from __future__ import annotations

import numpy as np
from numba import njit


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


@njit(cache=True, nogil=True)
def assembly_slack(p, d, points, sections, margins, slack, nearest):
    """Least distance minus margin over all points and sections, for every pose.

    p (M, 3): axis points at height 0; d (M, 3): unit directions. points (N, 3). sections (S, 4): heights of both ends and radii
    there, margins (S,). Fills slack (M,) in mm, cut off at the start value in it, and nearest (M,), the point's index or -1.
    """
    lowest = sections[0, 0]
    highest = sections[0, 1]
    widest = 0.0
    most = margins[0]
    for s in range(sections.shape[0]):
        lowest = min(lowest, sections[s, 0])
        highest = max(highest, sections[s, 1])
        widest = max(widest, max(sections[s, 2], sections[s, 3]))
        most = max(most, margins[s])
    for k in range(p.shape[0]):
        best = slack[k]
        nearest[k] = -1
        for i in range(points.shape[0]):
            x = points[i, 0] - p[k, 0]
            y = points[i, 1] - p[k, 1]
            t = points[i, 2] - p[k, 2]
            z = x * d[k, 0] + y * d[k, 1] + t * d[k, 2]
            reach = best + most
            if z < lowest - reach or z > highest + reach:
                continue
            square = x * x + y * y + t * t - z * z
            if square > (widest + reach) * (widest + reach):
                continue
            r = np.sqrt(square) if square > 0.0 else 0.0
            for s in range(sections.shape[0]):
                value = (
                    section_distance(z, r, sections[s, 0], sections[s, 1], sections[s, 2], sections[s, 3]) - margins[s]
                )
                if value < best:
                    best = value
                    nearest[k] = i
        slack[k] = best
