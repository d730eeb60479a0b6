"""Reader of DIN/ISO programs (.I) for HEIDENHAIN controls, of our own or from elsewhere.

As with conversational programs: what a block does to the cutter is followed where the text tells it, everything else
that could move the cutter or change where words lead to is a finding.

Source: HEIDENHAIN iTNC 530 user's manual, DIN/ISO programming.
"""

from __future__ import annotations

import re

from conflank_cli.verification.control import Block, Control, Flow, Jump
from conflank_cli.verification.program import NUMBER, HeaderReader, Program, Recorder, number
from conflank_cli.verification.words import INCH, PLAIN, lines_of, plain_words, rotary_letters, split_words

_LINE = re.compile(r"(/?)\s*(?:N(\d+))?\s*(/?)\s*(.*)")
_PLAIN = re.compile(rf"(?:G0?([01])\s*)?{PLAIN}(?:F\s*([\d.,]+)\s*)?")
_G = re.compile(r"G\s*(\d+)(?![.\d])")
_TOOL = re.compile(r"(?<![A-Z])T\s*(\d+)(?:\.\d+)?(?![\d.,])")
_SPEED = re.compile(r"(?<![A-Z])S\s*[\d.,]+")
_LABEL = re.compile(r"G98\s*L\s*(\d+)$")
_CALL = re.compile(r"L\s*(\d+)\s*,\s*(\d+)$")
_ENDING = re.compile(r"(?:.*\s)?M0*(?:2|30)(?!\d)")
_NAME = re.compile(r"%\s*(\S+?)\s+G7([01])$")
_ENDED = re.compile(r"%\s*\S+\s+G7[01]$")

_CURVES = {2, 3, 5, 6, 7, 10, 11, 12, 13, 15, 16}
"""Circles and polar moves."""
_CORNERS = {24, 25, 26, 27}
"""Chamfers, rounded corners, tangential approach and departure."""
_SKIPPED = {30, 31, 36, 38, 51, 99}
"""Blank, orientation of the spindle, stop, preselection and definition of tools."""
_FRAMES = {28: "mirroring", 72: "scaling", 73: "rotation", 80: "tilted plane"}


def split_iso_blocks(text: str) -> list[Block]:
    """Lines to blocks: numbers, skip marks, comments and the mark of the end taken apart."""
    blocks: list[Block] = []
    for line_number, line in enumerate(lines_of(text), start=1):
        content = line.strip().strip("\x00\x1a\x03").strip()
        if not content:
            continue
        if content.endswith("*"):
            content = content[:-1].rstrip()
        code, mark, comment = content.partition(";")
        comments = (comment.strip().removesuffix("*").rstrip(),) if mark else ()
        found = _LINE.match(code)
        assert found is not None
        before, name, after, rest = found.groups()
        rest = rest.strip().removesuffix("*").rstrip()
        blocks.append(Block(int(name) if name else line_number, rest, comments, bool(before or after)))
    return blocks


def read_iso(text: str) -> Program:
    """Read a DIN/ISO program.

    Parameters
    ----------
    text: the whole file.

    Returns
    -------
    What it states about itself, the poses that follow from it, and findings for all that does not.
    """
    blocks = split_iso_blocks(text)
    header = HeaderReader()
    used: set[str] = set()
    for block in blocks:
        for comment in block.comments:
            header.read(comment)
        if block.text and block.text[0] in "GXYZABCgxyzabcIi":
            used |= rotary_letters(block.text.upper())
    reading = _Reading(header, Recorder(used, False, tuple(header.rotary)))
    reading.run(blocks)
    return reading.result()


