"""A program as the verification sees it: what it states about itself, and the poses it moves through.

Nothing here belongs to one dialect of programs.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np
import numpy.typing as npt

from conflank_cli.verification.findings import Finding
from conflank_cli.verification.kinematics import CAD_FRAME, Axes, Frame, StatedAxes, letters_of
from conflank_cli.verification.numbers import NUMBER, number

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]

RETRACT_CHECKED = 200.0
"""A retract to the machine's limit has no length in the text; this much of it is checked, mm."""


class Interpolation(IntEnum):
    """How a control is asked to move the axis between two blocks; the tip moves straight in either."""

    VECTOR = 0
    AXIS = 1


@dataclass(frozen=True, slots=True)
class StatedTool:
    """A cutter as the program's header states it, mm."""

    number: int
    name: str
    r_min: float
    r_max: float
    length: float


@dataclass(frozen=True, slots=True)
class StatedRotary:
    """A rotary axis as the program's header states it: its letter, and the direction it turns the tool about."""

    letter: str
    direction: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Header:
    """What the comments of a program state, one fact a line; None or empty where they are silent."""

    part: str | None = None
    faces: tuple[int, ...] = ()
    tools: tuple[StatedTool, ...] = ()
    reference: str | None = None
    machine: str | None = None
    style: str | None = None
    frame: Frame | None = None
    rotary: tuple[StatedRotary, ...] = ()


@dataclass(frozen=True, slots=True)
class CutLabel:
    """A stretch as the program labels it: "sweep" or "pass" opens a cut, "approach", "retract" or "link" closes it."""

    kind: str
    number: int


@dataclass(frozen=True, slots=True)
class Moves:
    """Poses in program order; N of them.

    Attributes
    ----------
    point: programmed point, (N, 3) mm, in the program's frame.
    rotary: positions of the two rotary axes, (N, 2) radians, unwrapped; NaN where the axis is given as a vector.
    vector: axis vector, (N, 3), unit; NaN where it is given by rotary axes.
    feed: feed into the pose, (N,) mm/min; NaN where unknown or rapid.
    rapid: (N,) whether the pose is reached at rapid.
    block: (N,) block number.
    cut: (N,) index into the program's cuts, -1 outside.
    tool: (N,) index into the program's tool calls, -1 before the first.
    joined: (N,) whether the move into the pose starts at the pose before; otherwise the way there is not known.
    interpolation: (N,) the `Interpolation` that is active.
    spindle: (N,) speed on the way into the pose, 1/min: > 0 clockwise (M3), < 0 counter-clockwise (M4), 0 off; NaN
        where it turns at a speed that is not known.
    coolant: (N,) number of the M function that has the coolant on, 7 or 8; 0 off.
    called: first move and name of every stretch of moves that stands in a called program ("" in the first one).
    """

    point: Array
    rotary: Array
    vector: Array
    feed: Array
    rapid: Flags
    block: Integers
    cut: Integers
    tool: Integers
    joined: Flags
    interpolation: Integers
    spindle: Array
    coolant: Integers
    called: tuple[tuple[int, str], ...] = ()

    def program(self, move: int) -> str | None:
        """Name of the called program that a move stands in; None in the first one."""
        name = ""
        for first, called in self.called:
            if first <= move:
                name = called
        return name or None


@dataclass(frozen=True, slots=True)
class Event:
    """Something that happens between two poses and is harmless off the part only.

    Attributes
    ----------
    before: index of the first pose (row of `Moves`) that comes after it.
    what: a stop, a dwell, or what else it is, for messages.
    block: block number.
    """

    before: int
    what: str
    block: int


@dataclass(frozen=True, slots=True)
class Setting:
    """What holds from a block on.

    Attributes
    ----------
    before: index of the first pose (row of `Moves`) that comes after it.
    value: the number of the preset; T (mm) and TA (degrees) of the tolerance cycle, None where it is as the builder
        set it; the side of the radius compensation; whether the working plane is tilted.
    block: block number.
    """

    before: int
    value: int | tuple[float, float | None] | str | None
    block: int


@dataclass(frozen=True, slots=True)
class ToolCall:
    """A tool that the program calls, by number or name."""

    number: int | None
    name: str | None
    block: int


@dataclass(frozen=True, slots=True)
class UnknownMove:
    """A move whose way does not follow from the text alone; the machine's data may tell more.

    Attributes
    ----------
    before: index of the first known pose (row of `Moves`) that comes after it.
    kind: "tool" (a tool change), "limit" (M140 MB MAX: along the tool axis to the limit of the machine), "machine" and
        "machine 2" (M91, M92: coordinates of the machine), "turn" (rotary axes without tool centre point control; X, Y
        and Z stand), "across" (X and Y across the tool axis, at a height that is not known), or "lost" (anything else
        after which the position is not known).
    words: axis words by letter in mm or radians, None where the value is not known; machine coordinates for "machine"
        and "machine 2", positions of rotary axes for "turn".
    rapid: whether it is a rapid.
    block: block number.
    program: the called program that it stands in, "" in the first one.
    """

    before: int
    kind: str
    words: Mapping[str, float | None]
    rapid: bool
    block: int
    program: str = ""


@dataclass(frozen=True, slots=True)
class CalledProgram:
    """A called program: the file's name, and its text."""

    name: str
    text: str


