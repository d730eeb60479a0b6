"""Feed of the tip, block by block, for the feed that is asked for at the contact or at the tip."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from conflank_cli.posting.ride import PassRide, Ride
from postprocessors.errors import PostError
from postprocessors.kinematics.time_scaling import Run, scaled_seconds
from postprocessors.kinematics.timing import least_seconds
from postprocessors.machines.machine import Machine

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

LEAST_FEED = 1.0
"""mm/min; programs carry whole numbers, and 0 would mean rapid."""
PRINTED = 1e-4
"""mm and degrees, the last digit of a coordinate or rotary word in a program."""
AT_LIMIT = 1e-9
"""Relative excess over an axis' speed that is rounding."""


class FedCut(NamedTuple):
    """N poses that are run at feed one after the other, as they are printed.

    tip, axis: (N, 3) each; axes: positions of the machine's five axes there, (N, 5), mm and degrees, rotary words
    unwound; ride: the cut they belong to; label: of the cut in messages, `block` counts from its first.
    """

    tip: Array
    axis: Array
    axes: Array
    ride: Ride | PassRide
    label: str


def as_printed(values: Array, datum: Array) -> Array:
    """Coordinates (N, 3) as the control reads them: rounded as they are printed, counted from the datum."""
    return np.asarray(np.round((values - datum) / PRINTED) * PRINTED + datum)


def block_feeds(cuts: Sequence[FedCut], machine: Machine, at: str) -> list[Array]:
    """Feed of the tip into each pose of each cut, whole mm/min, (N,); the first pose gets the feed of the second.

    Parameters
    ----------
    cuts: what is run at feed, between rapids.
    machine: its feed, block time, and speed, acceleration and jerk of its axes limit the feed.
    at: "contact": the fastest point of what cuts has the tool's feed; "tip": the tip has.

    Raises
    ------
    PostError: a rotary axis would have to be faster than it can be even at the lowest feed, because the tip all but
        stands while the tool swings.
    """
    feeds = [np.full(len(cut.tip) - 1, LEAST_FEED) for cut in cuts]
    moving = [_fed(cut) for cut in cuts]
    runs = [_run(cut, fed, machine, at) for cut, fed in zip(cuts, moving, strict=True)]
    for feed, fed, run, seconds in zip(feeds, moving, runs, scaled_seconds(runs, machine.limits), strict=True):
        # The least times are those of whole feeds, so that rounding to the nearest one passes none of them.
        feed[fed] = np.maximum(np.round(60.0 * run.way / seconds), LEAST_FEED)
    for cut, feed, fed in zip(cuts, feeds, moving, strict=True):
        _check_speed(cut, feed, machine)
        # A block without motion is not written; it has the feed of the one before it.
        kept = np.maximum.accumulate(np.where(fed, np.arange(len(fed)), 0))
        feed[:] = feed[kept]
    return [np.concatenate([feed[:1], feed]) for feed in feeds]


def _fed(cut: FedCut) -> Flags:
    """Which blocks (N - 1,) have a way of the tip that a feed can be counted of."""
    return np.asarray((np.abs(np.diff(cut.tip, axis=0)) > 0.5 * PRINTED).any(axis=1))


def _run(cut: FedCut, fed: Flags, machine: Machine, at: str) -> Run:
    """The blocks with a way of the tip, and the least time of each by the feed that is asked for."""
    wanted = cut.ride.tool.feed_mm_min
    way = np.linalg.norm(np.diff(cut.tip, axis=0), axis=1)[fed]
    fastest = way
    if at == "contact":
        # |step| is a convex function of height, so the fastest point is at one of the ends.
        high = np.linalg.norm(np.diff(cut.tip + cut.ride.contact[1] * cut.axis, axis=0), axis=1)[fed]
        fastest = np.maximum(way, high)
    highest = np.floor(np.minimum(60.0 * way / least_seconds(machine, cut.axes)[fed], machine.max_feed_mm_min))
    feed = np.maximum(np.minimum(wanted * way / fastest, highest), LEAST_FEED)
    steps = np.diff(cut.axes, axis=0)[fed]
    return Run(np.vstack([np.zeros((1, 5)), np.cumsum(steps, axis=0)]), 60.0 * way / feed, way)


def _check_speed(cut: FedCut, feed: Array, machine: Machine) -> None:
    """Refuse a cut whose rotary axes cannot follow."""
    way = np.linalg.norm(np.diff(cut.tip, axis=0), axis=1)
    turning = (np.abs(np.diff(cut.axes[:, 3:], axis=0)) / machine.limits.speed[3:]).max(axis=1)
    late = 60.0 * way / feed < turning * (1.0 - AT_LIMIT)
    if late.any():
        block = int(np.flatnonzero(late)[0])
        words = " ".join(
            f"{rotary.letter} by {step:.4f} deg"
            for rotary, step in zip(
                machine.rotary, np.abs(np.diff(cut.axes[block : block + 2, 3:], axis=0))[0], strict=True
            )
        )
        raise PostError(
            f"{cut.label}, block {block + 1}",
            f"{words} while the tip moves {way[block]:.4f} mm",
            f"a motion that {machine.name} can follow at a feed of {LEAST_FEED:g} mm/min or more",
            "The tool swings about its tip or passes the pose of the first rotary axis: turn the part in [setup].",
        )
