"""Machines as data: two rotary axes, three linear ones, and how the control wants its words.

A machine file is TOML. The two ``[[rotary]]`` tables stand in the order of t = R(first) R(second) z, which maps the
spindle direction z to the tool axis t in part coordinates: the table axis that carries the part comes before the table
axis under it; table axes come before head axes; the head axis next to the machine comes before the one that carries
the spindle.

A value that nobody knows yet is written as "?": such a file can be listed and checked, but no program is posted for it.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from functools import lru_cache
from math import isfinite
from pathlib import Path
from typing import Literal, NamedTuple

import msgspec
import numpy as np
import numpy.typing as npt

from postprocessors.errors import PostError
from postprocessors.shipped import read_shipped, schema_error, shipped_names

Vector = tuple[float, float, float]
MOST_DEGREES = 36000.0
"""Largest word of a rotary axis with a range: a hundred turns, more than any cable takes."""
PARALLEL_SINE = 1e-3
"""Two rotary axes closer to parallel than this (0.06 degrees) do not make a five-axis machine: half of all
orientations would hang on the last digit of an axis vector."""


class Rotary(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One rotary axis.

    Attributes
    ----------
    letter: its word in the program.
    vector: direction of the axis with all rotary axes at 0 (any length; z is the spindle direction).
    carried_by: "table" or "head".
    sign: +1 where a growing word turns the tool counter-clockwise about `vector` relative to the part, else -1.
    pivot_mm: a point on the axis with all rotary axes at 0: of a table axis in machine coordinates, of a head axis as
        seen from the spindle nose.
    range_deg: least and greatest word, or None for an endless axis.
    max_speed_deg_min, max_acceleration_deg_s2, max_jerk_deg_s3: fastest rotation and how quickly it changes.
    output: "modulo" for words within 0 .. 360 that the control follows the shorter way (M126), "continuous" for words
        that count turns.
    """

    letter: Literal["A", "B", "C"]
    vector: Vector
    carried_by: Literal["table", "head"]
    sign: Literal[-1, 1] = 1
    pivot_mm: Vector = (0.0, 0.0, 0.0)
    range_deg: tuple[float, float] | None = None
    max_speed_deg_min: float
    max_acceleration_deg_s2: float
    max_jerk_deg_s3: float
    output: Literal["modulo", "continuous"] = "continuous"

    @property
    def direction(self) -> npt.NDArray[np.float64]:
        """Unit vector of the axis, shape (3,)."""
        vector = np.asarray(self.vector, dtype=np.float64)
        return np.asarray(vector / np.linalg.norm(vector))


