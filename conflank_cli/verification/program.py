"""A program as the verification sees it: what it states about itself, and the poses it moves through.

Nothing here belongs to one dialect. A reader turns text into calls of `Recorder`, which keeps the modal state of the
control and knows which poses follow from the text and which do not.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from math import isnan, pi, sqrt

import numpy as np
import numpy.typing as npt

from conflank_cli.verification.findings import Finding
from conflank_cli.verification.kinematics import CAD_FRAME, Axes, Frame, StatedAxes, axis_of, letters_of

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]

RETRACT_CHECKED = 200.0
"""A retract to the machine's limit has no length in the text; this much of it is checked, mm."""

_VECTOR_TOLERANCE = 1e-3
"""A tool vector whose length is off by more than this is a mistake, not rounding (the control reads 1.8 digits)."""


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
    called: tuple[tuple[int, str], ...] = ()

    def program(self, move: int) -> str | None:
        """Name of the called program that a move stands in; None in the first one."""
        name = ""
        for first, called in self.called:
            if first <= move:
                name = called
        return name or None


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
    kind: "tool" (tool change), "limit" (M140 MB MAX: along the tool axis to the limit of the machine), "machine" and
        "machine 2" (M91, M92: coordinates of the machine), "turn" (rotary axes without tool centre point control; X, Y
        and Z stand), or "lost" (anything else after which the position is not known).
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

    @property
    def rotary_letters(self) -> str:
        """Letters of the columns of `moves.rotary`."""
        return letters_of(self.letters)


NUMBER = r"[+-]?(?:\d+(?:[.,]\d*)?|[.,]\d+)"
"""A number with decimal point or comma, as a regular expression."""


def number(text: str) -> float:
    """A number with decimal point or comma."""
    return float(text.replace(",", "."))


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


Vector = tuple[float, float, float]
_Place = tuple[float, float, float]
_Turn = tuple[float, float]
_UNSET, _NO_TURN = (float("nan"),) * 3, (float("nan"),) * 2
_TURN = 2.0 * pi


