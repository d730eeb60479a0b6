"""Reader of HEIDENHAIN conversational programs (.H), of our own or from elsewhere.

What a block does to the cutter is followed where the text tells it; every other block that could move the cutter or
change where words lead to is a finding. Blocks may be numbered or not; a block without a number is named by its line.

Source: HEIDENHAIN iTNC 530 user's manual, conversational programming (340 49x).
"""

from __future__ import annotations

import re
from collections.abc import Callable

from conflank_cli.verification.control import DEEPEST, Block, Control, Flow, Jump
from conflank_cli.verification.program import (
    NUMBER,
    CalledProgram,
    HeaderReader,
    Interpolation,
    Program,
    Recorder,
    number,
)
from conflank_cli.verification.words import INCH, PLAIN, lines_of, plain_words, rotary_letters, split_words

Called = Callable[[str], str | None]
"""From the name of a file to its text; None where there is none."""

_LINE = re.compile(r"(/?)\s*(?:(\d+)(?=\s|$))?\s*(/?)\s*(.*)")
_MOTION = re.compile(r"(LN?)(?=[\sXYZABCIRFM]|$)(?!\s*BL)(.*)")
_PLAIN = re.compile(rf"(?:L|LN)\s+{PLAIN}(?:R0\s*)?(?:F\s*(MAX|[\d.,]+)\s*)?")
_SKIPPED = re.compile(r"BLK FORM|TOOL DEF|STOP\b|\*|END PGM|PLANE RESET|FUNCTION MODE|CYCL DEF 9\.|CYCL DEF 13\.")
"""Blocks without effect on the path: blank, preselection, stops, structure, dwell, orientation of the spindle."""
_LABEL = re.compile(r'LBL\s*(?:(\d+)|"([^"]*)")$')
_CALL = re.compile(r'CALL LBL\s*(?:(\d+)|"([^"]*)")\s*(?:REP\s*(\d+)?(?:\s*/\s*\d+)?)?$')
_ENDING = re.compile(r"(?:.*\s)?M0*(?:2|30)(?!\d)")
_PROGRAM = re.compile(r'CALL PGM\s+"?([^"]+?)"?$')


def split_blocks(text: str) -> list[Block]:
    """Lines to blocks: numbers, skip marks, comments and continuation lines (``~``) taken apart."""
    blocks: list[Block] = []
    continued = False
    for line_number, line in enumerate(lines_of(text), start=1):
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
            found = _LINE.match(code)
            assert found is not None
            before, name, after, rest = found.groups()
            blocks.append(Block(int(name) if name else line_number, rest.strip(), comments, bool(before or after)))
        continued = again
    return blocks


def read_conversational(text: str, called: Called | None = None) -> Program:
    """Read a conversational program.

    Parameters
    ----------
    text: the whole file.
    called: where the programs are that it calls.

    Returns
    -------
    What it states about itself, the poses that follow from it, and findings for all that does not.
    """
    library = _Library(called)
    main = split_blocks(text)
    library.take(main)
    header = HeaderReader()
    used: set[str] = set()
    vectors = False
    for blocks in (main, *library.blocks.values()):
        for block in blocks:
            for comment in block.comments:
                header.read(comment)
            if block.text[:1] in "Ll" and (found := _MOTION.match(block.text.upper())):
                used |= rotary_letters(found[2])
                vectors = vectors or (found[1] == "LN" and "TX" in found[2])
    reading = _Reading(header, Recorder(used, vectors, tuple(header.rotary)), library)
    reading.run(main)
    return reading.result(library.programs)


class _Library:
    """The programs that are called, and those that they call."""

    def __init__(self, called: Called | None) -> None:
        self._called = called
        self.blocks: dict[str, list[Block]] = {}
        self.programs: list[CalledProgram] = []

    def take(self, blocks: list[Block]) -> None:
        """Find what these blocks call."""
        for block in blocks:
            if self._called is None or not block.text.upper().startswith("CALL PGM"):
                continue
            name = file_called(block.text)
            text = None if name is None or name in self.blocks else self._called(name)
            if name is not None and text is not None:
                self.blocks[name] = split_blocks(text)
                self.programs.append(CalledProgram(name, text))
                self.take(self.blocks[name])


