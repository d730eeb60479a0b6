"""Feed of the tip, block by block, for the feed that is asked for at the contact or at the tip."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from conflank_cli.posting.ride import Ride
from postprocessors.errors import PostError
from postprocessors.kinematics.timing import followed_seconds, least_seconds
from postprocessors.machines.machine import Machine

Array = npt.NDArray[np.float64]

LEAST_FEED = 1.0
"""mm/min; programs carry whole numbers, and 0 would mean rapid."""
PRINTED = 1e-4
"""mm, the last digit of a coordinate in a program."""
AT_LIMIT = 1e-9
"""Relative excess over an axis' speed that is rounding."""


def block_feeds(tip: Array, axis: Array, axes: Array, ride: Ride, machine: Machine, at: str, label: str) -> Array:
    """Feed of the tip into each pose, whole mm/min, (N,); the first pose gets the feed of the second.

    Parameters
    ----------
    tip, axis: poses, each (N, 3).
    axes: positions of the machine's five axes there, (N, 5), mm and degrees, rotary words unwound.
    ride: the cut they belong to.
    machine: its feed, block time, and speed and acceleration of its axes limit the feed.
    at: "contact": the fastest point of the flute has the tool's feed; "tip": the tip has.
    label: of the cut in messages; `pose` counts from its first.

    Raises
    ------
    PostError: a rotary axis would have to be faster than it can be even at the lowest feed, because the tip all but
        stands while the tool swings.
    """
    wanted = ride.tool.feed_mm_min / 60.0
    low = np.linalg.norm(np.diff(tip, axis=0), axis=1)
    fastest = low
    if at == "contact":
        # |step| is a convex function of height, so the fastest point is at one of the ends.
        fastest = np.maximum(low, np.linalg.norm(np.diff(tip + ride.reach * axis, axis=0), axis=1))
    least = least_seconds(machine, axes)
    seconds = np.maximum(np.maximum(fastest / wanted, 60.0 * low / machine.max_feed_mm_min), least)
    seconds = followed_seconds(axes, seconds, machine.limits)
    # The control sees the printed coordinates; where the tip hardly moves, rounding them changes its way.
    printed = np.linalg.norm(np.diff(np.round(tip / PRINTED), axis=0), axis=1) * PRINTED
    # Rounded to whole numbers a feed may pass what is wanted, but not what an axis or the control can do.
    feed = np.minimum(np.round(60.0 * np.minimum(printed, low) / seconds), np.floor(60.0 * printed / least))
    feed = np.clip(feed, LEAST_FEED, np.floor(max(machine.max_feed_mm_min, LEAST_FEED)))
    turning = (np.abs(np.diff(axes[:, 3:], axis=0)) / machine.limits.speed[3:]).max(axis=1)
    late = 60.0 * printed / feed < turning * (1.0 - AT_LIMIT)
    if late.any():
        block = int(np.flatnonzero(late)[0])
        words = " ".join(
            f"{rotary.letter} by {step:.4f} deg"
            for rotary, step in zip(
                machine.rotary, np.abs(np.diff(axes[block : block + 2, 3:], axis=0))[0], strict=True
            )
        )
        raise PostError(
            f"{label}, block {block + 1}",
            f"{words} while the tip moves {printed[block]:.4f} mm",
            f"a motion that {machine.name} can follow at a feed of {LEAST_FEED:g} mm/min or more",
            "The tool swings about its tip or passes the pose of the first rotary axis: turn the part in [setup].",
        )
    return np.concatenate([feed[:1], feed])