class Recorder:
    """Modal state of a control, and the poses that follow from it.

    A pose follows from the text where X, Y, Z and the orientation have all been programmed while tool centre point
    control is active, or where it is not but all rotary axes stand at zero, so that both are the same. In a program
    without any rotary word or vector they are taken to stand at zero.
    """

    def __init__(self, used: set[str], vectors: bool, stated: tuple[StatedRotary, ...] = ()) -> None:
        """Begin.

        Parameters
        ----------
        used: rotary letters that occur anywhere in the program.
        vectors: whether axis vectors do.
        stated: rotary axes of the header.
        """
        self.axes = tilt_axes(used, stated)
        self.findings: dict[tuple[str, str], Finding] = {}
        self.unknown_moves = 0
        self.cuts: list[CutLabel] = []
        self.tool_calls: list[ToolCall] = []
        self.tolerance: tuple[float, float | None] | None = None
        self.shortest_way = False
        self.foreign_frame = ""
        self.spatial = False
        self.feed = float("nan")
        self._tcpm = False
        self._interpolation = Interpolation.AXIS
        self._cut = -1
        self._linear: dict[str, float | None] = {"X": None, "Y": None, "Z": None}
        self._letters = letters_of(self.axes or "")
        # An axis that the program never names may not exist; it is taken to stand at zero.
        self._rotary: dict[str, float | None] = {
            letter: None if letter in used or vectors else 0.0 for letter in self._letters
        }
        self._vector: Vector | None = None if used or vectors else (0.0, 0.0, 1.0)
        self._physical: tuple[_Place, _Turn, Vector] | None = None
        self._retracted = False
        self._program = ""
        self._called: list[tuple[int, str]] = []
        self._rows: list[tuple[float, ...]] = []
        self.unknown: list[UnknownMove] = []

    def enter(self, program: str) -> None:
        """What follows stands in a called program; "" for the first one."""
        if program != self._program:
            self._program = program
            self._called.append((len(self._rows), program))

    def find(self, code: str, text: str, block: int, key: str | None = None) -> None:
        """Note a finding; the same thing again only counts."""
        key = f"{self._program} {key or text}"
        again = self.findings.get((code, key))
        if again is None:
            self.findings[code, key] = Finding(code, text + (f", in {self._program}" * bool(self._program)), block)
        else:
            self.findings[code, key] = Finding(code, again.text, again.block, count=again.count + 1)

    def label(self, label: CutLabel) -> None:
        """Open a sweep or pass, or close it; the same sweep opened again is still the same cut."""
        if label.kind not in ("sweep", "pass"):
            self._cut = -1
            return
        if label not in self.cuts:
            self.cuts.append(label)
        self._cut = self.cuts.index(label)

    def call_tool(self, number: int | None, name: str | None, block: int) -> None:
        """Change the tool; where the new one stands is not known."""
        if self._tcpm:
            self.find("CF113", "tool called while tool centre point control is active", block)
        self.tool_calls.append(ToolCall(number, name, block))
        self._note("tool", {}, True, block)
        self._cut = -1
        self._physical = None
        self._retracted = True

    def control(self, active: bool, interpolation: Interpolation = Interpolation.AXIS) -> None:
        """Switch tool centre point control. Coordinates carry over only where all rotary axes stand at zero."""
        if active != self._tcpm and not self._upright():
            self._linear = {"X": None, "Y": None, "Z": None}
        self._tcpm = active
        self._interpolation = interpolation
        if not active and self._vector is not None and not self._rotary:
            self._vector = self._vector if self._vector[2] == 1.0 else None

    @property
    def controlled(self) -> bool:
        """Whether tool centre point control is active."""
        return self._tcpm

    def _upright(self) -> bool:
        if self._vector is not None:
            return self._vector[2] == 1.0
        return bool(self._rotary) and all(value == 0.0 for value in self._rotary.values())

    def to_limit(self, block: int) -> None:
        """Retract along the tool axis to the limit of the machine."""
        if self._physical is not None:
            self._append_along(RETRACT_CHECKED, block, True)
        self._note("limit", {}, True, block)
        self._lose()
        self._retracted = True

    def retract(self, length: float, rapid: bool, block: int) -> None:
        """Retract along the tool axis by a length in mm."""
        if self._physical is None:
            self._unknown("retract from a pose that is not known", block)
            return
        self._append_along(length, block, rapid)
        point = self._rows[-1]
        if self._tcpm or self._upright():
            self._linear = {letter: point[k] for k, letter in enumerate("XYZ")}
        else:
            self._linear = {"X": None, "Y": None, "Z": None}

    def _append_along(self, length: float, block: int, rapid: bool) -> None:
        assert self._physical is not None
        (x, y, z), rotary, vector = self._physical
        if isnan(vector[0]):
            i, j, k = axis_of(self.axes or "", np.array([rotary]))[0].tolist()
        else:
            i, j, k = vector
        self._append((x + length * i, y + length * j, z + length * k), rotary, vector, rapid, block)

    def _note(self, kind: str, words: Mapping[str, float | None], rapid: bool, block: int) -> None:
        self.unknown.append(UnknownMove(len(self._rows), kind, dict(words), rapid, block, self._program))

    def machine_move(self, words: Mapping[str, float | None], rapid: bool, block: int, second: bool = False) -> None:
        """A block in machine coordinates (M91; M92 if `second`): where it leads is not known in the part's."""
        self._note("machine 2" if second else "machine", words, rapid, block)
        self.unknown_moves += 1
        self._lose()
        for letter in words:
            if letter in self._rotary:
                self._rotary[letter] = None
        if "Z" in words:
            self._retracted = True
        elif not self._retracted:
            self._unknown("move in machine coordinates without a retract before it", block)

    def _lose(self) -> None:
        self._linear = {"X": None, "Y": None, "Z": None}
        self._physical = None

    def _unknown(self, text: str, block: int) -> None:
        self._physical = None
        self.unknown_moves += 1
        if not self._retracted:
            self.find("CF105", text, block)

    def move(
        self,
        words: Mapping[str, float | None],
        vector: Vector | None,
        rapid: bool,
        block: int,
    ) -> None:
        """A straight move. Words by letter in mm or radians, with a leading I for increments; None: value unknown."""
        linear, rotary = self._linear, self._rotary
        for word, value in words.items():
            letter = word[-1]
            if letter in linear:
                store = linear
            elif letter in rotary:
                store = rotary
                self._vector = None
            else:
                continue
            before = store[letter]
            if value is None:
                store[letter] = None
            elif word[0] == "I":
                if before is None:
                    self.find("CF105", f"increment {word} from a position that is not known", block)
                store[letter] = None if before is None else before + value
            elif self.shortest_way and before is not None and store is rotary:
                turn = (value - before + pi) % _TURN - pi
                store[letter] = before + (pi if turn == -pi and value > before else turn)
            else:
                store[letter] = value
        if vector is not None:
            self._point_along(vector, block)
        x, y, z = linear.values()
        if self.axes is None or self.foreign_frame:
            self._note("lost", {}, rapid, block)
            self._physical = None
            self.unknown_moves += 1
            if self.foreign_frame:
                self.find("CF105", f"move under {self.foreign_frame}, which is not followed", block)
            return
        if self.spatial and self._vector is None and not self._upright():
            self._note("lost", {}, rapid, block)
            self._physical = None
            self.find("CF108", "rotary words under AXIS SPAT are spatial angles, which are not followed", block)
            return
        known = self._vector is not None or (bool(rotary) and None not in rotary.values())
        if x is None or y is None or z is None or not known or not (self._tcpm or self._upright()):
            turns = {word[-1]: rotary.get(word[-1]) for word in words if word[-1] in rotary}
            only = len(turns) == len(words) and not self._tcpm and vector is None
            self._note("turn" if only else "lost", turns, rapid, block)
            self._unknown("the pose does not follow from the text (no tool centre point control, or no retract)", block)
            return
        if self._physical is None and not self._retracted:
            self.find("CF105", "the way to the first pose is not known, and no retract comes before it", block)
        if self._vector is not None:
            self._append((x, y, z), _NO_TURN, self._vector, rapid, block)
        else:
            first, second = rotary.values()
            self._append((x, y, z), (first or 0.0, second or 0.0), _UNSET, rapid, block)

    def _point_along(self, vector: Vector, block: int) -> None:
        x, y, z = vector
        length = sqrt(x * x + y * y + z * z)
        if abs(length - 1.0) > _VECTOR_TOLERANCE:
            self.find("CF109", f"tool vector of length {length:.4f}", block, "tool vector")
        if not self._tcpm:
            self.find("CF113", "tool vector without M128 or FUNCTION TCPM", block)
        self._vector = (x / length, y / length, z / length) if length > 0.0 else None
        self._rotary.update(dict.fromkeys(self._rotary))

    def _append(self, point: _Place, rotary: _Turn, axis: Vector, rapid: bool, block: int) -> None:
        joined = self._physical is not None
        feed = float("nan") if rapid else self.feed
        if not rapid and joined and feed != feed:
            self.find("CF112", "cutting move without a feed", block)
        tool = len(self.tool_calls) - 1
        self._rows.append((*point, *rotary, *axis, feed, rapid, block, self._cut, tool, joined, self._interpolation))
        self._physical = (point, rotary, axis)
        self._retracted = False

    def moves(self) -> Moves:
        """The poses so far."""
        table = np.array(self._rows, dtype=np.float64).reshape(len(self._rows), 15)
        return Moves(
            point=np.ascontiguousarray(table[:, 0:3]),
            rotary=np.ascontiguousarray(table[:, 3:5]),
            vector=np.ascontiguousarray(table[:, 5:8]),
            feed=table[:, 8].copy(),
            rapid=table[:, 9] > 0.0,
            block=table[:, 10].astype(np.int64),
            cut=table[:, 11].astype(np.int64),
            tool=table[:, 12].astype(np.int64),
            joined=table[:, 13] > 0.0,
            interpolation=table[:, 14].astype(np.int64),
            called=tuple(self._called),
        )
