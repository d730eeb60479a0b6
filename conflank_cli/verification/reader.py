"""Reader of HEIDENHAIN conversational programs (.H), of our own or from elsewhere.

What a block does to the cutter is followed where the text tells it; every other block that could move the cutter or
change where words lead to is a finding. Blocks may be numbered or not; a block without a number is named by its line.

Source: HEIDENHAIN iTNC 530 user's manual, conversational programming (340 49x).
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from math import radians

import numpy as np

from conflank_cli.verification.program import NUMBER, CutLabel, HeaderReader, Interpolation, Program, Recorder, number

_INCH = 25.4
_ROTARY = "ABC"

_WORD = re.compile(
    rf"""\s*(?:
      (?P<axis>I?[XYZABC])\s*(?:(?P<value>{NUMBER})|(?P<parameter>[+-]?Q[LRS]?\d+))
    | (?P<component>[NT][XYZ])\s*(?P<part>{NUMBER})
    | F\s*(?P<feed>MAX|AUTO|{NUMBER}|Q[LRS]?\d+)
    | (?P<variant>F[UTZ])\s*{NUMBER}
    | (?P<side>R[0LR])(?![A-Z0-9])
    | M\s*(?P<function>\d+)
    | MB\s*(?P<back>MAX|{NUMBER})
    )""",
    re.VERBOSE,
)

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

_SKIPPED = re.compile(r"BLK FORM|TOOL DEF|STOP\b|\*|END PGM|PLANE RESET|FUNCTION MODE|CYCL DEF 9\.|CYCL DEF 13\.")
"""Blocks without effect on the path: blank, preselection, stops, structure, dwell, orientation of the spindle."""


@dataclass(frozen=True, slots=True)
class Block:
    """One block: its number (or line), its text without comments, its comments, and whether it is skippable."""

    number: int
    text: str
    comments: tuple[str, ...]
    skippable: bool


def split_blocks(text: str) -> list[Block]:
    """Lines to blocks: numbers, skip marks, comments and continuation lines (``~``) taken apart."""
    blocks: list[Block] = []
    continued = False
    for line_number, line in enumerate(text.lstrip("\ufeff").splitlines(), start=1):
        content = line.strip().strip("\x00\x1a\x03").strip()
        if not content:
            continue
        again = content.endswith("~")
        content = content[:-1].rstrip() if again else content
        code, mark, comment = content.partition(";")
        comments = (comment.strip(),) if mark else ()
        if continued and blocks:
            last = blocks[-1]
            blocks[-1] = Block(
                last.number, f"{last.text} {code.strip()}".strip(), last.comments + comments, last.skippable
            )
        else:
            found = re.match(r"(/?)\s*(?:(\d+)(?=\s|$))?\s*(/?)\s*(.*)", code)
            assert found is not None
            name = int(found[2]) if found[2] else line_number
            blocks.append(Block(name, found[4].strip(), comments, bool(found[1] or found[3])))
        continued = again
    return blocks


@dataclass(frozen=True, slots=True)
class Words:
    """The words of a motion block, angles in radians, lengths as programmed; None stands for a value not known."""

    axes: dict[str, float | None]
    vector: dict[str, float]
    normal: bool
    feed: str | None
    side: str | None
    functions: tuple[int, ...]
    back: str | None
    rest: str


def split_words(text: str, unit: float) -> Words:
    """Take the words of a block apart; `rest` keeps what is no word."""
    axes: dict[str, float | None] = {}
    vector: dict[str, float] = {}
    functions: list[int] = []
    normal = False
    feed = side = back = None
    place = 0
    while place < len(text):
        found = _WORD.match(text, place)
        if found is None:
            break
        place = found.end()
        if axis := found["axis"]:
            value = None if found["value"] is None else number(found["value"])
            if value is not None:
                value = radians(value) if axis[-1] in _ROTARY else value * unit
            axes[axis] = value
        elif component := found["component"]:
            if component[0] == "T":
                vector[component[1]] = number(found["part"])
            else:
                normal = True
        elif found["feed"]:
            # F after M128 caps the compensating movement; it is not the cutting feed.
            feed = feed if functions[-1:] == [128] else found["feed"]
        elif found["side"]:
            side = found["side"]
        elif found["function"]:
            functions.append(int(found["function"]))
        elif found["back"]:
            back = found["back"]
    return Words(axes, vector, normal, feed, side, tuple(functions), back, text[place:].strip())


class _Reading:
    """The state of one reading that is the dialect's own."""

    def __init__(self, text: str) -> None:
        self.blocks = split_blocks(text)
        self.header = HeaderReader()
        motion = [block.text for block in self.blocks if re.match(r"LN?(?=[\sXYZABCIRFM]|$)(?!\s*BL)", block.text)]
        words = [split_words(re.sub(r"^LN?", "", text), 1.0) for text in motion]
        used = {axis[-1] for item in words for axis in item.axes if axis[-1] in _ROTARY}
        self.recorder = Recorder(used, any(item.vector for item in words))
        self.unit = 1.0
        self.name = ""
        self.ended = False
        self.shift = {"X": 0.0, "Y": 0.0, "Z": 0.0}
        self.preset: int | None = None
        self.side = "R0"
        self.delta = False
        self.cycle32: list[float | None] = []

    def read(self) -> Program:
        """Follow all blocks."""
        for block in self.blocks:
            for comment in block.comments:
                label = self.header.read(comment)
                if isinstance(label, CutLabel):
                    self.recorder.label(label)
            if block.text and not self.ended:
                self.follow(block)
        recorder = self.recorder
        header = self.header.header()
        last = self.blocks[-1].number if self.blocks else 0
        if not self.name and not any(block.text.startswith("BEGIN PGM") for block in self.blocks):
            recorder.find("CF101", "no BEGIN PGM block", last)
        if not any(block.text.startswith("END PGM") for block in self.blocks):
            recorder.find("CF101", "no END PGM block: the program may be cut off", last)
        if recorder.letters is None:
            recorder.find("CF108", "rotary words A, B and C in one program", last)
        return Program(
            name=self.name,
            header=header,
            moves=recorder.moves(),
            cuts=tuple(recorder.cuts),
            tool_calls=tuple(recorder.tool_calls),
            letters=recorder.letters or "",
            tolerance=recorder.tolerance,
            unknown_moves=recorder.unknown_moves,
            findings=tuple(recorder.findings.values()),
        )

    def follow(self, block: Block) -> None:
        """Follow one block."""
        text = block.text.upper()
        find = self.recorder.find
        if block.skippable:
            find("CF102", "skippable block: read as if it were run", block.number)
        if found := re.match(r"BEGIN PGM\s+(.*?)\s+(MM|INCH)$", text):
            self.name, self.unit = found[1], _INCH if found[2] == "INCH" else 1.0
        elif text.startswith("END PGM"):
            self.ended = True
        elif text.startswith("TOOL CALL"):
            self.tool_call(text, block.number)
        elif text.startswith("FUNCTION RESET TCPM"):
            self.recorder.control(False)
            self.recorder.spatial = False
        elif text.startswith("FUNCTION TCPM"):
            self.recorder.control(True, Interpolation.VECTOR if "PATHCTRL VECTOR" in text else Interpolation.AXIS)
            self.recorder.spatial = "AXIS SPAT" in text
            if "REFPNT" in text:
                find("CF102", "REFPNT: reference points other than the programmed one are not followed", block.number)
        elif text.startswith("PLANE RESET"):
            self.recorder.foreign_frame = ""
        elif text.startswith("PLANE"):
            self.recorder.foreign_frame = "a tilted plane"
            find("CF102", "tilted plane (PLANE) is not followed", block.number)
        elif _SKIPPED.match(text):
            pass
        elif text.startswith("CYCL DEF"):
            self.cycle(text, block.number)
        elif re.match(r"(LBL|CALL LBL|CALL PGM|CYCL CALL|FN\s*\d|Q[LRS]?\d+\s*=)", text):
            found = re.match(r"LBL|CALL LBL|CALL PGM|CYCL CALL|FN|Q", text)
            assert found is not None
            what = {"Q": "Q parameter", "FN": "Q parameter function"}.get(found[0], found[0])
            find("CF102", f"{what} is not followed", block.number)
        elif found := re.match(r"(LN?)(?=[\sXYZABCIRFM]|$)(.*)", text):
            self.motion(found[1], found[2], block.number)
        elif re.match(r"M\d+", text):
            self.motion("M", text, block.number)
        elif re.match(r"(CC|CR|CT|CP|CTP|LP|LT|LCT|RND|CHF|APPR|DEP|SPL|C|PLANE|FUNCTION|ROUND)\b", text):
            find("CF102", f"{text.split()[0]} block is not followed", block.number)
            if not re.match(r"(CC|FUNCTION)\b", text):
                self.recorder.move(dict.fromkeys("XYZ"), None, False, block.number)
        else:
            find("CF101", f"block not understood: {block.text[:60]}", block.number)

    def tool_call(self, text: str, block: int) -> None:
        """TOOL CALL with a number or name changes the tool; without, only speed and feed."""
        found = re.match(r'TOOL CALL\s*(?:"([^"]*)"|(\d+)(?:\.\d+)?(?![\d.,]))?(.*)', text)
        assert found is not None
        rest = found[3]
        if feed := re.search(rf"\bF\s*({NUMBER})", rest):
            self.recorder.feed = number(feed[1]) * (self.unit if self.unit == 1.0 else _INCH / 10.0)
        if found[1] is None and found[2] is None:
            return
        if axis := re.match(r"\s*([XYUVW])\b", rest):
            self.recorder.find("CF102", f"tool axis {axis[1]}: only Z is followed", block)
        deltas = {name: number(value) for name, value in re.findall(rf"(D[LR])\s*({NUMBER})", rest)}
        if deltas.get("DL"):
            self.recorder.find("CF102", f"length delta DL{deltas['DL']:+g} in the tool call is not followed", block)
        self.delta = bool(deltas.get("DR"))
        self.recorder.call_tool(int(found[2]) if found[2] else None, found[1], block)

    def cycle(self, text: str, block: int) -> None:
        """The cycles that set frames and tolerances; any other is a finding."""
        found = re.match(r"CYCL DEF\s+(\d+)(?:\.(\d+))?\s*(.*)", text)
        if found is None:
            self.recorder.find("CF101", f"block not understood: {text[:60]}", block)
            return
        cycle, line, rest = int(found[1]), int(found[2] or 0), found[3]
        words = split_words(rest, self.unit) if line > 0 else split_words("", 1.0)
        find = self.recorder.find
        if cycle == 7:
            for word, value in words.axes.items():
                if word[-1] in _ROTARY or value is None:
                    if value != 0.0:
                        find("CF102", f"datum shift in {word} is not followed", block)
                        self.recorder.foreign_frame = "a datum shift"
                    continue
                self.shift[word[-1]] = value + (self.shift[word[-1]] if word[0] == "I" else 0.0)
            if line > 0 and words.rest:
                find("CF102", f"datum shift by {words.rest} is not followed", block)
                self.recorder.foreign_frame = "a datum shift from a table"
        elif cycle == 247:
            preset = re.search(rf"Q339\s*=\s*({NUMBER})", text)
            number_of = int(number(preset[1])) if preset else None
            if self.preset is not None and number_of != self.preset:
                find("CF104", "more than one preset: the header states one frame", block)
            self.preset = number_of
        elif cycle == 32:
            if line == 1:
                t = re.search(rf"\bT\s*({NUMBER})", rest)
                self.recorder.tolerance = (number(t[1]) * self.unit, None) if t else self.recorder.tolerance
            elif line == 2 and self.recorder.tolerance is not None:
                ta = re.search(rf"\bTA\s*({NUMBER})", rest)
                if ta:
                    self.recorder.tolerance = (self.recorder.tolerance[0], number(ta[1]))
        elif cycle == 19:
            if line == 1:
                tilted = any(value != 0.0 for value in words.axes.values())
                self.recorder.foreign_frame = "a tilted plane" if tilted else ""
                if tilted:
                    find("CF102", "tilted plane (cycle 19) is not followed", block)
        elif cycle in (8, 10, 11, 26):
            names = {8: "mirroring", 10: "rotation", 11: "scaling", 26: "scaling per axis"}
            neutral = {8: rest == "", 10: bool(re.fullmatch(r"I?ROT\s*[+-]?0*[.,]?0*", rest))}.get(
                cycle, bool(re.fullmatch(r"SCL\s*\+?1[.,]?0*", rest))
            )
            if line > 0:
                self.recorder.foreign_frame = "" if neutral else names[cycle]
                if not neutral:
                    find("CF102", f"{names[cycle]} (cycle {cycle}) is not followed", block)
        elif line == 0:
            find("CF102", f"cycle {cycle} is not followed", block)

    def motion(self, kind: str, text: str, block: int) -> None:
        """L, LN, or a block of M functions only."""
        recorder = self.recorder
        words = split_words(text, self.unit)
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
        rapid = words.feed == "MAX"
        if words.feed is not None and not rapid:
            if re.fullmatch(NUMBER, words.feed):
                # Feeds of inch programs are in tenths of an inch a minute.
                recorder.feed = number(words.feed) * (1.0 if self.unit == 1.0 else _INCH / 10.0)
            elif words.feed != "AUTO":
                recorder.feed = float("nan")
                recorder.find("CF102", "feed from a Q parameter is not followed", block)
        self.side = words.side or self.side
        if self.side != "R0" and self.delta:
            recorder.find("CF102", "radius delta DR with RL or RR moves the path; that is not followed", block)
        if self.side != "R0" and not recorder.controlled:
            recorder.find("CF102", f"radius compensation {self.side} is not followed", block, "radius compensation")
        if any(value is None for value in words.axes.values()):
            recorder.find("CF102", "coordinate from a Q parameter is not followed", block)
        if 91 in functions or 92 in functions:
            if recorder.controlled:
                recorder.find("CF113", "machine coordinates while tool centre point control is active", block)
            if self.header.machine is None:
                recorder.find("CF106", "M91 or M92 without a machine in the header", block)
            recorder.machine_move(words.axes, block)
        elif words.axes or words.vector:
            shifted = {
                word: value + self.shift[word] if value is not None and word in self.shift else value
                for word, value in words.axes.items()
            }
            vector = None
            if words.vector:
                if kind != "LN" or set(words.vector) != set("XYZ"):
                    recorder.find("CF101", "tool vector needs LN and all of TX TY TZ", block)
                vector = np.array([words.vector.get(letter, 0.0) for letter in "XYZ"])
            recorder.move(shifted, vector, rapid, block)
        if 140 in functions:
            if words.back is None or words.back == "MAX":
                recorder.to_limit(block)
            else:
                recorder.retract(number(words.back) * self.unit, rapid, block)
        if 129 in functions:
            recorder.control(False)


def read_program(text: str) -> Program:
    """Read a conversational program.

    Parameters
    ----------
    text: the whole file.

    Returns
    -------
    What it states about itself, the poses that follow from it, and findings for all that does not.
    """
    return _Reading(text).read()
