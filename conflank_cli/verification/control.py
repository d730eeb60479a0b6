"""What a HEIDENHAIN control makes of its blocks, in whichever of its languages they are written.

Source: HEIDENHAIN iTNC 530 user's manuals, conversational (340 49x) and DIN/ISO programming.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from conflank_cli.verification.program import (
    NUMBER,
    CalledProgram,
    CutLabel,
    HeaderReader,
    Interpolation,
    Program,
    Recorder,
    Vector,
    number,
)
from conflank_cli.verification.words import INCH, ROTARY, Words

_HARMLESS = {
    0,
    1,
    3,
    4,
    5,
    7,
    8,
    9,
    13,
    14,
    2,
    30,
    90,
    94,
    97,
    107,
    108,
    116,
    117,
    126,
    127,
    134,
    135,
    136,
    137,
    148,
    149,
}
"""M functions that change neither where the cutter goes nor how fast the text says it does (beyond stops)."""

DEEPEST = 20
"""Levels of calls; the control allows fewer."""
MOST_BLOCKS = 20_000_000
"""Blocks that are followed, repetitions counted."""


@dataclass(frozen=True, slots=True)
class Block:
    """One block: its number (or line), its text without comments, its comments, and whether it is skippable."""

    number: int
    text: str
    comments: tuple[str, ...]
    skippable: bool


@dataclass(frozen=True, slots=True)
class Jump:
    """A block that steers the program.

    "label"; "call" of one, with `repeat` if it repeats what lies between; "end" (M2, M30); "last", after which no block
    comes.
    """

    kind: str
    name: str = ""
    repeat: int | None = None


class Control:
    """The state of the control while a program is read, beyond that of the recorder."""

    def __init__(self, header: HeaderReader, recorder: Recorder) -> None:
        self.header = header
        self.recorder = recorder
        self.unit = 1.0
        self.name = ""
        self.shift = {"X": 0.0, "Y": 0.0, "Z": 0.0}
        self.preset: int | None = None
        self.side = "R0"
        self.delta = False

    @property
    def feed_unit(self) -> float:
        """Feeds of inch programs are in tenths of an inch a minute."""
        return 1.0 if self.unit == 1.0 else INCH / 10.0

    def running_through(self, flow: Flow) -> Iterator[Block]:
        """Blocks to follow, in the order they run; comments are read on the way."""
        while (block := flow.next(self.recorder)) is not None:
            if block.comments:
                self.comments(block)
            if not block.text:
                continue
            if block.skippable:
                self.recorder.find("CF102", "skippable block: read as if it were run", block.number)
            yield block

    def comments(self, block: Block) -> None:
        """Labels of cuts; the header's facts have been read before."""
        for comment in block.comments:
            label = HeaderReader().read(comment)
            if isinstance(label, CutLabel):
                self.recorder.label(label)

    def set_preset(self, text: str, block: int) -> None:
        """Cycle 247."""
        preset = re.search(rf"Q339\s*=\s*({NUMBER})", text)
        chosen = int(number(preset[1])) if preset else None
        if self.preset is not None and chosen != self.preset:
            self.recorder.find("CF104", "more than one preset: the header states one frame", block)
        self.preset = chosen

    def shift_datum(self, words: Words, block: int) -> None:
        """Cycle 7."""
        for word, value in words.axes.items():
            if word[-1] in ROTARY or value is None:
                if value != 0.0:
                    self.recorder.find("CF102", f"datum shift in {word} is not followed", block)
                    self.recorder.foreign_frame = "a datum shift"
                continue
            self.shift[word[-1]] = value + (self.shift[word[-1]] if word[0] == "I" else 0.0)
        if words.rest:
            self.recorder.find("CF102", f"datum shift by {words.rest} is not followed", block)
            self.recorder.foreign_frame = "a datum shift from a table"

    def transform(self, what: str, neutral: bool, block: int) -> None:
        """A frame that is not followed, or its end."""
        self.recorder.foreign_frame = "" if neutral else what.partition(" (")[0]
        if not neutral:
            self.recorder.find("CF102", f"{what} is not followed", block)

    def plain(self, axes: dict[str, float | None], vector: Vector | None, rapid: bool, block: int) -> None:
        """A motion block of the usual words only."""
        if any(self.shift.values()):
            axes = self._shifted(axes)
        if self.side != "R0":
            self._check_side(block)
        self.recorder.move(axes, vector, rapid, block)

    def _shifted(self, axes: dict[str, float | None]) -> dict[str, float | None]:
        return {
            word: value + self.shift[word] if value is not None and word in self.shift else value
            for word, value in axes.items()
        }

    def _check_side(self, block: int) -> None:
        find = self.recorder.find
        if self.delta:
            find("CF102", "radius delta DR with RL or RR moves the path; that is not followed", block)
        if not self.recorder.controlled:
            find("CF102", f"radius compensation {self.side} is not followed", block, "radius compensation")

    def motion(self, words: Words, vectors: bool, rapid: bool, block: int) -> None:
        """A block of motion words, M functions or both; `vectors`: whether tool vectors may stand in it."""
        recorder = self.recorder
        if words.rest:
            recorder.find("CF101", f"words not understood: {words.rest[:60]}", block)
        functions = words.functions
        for function in functions:
            if function == 126:
                recorder.shortest_way = True
            elif function == 127:
                recorder.shortest_way = False
            elif function not in _HARMLESS | {91, 92, 128, 129, 140}:
                recorder.find("CF102", f"M{function} is not followed", block)
        if 128 in functions:
            recorder.control(True, Interpolation.AXIS)
        rapid = rapid or words.feed == "MAX"
        if words.feed is not None and words.feed != "MAX":
            if re.fullmatch(NUMBER, words.feed):
                recorder.feed = number(words.feed) * self.feed_unit
            elif words.feed != "AUTO":
                recorder.feed = float("nan")
                recorder.find("CF102", "feed from a Q parameter is not followed", block)
        self.side = words.side or self.side
        if self.side != "R0":
            self._check_side(block)
        if any(value is None for value in words.axes.values()):
            recorder.find("CF102", "coordinate from a Q parameter is not followed", block)
        if 91 in functions or 92 in functions:
            if recorder.controlled:
                recorder.find("CF113", "machine coordinates while tool centre point control is active", block)
            if self.header.machine is None:
                recorder.find("CF106", "M91 or M92 without a machine in the header", block)
            recorder.machine_move(words.axes, rapid, block, 92 in functions)
        elif words.axes or words.vector:
            vector = None
            if words.vector:
                if not vectors or set(words.vector) != set("XYZ"):
                    recorder.find("CF101", "tool vector needs LN and all of TX TY TZ", block)
                x, y, z = (words.vector.get(letter, 0.0) for letter in "XYZ")
                vector = (x, y, z)
            recorder.move(self._shifted(words.axes), vector, rapid, block)
        if 140 in functions:
            if words.back is None or words.back == "MAX":
                recorder.to_limit(block)
            else:
                recorder.retract(number(words.back) * self.unit, rapid, block)
        if 129 in functions:
            recorder.control(False)

    def result(self, called: Iterable[CalledProgram] = ()) -> Program:
        """What has been read."""
        recorder = self.recorder
        return Program(
            name=self.name,
            header=self.header.header(),
            moves=recorder.moves(),
            cuts=tuple(recorder.cuts),
            tool_calls=tuple(recorder.tool_calls),
            letters="" if recorder.axes is None else recorder.axes,
            tolerance=recorder.tolerance,
            unknown_moves=recorder.unknown_moves,
            findings=tuple(recorder.findings.values()),
            called=tuple(called),
            unknown=tuple(recorder.unknown),
        )


