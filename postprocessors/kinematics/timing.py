"""How long a machine takes for a path.

What each axis does is taken over a *nominal time*, in which every block runs at its programmed feed; the machine runs
through it at a rate w of 0 to 1.

- A block's nominal time is at least what its fastest axis needs, and a block of the control.
- w changes no faster than the axis that is nearest to its acceleration lets it, and at a corner only as fast as lets
  every axis change its speed within the time constant below.
- Jerk: axis positions are then averaged over tau = max(a / j), as controls filter their set points. A step of the
  acceleration becomes a ramp of at most j; nothing is shortened; the way takes tau longer from rest to rest.

A straight block of length s then takes s / v + v / a + a / j: the exact time of the S-curve with seven phases.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from postprocessors.machines.machine import Limits, Machine

Array = npt.NDArray[np.float64]


class Profile(NamedTuple):
    """How a path of N blocks is run, from rest to rest.

    rate (N + 1,): share of the programmed feeds at the ends of blocks; seconds (N,): time of each block, before
    filtering; tail: seconds that filtering adds.
    """

    rate: Array
    seconds: Array
    tail: float

    @property
    def total(self) -> float:
        """Seconds from rest to rest."""
        return float(self.seconds.sum()) + self.tail


def unwound(machine: Machine, words: Array) -> Array:
    """Rotary words (N, 2) as the control follows them: an endless axis takes the shorter way."""
    steps = np.diff(words, axis=0)
    for column, rotary in enumerate(machine.rotary):
        if rotary.range_deg is None:
            steps[:, column] -= 360.0 * np.round(steps[:, column] / 360.0)
    return np.concatenate([words[:1], words[:1] + np.cumsum(steps, axis=0)])


def least_seconds(machine: Machine, axes: Array) -> Array:
    """Seconds that each block between positions (N + 1, 5) needs by its axes' speed and the control's cycle, (N,)."""
    by_speed = (np.abs(np.diff(axes, axis=0)) / machine.limits.speed).max(axis=1)
    return np.asarray(np.maximum(by_speed, machine.block_time_ms / 1000.0))


def profile(axes: Array, nominal: Array, limits: Limits) -> Profile:
    """How the machine runs N blocks between axis positions (N + 1, 5) whose nominal times are (N,), from rest to rest.

    Blocks without motion may be there; they take no time.
    """
    steps = np.diff(axes, axis=0)
    moving = (np.abs(steps).max(axis=1) > 0.0) & (nominal > 0.0)
    tail = float((limits.acceleration / limits.jerk).max()) if moving.any() else 0.0
    speed = steps[moving] / nominal[moving, None]
    time = nominal[moving]
    cap = np.minimum(1.0, 1.0 / np.maximum((np.abs(speed) / limits.speed).max(axis=1, initial=0.0), 1e-12))
    corner = (np.abs(np.diff(speed, axis=0)) / limits.acceleration).max(axis=1, initial=0.0) / max(tail, 1e-12)
    at_corner = np.minimum(np.minimum(cap[1:], cap[:-1]), 1.0 / np.maximum(corner, 1e-12))
    rate, taken = _braked(speed, time, cap, np.concatenate([[0.0], at_corner, [0.0]]), limits)

    seconds, rates = np.zeros(len(nominal)), np.zeros(len(nominal) + 1)
    seconds[moving] = taken
    if moving.any():
        rates[1:] = rate[np.cumsum(moving)]
    return Profile(rates, seconds, tail)


def _braked(speed: Array, time: Array, cap: Array, at_nodes: Array, limits: Limits) -> tuple[Array, Array]:
    """Rates at the N + 1 ends of blocks, and the seconds that each of the N blocks takes.

    speed (N, 5) at rate 1; time (N,) at rate 1; cap (N,) and at_nodes (N + 1,): largest rates in and between blocks.
    """
    change = 1.0 / np.maximum((np.abs(speed) / limits.acceleration).max(axis=1, initial=0.0), 1e-12)
    # Nowhere faster than what can be reached from each place before it, and braked to each place after it.
    ways = np.concatenate([[0.0], np.cumsum(2.0 * change * time)])
    squared = np.minimum(at_nodes**2, np.minimum.accumulate(at_nodes**2 - ways) + ways)
    backwards = ways[-1] - ways[::-1]
    squared = np.minimum(squared, (np.minimum.accumulate(squared[::-1] - backwards) + backwards)[::-1])
    rate = np.sqrt(np.maximum(squared, 0.0))
    top = np.sqrt(np.minimum(cap**2, 0.5 * (rate[1:] ** 2 + rate[:-1] ** 2) + change * time))
    spent = (2.0 * top**2 - rate[1:] ** 2 - rate[:-1] ** 2) / (2.0 * change)
    taken = (2.0 * top - rate[1:] - rate[:-1]) / change + np.maximum(time - spent, 0.0) / top
    return rate, np.asarray(taken)
