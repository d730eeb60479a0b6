"""The machine of a job as the verification knows it: its axes, their limits, and where they stand for a pose.

A machine file is read as data, by this module alone: posts have a reader and kinematics of their own, so that a mistake
in either shows.

The part is clamped to the table axes, the spindle nose to the head axes. With the vectors and pivots as they are with
both rotary axes at zero, and the first axis of a pair carrying the part (table) or the other one (head),

    axis of the tool, seen from the part   a = R(first) R(second) z
    machine's Z, seen from the part        u = R(tables) z
    a point w of the part, on the machine  T(w) = P + R(-angle) (w - P), for each table axis, the first one first
    a point h of the head, off the nose    H(h) = P + R(angle) (h - P), for each head axis, the second one first

and the tool touches the part where both are the same: nose + H(-L z) = T(zero + tip), with `zero` the program's datum
in machine coordinates and L the tool's length from tip to nose.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from math import inf, isfinite, nan, pi, radians
from typing import Literal, NamedTuple

import msgspec
import numpy as np
import numpy.typing as npt

from conflank_cli import job as job_keys
from conflank_cli.errors import InputError
from conflank_cli.verification.kinematics import StatedAxes, axis_of, turned

Array = npt.NDArray[np.float64]
Triple = tuple[float, float, float]

_PARALLEL = 1e-3
"""Sine of the angle below which two axes count as parallel: half of all orientations would hang on the last digit."""

_REACHED = 1e-9
"""Cosines may pass 1 by this much: rounding of axis vectors with seven decimals makes 1e-7 rad of it."""

_UPRIGHT = 1e-7
"""Sine of the angle to the first axis below which its position is not told by the tool axis: the last digit of a
vector that is written with seven decimals."""

_AHEAD = 4096
"""Poses that are looked at in one go."""

OWN_FUNCTIONS = frozenset({*range(7), 8, 9, 13, 14, 30, *range(89, 151), *range(197, 205)})
"""M functions whose meaning the control itself lays down; no machine file can call one of them harmless."""


class _RotaryKeys(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A table [[rotary]] of a machine file."""

    letter: Literal["A", "B", "C"]
    vector: Triple
    carried_by: Literal["table", "head"]
    sign: Literal[-1, 1] = 1
    pivot_mm: Triple = (0.0, 0.0, 0.0)
    range_deg: tuple[float, float] | None = None
    max_speed_deg_min: float
    max_acceleration_deg_s2: float
    max_jerk_deg_s3: float
    output: Literal["modulo", "continuous"] = "continuous"