class _Reading(Control):
    """One reading of a program."""

    def __init__(self, header: HeaderReader, recorder: Recorder) -> None:
        super().__init__(header, recorder)
        self.path = 1
        self.incremental = False
        self.ended = False

    def run(self, blocks: list[Block]) -> None:
        """Run the program from its first block."""
        recorder = self.recorder
        jumps = {index: jump for index, block in enumerate(blocks) if (jump := _jump(block.text)) is not None}
        flow = Flow(blocks, jumps)
        for block in self.running_through(flow):
            text = block.text
            found = None if self.incremental else _PLAIN.fullmatch(text)
            if found is None or not self.usual(found.groups(), block.number):
                self.follow(text.upper(), block.number)
        last = blocks[-1].number if blocks else 0
        names = [block for block in blocks if _ENDED.match(block.text)]
        if not names or names[0] is not next((block for block in blocks if block.text), None):
            recorder.find("CF101", "no % block at the beginning", last)
        if len(names) < 2:
            recorder.find("CF101", "no % block at the end: the program may be cut off", last)
        if recorder.axes is None:
            recorder.find("CF108", "rotary words that belong to no pair of axes", last)

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
            self.recorder.feed = number(feed) * self.feed_unit
        if path is not None:
            self.path = int(path)
        self.plain(words[0], None, self.path == 0, block)
        return True

    def follow(self, text: str, block: int) -> None:
        """Follow one block."""
        find = self.recorder.find
        if found := _NAME.match(text):
            self.name = self.name or found[1]
            self.unit = INCH if found[2] == "0" else 1.0
        elif text.startswith("%") or re.match(r"L\s*\d", text):
            find("CF102", f"call {text[:60]} is not followed", block)
            # Wherever the axes go there, nothing that comes after is known.
            self.recorder.move(dict.fromkeys("XYZABC"), None, False, block)
        elif text.startswith("PLANE RESET"):
            self.recorder.foreign_frame = ""
        elif text.startswith("PLANE"):
            self.transform("tilted plane (PLANE)", False, block)
        elif re.match(r"D\s*\d|Q[LRS]?\d+\s*=", text):
            find("CF102", "Q parameter is not followed", block)
        else:
            self.words(text, block)

    def words(self, text: str, block: int) -> None:
        """A block of G codes and words."""
        find = self.recorder.find
        codes = [int(code) for code in _G.findall(text)]
        rest = _G.sub(" ", text)
        if 247 in codes:
            self.set_preset(text, block)
            return
        if any(code in _SKIPPED for code in codes) or 4 in codes:
            return
        for code in codes:
            if code in (90, 91):
                self.incremental = code == 91
            elif code in (70, 71):
                self.unit = INCH if code == 70 else 1.0
            elif code in (40, 41, 42):
                self.side = {40: "R0", 41: "RL", 42: "RR"}[code]
            elif code in (18, 19, 20):
                find("CF102", f"tool axis of G{code}: only Z (G17) is followed", block)
            elif code in (0, 1) or code in _CURVES:
                self.path = code
            elif code not in {17, 29, 54, 62, *_FRAMES, *_CORNERS}:
                find("CF102", f"G{code} is not followed", block)
        if self.frames(codes, rest, block):
            return
        if called := _TOOL.search(rest):
            self.delta = bool(re.search(r"DR\s*[+-]?0*[.,]?0*[1-9]", rest))
            if re.search(r"DL\s*[+-]?0*[.,]?0*[1-9]", rest):
                find("CF102", "length delta DL in the tool call is not followed", block)
            self.recorder.call_tool(int(called[1]), None, block)
            rest = re.sub(rf"D[LR]\s*{NUMBER}", " ", _TOOL.sub(" ", rest))
        rest = _SPEED.sub(" ", rest)
        moves = bool(re.search(r"(?<![A-Z])[XYZABCHIJKR]\s*[+-]?[\d.,Q]", rest))
        if (self.path in _CURVES and moves) or any(code in _CORNERS for code in codes):
            find("CF102", f"G{self.path:02d} block is not followed", block)
            self.recorder.move(dict.fromkeys("XYZ"), None, False, block)
            return
        words = split_words(rest.strip(), self.unit)
        if self.incremental:
            axes = {word if word[0] == "I" else f"I{word}": value for word, value in words.axes.items()}
            words = type(words)(
                axes,
                words.vector,
                words.normal,
                words.feed,
                words.side,
                words.functions,
                words.back,
                words.rest,
            )
        self.motion(words, False, self.path == 0, block)

    def frames(self, codes: list[int], rest: str, block: int) -> bool:
        """Shifts, tolerance and other frames; whether the block was one."""
        if 54 in codes:
            self.shift_datum(split_words(rest.strip(), self.unit), block)
            return True
        if 62 in codes:
            t = re.search(rf"(?<![A-Z])T\s*({NUMBER})", rest)
            ta = re.search(rf"P0?2\s+({NUMBER})", rest)
            if t:
                self.recorder.tolerance = (number(t[1]) * self.unit, number(ta[1]) if ta else None)
            return True
        for code, name in _FRAMES.items():
            if code in codes:
                words = re.findall(rf"[A-Z]\s*({NUMBER})", rest)
                zero = 1.0 if code == 72 else 0.0
                neutral = not re.search("[A-Z]", rest) or (all(number(word) == zero for word in words) and bool(words))
                self.transform(f"{name} (G{code})", (neutral and code != 28) or not re.search("[A-Z]", rest), block)
                return True
        return False


def _jump(text: str) -> Jump | None:
    """What a block does to the order of blocks."""
    head = text[:1].upper()
    if head == "G" and text[1:3] != "98" and "M" not in text.upper():
        return None
    text = text.upper()
    if found := _LABEL.match(text):
        return Jump("label", str(int(found[1])))
    if found := _CALL.match(text):
        return Jump("call", str(int(found[1])), int(found[2]) or None)
    if _ENDING.match(text):
        return Jump("end")
    return None
