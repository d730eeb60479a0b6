"""Where the cutter goes: the poses that follow from a program's words, and the moves that do not.

Nothing here belongs to one dialect. A reader turns text into calls of `Recorder`, which keeps the position in the
coordinate system that is active and knows which poses follow from the text.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from math import isnan, nan, pi, sqrt

import numpy as np

from conflank_cli.verification.findings import Finding
from conflank_cli.verification.frames import Frame
from conflank_cli.verification.kinematics import Axes, axis_of, letters_of, reduced_of
from conflank_cli.verification.program import (
    RETRACT_CHECKED,
    CutLabel,
    Event,
    Interpolation,
    Moves,
    Setting,
    StatedRotary,
    ToolCall,
    UnknownMove,
    tilt_axes,
)
from conflank_cli.verification.words import Vector

_Turn = tuple[float, float]
_UNSET, _NO_TURN = (nan,) * 3, (nan,) * 2
_TURN = 2.0 * pi
_UP: Vector = (0.0, 0.0, 1.0)

_VECTOR_TOLERANCE = 1e-3
"""A tool vector whose length is off by more than this is a mistake, not rounding (the control reads 1.8 digits)."""

_SQUARE = 1e-4
"""Most that a tool axis may be off the one that a tilted plane asks for, radians: four decimals of a degree, and the
play of what the axes hold."""


class Recorder:
    """Position, orientation and coordinate system of a program that is being read, and the poses so far.

    A pose follows from the text where X, Y, Z and the orientation have all been programmed while tool centre point
    control is active; where it is not, while all rotary axes stand at zero, so that both are the same, or stand as the
    tilted plane asks. In a program without any rotary word or vector they are taken to stand at zero.
    """

    def __init__(
        self,
        used: set[str],
        vectors: bool,
        stated: tuple[StatedRotary, ...] = (),
        machine: Axes | None = None,
    ) -> None:
        """Begin.

        Parameters
        ----------
        used: rotary letters that occur anywhere in the program.
        vectors: whether axis vectors do.
        stated: rotary axes of the header.
        machine: the rotary axes of the machine that the program is for; where it is not known, they are told from the
            header or from the letters in use.
        """
        self.axes = tilt_axes(used, stated) if machine is None else machine
        self._letters = letters_of(self.axes or "")
        self._reduced = reduced_of(self.axes or "")
        if not used <= set(self._letters):
            self.axes = None
        self.findings: dict[tuple[str, str], Finding] = {}
        self.unknown_moves = 0
        self.cuts: list[CutLabel] = []
        self.tool_calls: list[ToolCall] = []
        self.unknown: list[UnknownMove] = []
        self.events: list[Event] = []
        self.presets: list[Setting] = []
        self.tolerances: list[Setting] = []
        self.sides: list[Setting] = []
        self.tilts: list[Setting] = []
        self.shortest_way = False
        self.unfollowed = ""
        self.spatial = False
        self.feed = nan
        self.spindle = 0.0
        self.coolant = 0
        self.frame = Frame()
        self._tcpm = False
        self._interpolation = Interpolation.AXIS
        self._cut = -1
        self._linear: dict[str, float | None] = {"X": None, "Y": None, "Z": None}
        # An axis that the program never names may not exist; it is taken to stand at zero.
        self._rotary: dict[str, float | None] = {
            letter: None if letter in used or vectors else 0.0 for letter in self._letters
        }
        self._vector: Vector | None = None if used or vectors else _UP
        self._in_plane = False
        self._physical: tuple[Vector, _Turn, Vector] | None = None
        self._retracted = False
        self._across = False
        self._program = ""
        self._called: list[tuple[int, str]] = []
        self._rows: list[tuple[float, ...]] = []

    # --- what is noted ----------------------------------------------------------------------------------------------

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

    def event(self, what: str, block: int) -> None:
        """Note a stop, dwell or the like."""
        self.events.append(Event(len(self._rows), what, block))

    def set(self, settings: list[Setting], value: int | tuple[float, float | None] | str | None, block: int) -> None:
        """Note what holds from now on, in one of the lists of settings."""
        settings.append(Setting(len(self._rows), value, block))

    def _note(self, kind: str, words: Mapping[str, float | None], rapid: bool, block: int) -> None:
        self.unknown.append(UnknownMove(len(self._rows), kind, dict(words), rapid, block, self._program))

    # --- state ------------------------------------------------------------------------------------------------------

    @property
    def controlled(self) -> bool:
        """Whether tool centre point control is active."""
        return self._tcpm

    @property
    def place(self) -> Vector | None:
        """Programmed X, Y and Z of the present position; None where one is not known."""
        x, y, z = self._linear.values()
        return None if x is None or y is None or z is None else (x, y, z)

    @property
    def stands(self) -> bool:
        """Whether the present pose is known."""
        return self._physical is not None

    def came_from(self) -> Vector | None:
        """Programmed X, Y and Z before the last move, where that was a straight one at feed in this system."""
        if len(self._rows) < 2 or self._physical is None:
            return None
        row, before = self._rows[-1], self._rows[-2]
        joined, rapid = row[13], row[9]
        return self.frame.coordinates((before[0], before[1], before[2])) if joined and not rapid else None

    def call_tool(self, number: int | None, name: str | None, block: int) -> None:
        """Change the tool; where the new one stands is not known, and its spindle does not turn yet."""
        if self._tcpm:
            self.find("CF113", "tool called while tool centre point control is active", block)
        self._note("tool", {}, False, block)
        self.tool_calls.append(ToolCall(number, name, block))
        self._cut = -1
        self.spindle = 0.0
        self._lose()
        self._retracted = True

    def control(self, active: bool, interpolation: Interpolation = Interpolation.AXIS) -> None:
        """Switch tool centre point control. Coordinates carry over only where all rotary axes stand at zero."""
        if active != self._tcpm and not self._upright():
            self._linear = {"X": None, "Y": None, "Z": None}
        self._tcpm = active
        self._interpolation = interpolation
        if not active and self._vector is not None and not self._rotary:
            self._vector = self._vector if self._vector == _UP else None

    def change_frame(self, frame: Frame) -> None:
        """Another coordinate system; the cutter stays where it is."""
        if frame == self.frame:
            return
        old, self.frame = self.frame, frame
        if old.only_shifted and frame.only_shifted:
            for letter, before, after in zip("XYZ", old.shift, frame.shift, strict=True):
                value = self._linear[letter]
                self._linear[letter] = None if value is None else value + before - after
            return
        if old.tilt != frame.tilt:
            self._in_plane = False
        known = self.place
        self._linear = {"X": None, "Y": None, "Z": None}
        if known is not None and old.tilt == frame.tilt:
            self._linear = dict(zip("XYZ", frame.coordinates(old.point(*known)), strict=True))

    def lose_place(self, block: int) -> None:
        """The coordinate system now hangs on something that the text does not tell; so does the position in it."""
        self._note("lost", {}, True, block)
        self._lose()

    def turn_into_plane(self, rapid: bool, block: int) -> None:
        """The control turns the rotary axes as the tilted plane asks; X, Y and Z are not known after it."""
        self._note("turn", dict.fromkeys(self._letters), rapid, block)
        self._lose()
        self._rotary = dict.fromkeys(self._letters)
        self._vector = None
        self._in_plane = True

    def turn_upright(self, rapid: bool, block: int) -> None:
        """The control turns the rotary axes to zero; X, Y and Z are not known after it."""
        self._note("turn", dict.fromkeys(self._letters, 0.0), rapid, block)
        self._lose()
        self._rotary = dict.fromkeys(self._letters, 0.0)
        self._vector = None if self._letters else _UP

    def _upright(self) -> bool:
        if self._vector is not None:
            return self._vector[2] == 1.0
        return bool(self._rotary) and all(value == 0.0 for value in self._rotary.values())

    def _lose(self) -> None:
        self._linear = {"X": None, "Y": None, "Z": None}
        self._physical = None
        self._across = False

    # --- motion -----------------------------------------------------------------------------------------------------

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
            self._unknown({}, "retract from a pose that is not known", rapid, block)
            return
        self._append_along(length, block, rapid)
        known = self._tcpm or self._upright() or self._in_plane
        point = self._rows[-1]
        self._linear = {"X": None, "Y": None, "Z": None}
        if known:
            self._linear = dict(zip("XYZ", self.frame.coordinates((point[0], point[1], point[2])), strict=True))

    def _append_along(self, length: float, block: int, rapid: bool) -> None:
        assert self._physical is not None
        (x, y, z), rotary, vector = self._physical
        if isnan(vector[0]):
            i, j, k = axis_of(self.axes or "", np.array([rotary]))[0].tolist()
        else:
            i, j, k = vector
        self._append((x + length * i, y + length * j, z + length * k), rotary, vector, rapid, block)

    def machine_move(self, words: Mapping[str, float | None], rapid: bool, block: int, second: bool = False) -> None:
        """A block in machine coordinates (M91; M92 if `second`): where it leads is not known in the part's."""
        self._note("machine 2" if second else "machine", words, rapid, block)
        self.unknown_moves += 1
        self._lose()
        for letter in words:
            if letter in self._rotary:
                self._rotary[letter] = None
                self._vector = None
        if "Z" in words:
            self._retracted = True

    def move(
        self,
        words: Mapping[str, float | None],
        vector: Vector | None,
        rapid: bool,
        block: int,
        plane: Iterable[str] = (),
    ) -> None:
        """A straight move.

        Parameters
        ----------
        words: coordinates by letter in mm or radians, with a leading I for increments; None: value unknown.
        vector: tool axis.
        rapid, block: as they are.
        plane: rotary letters that are brought to where the tilted plane asks for them.
        """
        self._store(words, block)
        if plane and set(plane) >= set(self._letters) and self.frame.tilted:
            self._in_plane = True
        elif any(word[-1] in self._rotary for word in words):
            self._in_plane = self.frame.tilted and self._square_to_plane()
        if vector is not None:
            self._point_along(vector, block)
        reason = self._unfollowed()
        if reason:
            self._physical = None
            self.unknown_moves += 1
            self._note("lost", {}, rapid, block)
            self.find(*reason, block)
            return
        x, y, z = self._linear.values()
        turned = self._rotary_known()
        axis, rotary = self._orientation(turned)
        if x is None or y is None or z is None or axis is None:
            self._off(words, axis, rapid, block)
            return
        point = self.frame.point(x, y, z)
        if self._physical is None and self._across and set(words) == {"Z"}:
            # It comes down from the height at which X and Y were reached.
            away = self._direction(axis, rotary)
            self._append(
                (
                    point[0] + RETRACT_CHECKED * away[0],
                    point[1] + RETRACT_CHECKED * away[1],
                    point[2] + RETRACT_CHECKED * away[2],
                ),
                rotary,
                axis,
                True,
                block,
            )
        self._append(point, rotary, axis, rapid, block)

    def through(self, points: Iterable[tuple[float, float, float]], block: int) -> None:
        """Feed along programmed points (X, Y, Z) with the tool axis as it is, from a pose that is known."""
        assert self._physical is not None
        _, rotary, axis = self._physical
        for x, y, z in points:
            self._append(self.frame.point(x, y, z), rotary, axis, False, block)
            self._linear = {"X": x, "Y": y, "Z": z}

    def cut_short(self, point: tuple[float, float, float]) -> None:
        """End the last move earlier, at a programmed point on its way."""
        row = self._rows[-1]
        place = self.frame.point(*point)
        self._rows[-1] = (*place, *row[3:])
        assert self._physical is not None
        self._physical = (place, *self._physical[1:])
        self._linear = dict(zip("XYZ", point, strict=True))

    def _store(self, words: Mapping[str, float | None], block: int) -> None:
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
            elif self.shortest_way and before is not None and letter in self._reduced:
                turn = (value - before + pi) % _TURN - pi
                store[letter] = before + (pi if turn == -pi and value > before else turn)
            else:
                store[letter] = value

    def _unfollowed(self) -> tuple[str, str] | None:
        """Code and text of what makes every move unknown, if there is something."""
        if self.axes is None:
            return "CF108", "move of rotary axes that are not followed: their letters belong to no pair of axes"
        if self.unfollowed:
            return "CF105", f"move under {self.unfollowed}, which is not followed"
        if self._tcpm and not self.frame.only_shifted:
            return "CF105", "move under tool centre point control in a turned coordinate system, which is not followed"
        if self.spatial and self._vector is None and not self._upright():
            return "CF108", "rotary words under AXIS SPAT are spatial angles, which are not followed"
        return None

    def _rotary_known(self) -> _Turn | None:
        values = tuple(self._rotary.values())
        if not values or None in values:
            return None
        first, second = values
        return (first or 0.0, second or 0.0)

    def _orientation(self, turned: _Turn | None) -> tuple[Vector | None, _Turn]:
        """Tool axis and rotary positions as a row has them; None for the axis where it is not known."""
        if self.frame.tilted:
            return (self.frame.tool_axis if self._in_plane else None), _NO_TURN
        if not (self._tcpm or self._upright()):
            return None, _NO_TURN
        if self._vector is not None:
            return self._vector, _NO_TURN
        return (None, _NO_TURN) if turned is None else (_UNSET, turned)

    def _direction(self, axis: Vector, rotary: _Turn) -> Vector:
        if not isnan(axis[0]):
            return axis
        i, j, k = axis_of(self.axes or "", np.array([rotary]))[0].tolist()
        return (i, j, k)

    def _square_to_plane(self) -> bool:
        """Whether the rotary axes stand so that the tool axis is the one that the tilted plane asks for."""
        turned = self._rotary_known()
        if turned is None:
            return False
        axis = axis_of(self.axes or "", np.array([turned]))[0]
        return float(np.linalg.norm(axis - np.array(self.frame.tool_axis))) < _SQUARE

    def _off(self, words: Mapping[str, float | None], axis: Vector | None, rapid: bool, block: int) -> None:
        """A move whose pose is not known."""
        turns = {word[-1]: self._rotary.get(word[-1]) for word in words if word[-1] in self._rotary}
        x, y, _ = self._linear.values()
        upright = axis is not None and (not self._tcpm or self._upright())
        across = upright and rapid and x is not None and y is not None and set(words) <= {"X", "Y"}
        kind = "turn" if turns and len(turns) == len(words) and not self._tcpm else "across" if across else "lost"
        self._unknown(
            turns if kind == "turn" else words if across else {},
            "the pose does not follow from the text (no tool centre point control, or no retract)",
            rapid,
            block,
            kind,
        )
        self._across = across and self._retracted

    def _unknown(
        self, words: Mapping[str, float | None], text: str, rapid: bool, block: int, kind: str = "lost"
    ) -> None:
        self._note(kind, words, rapid, block)
        self._physical = None
        self.unknown_moves += 1
        if kind == "turn":
            # Where the machine is known it has a way; whether it has is judged with the machine's data.
            return
        if not rapid:
            self.find("CF105", f"feed move: {text}", block)
        elif not self._retracted:
            self.find("CF105", text, block)

    def _point_along(self, vector: Vector, block: int) -> None:
        x, y, z = vector
        length = sqrt(x * x + y * y + z * z)
        if abs(length - 1.0) > _VECTOR_TOLERANCE:
            self.find("CF109", f"tool vector of length {length:.4f}", block, "tool vector")
        if not self._tcpm:
            self.find("CF113", "tool vector without M128 or FUNCTION TCPM", block)
        self._vector = (x / length, y / length, z / length) if length > 0.0 else None
        self._rotary.update(dict.fromkeys(self._rotary))

    def _append(self, point: Vector, rotary: _Turn, axis: Vector, rapid: bool, block: int) -> None:
        joined = self._physical is not None
        feed = nan if rapid else self.feed
        if not rapid and feed != feed:
            self.find("CF112", "cutting move without a feed", block)
        tool = len(self.tool_calls) - 1
        self._rows.append(
            (
                *point, *rotary, *axis, feed, rapid, block, self._cut, tool, joined, self._interpolation, self.spindle,
                self.coolant,
            )
        )  # fmt: skip
        self._physical = (point, rotary, axis)
        self._retracted = False
        self._across = False

    def moves(self) -> Moves:
        """The poses so far."""
        table = np.array(self._rows, dtype=np.float64).reshape(len(self._rows), 17)
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
            spindle=table[:, 15].copy(),
            coolant=table[:, 16].astype(np.int64),
            called=tuple(self._called),
        )
