"""Machines as data: two rotary axes, three linear ones, and how the control wants its words.

A machine file is TOML. The two ``[[rotary]]`` tables stand in the order of t = R(first) R(second) z, which maps the
spindle direction z to the tool axis t in part coordinates: the table axis that carries the part comes before the table
axis under it; table axes come before head axes; the head axis next to the machine comes before the one that carries
the spindle.
"""

from __future__ import annotations

import re
from math import isfinite
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np
import numpy.typing as npt

from postprocessors.errors import PostError
from postprocessors.shipped import read_shipped, shipped_names

Vector = tuple[float, float, float]
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
    pivot_mm: a point on the axis, machine coordinates with all rotary axes at 0.
    range_deg: least and greatest word, or None for an endless axis.
    max_speed_deg_min: fastest rotation.
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
    output: Literal["modulo", "continuous"] = "continuous"

    @property
    def direction(self) -> npt.NDArray[np.float64]:
        """Unit vector of the axis, shape (3,)."""
        vector = np.asarray(self.vector, dtype=np.float64)
        return np.asarray(vector / np.linalg.norm(vector))


class Travel(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Least and greatest position of the linear axes, machine coordinates, mm."""

    x: tuple[float, float]
    y: tuple[float, float]
    z: tuple[float, float]


class Machine(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A five-axis machine.

    Attributes
    ----------
    name: as the program header states it.
    description: one sentence for people.
    verified: whether somebody has checked the data against the real machine.
    rotary: the two rotary axes in the order of t = R(first) R(second) z.
    travel_mm: linear travels.
    max_feed_mm_min: highest feed that is programmed.
    retract: "M140" retracts along the tool axis to the limit; "M91" goes to Z `retract_z_mm` in machine coordinates.
    retract_z_mm: only with M91.
    block_time_ms: time the control needs for one block.
    """

    name: str
    description: str = ""
    verified: bool = False
    rotary: tuple[Rotary, Rotary]
    travel_mm: Travel
    max_feed_mm_min: float
    retract: Literal["M140", "M91"] = "M140"
    retract_z_mm: float | None = None
    block_time_ms: float


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
    content, where = read_shipped(name_or_path, _SHIPPED, "machine", "a machine file")
    return parse_machine(content, where)


def parse_machine(content: str, where: str) -> Machine:
    """Read a machine from the text of its file; `where` names it in messages.

    Raises
    ------
    PostError: no TOML, unknown or impossible values.
    """
    try:
        machine = msgspec.toml.decode(content, type=Machine)
    except msgspec.ValidationError as error:
        what, _, place = str(error).partition(" - at `$")
        where = f"{where}: {place.rstrip('`').lstrip('.')}" if place else where
        raise PostError(where, what, "the keys of a machine file", "Compare with the shipped machines.") from error
    except msgspec.DecodeError as error:
        raise PostError(where, str(error), "TOML", "Correct the syntax of the file.") from error
    _check(machine, where)
    return machine


def _check(machine: Machine, where: str) -> None:
    """Refuse what the types allow and geometry does not."""
    change = "Correct the machine file."
    positive = {f"rotary {axis.letter} max_speed_deg_min": axis.max_speed_deg_min for axis in machine.rotary}
    positive |= {"max_feed_mm_min": machine.max_feed_mm_min, "block_time_ms": machine.block_time_ms}
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
        if axis.range_deg is not None and not axis.range_deg[0] < axis.range_deg[1]:
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
    for letter in ("x", "y", "z"):
        low, high = getattr(machine.travel_mm, letter)
        if not low < high:
            raise PostError(f"{where}: travel_mm.{letter}", f"[{low}, {high}]", "[least, greatest]", change)
    if (machine.retract == "M91") != (machine.retract_z_mm is not None):
        found = f"retract {machine.retract} and retract_z_mm {machine.retract_z_mm}"
        raise PostError(f"{where}: retract", found, "retract_z_mm exactly with M91", change)
