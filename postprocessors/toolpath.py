"""The neutral tool path that every post consumes: tip points, axis vectors, feeds, and what each stretch is for.

Coordinates are those of the program (the frame on the machine table), mm.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Literal

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


class Purpose(Enum):
    """What a stretch of the path does."""

    SWEEP = "sweep"
    PASS = "pass"
    APPROACH = "approach"
    RETRACT = "retract"
    LINK = "link"
    UPRIGHT = "upright"


@dataclass(frozen=True, slots=True)
class Cutter:
    """What a post needs to know of a tool: its number, name and cutting data, and the cone for the header (mm)."""

    number: int
    name: str
    r_min: float
    r_max: float
    length: float
    spindle_rpm: float


@dataclass(frozen=True, slots=True)
class Stretch:
    """A run of poses with the tool centre point control active.

    Attributes
    ----------
    purpose: what it does.
    cut: number of the sweep or pass it belongs to, from 1.
    tip: tip points, shape (N, 3), mm.
    axis: unit vectors from tip to spindle, shape (N, 3).
    feed: feed into each pose, shape (N,), mm/min of the tip point; 0 means rapid.
    material: of a sweep, the side of the feed ("left" or "right", seen from the spindle) on which it lies; "" where
        nobody says, or where the ball cuts.
    """

    purpose: Purpose
    cut: int
    tip: Array
    axis: Array
    feed: Array
    material: Literal["", "left", "right"] = ""


@dataclass(frozen=True, slots=True)
class Operation:
    """One tool and what it cuts, in order: each sweep or pass is APPROACH, SWEEP or PASS, RETRACT.

    A cut that has to be left on the way, so that a rotary axis can unwind, is several such visits with the same number.
    A LINK leads from the retract before it to the approach after it, whose cut's number it has, without a full retract.
    On a machine whose head tilts the tool a RETRACT that ends a visit is followed by UPRIGHT: one pose, the tip at
    rest, with the head axes at zero and the table axes as before, so that a retract along the tool axis is along Z.
    """

    cutter: Cutter
    stretches: tuple[Stretch, ...]


def visits(operation: Operation) -> list[tuple[Stretch, ...]]:
    """The stretches from each approach to its retract: what the tool does between two full retracts."""
    found: list[list[Stretch]] = []
    for stretch in operation.stretches:
        last = found[-1][-1] if found else None
        goes_on = stretch.purpose in (Purpose.LINK, Purpose.UPRIGHT)
        left = last is None or last.purpose in (Purpose.RETRACT, Purpose.UPRIGHT) or last.cut != stretch.cut
        if last is None or (left and not goes_on):
            found.append([])
        found[-1].append(stretch)
    return [tuple(stretches) for stretches in found]


@dataclass(frozen=True, slots=True)
class ToolPath:
    """A whole program.

    Attributes
    ----------
    name: program name on the control.
    part: part name for the header.
    faces: face numbers for the header.
    frame: "CAD", or "ROTATE a b c TRANSLATE x y z", as the header states it.
    blank_low, blank_high: corners of the blank for the control's graphics, mm.
    operations: in the order they run.
    """

    name: str
    part: str
    faces: tuple[int, ...]
    frame: str
    blank_low: tuple[float, float, float]
    blank_high: tuple[float, float, float]
    operations: tuple[Operation, ...]
