"""Feed of the tip for the feed at the contact, and the time it takes."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from conflank_cli.posting.ride import PassRide, Ride
from postprocessors.machines.machine import Machine
from postprocessors.toolpath import Stretch

Array = npt.NDArray[np.float64]

FEED_FLOOR = 0.01
"""Least tip feed as a share of the contact feed: below it the tip all but stands while the axis swings."""
LEAST_FEED = 1.0
"""mm/min; programs carry whole numbers, and 0 would mean rapid."""


def contact_feed(tip: Array, axis: Array, words: Array, ride: Ride | PassRide, machine: Machine) -> Array:
    """Feed of the tip into each pose, mm/min, (N,), for which the fastest point of the flute has the tool's feed.

    In a pass nothing above the ball cuts, so there the ball's centre has it.

    Not below `FEED_FLOOR`; limited by the machine's feed, block time and rotary speeds. The first pose gets the feed of
    the second.
    """
    wanted = ride.tool.feed_mm_min
    low = np.linalg.norm(np.diff(tip, axis=0), axis=1)
    reach = ride.tool.ball_radius if isinstance(ride, PassRide) else ride.reach
    high = np.linalg.norm(np.diff(tip + reach * axis, axis=0), axis=1)
    # |step| is a convex function of height, so the fastest point is at one of the ends.
    fastest = np.maximum(np.maximum(low, high), np.finfo(np.float64).tiny)
    turn = np.diff(words, axis=0)
    for column, rotary in enumerate(machine.rotary):
        if rotary.range_deg is None:
            turn[:, column] -= 360.0 * np.round(turn[:, column] / 360.0)
    speeds = np.array([rotary.max_speed_deg_min for rotary in machine.rotary])
    minutes = np.maximum((np.abs(turn) / speeds).max(axis=1), machine.block_time_ms / 60000.0)
    feed = np.maximum(wanted * low / fastest, FEED_FLOOR * wanted)
    feed = np.minimum(np.minimum(feed, low / minutes), machine.max_feed_mm_min)
    feed = np.maximum(feed, LEAST_FEED)
    return np.concatenate([feed[:1], feed])


def stretch_seconds(stretch: Stretch, rapid_mm_min: float) -> float:
    """Time for a stretch at its programmed feeds, seconds; rapid moves at `rapid_mm_min`. Acceleration is ignored."""
    length = np.linalg.norm(np.diff(stretch.tip, axis=0), axis=1)
    feed = np.where(stretch.feed[1:] > 0.0, stretch.feed[1:], rapid_mm_min)
    return float(60.0 * (length / feed).sum())