class Linear(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One linear axis.

    Attributes
    ----------
    travel_mm: least and greatest position of the spindle nose, machine coordinates (M91, no tool length).
    max_speed_mm_min, max_acceleration_mm_s2, max_jerk_mm_s3: fastest motion and how quickly it changes.
    """

    travel_mm: tuple[float, float]
    max_speed_mm_min: float
    max_acceleration_mm_s2: float
    max_jerk_mm_s3: float


class LinearAxes(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The three linear axes."""

    x: Linear
    y: Linear
    z: Linear

    @property
    def each(self) -> tuple[Linear, Linear, Linear]:
        """X, Y and Z in this order."""
        return (self.x, self.y, self.z)


class Limits(NamedTuple):
    """Limits of X, Y, Z (mm) and the two rotary axes (degrees), each (5,): speed a second, acceleration, jerk."""

    speed: npt.NDArray[np.float64]
    acceleration: npt.NDArray[np.float64]
    jerk: npt.NDArray[np.float64]


class Machine(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A five-axis machine.

    Attributes
    ----------
    name: as the program header states it.
    description: one sentence for people.
    verified: whether somebody has checked the data against the real machine.
    rotary: the two rotary axes in the order of t = R(first) R(second) z.
    linear: the three linear axes.
    max_feed_mm_min: highest feed that is programmed.
    retract: "M140" retracts along the tool axis to the limit; "M91" goes to Z `retract_z_mm` in machine coordinates.
    retract_z_mm: only with M91.
    block_time_ms: time the control needs for one block.
    harmless_m: M functions of the machine's builder that move and stop nothing (clamps of an axis, say); the
        verification of a program passes them over.
    """

    name: str
    description: str = ""
    verified: bool = False
    rotary: tuple[Rotary, Rotary]
    linear: LinearAxes
    max_feed_mm_min: float
    retract: Literal["M140", "M91"] = "M140"
    retract_z_mm: float | None = None
    block_time_ms: float
    harmless_m: tuple[int, ...] = ()

    @property
    def limits(self) -> Limits:
        """Speed, acceleration and jerk of all five axes."""
        lines, turns = self.linear.each, self.rotary
        return Limits(
            np.array([*(a.max_speed_mm_min / 60.0 for a in lines), *(a.max_speed_deg_min / 60.0 for a in turns)]),
            np.array([*(a.max_acceleration_mm_s2 for a in lines), *(a.max_acceleration_deg_s2 for a in turns)]),
            np.array([*(a.max_jerk_mm_s3 for a in lines), *(a.max_jerk_deg_s3 for a in turns)]),
        )


CONTROL_FUNCTIONS = frozenset({*range(7), 8, 9, 13, 14, 30, *range(89, 151), *range(197, 205)})
"""M functions that the control itself defines: a machine's builder has no say in them."""

UNKNOWN = "?"
"""Stands in a machine file for a value that has to be filled in."""

_SHIPPED = Path(__file__).parent


def shipped_machines() -> tuple[str, ...]:
    """Names of the machines that come with the program."""
    return shipped_names(_SHIPPED)


def load_machine(name_or_path: str | Path) -> Machine:
    """Read a machine by shipped name, or from a file (anything with a folder or ending in .toml).

    Raises
    ------
    PostError: no such machine, unreadable TOML, unknown or impossible values.
    """
    return parse_machine(*read_machine_file(name_or_path))


def read_machine_file(name_or_path: str | Path) -> tuple[str, str]:
    """The text of a machine file and its name in messages; see `load_machine`.

    Raises
    ------
    PostError: no such machine, or none that can be read.
    """
    return read_shipped(name_or_path, _SHIPPED, "machine", "a machine file")


def unknown_keys(content: str, where: str) -> tuple[str, ...]:
    """Keys of a machine file whose value is still unknown.

    Raises
    ------
    PostError: no TOML.
    """
    try:
        return tuple(_unknown(tomllib.loads(content), ""))
    except tomllib.TOMLDecodeError as error:
        raise PostError(where, str(error), "TOML", "Correct the syntax of the file.") from error


def _unknown(value: object, place: str) -> Iterator[str]:
    if value == UNKNOWN:
        yield place
    elif isinstance(value, dict):
        for key, item in value.items():
            yield from _unknown(item, f"{place}.{key}" if place else str(key))
    elif isinstance(value, list):
        # One unknown number makes the whole vector or range unknown; tables of a list are told apart.
        if UNKNOWN in value:
            yield place
        for number, item in enumerate(value):
            if isinstance(item, dict):
                yield from _unknown(item, f"{place}[{number}]")


@lru_cache(maxsize=8)
def parse_machine(content: str, where: str) -> Machine:
    """Read a machine from the text of its file; `where` names it in messages.

    Raises
    ------
    PostError: no TOML, a value that is still unknown, unknown keys or impossible values.
    """
    open_keys = unknown_keys(content, where)
    if open_keys:
        raise PostError(
            where,
            f"{len(open_keys)} values still to be filled in: {', '.join(open_keys)}",
            "the data of the real machine",
            "Copy the file, fill these in from the machine's documents, and name the copy under [machine] file.",
        )
    try:
        machine = msgspec.toml.decode(content, type=Machine)
    except msgspec.ValidationError as error:
        known = [key for table in (Machine, LinearAxes, Linear, Rotary) for key in table.__struct_fields__]
        raise schema_error(str(error), where, known, "the keys of a machine file", "See docs/machines.md.") from error
    _check(machine, where)
    return machine


def _check(machine: Machine, where: str) -> None:
    """Refuse what the types allow and geometry does not."""
    change = "Correct the machine file."
    positive = {"max_feed_mm_min": machine.max_feed_mm_min, "block_time_ms": machine.block_time_ms}
    for axis in machine.rotary:
        for key in ("max_speed_deg_min", "max_acceleration_deg_s2", "max_jerk_deg_s3"):
            positive[f"rotary {axis.letter} {key}"] = getattr(axis, key)
    for letter, line in zip("xyz", machine.linear.each, strict=True):
        for key in ("max_speed_mm_min", "max_acceleration_mm_s2", "max_jerk_mm_s3"):
            positive[f"linear.{letter}.{key}"] = getattr(line, key)
    for key, value in positive.items():
        if not (isfinite(value) and value > 0.0):
            raise PostError(f"{where}: {key}", f"{value}", "a number > 0", change)
    if re.fullmatch(r"[!-}]{1,32}", machine.name) is None:
        raise PostError(f"{where}: name", f"'{machine.name}'", "1 to 32 ASCII characters without spaces", change)
    for axis in machine.rotary:
        place = f"{where}: rotary {axis.letter}"
        numbers = np.array([*axis.vector, *axis.pivot_mm])
        if not np.isfinite(numbers).all() or not np.linalg.norm(axis.vector) > 0.0:
            raise PostError(f"{place} vector", f"{list(axis.vector)}", "a finite vector of non-zero length", change)
        # What is endless has no range; an infinite one would have infinitely many turns.
        if axis.range_deg is not None and not -MOST_DEGREES <= axis.range_deg[0] < axis.range_deg[1] <= MOST_DEGREES:
            raise PostError(f"{place} range_deg", f"{list(axis.range_deg)}", "[least, greatest]", change)
        if axis.range_deg is not None and axis.output == "modulo":
            found = f"range_deg {list(axis.range_deg)} with output modulo"
            raise PostError(place, found, "an endless axis (no range_deg) or output continuous", change)
    first, second = machine.rotary
    if first.letter == second.letter:
        raise PostError(f"{where}: rotary", f"two axes {first.letter}", "two different letters", change)
    if (first.carried_by, second.carried_by) == ("head", "table"):
        expected = "the table axis before the head axis"
        raise PostError(f"{where}: rotary", f"{first.letter} (head) before {second.letter} (table)", expected, change)
    if float(np.linalg.norm(np.cross(first.direction, second.direction))) < PARALLEL_SINE:
        raise PostError(f"{where}: rotary", "two parallel axes", "axes with an angle between them", change)
    if float(np.hypot(*second.direction[:2])) < PARALLEL_SINE:
        expected = "a second axis that tilts the spindle direction"
        raise PostError(f"{where}: rotary {second.letter}", "an axis along z", expected, change)
    for letter, line in zip("xyz", machine.linear.each, strict=True):
        low, high = line.travel_mm
        if not (isfinite(low) and isfinite(high) and low < high):
            raise PostError(f"{where}: linear.{letter}.travel_mm", f"[{low}, {high}]", "[least, greatest]", change)
    for function in machine.harmless_m:
        if function in CONTROL_FUNCTIONS or not 0 <= function <= 999:
            expected = "M functions of the machine's builder, as M10"
            raise PostError(f"{where}: harmless_m", f"M{function}", expected, change)
    if (machine.retract == "M91") != (machine.retract_z_mm is not None):
        found = f"retract {machine.retract} and retract_z_mm {machine.retract_z_mm}"
        raise PostError(f"{where}: retract", found, "retract_z_mm exactly with M91", change)