class Flow:
    """The order in which the blocks of one program are run: labels, calls of subprograms, repetitions.

    A subprogram stands between its label and the next label 0. A call without repetitions runs it; a call with n
    repetitions runs what lies between the label and the call n times more.
    """

    def __init__(self, blocks: list[Block], jumps: dict[int, Jump]) -> None:
        """Take the blocks, and those among them that steer, by their index."""
        self._blocks = blocks
        self._jumps = jumps
        self._labels: dict[str, int] = {}
        for index, jump in jumps.items():
            if jump.kind == "label" and jump.name != "0":
                self._labels.setdefault(jump.name, index)
        self._place = 0
        self._count = 0
        self._returns: list[int] = []
        self._left: dict[int, int] = {}
        self.ended: int | None = None
        """The block with M2 or M30 that has ended the program."""

    def next(self, recorder: Recorder) -> Block | None:
        """The next block that does not steer; None at the end."""
        while self._place < len(self._blocks):
            index = self._place
            self._place += 1
            self._count += 1
            jump = self._jumps.get(index)
            block = self._blocks[index]
            if self._count > MOST_BLOCKS:
                recorder.find("CF102", f"repetitions beyond {MOST_BLOCKS:,} blocks are not followed", block.number)
                return None
            if jump is None:
                return block
            if jump.kind == "end":
                if self._returns:
                    recorder.find("CF109", "the program ends within a subprogram", block.number)
                self.ended = block.number
                self._place = len(self._blocks)
                return block
            self._steer(index, jump, block.number, recorder)
        return None

    def _steer(self, index: int, jump: Jump, block: int, recorder: Recorder) -> None:
        if jump.kind == "last":
            if self._returns:
                recorder.find("CF109", "a subprogram without LBL 0 (G98 L0) at its end", block)
            self._place = len(self._blocks)
        elif jump.kind == "label":
            if jump.name == "0" and self._returns:
                self._place = self._returns.pop()
        elif jump.name not in self._labels:
            recorder.find("CF109", f"label {jump.name} is not in the program", block)
        elif jump.repeat is None:
            if len(self._returns) >= DEEPEST:
                recorder.find("CF102", f"calls more than {DEEPEST} deep are not followed", block)
            else:
                self._returns.append(self._place)
                self._place = self._labels[jump.name] + 1
        elif self._labels[jump.name] > index:
            recorder.find("CF109", f"label {jump.name} to be repeated comes later", block)
        else:
            left = self._left.get(index, jump.repeat)
            if left > 0:
                self._left[index] = left - 1
                self._place = self._labels[jump.name] + 1
            else:
                # The next time round the repetitions count anew.
                self._left.pop(index, None)
