"""Block spacing: as few blocks as keep the posted axis on the exact motion, whichever way the control interpolates.

The control moves the tip on a straight line between blocks and swings the axis either on a great circle or by
interpolating the rotary words, depending on its mode. Blocks are spaced so that the cutter's axis, from the tip to the
plane of r_max, stays within `CHORD_TOLERANCE` of the exact motion either way.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from conflank_cli.errors import NumericalError
from conflank_cli.posting.ride import PassRide, Ride, great_circle
from postprocessors.kinematics.two_rotary import Run, choose_words, forward, legs
from postprocessors.machines.machine import Machine

Array = npt.NDArray[np.float64]

POSTED_WITHIN = 5e-4
"""mm, what posting may cost in all."""
CHORD_TOLERANCE = 3e-4
"""mm. With rounding to four decimals (0.09 µm of the tip, 0.06 µm by both angles at 50 mm) the posted axis stays within
the 0.5 µm that posting may cost."""
GRADING = 0.2
"""Share by which a block may be longer than the one beside it: where a motion has an inflection, blocks could be many
times as long as beside it, and the control would have to change its pace."""
UNEVEN = 2.2
"""Times that a block may be as long as the one beside it; where one is halved for its deviation, the feed would else
have to jump with the length of blocks, and an axis' speed with it."""
SHORT = 0.05
"""mm; blocks shorter than this are not halved to be more even: some passes begin or end with a scrap."""
CHECKS_PER_BLOCK = 7
"""Places within each block where the deviation is checked; it is a bump with one top, or two and a zero between."""
CHECK_SLACK = 0.97
"""What a check at seven places can miss of the top of such a bump is below 2 %."""
REFINEMENTS = 24
"""Rounds of halving blocks that are still too long; a sweep that needs more runs through the singular pose."""


def space_blocks(
    rides: Sequence[Ride | PassRide],
    machine: Machine,
    labels: Sequence[str],
    links: Sequence[tuple[Array, Array]],
    linked: Sequence[bool] = (),
) -> list[Array]:
    """Times of the blocks of each ride, as few as hold `CHORD_TOLERANCE`, evenly loaded.

    Parameters
    ----------
    rides: what is cut, in order.
    machine: its rotary words are one of the two interpolations.
    labels: name the rides in messages.
    links: axes (N, 3) of the poses before the first and after the last of each ride, in order.
    linked: whether each ride follows the one before without a full retract; none does if not given.

    The deviation of a block grows with the square of its length, so its second-order coefficient gives the density of
    blocks that loads all of them alike; what still fails then (near the singular pose the rotary words have no such
    coefficient) is halved.

    Raises
    ------
    NumericalError: blocks get endlessly short.
    """
    times = [_first_times(ride, machine, label) for ride, label in zip(rides, labels, strict=True)]
    limit = CHECK_SLACK * CHORD_TOLERANCE
    for _ in range(REFINEMENTS):
        # The words of the whole program: which of two solutions a sweep gets may depend on its links and neighbours.
        axes = [
            np.vstack([before, ride.poses(t)[1], after])
            for ride, t, (before, after) in zip(rides, times, links, strict=True)
        ]
        words = words_of(machine, labels, axes, linked or [False] * len(rides))
        done = True
        for index, ride in enumerate(rides):
            t = times[index]
            own = words[index][len(links[index][0]) :][: len(t)]
            fails = (block_deviation(ride, t, own, machine) > limit) | _uneven(ride, t)
            if fails.any():
                done = False
                times[index] = np.sort(np.concatenate([t, 0.5 * (t[:-1] + t[1:])[fails]]))
        if done:
            return times
    raise NumericalError(
        "posting",
        f"blocks that are still too long after {REFINEMENTS} halvings",
        "a motion whose rotary axes follow it",
        "The sweep passes the pose where the first rotary axis is along the tool: turn the part in [setup].",
    )


def words_of(machine: Machine, labels: Sequence[str], axes: Sequence[Array], linked: Sequence[bool]) -> list[Array]:
    """Rotary words (N, 2), degrees, for the axes (N, 3) of each ride with its ways, chosen over the whole program.

    `linked`: whether a ride follows the one before without a full retract.
    """
    starts = [index for index, follows in enumerate(linked) if not follows]
    visits = [range(first, last) for first, last in pairwise([*starts, len(linked)])]
    runs = [Run(labels[visit[0]], np.vstack([axes[index] for index in visit])) for visit in visits]
    words: list[Array] = []
    for visit, chosen in zip(visits, choose_words(machine, runs), strict=True):
        words += np.split(chosen, np.cumsum([len(axes[index]) for index in visit])[:-1])
    return words


def legs_of(ride: Ride | PassRide, machine: Machine, label: str) -> Sequence[Ride | PassRide]:
    """The pieces in which the machine can run through a cut, in order: one, unless a rotary axis has to unwind.

    Raises
    ------
    PostError: an orientation is out of the machine's reach.
    """
    t = ride.times
    pieces = legs(machine, Run(label, planned_axes(ride)))
    return [ride.between(float(t[first]), float(t[last])) for first, last in pieces]


def planned_axes(ride: Ride | PassRide) -> Array:
    """Tool axes (N, 3) that stand for the whole of a ride."""
    return ride.poses(ride.times)[1]


def _first_times(ride: Ride | PassRide, machine: Machine, label: str) -> Array:
    """Times from which blocks are halved where they must be: a pass begins with its own poses."""
    return ride.times if isinstance(ride, PassRide) else _planned_times(ride, machine, label)


