"""Reader of DIN/ISO programs (.I) for HEIDENHAIN controls, of our own or from elsewhere.

As with conversational programs: every word of every block is taken by a rule, or is a finding.

Source: HEIDENHAIN iTNC 530 user's manual, DIN/ISO programming.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from functools import partial

from conflank_cli.verification.blocks import Block, split_iso
from conflank_cli.verification.control import Control
from conflank_cli.verification.flow import Flow, Jump
from conflank_cli.verification.kinematics import Axes
from conflank_cli.verification.numbers import MOST, NUMBER, number
from conflank_cli.verification.parameters import PARAMETER, VALUE
from conflank_cli.verification.program import HeaderReader, Program
from conflank_cli.verification.recorder import Recorder
from conflank_cli.verification.words import INCH, PLAIN, Words, plain_words, rotary_letters

_PLAIN = re.compile(rf"(?:G0?([01])\s*)?{PLAIN}(?:F\s*([\d.,]+)\s*)?")
_LABEL = re.compile(r"G98\s*L\s*(\d+)$")
_CALL = re.compile(r"L\s*(\d+)\s*,\s*(\d+)$")
_ENDING = re.compile(r"(?:.*\s)?M0*(?:2|30)(?!\d)")
_NAME = re.compile(r"%\s*(\S+?)\s+G7([01])$")
_PRESET = re.compile(rf"G247\s*Q339\s*=\s*({VALUE})$")
_FUNCTION = re.compile(rf"D\s*(\d+)\s+({PARAMETER})((?:\s+P0?\d\s*{VALUE})+)$")
_JUMP = re.compile(rf'D\s*(9|09|10|11|12)\s+P0?1\s*({VALUE})\s+P0?2\s*({VALUE})\s+P0?3\s*(?:(\d+)|"([^"]*)")$')
_OPERAND = re.compile(rf"P0?\d\s*({VALUE})")
_FORMULA = re.compile(rf"({PARAMETER})\s*=\s*(.*)$")
_TOLERANCE = re.compile(rf"(?:T\s*(?P<t>{VALUE}))?(?:\s*P0?1\s+[01])?(?:\s*P0?2\s+(?P<ta>{VALUE}))?$")

_WORD = re.compile(
    rf"""\s*(?:
      G\s*(?P<code>\d+)(?![.\d])
    | (?P<variant>F\s*(?:MAXT|[UTZ]\s*{VALUE}))
    | (?P<delta>D(?:L|R2?))\s*(?P<size>{VALUE})
    | MB\s*(?P<back>MAX|{VALUE})
    | M\s*(?P<function>\d+)
    | F\s*(?P<feed>MAX|AUTO|{VALUE})
    | T\s*(?P<tool>{VALUE})
    | S\s*(?P<speed>{VALUE})
    | (?P<letter>[XYZABCIJRH])\s*(?P<value>{VALUE})
    )""",
    re.VERBOSE,
)

_SIDES = {40: "R0", 41: "RL", 42: "RR"}
_TURNS = {2: -1, 3: 1, 12: -1, 13: 1}
_LINES = (0, 1, 10, 11)
_MODAL = frozenset({17, 40, 41, 42, 70, 71, 90, 91, *_LINES, 2, 3, 5, 6, 12, 13})
_FRAMES = (28, 54, 72, 73, 80)
_BLANK = re.compile(rf"G30\s*G17(?:\s*[XYZ]\s*{NUMBER}){{3}}$|G31(?:\s*G9[01])?(?:\s*[XYZ]\s*{NUMBER}){{3}}$")
_DEFINED = re.compile(r"G51\s*T\s*\d+(?:\.\d)?$")
"""Preselection of a tool."""
_GEOMETRY = re.compile(rf"G99\s*T\s*\d+(?:\s*[LR]\s*{NUMBER})*$")


def read_iso(text: str, machine: Axes | None = None, harmless: Iterable[int] = ()) -> Program:
    """Read a DIN/ISO program.

    Parameters
    ----------
    text, machine, harmless: as `read_conversational`.

    Returns
    -------
    What it states about itself, the poses that follow from it, and findings for all that does not.
    """
    blocks, findings = split_iso(text)
    header = HeaderReader()
    used: set[str] = set()
    for block in blocks:
        for comment in block.comments:
            header.read(comment)
        if block.text and block.text[0] in "GXYZABCgxyzabcIi":
            used |= rotary_letters(block.text.upper())
    reading = _Reading(header, Recorder(used, False, tuple(header.rotary), machine), harmless)
    for finding in findings:
        reading.recorder.findings[finding.code, finding.text] = finding
    reading.run(blocks)
    return reading.result()


class _Block:
    """The words of one ISO block by what they are."""

    def __init__(self, text: str, unit: float, control: Control) -> None:
        self.codes: list[int] = []
        self.words = Words()
        self.tool: str | None = None
        self.speed: str | None = None
        self.deltas: list[tuple[str, str]] = []
        self.pole: dict[str, float | None] = {}
        self.height: str | None = None
        value = control.parameters.value
        place = 0
        while place < len(text):
            found = _WORD.match(text, place)
            if found is None:
                break
            place = found.end()
            self._take(found, unit, value)
        self.words.rest = text[place:].strip()

    def _take(self, found: re.Match[str], unit: float, value: object) -> None:
        words, kind = self.words, found.lastgroup
        assert callable(value)
        if kind == "code":
            self.codes.append(int(found["code"][:6]))
        elif kind == "value":
            letter, text = found["letter"], found["value"]
            if letter in "IJ":
                known = value(text)
                words.once(letter, letter if letter in self.pole else None)
                self.pole[letter] = None if known is None or not abs(known) <= MOST else known * unit
            elif letter == "R":
                words.take_radius(text, unit, value)
            elif letter == "H":
                words.once("H", self.height)
                self.height = text
            else:
                words.coordinate(letter, text, unit, value)
        elif kind == "size":
            self.deltas.append((found["delta"], found["size"]))
        elif kind == "function":
            words.functions = (*words.functions, int(found["function"][:6]))
        elif kind == "feed":
            words.take_feed(found["feed"])
        elif kind == "variant":
            words.variant = found["variant"]
        elif kind == "back":
            words.once("MB", words.back)
            words.back = found["back"]
        elif kind == "tool":
            words.once("T", self.tool)
            self.tool = found["tool"]
        elif kind == "speed":
            words.once("S", self.speed)
            self.speed = found["speed"]


class _Reading(Control):
    """One reading of a program."""

    def __init__(self, header: HeaderReader, recorder: Recorder, harmless: Iterable[int]) -> None:
        super().__init__(header, recorder, harmless)
        self.path = 1
        self.incremental = False

    def run(self, blocks: list[Block]) -> None:
        """Run the program from its first block."""
        recorder = self.recorder
        jumps = {index: jump for index, block in enumerate(blocks) if (jump := _jump(block.text)) is not None}
        self.flow = Flow(blocks, jumps, recorder)
        self.frame_blocks(blocks)
        for block in self.running_through(self.flow):
            text = block.text
            found = None if self.incremental or self.corner is not None else _PLAIN.fullmatch(text)
            if found is None or not self.usual(found.groups(), block.number):
                self.follow(text.upper(), block.number)
        last = blocks[-1].number if blocks else 0
        self._no_corner(last)
        if recorder.axes is None:
            recorder.find("CF108", "rotary words that belong to no pair of axes", last)

    def frame_blocks(self, blocks: list[Block]) -> None:
        """The block with % and the name first, the same block last, and neither anywhere else."""
        find = self.recorder.find
        last = blocks[-1].number if blocks else 0
        named = [(index, found) for index, block in enumerate(blocks) if (found := _NAME.match(block.text.upper()))]
        if not named or named[0][0] != next((index for index, block in enumerate(blocks) if block.text), None):
            find("CF101", "no % block at the beginning", last)
            return
        if named[0][0] > 0:
            find("CF119", "text before the % block", blocks[0].number)
        self.name, self.unit = named[0][1][1], INCH if named[0][1][2] == "0" else 1.0
        if len(named) < 2:
            find("CF101", "no % block at the end: the program may be cut off", last)
            return
        if named[1][0] < len(blocks) - 1:
            find("CF119", "text after the % block that ends the program", blocks[named[1][0] + 1].number)
        if named[0][1].groups() != named[1][1].groups():
            find("CF119", "the last % block names another program or unit than the first", blocks[named[1][0]].number)

    def usual(self, groups: tuple[str | None, ...], block: int) -> bool:
        """Follow a motion block of the usual words; False where it is none after all."""
        path, feed = groups[0], groups[10]
        if groups[7] is not None or (path is None and self.path not in (0, 1)):
            return False
        words = plain_words(groups[1:10], self.unit)
        if words is None or not words[0]:
            return False
        if feed is not None:
            if re.fullmatch(NUMBER, feed) is None:
                return False
            self.set_feed(feed, block)
        if path is not None:
            self.path = int(path)
        self.plain(words[0], None, self.path == 0, block)
        return True

    def follow(self, text: str, block: int) -> None:
        """Follow one block."""
        find = self.recorder.find
        if _NAME.match(text) or _BLANK.match(text) or _DEFINED.match(text):
            return
        if _GEOMETRY.match(text):
            if any(number(size) != 0.0 for size in re.findall(rf"L\s*({NUMBER})", text)):
                find("CF102", "length of a tool in the program (G99 L) is not followed", block)
        elif found := _PRESET.match(text):
            self.set_preset(found[1], block)
        elif text.startswith("%") or re.match(r"L\s*\d", text):
            find("CF102", f"call {text[:60]} is not followed", block)
            # Wherever the axes go there, nothing that comes after is known.
            self.recorder.move(dict.fromkeys("XYZABC"), None, False, block)
        elif re.fullmatch(r"PLANE RESET STAY", text):
            self.reset_tilt(block)
        elif text.startswith("PLANE"):
            self.not_followed(f"a tilted plane by {text[:60]}", block)
        elif found := _JUMP.match(text):
            label = str(int(found[4])) if found[4] else found[5]
            self.jump_if(self.parameters.holds(int(found[1]), found[2], found[3]), label, text, block)
        elif found := _FUNCTION.match(text):
            operands = _OPERAND.findall(found[3])
            self.assign(found[2], partial(self.parameters.iso_numbered, int(found[1]), operands), block)
        elif found := _FORMULA.match(text):
            self.assign(found[1], partial(self.parameters.formula, found[2]), block)
        else:
            self.words(text, block)

    def words(self, text: str, block: int) -> None:
        """A block of G codes and words."""
        recorder = self.recorder
        codes = [int(code[:6]) for code in re.findall(r"(?<![A-Z])G\s*(\d+)", text)]
        if 62 in codes:
            self.tolerance(re.sub(r"G\s*62", "", text, count=1).strip(), block)
            return
        read = _Block(text, self.unit, self)
        for code in read.codes:
            self._code(code, read, block)
        if read.tool is not None:
            self.select_tool(read.tool, None, block)
        if read.speed is not None:
            self.set_speed(read.speed, block)
        if read.deltas:
            self.check_deltas(read.deltas, block)
        if any(code in _FRAMES for code in read.codes):
            self.frames(read, block)
        elif 4 in read.codes:
            self.dwell(read, block)
        elif 24 in read.codes or 25 in read.codes:
            self.set_corner("RND" if 25 in read.codes else "CHF", (read.words.radius or [None])[0], block)
        elif 36 in read.codes or 38 in read.codes:
            recorder.event("orientation of the spindle (G36)" if 36 in read.codes else "stop (G38)", block)
            self.motion(read.words, False, self.path in (0, 10), block)
        else:
            self.move(read, block)

    def _code(self, code: int, read: _Block, block: int) -> None:
        """What a G code sets."""
        find = self.recorder.find
        if code in (90, 91):
            self.incremental = code == 91
        elif code in (70, 71):
            if self.unit != (INCH if code == 70 else 1.0):
                find("CF102", "unit changed within the program", block)
        elif code in _SIDES:
            read.words.side = _SIDES[code]
        elif code in (18, 19, 20):
            find("CF102", f"tool axis of G{code}: only Z (G17) is followed", block)
        elif code in _LINES or code in _TURNS or code in (5, 6):
            self.path = code
        elif code == 29:
            self.set_pole(Words(), block)
        elif code not in (4, 17, 24, 25, 36, 38, *_FRAMES):
            find("CF102", f"G{code} is not followed", block)
            if code not in _MODAL:
                self.recorder.lose_place(block)
        if read.codes.count(code) > 1:
            read.words.wrong.append(f"G{code} stands twice in the block")

    def move(self, read: _Block, block: int) -> None:
        """Straight moves, arcs, polar coordinates and poles."""
        words = read.words
        if read.pole:
            axes = {("IX" if letter == "I" else "IY") if self.incremental else "XY"["IJ".index(letter)]: value
                    for letter, value in read.pole.items()}  # fmt: skip
            self.set_pole(Words(axes=axes), block)
        if self.path in (10, 11, 12, 13):
            self._polar(read, block)
            return
        if read.height is not None:
            words.wrong.append("H without polar coordinates")
        if self.incremental:
            words.axes = {word if word[0] == "I" else f"I{word}": value for word, value in words.axes.items()}
        if self.path in (0, 1) or not words.axes:
            self.motion(words, False, self.path == 0, block)
            return
        if self.path == 5:
            self.recorder.find("CF102", "G05 is not followed", block)
            self.recorder.move(dict.fromkeys("XYZ"), None, False, block)
            return
        words.turn = _TURNS.get(self.path, 0)
        self.arc("CT" if self.path == 6 else "CR" if words.radius else "C", words, block)

    def _polar(self, read: _Block, block: int) -> None:
        words = read.words
        if not words.radius and read.height is None:
            self.motion(words, False, self.path == 10, block)
            return
        mark = "I" if self.incremental else ""
        if words.radius:
            words.polar[f"{mark}PR"] = words.radius[0]
            words.radius = []
        if read.height is not None:
            words.coordinate(f"{mark}PA", read.height, 1.0, self.parameters.value)
        if self.incremental:
            words.axes = {word if word[0] == "I" else f"I{word}": value for word, value in words.axes.items()}
        if self.path in (12, 13):
            words.turn = _TURNS[self.path]
            self.helix(words, block)
        elif self.polar_end(words, block):
            words.polar = {}
            self.motion(words, False, self.path == 10, block)
        else:
            self.recorder.move(dict.fromkeys("XYZ"), None, False, block)

    def frames(self, read: _Block, block: int) -> None:
        """G54, G28, G72, G73 and G80."""
        words, codes = read.words, read.codes
        if 54 in codes:
            if self.incremental:
                words.axes = {f"I{word}": value for word, value in words.axes.items()}
            self.shift_datum(words, block)
        elif 28 in codes:
            letters = re.findall("[XYZABC]", words.rest)
            if set(words.rest.replace(" ", "")) - set("XY") or words.axes:
                self.not_followed(f"mirroring of {words.rest[:20]}", block)
            else:
                words.rest = ""
                self._refuse(words, block, "mirroring")
                self.mirror("".join(sorted(letters)), block)
        elif 73 in codes:
            degrees = 0.0 if read.height is None else self.parameters.value(read.height)
            self._refuse(words, block, "rotation")
            self.rotate(degrees, self.incremental, block)
        elif 72 in codes:
            factor = 1.0 if words.feed is None else self.parameters.value(words.feed)
            if factor != 1.0 or words.axes:
                self.not_followed("scaling (G72)", block)
        elif words.axes or not words.rest:
            matrix = self.spatial_angles(words, block)
            if matrix is not None:
                self.tilt(matrix, block)

    def tolerance(self, text: str, block: int) -> None:
        """G62, cycle 32."""
        found = _TOLERANCE.match(text)
        if found is None:
            self.recorder.find("CF101", f"words not understood: {text[:60]}", block)
            return
        self.set_tolerance(found["t"], block)
        if found["ta"] is not None:
            self.set_rotary_tolerance(found["ta"], block)
        elif found["t"] is not None:
            self.recorder.find("CF117", "cycle 32 without TA", block)

    def dwell(self, read: _Block, block: int) -> None:
        """G04."""
        self.recorder.event("dwell (G04)", block)
        read.words.feed = None
        self._refuse(read.words, block, "dwell")


def _jump(text: str) -> Jump | None:
    """What a block does to the order of blocks."""
    head = text[:1].upper()
    if head == "G" and text[1:3] != "98" and "M" not in text.upper():
        return None
    text = text.upper()
    if found := _LABEL.match(text):
        return Jump("label", str(int(found[1])))
    if found := _CALL.match(text):
        return Jump("call", str(int(found[1])), int(found[2][:9]) or None)
    if _ENDING.match(text):
        return Jump("end")
    return None
