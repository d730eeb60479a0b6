"""A machine that is driven in short steps of time: the fine integration that predicted times are held against.

It shares the description of the machine with `postprocessors.kinematics.timing` (what an axis can, how corners are
passed, that set points are averaged over a time), and none of its formulas: speeds are found by going back from the end
of the path in short pieces, and the way is summed up.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from postprocessors.machines.machine import Limits

Array = npt.NDArray[np.float64]

STEP = 1e-4  # s
PIECES = 20  # of each block
CREEP = 1e-4  # least rate, so that a machine at rest gets going
ARRIVED = 1e-6  # mm or degrees


class Drive(NamedTuple):
    """Seconds from rest to rest, and positions of the five axes every `STEP`, (T, 5)."""

    seconds: float
    axes: Array


def drive(axes: Array, nominal: Array, limits: Limits) -> Drive:
    """Run N blocks between axis positions (N + 1, 5) with nominal times (N,), none of them 0."""
    speed = np.abs(np.diff(axes, axis=0)) / nominal[:, None]
    cap = np.minimum(1.0, (limits.speed / np.maximum(speed, 1e-12)).min(axis=1))
    change = (limits.acceleration / np.maximum(speed, 1e-12)).min(axis=1)
    smoothing = float((limits.acceleration / limits.jerk).max())
    jump = np.abs(np.diff(np.diff(axes, axis=0) / nominal[:, None], axis=0))
    corner = (limits.acceleration * smoothing / np.maximum(jump, 1e-12)).min(axis=1)

    way = [0.0]
    for time in nominal.tolist():
        way += [way[-1] + time / PIECES * (k + 1) for k in range(PIECES)]
    caps, changes = np.repeat(cap, PIECES).tolist(), np.repeat(change, PIECES).tolist()
    # The rate from which the machine can still brake for everything that comes, at each place.
    most = [0.0] * len(way)
    for place in range(len(way) - 2, -1, -1):
        most[place] = min(
            caps[place], sqrt(most[place + 1] ** 2 + 2.0 * changes[place] * (way[place + 1] - way[place]))
        )
        if place > 0:
            most[place] = min(most[place], caps[place - 1])
            if place % PIECES == 0:
                most[place] = min(most[place], float(corner[place // PIECES - 1]))
    at, rate, piece, places = 0.0, 0.0, 0, [0.0]
    while at < way[-1]:
        while piece < len(caps) - 1 and way[piece + 1] <= at:
            piece += 1
        brake = sqrt(most[piece + 1] ** 2 + 2.0 * changes[piece] * max(way[piece + 1] - at, 0.0))
        rate = max(min(rate + changes[piece] * STEP, brake, caps[piece]), CREEP)
        at = min(at + rate * STEP, way[-1])
        places.append(at)
    times = np.concatenate([[0.0], np.cumsum(nominal)])
    driven = np.stack([np.interp(places, times, column) for column in axes.T], axis=1)
    width = max(round(smoothing / STEP), 1)
    padded = np.vstack([np.repeat(driven[:1], width, axis=0), driven, np.repeat(driven[-1:], width, axis=0)])
    sums = np.vstack([np.zeros((1, 5)), np.cumsum(padded - padded[0], axis=0)])
    smooth = padded[0] + (sums[width:] - sums[:-width]) / width
    still_off = np.flatnonzero(np.abs(smooth - axes[-1]).max(axis=1) > ARRIVED)
    return Drive(float(still_off[-1]) * STEP if len(still_off) else 0.0, smooth)
