"""Where X, Y and Z stand for poses of the tool on the part, on a machine with any two rotary axes.

A point of the part is carried by the table axes, the tip by the head axes. Both must meet:

    nose = table(zero + tip) - head(-L z)
    table(w) = P + R(-angle) (w - P) for each table axis, the part's own first
    head(h)  = P + R(+angle) (h - P) for each head axis, the spindle's own first

with `zero` the program's datum in machine coordinates while all rotary axes are at 0, L the tool's length from its tip
to the spindle nose, and P the pivot of each axis. The position is linear in `zero` and in L, whatever the angles are.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from postprocessors.errors import PostError
from postprocessors.machines.machine import PARALLEL_SINE, Machine

Array = npt.NDArray[np.float64]


class NosePositions(NamedTuple):
    """Positions of the spindle nose in machine coordinates: constant + by_zero @ zero + by_length * L.

    constant (N, 3) mm, by_zero (N, 3, 3), by_length (N, 3).
    """

    constant: Array
    by_zero: Array
    by_length: Array

    def at(self, zero: Array, length: float) -> Array:
        """X, Y and Z (N, 3) for a datum (3,) and a tool's length, mm."""
        return np.asarray(self.constant + self.by_zero @ zero + length * self.by_length)


def nose_positions(machine: Machine, tip: Array, words: Array) -> NosePositions:
    """Positions of the linear axes for tips (N, 3) in the program's frame, mm, and rotary words (N, 2), degrees."""
    count = len(tip)
    point, by_zero = tip, np.broadcast_to(np.eye(3), (count, 3, 3))
    offset, by_length = np.zeros((count, 3)), np.broadcast_to([0.0, 0.0, -1.0], (count, 3))
    turns = [
        rotation(axis.direction, np.radians(axis.sign * words[:, column])) for column, axis in enumerate(machine.rotary)
    ]
    # The first table axis carries the part; the second head axis carries the spindle.
    for axis, turn in zip(machine.rotary, turns, strict=True):
        if axis.carried_by == "table":
            pivot = np.asarray(axis.pivot_mm)
            point = pivot + np.einsum("nji,nj->ni", turn, point - pivot)
            by_zero = np.einsum("nji,njk->nik", turn, by_zero)
    for axis, turn in zip(reversed(machine.rotary), reversed(turns), strict=True):
        if axis.carried_by == "head":
            pivot = np.asarray(axis.pivot_mm)
            offset = pivot + np.einsum("nij,nj->ni", turn, offset - pivot)
            by_length = np.einsum("nij,nj->ni", turn, by_length)
    return NosePositions(np.asarray(point - offset), np.asarray(by_zero), np.asarray(-by_length))


def up_in_part(machine: Machine, words: Array) -> Array:
    """Machine +Z as the part on the table sees it at rotary words (N, 2) in degrees: unit vectors (N, 3).

    The tool axis differs from it by what the head axes tilt the tool.
    """
    return np.ascontiguousarray(nose_positions(machine, np.zeros((len(words), 3)), words).by_zero[:, 2, :])


def has_head(machine: Machine) -> bool:
    """Whether a head axis tilts the spindle off machine Z."""
    # The second axis always tilts it, and where only one axis is in the head it is that one.
    return any(rotary.carried_by == "head" for rotary in machine.rotary)


def upright_words(machine: Machine, words: Array) -> Array:
    """Rotary words (N, 2) that bring the spindle to machine Z from others, degrees: head axes to 0, table axes stay.

    A head axis next to the machine that runs along Z does not tilt the spindle; it stays as well.

    Raises
    ------
    PostError: a head axis that tilts the spindle has no 0 in its range.
    """
    words = words.copy()
    for column, rotary in enumerate(machine.rotary):
        if rotary.carried_by == "table" or (column == 0 and float(np.hypot(*rotary.direction[:2])) < PARALLEL_SINE):
            continue
        if rotary.range_deg is not None and not rotary.range_deg[0] <= 0.0 <= rotary.range_deg[1]:
            raise PostError(
                f"{machine.name}: rotary {rotary.letter} range_deg",
                f"{list(rotary.range_deg)}",
                "0 within the range of a head axis: the tool is retracted with the spindle upright",
                "Correct the machine file, or choose another machine.",
            )
        words[:, column] = 0.0
    return words


def rotation(direction: Array, angle: Array) -> Array:
    """Rotation matrices (N, 3, 3) about a unit vector (3,) by angles (N,) in radians."""
    x, y, z = direction
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    sine, cosine = np.sin(angle)[:, None, None], np.cos(angle)[:, None, None]
    return np.asarray(np.eye(3) + sine * cross + (1.0 - cosine) * (cross @ cross))