@dataclass(frozen=True, slots=True)
class Program:
    """A program that has been read.

    Attributes
    ----------
    name: name it gives itself, or "".
    header: what its comments state.
    moves: the poses that follow from the text.
    cuts: the labels `moves.cut` points to.
    tool_calls: the tools `moves.tool` points to.
    letters: the rotary axes in use, e.g. "AC", with their directions where the header states them; "" where it names
        none.
    tolerance: last T (mm) and TA (degrees, None where not given) of the control's tolerance cycle, or None.
    unknown_moves: moves after a retract whose poses the text does not tell.
    findings: what is wrong or unknown.
    called: the programs it calls that were followed.
    unknown: the moves whose way does not follow from the text alone, in program order.
    events: stops, dwells and the like.
    presets, tolerances, sides, tilts: what cycle 247, cycle 32, RL or RR, and cycle 19 or PLANE have set, in program
        order; of a tilt whether there is one.
    control: whether it is written for the control; APT data is not.
    """

    name: str
    header: Header
    moves: Moves
    cuts: tuple[CutLabel, ...]
    tool_calls: tuple[ToolCall, ...]
    letters: Axes
    tolerance: tuple[float, float | None] | None
    unknown_moves: int
    findings: tuple[Finding, ...]
    called: tuple[CalledProgram, ...] = ()
    unknown: tuple[UnknownMove, ...] = ()
    events: tuple[Event, ...] = ()
    presets: tuple[Setting, ...] = ()
    tolerances: tuple[Setting, ...] = ()
    sides: tuple[Setting, ...] = ()
    tilts: tuple[Setting, ...] = ()
    control: bool = True

    @property
    def rotary_letters(self) -> str:
        """Letters of the columns of `moves.rotary`."""
        return letters_of(self.letters)


@dataclass(slots=True)
class HeaderReader:
    """Collects the header's facts from comments, whatever the dialect wraps them in."""

    part: str | None = None
    faces: tuple[int, ...] = ()
    tools: list[StatedTool] = field(default_factory=list)
    reference: str | None = None
    machine: str | None = None
    style: str | None = None
    frame: Frame | None = None
    rotary: list[StatedRotary] = field(default_factory=list)

    def read(self, comment: str) -> CutLabel | None:
        """Take in one comment; returns the label if it is one."""
        text = comment.strip()
        if found := re.fullmatch(r"(SWEEP|PASS|APPROACH|RETRACT|LINK)\s+(\d+)\b.*", text):
            return CutLabel(found[1].lower(), int(found[2]))
        if found := re.fullmatch(r"PART\s+(.*?)\s+FACE\s+([\d\s,]+)", text):
            # A long list of faces takes several lines.
            # A called program states the same again.
            faces = dict.fromkeys([*self.faces, *(int(item) for item in re.findall(r"\d+", found[2]))])
            self.part, self.faces = found[1], tuple(faces)
        elif found := re.fullmatch(
            rf"TOOL\s+(\d+)\s+(.*?)\s*R_MIN\s+({NUMBER})\s+R_MAX\s+({NUMBER})\s+LENGTH\s+({NUMBER})\b.*", text
        ):
            tool = StatedTool(int(found[1]), found[2], *(number(found[k]) for k in (3, 4, 5)))
            if tool not in self.tools:
                self.tools.append(tool)
        elif found := re.fullmatch(r"REFERENCE\s+(TIP|SPHERE CENTRE)", text):
            self.reference = found[1]
        elif found := re.fullmatch(r"MACHINE\s+(\S.*)", text):
            self.machine = found[1]
        elif found := re.fullmatch(r"STYLE\s+(\S.*)", text):
            self.style = found[1]
        elif re.fullmatch(r"FRAME\s+CAD", text):
            self.frame = CAD_FRAME
        elif found := re.fullmatch(rf"FRAME\s+ROTATE((?:\s+{NUMBER}){{3}})\s+TRANSLATE((?:\s+{NUMBER}){{3}})", text):
            turn, shift = ([number(item) for item in found[k].split()] for k in (1, 2))
            self.frame = Frame((turn[0], turn[1], turn[2]), (shift[0], shift[1], shift[2]))
        elif found := re.fullmatch(rf"ROTARY\s+([ABC])((?:\s+{NUMBER}){{3}})", text):
            x, y, z = (number(item) for item in found[2].split())
            rotary = StatedRotary(found[1], (x, y, z))
            if rotary not in self.rotary:
                self.rotary.append(rotary)
        return None

    def header(self) -> Header:
        """The facts so far."""
        return Header(
            self.part,
            self.faces,
            tuple(self.tools),
            self.reference,
            self.machine,
            self.style,
            self.frame,
            tuple(self.rotary),
        )


def tilt_axes(letters: set[str], stated: tuple[StatedRotary, ...] = ()) -> Axes | None:
    """The pair of rotary axes that moves; None where it is not known.

    Two axes that the header states, in the order of t = R(first) R(second) z, or else the pair named from the letters a
    program uses. A single letter belongs to the table pair it is usual in: A or C to A/C, B to B/C.
    """
    if stated:
        names = "".join(rotary.letter for rotary in stated)
        if len(stated) != 2 or len(set(names)) != 2 or not letters <= set(names):
            return None
        return StatedAxes(names, stated[0].direction, stated[1].direction)
    if letters <= {"A", "C"}:
        return "AC" if letters else ""
    if letters <= {"B", "C"}:
        return "BC"
    if letters <= {"A", "B"}:
        return "AB"
    return None