def file_called(text: str) -> str | None:
    """Name of the file that a CALL PGM block means, without its folder; None where it is no conversational program."""
    found = _PROGRAM.match(text if text[:8].isupper() else text.upper())
    if found is None:
        return None
    name = re.split(r"[\\/]", found[1])[-1]
    if "." not in name:
        return f"{name}.H"
    return name if name.upper().endswith(".H") else None


class _Reading(Control):
    """One reading of a program and of what it calls."""

    def __init__(self, header: HeaderReader, recorder: Recorder, library: _Library) -> None:
        super().__init__(header, recorder)
        self.library = library
        self.running: list[str] = []

    def run(self, blocks: list[Block]) -> None:
        """Run one program from its first block."""
        recorder = self.recorder
        jumps = {index: jump for index, block in enumerate(blocks) if (jump := _jump(block.text)) is not None}
        flow = Flow(blocks, jumps)
        for block in self.running_through(flow):
            text = block.text
            found = _PLAIN.fullmatch(text)
            if found is None or not self.usual(found.groups(), text, block.number):
                self.follow(text.upper(), text, block.number)
        if flow.ended is not None and self.running:
            recorder.find("CF109", "M2 or M30 in a called program", flow.ended)
        last = blocks[-1].number if blocks else 0
        if not any(block.text.startswith("BEGIN PGM") for block in blocks[:50]):
            recorder.find("CF101", "no BEGIN PGM block", last)
        if not any(block.text.upper().startswith("END PGM") for block in blocks):
            recorder.find("CF101", "no END PGM block: the program may be cut off", last)
        if recorder.axes is None and not self.running:
            recorder.find("CF108", "rotary words that belong to no pair of axes", last)

    def usual(self, groups: tuple[str | None, ...], text: str, block: int) -> bool:
        """Follow a motion block of the usual words; False where it is none after all."""
        feed = groups[9]
        if (text[1] == "N" and groups[6] is None) or (text[1] != "N" and groups[6] is not None):
            return False
        words = plain_words(groups, self.unit)
        if words is None or not words[0]:
            return False
        if feed is not None and feed != "MAX":
            if re.fullmatch(NUMBER, feed) is None:
                return False
            self.recorder.feed = number(feed) * self.feed_unit
        if "R0" in text:
            self.side = "R0"
        self.plain(*words, feed == "MAX", block)
        return True

    def follow(self, text: str, written: str, block: int) -> None:
        """Follow one block."""
        find = self.recorder.find
        if found := re.match(r"BEGIN PGM\s+(.*?)\s+(MM|INCH)$", text):
            self.name = self.name or found[1]
            self.unit = INCH if found[2] == "INCH" else 1.0
        elif text.startswith("END PGM"):
            pass
        elif text.startswith("TOOL CALL"):
            self.tool_call(text, block)
        elif text.startswith("FUNCTION RESET TCPM"):
            self.recorder.control(False)
            self.recorder.spatial = False
        elif text.startswith("FUNCTION TCPM"):
            self.recorder.control(True, Interpolation.VECTOR if "PATHCTRL VECTOR" in text else Interpolation.AXIS)
            self.recorder.spatial = "AXIS SPAT" in text
            if "REFPNT" in text:
                find("CF102", "REFPNT: reference points other than the programmed one are not followed", block)
        elif text.startswith("PLANE RESET"):
            self.recorder.foreign_frame = ""
        elif text.startswith("PLANE"):
            self.transform("tilted plane (PLANE)", False, block)
            self.recorder.foreign_frame = "a tilted plane"
        elif _SKIPPED.match(text):
            pass
        elif text.startswith("CYCL DEF"):
            self.cycle(text, block)
        elif text.startswith("CALL PGM"):
            self.call(written, block)
        elif found := re.match(r"LBL|CALL LBL|CYCL CALL|FN\s*\d|Q[LRS]?\d+\s*=", text):
            what = {"Q": "Q parameter", "F": "Q parameter function"}.get(found[0][0], found[0])
            find("CF102", f"{what} is not followed", block)
        elif found := _MOTION.match(text):
            self.motion(split_words(found[2], self.unit), found[1] == "LN", False, block)
        elif re.match(r"M\d+", text):
            self.motion(split_words(text, self.unit), False, False, block)
        elif re.match(r"(CC|CR|CT|CP|CTP|LP|LT|LCT|RND|CHF|APPR|DEP|SPL|C|PLANE|FUNCTION|ROUND)\b", text):
            find("CF102", f"{text.split()[0]} block is not followed", block)
            if not re.match(r"(CC|FUNCTION)\b", text):
                self.recorder.move(dict.fromkeys("XYZ"), None, False, block)
        else:
            find("CF101", f"block not understood: {text[:60]}", block)

    def call(self, text: str, block: int) -> None:
        """Run another program; the control's state goes with it and comes back with it."""
        name = file_called(text)
        blocks = self.library.blocks.get(name or "")
        if name is None or blocks is None:
            reason = "is not followed" if name is None else f"is not followed: there is no {name} beside the program"
            self.recorder.find("CF102", f"{text} {reason}", block)
            # Wherever the axes go there, nothing that comes after is known.
            self.recorder.move(dict.fromkeys("XYZABC"), None, False, block)
            return
        if len(self.running) >= DEEPEST or name in self.running:
            self.recorder.find("CF102", f"{text} is not followed: the programs call each other in a circle", block)
            return
        outside, unit = (self.running[-1] if self.running else ""), self.unit
        self.running.append(name)
        self.recorder.enter(name)
        self.run(blocks)
        self.running.pop()
        self.recorder.enter(outside)
        self.unit = unit

    def tool_call(self, text: str, block: int) -> None:
        """TOOL CALL with a number or name changes the tool; without, only speed and feed."""
        found = re.match(r'TOOL CALL\s*(?:"([^"]*)"|(\d+)(?:\.\d+)?(?![\d.,]))?(.*)', text)
        assert found is not None
        rest = found[3]
        if feed := re.search(rf"\bF\s*({NUMBER})", rest):
            self.recorder.feed = number(feed[1]) * self.feed_unit
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
        if cycle == 7:
            self.shift_datum(words, block)
        elif cycle == 247:
            self.set_preset(text, block)
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
                self.transform("tilted plane (cycle 19)", not tilted, block)
                self.recorder.foreign_frame = "a tilted plane" if tilted else ""
        elif cycle in (8, 10, 11, 26):
            names = {8: "mirroring", 10: "rotation", 11: "scaling", 26: "scaling per axis"}
            neutral = {8: rest == "", 10: bool(re.fullmatch(r"I?ROT\s*[+-]?0*[.,]?0*", rest))}.get(
                cycle, bool(re.fullmatch(r"SCL\s*\+?1[.,]?0*", rest))
            )
            if line > 0:
                self.transform(f"{names[cycle]} (cycle {cycle})", neutral, block)
        elif line == 0:
            self.recorder.find("CF102", f"cycle {cycle} is not followed", block)


def _jump(text: str) -> Jump | None:
    """What a block does to the order of blocks."""
    head = text[:1].upper()
    # Most blocks are motion: what cannot be of interest leaves first.
    if head not in "LCME" or (head == "L" and text[1:2] in " N" and "M" not in text.upper().replace("FMAX", "")):
        return None
    text = text.upper()
    if found := _LABEL.match(text):
        return Jump("label", found[1].lstrip("0") or "0" if found[1] else found[2])
    if found := _CALL.match(text):
        name = found[1].lstrip("0") or "0" if found[1] else found[2]
        return Jump("call", name, int(found[3] or 0) if "REP" in text else None)
    if text.startswith("END PGM"):
        return Jump("last")
    if head in "LM" and _ENDING.match(text):
        return Jump("end")
    return None