def _planned_times(ride: Ride, machine: Machine, label: str) -> Array:
    """Times that load all blocks alike, with the least count for which none exceeds the tolerance (or nearly).

    `label` names the sweep in messages.
    """
    t = ride.times
    count = len(t)
    tip, axis = ride.poses(t)
    words = choose_words(machine, [Run(label, axis)])[0]
    width = 2.0 / (count - 1)
    pairs = np.stack([np.arange(count - 2), np.arange(2, count)], axis=1)
    deviation = _deviation(ride, tip[pairs], axis[pairs], words[pairs], tip[1:-1, None], axis[1:-1, None], machine)
    density = np.sqrt(deviation / (CHECK_SLACK * CHORD_TOLERANCE)) / width
    density = np.concatenate([density[:1], density, density[-1:]])
    # A straight stretch has no density of its own; a small one keeps the inverse of the integral defined.
    density = np.maximum(density, max(1e-3 * float(density.max()), np.finfo(np.float64).tiny))
    density = 1.0 / _graded(1.0 / density, t)
    load = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]) * np.diff(t))])
    blocks = max(1, int(np.ceil(load[-1])))
    for _ in range(6):
        times = np.interp(np.linspace(0.0, load[-1], blocks + 1), load, t)
        times[0], times[-1] = 0.0, 1.0
        words = choose_words(machine, [Run(label, ride.poses(times)[1])])[0]
        worst = float(block_deviation(ride, times, words, machine).max()) / (CHECK_SLACK * CHORD_TOLERANCE)
        # Where even a third more blocks would not do, single blocks are to blame, and those get halved later.
        if worst <= 1.0 or worst > 1.8:
            break
        blocks = max(blocks + 1, int(np.ceil(blocks * np.sqrt(worst))))
    return np.asarray(times)


def _uneven(ride: Ride | PassRide, t: Array) -> npt.NDArray[np.bool_]:
    """Which blocks between times t (N,) are more than `UNEVEN` times as long as one beside them, (N - 1,)."""
    tip, axis = ride.poses(t)
    length = np.linalg.norm(np.diff(tip + ride.contact[0] * axis, axis=0), axis=1)
    uneven = np.zeros(len(length), dtype=np.bool_)
    uneven[1:] |= length[1:] > UNEVEN * length[:-1]
    uneven[:-1] |= length[:-1] > UNEVEN * length[1:]
    return np.asarray(uneven & (length > SHORT))


def _graded(length: Array, t: Array) -> Array:
    """Lengths of blocks (N,) at times t (N,), none longer than given, that change by `GRADING` from block to block."""
    rising = np.minimum.accumulate(length - GRADING * t) + GRADING * t
    falling = (np.minimum.accumulate((length + GRADING * t)[::-1]))[::-1] - GRADING * t
    return np.asarray(np.minimum(rising, falling))


def block_deviation(ride: Ride | PassRide, t: Array, words: Array, machine: Machine) -> Array:
    """Largest deviation (mm) of each block between t[i] and t[i + 1] from the exact motion, shape (N - 1,).

    Both interpolations of the axis, at `CHECKS_PER_BLOCK` places, at the tip and at the plane of r_max; between these
    heights the deviation is smaller.
    """
    tip, axis = ride.poses(t)
    fractions = np.arange(1, CHECKS_PER_BLOCK + 1) / (CHECKS_PER_BLOCK + 1)
    inner = t[:-1, None] + np.diff(t)[:, None] * fractions
    inner_tip, inner_axis = ride.poses(inner.ravel())
    pairs = np.stack([np.arange(len(t) - 1), np.arange(1, len(t))], axis=1)
    shape = (*inner.shape, 3)
    return _deviation(
        ride, tip[pairs], axis[pairs], words[pairs], inner_tip.reshape(shape), inner_axis.reshape(shape), machine
    )


def _deviation(
    ride: Ride | PassRide, tip: Array, axis: Array, words: Array, inner_tip: Array, inner_axis: Array, machine: Machine
) -> Array:
    """Deviation of N blocks from K exact poses within each, mm, (N,).

    tip, axis (N, 2, 3) and words (N, 2, 2) at the ends; inner_tip, inner_axis (N, K, 3) exact. When a pose is passed
    does not matter, only that it is: each exact pose is compared with the place in the block that is level with its
    middle.
    """
    reach = ride.reach
    count, places, _ = inner_tip.shape
    start = tip[:, 0] + 0.5 * reach * axis[:, 0]
    chord = tip[:, 1] + 0.5 * reach * axis[:, 1] - start
    along = np.einsum("nki,ni->nk", inner_tip + 0.5 * reach * inner_axis - start[:, None], chord)
    share = (along / np.maximum(np.einsum("ni,ni->n", chord, chord), np.finfo(np.float64).tiny)[:, None])[..., None]
    share = np.clip(share, 0.0, 1.0)
    tips = tip[:, None, 0] + share * (tip[:, None, 1] - tip[:, None, 0])
    error_tip = np.linalg.norm(tips - inner_tip, axis=2)

    step = words[:, 1] - words[:, 0]
    for column, rotary in enumerate(machine.rotary):
        if rotary.range_deg is None:
            step[:, column] -= 360.0 * np.round(step[:, column] / 360.0)
    by_words = forward(machine, (words[:, None, 0] + share * step[:, None]).reshape(-1, 2)).reshape(count, places, 3)
    by_circle = great_circle(axis[:, None, 0], axis[:, None, 1], share)
    worst = error_tip.max(axis=1)
    for axes in (by_words, by_circle):
        error_top = np.linalg.norm(tips - inner_tip + reach * (axes - inner_axis), axis=2)
        worst = np.maximum(worst, error_top.max(axis=1))
    return np.asarray(worst)
