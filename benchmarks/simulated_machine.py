"""A machine by other means than posts have: where its axes put the tool, and how long it takes for a path.

It shares the description of the machine with `postprocessors.kinematics` (how axes are stacked, what each can, how
corners are passed, that set points are averaged over a time), and none of its formulas: rotations are SciPy's, speeds
are found by going back from the end of the path in short pieces, and the way is summed up in short steps of time.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from postprocessors.machines.machine import Limits, Machine

Array = npt.NDArray[np.float64]

STEP = 1e-4  # s
PIECES = 20  # of each block
CREEP = 1e-4  # least rate, so that a machine at rest gets going
ARRIVED = 1e-6  # mm or degrees


def on_the_part(machine: Machine, nose: Array, words: Array, zero: Array, length: float) -> tuple[Array, Array]:
    """Tip and axis on the part, each (N, 3), from positions of all axes in the order the machine stacks them, mm."""
    tip, axis = np.tile([0.0, 0.0, -length], (len(nose), 1)), np.tile([0.0, 0.0, 1.0], (len(nose), 1))
    turns = [
        (Rotation.from_rotvec(np.radians(rotary.sign * words[:, [k]]) * rotary.direction), rotary)
        for k, rotary in enumerate(machine.rotary)
    ]
    # The spindle's own head axis turns first; of two tables, seen from the part, the outer one turns back first.
    for carried_by, shift in (("head", nose), ("table", np.zeros(3))):
        for turn, rotary in reversed(turns):
            if rotary.carried_by == carried_by:
                tip, axis = turn.apply(tip - rotary.pivot_mm) + rotary.pivot_mm, turn.apply(axis)
        tip = tip + shift
    return np.asarray(tip - zero), np.asarray(axis)


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