class _LinearKeys(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A table [linear.x] of a machine file."""

    travel_mm: tuple[float, float]
    max_speed_mm_min: float
    max_acceleration_mm_s2: float
    max_jerk_mm_s3: float


class _LinearTables(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    x: _LinearKeys
    y: _LinearKeys
    z: _LinearKeys


class _MachineKeys(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A machine file."""

    name: str
    description: str = ""
    verified: bool = False
    rotary: tuple[_RotaryKeys, _RotaryKeys]
    linear: _LinearTables
    max_feed_mm_min: float
    retract: Literal["M140", "M91"] = "M140"
    retract_z_mm: float | None = None
    block_time_ms: float
    harmless_m: tuple[int, ...] = ()


class AxisLimits(NamedTuple):
    """Limits of X, Y, Z (mm) and of both rotary axes (radians), in the machine's order, each (5,); s for the time."""

    speed: Array
    acceleration: Array
    jerk: Array


@dataclass(frozen=True, slots=True)
class RotaryAxis:
    """A rotary axis.

    Attributes
    ----------
    letter: its word.
    direction: unit vector about which a growing word turns the tool counter-clockwise, seen from the part, with both
        axes at zero.
    table: whether it carries the part; else it carries the spindle.
    pivot: a point on it, mm, with both axes at zero: on the machine for a table, as seen from the nose for a head.
    low, high: least and greatest position, radians; infinite for an endless axis.
    modulo: whether its words lie within one turn and the control goes the shorter way.
    """

    letter: str
    direction: Triple
    table: bool
    pivot: Triple
    low: float
    high: float
    modulo: bool


@dataclass(frozen=True, slots=True)
class MachineModel:
    """A machine with two rotary axes.

    Attributes
    ----------
    name: as headers state it.
    rotary: the two axes in the order of t = R(first) R(second) z; positions are columns in this order everywhere.
    travel: least and greatest position of the nose in X, Y and Z, machine coordinates, mm.
    limits: speed, acceleration and jerk of all five axes; as tuples of five.
    max_feed: highest feed, mm/min.
    retract_z: Z in machine coordinates that its retracts go to; None where they go to the limit.
    block_time: least time of a block, s.
    harmless: M functions of the builder's that neither move nor stop anything that matters here.
    """

    name: str
    rotary: tuple[RotaryAxis, RotaryAxis]
    travel: tuple[tuple[float, float], tuple[float, float], tuple[float, float]]
    speed: tuple[float, ...]
    acceleration: tuple[float, ...]
    jerk: tuple[float, ...]
    max_feed: float
    retract_z: float | None
    block_time: float
    harmless: frozenset[int]

    @property
    def letters(self) -> str:
        """Letters of the rotary axes, in their order."""
        return "".join(axis.letter for axis in self.rotary)

    @property
    def axes(self) -> StatedAxes:
        """The rotary axes as poses are computed with: a = R(first) R(second) z, signs in the directions."""
        reduced = "".join(axis.letter for axis in self.rotary if axis.modulo)
        return StatedAxes(self.letters, self.rotary[0].direction, self.rotary[1].direction, reduced)

    @property
    def limits(self) -> AxisLimits:
        """Limits of X, Y, Z and the rotary axes as arrays."""
        return AxisLimits(np.array(self.speed), np.array(self.acceleration), np.array(self.jerk))

    @property
    def top(self) -> float:
        """Z of the nose, machine coordinates, from which on a retract is a full one, mm."""
        return self.travel[2][1] if self.retract_z is None else self.retract_z

    def tool_axis(self, rotary: Array) -> Array:
        """Tool axis, tip to spindle, seen from the part: (N, 3) at positions (N, 2), radians."""
        return axis_of(self.axes, rotary)

    def up(self, rotary: Array) -> Array:
        """The machine's Z, seen from the part: (N, 3) at positions (N, 2), radians."""
        result = np.tile([0.0, 0.0, 1.0], (len(rotary), 1))
        for axis, angle in self._carrying(rotary, table=True)[::-1]:
            result = turned(axis.direction, angle, result)
        return result

    def spindle(self, rotary: Array) -> Array:
        """Tool axis, tip to spindle, in machine coordinates: (N, 3) at positions (N, 2), radians."""
        result = np.tile([0.0, 0.0, 1.0], (len(rotary), 1))
        for axis, angle in self._carrying(rotary, table=False)[::-1]:
            result = turned(axis.direction, angle, result)
        return result

    def upright(self, rotary: Array) -> npt.NDArray[np.bool_]:
        """Where the tool axis is the machine's Z: (N,) at positions (N, 2), radians."""
        return np.asarray(np.hypot(*self.spindle(rotary)[:, :2].T) < _UPRIGHT)

    def nose(self, tip: Array, rotary: Array, zero: Array, length: Array | float) -> Array:
        """Where X, Y and Z stand, machine coordinates, (N, 3) mm.

        Parameters
        ----------
        tip: (N, 3) mm, in the program's frame.
        rotary: (N, 2) radians.
        zero: the program's datum in machine coordinates with both rotary axes at zero, (3,) mm.
        length: from tip to nose, (N,) or one for all, mm.
        """
        place = tip + zero
        for axis, angle in self._carrying(rotary, table=True):
            place = axis.pivot + turned(axis.direction, -angle, place - axis.pivot)
        return np.asarray(place - self._tip_off_nose(rotary, length))

    def tip(self, nose: Array, rotary: Array, zero: Array, length: Array | float) -> Array:
        """The tip in the program's frame, (N, 3) mm, where X, Y and Z stand at `nose`; otherwise as `nose`."""
        place = nose + self._tip_off_nose(rotary, length)
        for axis, angle in self._carrying(rotary, table=True)[::-1]:
            place = axis.pivot + turned(axis.direction, angle, place - axis.pivot)
        return np.asarray(place - zero)

    def _tip_off_nose(self, rotary: Array, length: Array | float) -> Array:
        point = np.zeros((len(rotary), 3))
        point[:, 2] = -np.asarray(length)
        for axis, angle in self._carrying(rotary, table=False)[::-1]:
            point = axis.pivot + turned(axis.direction, angle, point - axis.pivot)
        return point

    def _carrying(self, rotary: Array, table: bool) -> list[tuple[RotaryAxis, Array]]:
        """The table axes, or the head axes, each with its positions (N,), in the machine's order."""
        return [(axis, rotary[:, k]) for k, axis in enumerate(self.rotary) if axis.table == table]

    def positions(self, axis: Array) -> Array:
        """Both pairs of positions with which the tool points along `axis` (N, 3): (2, N, 2), within half a turn.

        Where the tool points along the first axis its position may be any, and is NaN. Where an axis is out of reach
        all are NaN.

        Source: t = R(a, first) R(b, second) z gives, with P = a . (z - (b.z) b), Q = a . (b x z) and
        D = a . t - (b.z)(a.b): P cos(second) + Q sin(second) = D.
        """
        a, b = (np.array(each.direction) for each in self.rotary)
        z = np.array([0.0, 0.0, 1.0])
        p, q = float(a @ (z - (b @ z) * b)), float(a @ np.cross(b, z))
        cosine = (axis @ a - float(b @ z) * float(a @ b)) / np.hypot(p, q)
        reached = np.abs(cosine) <= 1.0 + _REACHED
        half = np.arccos(np.clip(cosine, -1.0, 1.0))
        result = np.full((2, len(axis), 2), np.nan)
        for row, sense in enumerate((1.0, -1.0)):
            second = _half_turn(np.arctan2(q, p) + sense * half)
            start = turned(self.rotary[1].direction, second, np.tile(z, (len(axis), 1)))
            start, end = start - np.outer(start @ a, a), axis - np.outer(axis @ a, a)
            first = np.arctan2(np.cross(start, end) @ a, np.einsum("ij,ij->i", start, end))
            # Along the first axis there is nothing to measure an angle by.
            first = np.where(np.linalg.norm(end, axis=1) > _UPRIGHT, first, np.nan)
            result[row] = np.where(reached[:, None], np.stack([first, second], axis=1), np.nan)
        return result

    def followed_positions(self, axis: Array, start: Array) -> Array:
        """Positions (N, 2), radians, through axes (N, 3): each time the nearer of the two from the one before.

        That is what the control is said to do with tool vectors. `start`: positions before the first, (2,). NaN from
        where an axis is out of reach.
        """
        both = self.positions(axis)
        result = np.full((len(axis), 2), nan)
        last = np.asarray(start, dtype=np.float64)
        row = 0
        while row < len(axis):
            # Any position of the first axis will do where the tool points along it: it stays.
            choice = np.where(np.isnan(both[:, row]), last, both[:, row])
            if np.isnan(both[:, row, 1]).all():
                break
            choice = last + _half_turn(choice - last)
            way = np.abs(choice - last).sum(axis=1) + np.where(self._inside(choice), 0.0, 10.0 * pi)
            branch = int(way.argmin())
            result[row] = choice[branch]
            # As long as this solution stays the nearer one, it is taken in one go.
            ahead = both[:, row : row + _AHEAD]
            step = _half_turn(np.diff(ahead[branch], axis=0))
            change = _half_turn(ahead[1 - branch, 1:] - ahead[branch, :-1])
            followed = choice[branch] + np.cumsum(step, axis=0)
            stays = (np.abs(step).sum(axis=1) < np.abs(change).sum(axis=1)) & self._inside(followed)
            count = int(np.argmin(np.append(stays, False)))
            result[row + 1 : row + 1 + count] = followed[:count]
            row += 1 + count
            last = result[row - 1]
        return result

    def _inside(self, rotary: Array) -> npt.NDArray[np.bool_]:
        """Whether positions (N, 2), radians, are within the ranges of the axes, (N,)."""
        low, high = (np.array([getattr(each, name) for each in self.rotary]) for name in ("low", "high"))
        return np.asarray(((rotary >= low - _UPRIGHT) & (rotary <= high + _UPRIGHT)).all(axis=1))


def _half_turn(angle: Array) -> Array:
    """Angles brought within half a turn either way."""
    return np.asarray(angle - 2.0 * pi * np.round(angle / (2.0 * pi)))


def machine_of(keys: job_keys.Machine) -> MachineModel:
    """The machine that a job names: from the text of its file, or one that comes with the program.

    Raises
    ------
    InputError: there is no such machine, or its file is not one.
    """
    if keys.definition is not None:
        return read_machine(keys.definition, keys.file or keys.name)
    return _shipped(keys.name)


@lru_cache(maxsize=8)
def _shipped(name: str) -> MachineModel:
    folder = resources.files("postprocessors.machines")
    if re.fullmatch(r"[A-Za-z0-9_-]{1,64}", name) is None or not (file := folder / f"{name}.toml").is_file():
        names = sorted(item.name.removesuffix(".toml") for item in folder.iterdir() if item.name.endswith(".toml"))
        raise InputError(
            "[machine] name", repr(name)[:80], f"one of {', '.join(names)}", "Name one of these, or your file's path."
        )
    return read_machine(file.read_text("utf-8"), f"{name}.toml")


@lru_cache(maxsize=8)
def read_machine(content: str, where: str) -> MachineModel:
    """A machine from the text of its file; `where` names it in messages.

    Raises
    ------
    InputError: no TOML, a value that is not filled in, unknown keys, or values that make no machine.
    """
    step = "Correct the machine file; docs/machines.md lists its keys."
    try:
        keys = msgspec.toml.decode(content, type=_MachineKeys)
    except msgspec.DecodeError as error:
        raise InputError(where, str(error)[:200], "a machine file with all values filled in", step) from None
    for place, value, expected in _mistakes(keys):
        raise InputError(f"{where}: {place}", value, expected, step)
    axes = []
    for axis in keys.rotary:
        x, y, z = (float(value) for value in axis.sign * np.array(axis.vector) / np.linalg.norm(axis.vector))
        low, high = (-inf, inf) if axis.range_deg is None else (radians(value) for value in axis.range_deg)
        axes.append(
            RotaryAxis(
                axis.letter, (x, y, z), axis.carried_by == "table", axis.pivot_mm, low, high, axis.output == "modulo"
            )
        )
    lines, turns = (keys.linear.x, keys.linear.y, keys.linear.z), keys.rotary
    return MachineModel(
        name=keys.name,
        rotary=(axes[0], axes[1]),
        travel=(lines[0].travel_mm, lines[1].travel_mm, lines[2].travel_mm),
        speed=(*(x.max_speed_mm_min / 60.0 for x in lines), *(radians(x.max_speed_deg_min) / 60.0 for x in turns)),
        acceleration=(
            *(x.max_acceleration_mm_s2 for x in lines), *(radians(x.max_acceleration_deg_s2) for x in turns),
        ),
        jerk=(*(x.max_jerk_mm_s3 for x in lines), *(radians(x.max_jerk_deg_s3) for x in turns)),
        max_feed=keys.max_feed_mm_min,
        retract_z=keys.retract_z_mm if keys.retract == "M91" else None,
        block_time=keys.block_time_ms / 1000.0,
        harmless=frozenset(keys.harmless_m),
    )  # fmt: skip


def _mistakes(keys: _MachineKeys) -> list[tuple[str, str, str]]:
    """What the types allow and no machine has: place, what is there, what is expected."""
    found: list[tuple[str, str, str]] = []
    lines = [("x", keys.linear.x), ("y", keys.linear.y), ("z", keys.linear.z)]
    positive = [("max_feed_mm_min", keys.max_feed_mm_min), ("block_time_ms", keys.block_time_ms)]
    for place, table in [(f"linear.{letter}", line) for letter, line in lines] + [
        (f"rotary {axis.letter}", axis) for axis in keys.rotary
    ]:
        positive += [
            (f"{place} {key}", getattr(table, key)) for key in table.__struct_fields__ if key.startswith("max_")
        ]
    found += [(place, f"{value}", "a number > 0") for place, value in positive if not (isfinite(value) and value > 0.0)]
    ranges = [(f"linear.{letter} travel_mm", line.travel_mm) for letter, line in lines]
    ranges += [(f"rotary {axis.letter} range_deg", axis.range_deg) for axis in keys.rotary if axis.range_deg]
    found += [
        (place, f"[{low}, {high}]", "[least, greatest]")
        for place, (low, high) in ranges
        if not (isfinite(low) and isfinite(high) and low < high)
    ]
    first, second = keys.rotary
    for axis in keys.rotary:
        if not np.isfinite([*axis.vector, *axis.pivot_mm]).all() or not np.linalg.norm(axis.vector) > 0.0:
            return [*found, (f"rotary {axis.letter} vector, pivot_mm", f"{list(axis.vector)}", "finite, length > 0")]
    a, b = (np.array(axis.vector) / np.linalg.norm(axis.vector) for axis in keys.rotary)
    if first.letter == second.letter:
        found.append(("rotary", f"two axes {first.letter}", "two different letters"))
    if (first.carried_by, second.carried_by) == ("head", "table"):
        found.append(("rotary", f"{first.letter} (head) before {second.letter} (table)", "the table axis first"))
    if float(np.linalg.norm(np.cross(a, b))) < _PARALLEL or float(np.hypot(b[0], b[1])) < _PARALLEL:
        found.append(("rotary", "parallel axes", "two axes at an angle, the second not along z"))
    if (keys.retract == "M91") != (keys.retract_z_mm is not None):
        found.append(("retract_z_mm", f"{keys.retract_z_mm} with retract {keys.retract}", "a height exactly with M91"))
    if wrong := sorted(set(keys.harmless_m) & OWN_FUNCTIONS) or [m for m in keys.harmless_m if not 0 <= m <= 999]:
        found.append(("harmless_m", f"M{wrong[0]}", "M functions of the machine's builder"))
    return found
