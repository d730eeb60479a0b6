"""Whether the linear axes have the travel that a program needs, and where on the machine it may lie.

What a program needs depends on where its datum lies on the machine and on how far each tool sticks out of the spindle.
Where both are known, every pose is checked. Where either is not, the check is whether there is *any* datum, and any
length of those tools, with which all poses are within travel; positions are linear in these: a linear program.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.optimize import linprog

from postprocessors.errors import PostError
from postprocessors.kinematics.linear_axes import NosePositions, nose_positions
from postprocessors.kinematics.timing import unwound
from postprocessors.kinematics.visits import VisitWords
from postprocessors.machines.machine import Machine, Vector

Array = npt.NDArray[np.float64]

SLACK = 1e-6
"""mm by which a position may pass a limit before it counts: rounding."""
TURN_CHECKED_DEG = 5.0
"""Turn of a rotary axis between places that are checked: with a radius of 500 mm they leave the chord by 0.5 mm."""
ROOMY = 1e5
"""Distance from the limits (mm) that is not worth more; keeps the linear program bounded."""


@dataclass(frozen=True, slots=True)
class Mounting:
    """What is known of how part and tools are mounted.

    Attributes
    ----------
    zero: the program's datum in machine coordinates with all rotary axes at 0, mm; None where it is not known.
    gauge_length: length from tip to spindle nose by tool name, mm, of the tools for which it is known.
    """

    zero: Vector | None = None
    gauge_length: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class TravelCheck:
    """What a travel check found.

    Attributes
    ----------
    complete: whether datum and all tool lengths were known, so that every pose was checked.
    low, high: least and greatest position of X, Y and Z, mm; for the datum below where that was not known.
    zero: the datum: as given, or the one that keeps farthest from all limits.
    margin: least distance from a limit, mm.
    supposed: tools whose length was not known, with the length that goes with `zero`.
    """

    complete: bool
    low: Array
    high: Array
    zero: Vector
    margin: float
    supposed: Mapping[str, float]


def check_travel(machine: Machine, visits: tuple[VisitWords, ...], mounting: Mounting) -> TravelCheck:
    """Check X, Y and Z on the way through all poses against the machine's travels.

    On a machine that retracts to a height of its own, the first and the last pose of a visit must not be higher.

    Raises
    ------
    PostError: a pose is out of travel, or no datum exists for which all are within.
    """
    places = [_places(machine, visit) for visit in visits]
    positions = [place.nose for place in places]
    names = [visit.tool for visit in visits]
    unknown = sorted({name for name in names if name not in mounting.gauge_length})
    limits = [_limits(machine, len(place.pose)) for place in places]
    if mounting.zero is not None and not unknown:
        zero, lengths = np.asarray(mounting.zero, dtype=np.float64), dict(mounting.gauge_length)
    else:
        zero, lengths = _roomiest(positions, names, unknown, mounting, limits)
    complete = mounting.zero is not None and not unknown
    nose = [at.at(zero, lengths[name]) for at, name in zip(positions, names, strict=True)]
    every = np.concatenate(nose)
    low, high = every.min(axis=0), every.max(axis=0)
    least, most = np.concatenate(limits).transpose(1, 0, 2)
    room = np.minimum(every - least, most - every)
    margin = float(room.min())
    if margin < -SLACK:
        labels = [
            f"{visit.label}, pose {pose + 1}"
            for visit, place in zip(visits, places, strict=True)
            for pose in place.pose
        ]
        raise _out_of_travel(every, room, labels, np.stack([least, most], axis=-1), complete, machine)
    supposed = {name: round(lengths[name], 3) for name in unknown}
    x, y, z = (float(value) for value in zero)
    return TravelCheck(complete, low, high, (x, y, z), margin, supposed)


class _Places(NamedTuple):
    """Positions of the spindle nose over one visit, (N, ...), and the pose that each leads to or is, (N,)."""

    nose: NosePositions
    pose: npt.NDArray[np.int64]


def _places(machine: Machine, visit: VisitWords) -> _Places:
    """All poses of a visit, and places between two where a rotary axis turns far: X, Y and Z then leave the chord."""
    words = unwound(machine, visit.words)
    turn = np.abs(np.diff(words, axis=0)).max(axis=1, initial=0.0)
    steps = np.maximum(np.ceil(turn / TURN_CHECKED_DEG).astype(np.int64), 1)
    # Block k is passed in steps[k] equal steps, of which the last ends at pose k + 1.
    pose = np.concatenate([[0], np.repeat(np.arange(1, len(words)), steps)])
    number = np.concatenate([[1], np.arange(1, len(pose)) - np.repeat(np.cumsum(steps) - steps, steps)])
    share = (number / np.concatenate([[1], steps])[pose])[:, None]
    before = np.maximum(pose - 1, 0)
    tip = visit.tip[before] + share * (visit.tip[pose] - visit.tip[before])
    return _Places(nose_positions(machine, tip, words[before] + share * (words[pose] - words[before])), pose)


def _limits(machine: Machine, count: int) -> Array:
    """Least and greatest X, Y and Z at the places of a visit, (count, 2, 3).

    A retract to a height of the machine goes up from the last of them, and the way to the first comes down from it.
    """
    limits = np.tile(np.array([line.travel_mm for line in machine.linear.each]).T, (count, 1, 1))
    if machine.retract_z_mm is not None:
        limits[[0, -1], 1, 2] = np.minimum(limits[[0, -1], 1, 2], machine.retract_z_mm)
    return limits


def _roomiest(
    positions: list[NosePositions], names: list[str], unknown: list[str], mounting: Mounting, limits: Sequence[Array]
) -> tuple[Array, dict[str, float]]:
    """The datum and tool lengths, as far as they are free, that keep farthest from all limits.

    Variables: datum (3), lengths of the unknown tools, and the margin, which is made as large as it gets.
    """
    rows, sides = [], []
    for at, name, limit in zip(positions, names, limits, strict=True):
        known = mounting.gauge_length.get(name)
        constant = at.constant if known is None else at.constant + known * at.by_length
        lengths = np.zeros((len(constant), 3, len(unknown)))
        if known is None:
            lengths[:, :, unknown.index(name)] = at.by_length
        row = np.concatenate([at.by_zero, lengths], axis=2).reshape(-1, 3 + len(unknown))
        low = (constant - limit[:, 0]).reshape(-1)
        high = (limit[:, 1] - constant).reshape(-1)
        # low + row x >= margin and high - row x >= margin
        rows += [np.column_stack([-row, np.ones(len(row))]), np.column_stack([row, np.ones(len(row))])]
        sides += [low, high]
    zero_bounds = [(None, None)] * 3 if mounting.zero is None else [(value, value) for value in mounting.zero]
    bounds = [*zero_bounds, *[(0.0, None)] * len(unknown), (None, ROOMY)]
    goal = np.zeros(4 + len(unknown))
    goal[-1] = -1.0
    found = linprog(goal, A_ub=np.vstack(rows), b_ub=np.concatenate(sides), bounds=bounds, method="highs")
    # The margin may be as negative as it needs to be, so that there always is a solution.
    assert found.status == 0, found.message
    lengths_found = {name: float(value) for name, value in zip(unknown, found.x[3:-1], strict=True)}
    return np.asarray(found.x[:3]), {**mounting.gauge_length, **lengths_found}


def _out_of_travel(
    every: Array, room: Array, labels: list[str], limits: Array, complete: bool, machine: Machine
) -> PostError:
    """Name the worst pose, and what the axis has."""
    pose, axis = (int(index) for index in np.unravel_index(room.argmin(), room.shape))
    letter = "XYZ"[axis]
    low, high = (float(value) for value in limits[pose, axis])
    if complete:
        found = f"{letter}{every[pose, axis]:+.3f} in machine coordinates"
        retract = ", the retract's height" if high < machine.linear.each[axis].travel_mm[1] else ""
        expected = f"{letter} {low:g} .. {high:g}{retract}"
        return PostError(labels[pose], found, expected, "Move the part ([machine] zero), or take another machine.")
    first, last = labels[int(every[:, axis].argmin())], labels[int(every[:, axis].argmax())]
    need = float(np.ptp(every[:, axis]))
    return PostError(
        f"{labels[pose]}",
        f"{letter} needs {need:.1f} mm (from {first} to {last}), with the part where it fits best",
        f"at most {high - low:g} mm of {letter}",
        "Turn the part in [setup], or choose a machine with more travel.",
    )
