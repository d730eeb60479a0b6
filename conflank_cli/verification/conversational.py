"""Reader of HEIDENHAIN conversational programs (.H), of our own or from elsewhere.

Every block belongs to one of the forms below, which take all of its words; what belongs to none is a finding. Blocks
may be numbered or not; a block without a number is named by its line.

Source: HEIDENHAIN iTNC 530 user's manual, conversational programming (340 49x).
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from functools import partial
from math import radians

from conflank_cli.verification.blocks import Block, split_conversational
from conflank_cli.verification.control import Control
from conflank_cli.verification.findings import Finding
from conflank_cli.verification.flow import DEEPEST, Flow, Jump
from conflank_cli.verification.frames import Frame, Matrix, euler, further, spanned, spatial
from conflank_cli.verification.kinematics import Axes
from conflank_cli.verification.numbers import NUMBER, number
from conflank_cli.verification.parameters import COMPARED, PARAMETER, VALUE
from conflank_cli.verification.program import CalledProgram, HeaderReader, Interpolation, Program
from conflank_cli.verification.recorder import Recorder
from conflank_cli.verification.words import INCH, PLAIN, Vector, Words, plain_words, rotary_letters, split_words

Called = Callable[[str], str | None]
"""From the name of a file to its text; None where there is none."""

Act = Callable[[re.Match[str], str, int], None]
"""What a block does: its match, its text as written, its number."""

_PLAIN = re.compile(rf"(?:L|LN)\s+{PLAIN}(?:R0\s*)?(?:F\s*(MAX|[\d.,]+)\s*)?")
_MOTION = re.compile(r"(LN?)(?=[\sXYZABCIRFM]|$)(?!\s*BL)(.*)")
_ARC = re.compile(r"(CR|CT|C)(?=\s|I?[XYZ]\s*[+-]?[\d.,Q]|$)(.*)")
_POLAR = re.compile(r"(LP|CP)(?=[\sPI]|$)(.*)")
_POLE = re.compile(r"CC(?=[\sXYI]|$)(.*)")
_BEGIN = re.compile(r"BEGIN PGM\s+(\S.*?)\s+(MM|INCH)$")
_END = re.compile(r"END PGM\s+(\S.*?)\s+(MM|INCH)$")
_CORNER = {
    "RND": re.compile(rf"RND\s*R\s*({VALUE})(?:\s*F\s*({VALUE}))?$"),
    "CHF": re.compile(rf"CHF\s*({VALUE})(?:\s*F\s*({VALUE}))?$"),
}
_LABEL = re.compile(r'LBL\s*(?:(\d+)|"([^"]*)")$')
_CALL = re.compile(r'CALL LBL\s*(?:(\d+)|"([^"]*)")\s*(?:(REP)\s*(\d+)?(?:\s*/\s*\d+)?)?$')
_ENDING = re.compile(r"(?:.*\s)?M0*(?:2|30)(?!\d)")
_PROGRAM = re.compile(r'CALL PGM\s+"?([^"]+?)"?$')
_TOOL_CALL = re.compile(
    rf'TOOL CALL(?:\s*(?:"(?P<name>[^"]*)"|(?P<number>\d+(?:[.,]\d)?(?![\d.,])|{PARAMETER})))?'
    r"(?:\s+(?P<axis>[XYZUVW]))?"
    rf"(?P<rest>(?:\s*(?:S\s*{VALUE}|F\s*{VALUE}|D(?:L|R2?)\s*:?\s*{VALUE}))*)\s*$"
)
_TOOL_WORD = re.compile(rf"(S|F|DL|DR2|DR)\s*:?\s*({VALUE})")
_TCPM = re.compile(r"FUNCTION TCPM F (TCP|CONT) AXIS (POS|SPAT) PATHCTRL (AXIS|VECTOR)$")
_FUNCTION = re.compile(rf"FN\s*(\d+)\s*:\s*({PARAMETER})\s*=\s*(.*)$")
_JUMP = re.compile(
    rf'FN\s*(9|10|11|12)\s*:\s*IF\s*({VALUE})\s*(EQU|NE|GT|LT)\s*({VALUE})\s*GOTO LBL\s*(?:(\d+)|"([^"]*)")$'
)
_FORMULA = re.compile(rf"({PARAMETER})\s*=\s*(.*)$")
_CYCLE = re.compile(r"CYCL DEF\s+(\d+)(?:\.(\d+))?(?:\s+(.*))?$")
_PRESET = re.compile(rf"(?:[A-Z. ]*?)\s*Q339\s*=\s*({VALUE})$")
_MOVED = re.compile(
    rf"(STAY|MOVE|TURN)(?:\s+(?:DIST\s*{VALUE}|F\s*(?:MAX|AUTO|{VALUE})|MB\s*(?:MAX|{VALUE})|SEQ[+-]|"
    r"(?:TABLE|COORD) ROT))*$"
)
_HARMLESS = tuple(
    re.compile(form)
    for form in (
        rf"BLK FORM 0\.1 Z(?:\s+[XYZ]\s*{NUMBER}){{3}}$",
        rf"BLK FORM 0\.2(?:\s+I?[XYZ]\s*{NUMBER}){{3}}$",
        r"\*.*",
        r'TOOL DEF\s*(?:\d+(?:\.\d)?|"[^"]*")$',
        r"FUNCTION MODE MILL$",
    )
)
"""Blocks without effect on anything that is judged: blank, structure, preselection of a tool, milling."""

_ANGLE_WORDS = re.compile(rf"\s*([A-Z]+?)\s*({VALUE})")


def read_conversational(
    text: str, called: Called | None = None, machine: Axes | None = None, harmless: Iterable[int] = ()
) -> Program:
    """Read a conversational program.

    Parameters
    ----------
    text: the whole file.
    called: where the programs are that it calls.
    machine: the rotary axes of the machine that it is for, where it is known.
    harmless: M functions of that machine that change nothing that is judged.

    Returns
    -------
    What it states about itself, the poses that follow from it, and findings for all that does not.
    """
    library = _Library(called)
    main, findings = split_conversational(text)
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
    reading = _Reading(header, Recorder(used, vectors, tuple(header.rotary), machine), library, harmless)
    for finding in (*findings, *library.findings):
        reading.recorder.findings[finding.code, finding.text] = finding
    reading.run(main)
    return reading.result(library.programs)


class _Library:
    """The programs that are called, and those that they call."""

    def __init__(self, called: Called | None) -> None:
        self._called = called
        self.blocks: dict[str, list[Block]] = {}
        self.programs: list[CalledProgram] = []
        self.findings: list[Finding] = []

    def take(self, blocks: list[Block]) -> None:
        """Find what these blocks call."""
        for block in blocks:
            if self._called is None or not block.text.upper().startswith("CALL PGM"):
                continue
            name = file_called(block.text)
            text = None if name is None or name in self.blocks else self._called(name)
            if name is not None and text is not None:
                self.blocks[name], findings = split_conversational(text)
                self.findings += [
                    Finding(finding.code, f"{finding.text}, in {name}", finding.block, count=finding.count)
                    for finding in findings
                ]
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

    def __init__(self, header: HeaderReader, recorder: Recorder, library: _Library, harmless: Iterable[int]) -> None:
        super().__init__(header, recorder, harmless)
        self.library = library
        self.running: list[str] = []
        self._cycle = (0, 0)
        self._forms = self._all_forms()

    def _all_forms(self) -> tuple[tuple[re.Pattern[str], Act], ...]:
        """The forms of blocks beside plain motion, and what each does: (match, block as written, number)."""

        def form(words: str, act: Act) -> tuple[re.Pattern[str], Act]:
            return re.compile(words), act

        return (
            (_MOTION, lambda found, _, block: self.motion(self.split(found[2]), found[1] == "LN", False, block)),
            form(r"M\s*\d", lambda found, _, block: self.motion(self.split(found.string), False, False, block)),
            form(r"BEGIN PGM|END PGM", lambda found, text, block: None),
            form("TOOL CALL", lambda found, text, block: self.tool_call(text, block)),
            form("FUNCTION RESET TCPM$", lambda found, text, block: self.tcpm(None, block)),
            (_TCPM, lambda found, _, block: self.tcpm(found, block)),
            form(r"PLANE\s", lambda found, _, block: self.plane(found.string[found.end() :], block)),
            form(r"CYCL DEF\s", lambda found, text, block: self.cycle(text, block)),
            form(r"CALL PGM\s", lambda found, text, block: self.call(text, block)),
            (_POLE, lambda found, _, block: self.set_pole(self.split(found[1]), block)),
            (_ARC, lambda found, _, block: self.arc(found[1], self.split(found[2]), block)),
            (_POLAR, lambda found, _, block: self.polar(found[1], self.split(found[2]), block)),
            (_JUMP, lambda found, text, block: self.jump(found, text, block)),
            (_FUNCTION, self.function),
            (
                _FORMULA,
                lambda found, _, block: self.assign(found[1], partial(self.parameters.formula, found[2]), block),
            ),
            form(r"STOP\b", lambda found, _, block: self.stop(found.string[found.end() :], block)),
            *((words, partial(self.corner_block, kind)) for kind, words in _CORNER.items()),
            *((words, lambda found, text, block: None) for words in _HARMLESS),
        )

    def split(self, text: str) -> Words:
        """The words of a block."""
        return split_words(text, self.unit, self.parameters.value)

    def run(self, blocks: list[Block]) -> None:
        """Run one program from its first block."""
        recorder = self.recorder
        jumps = {index: jump for index, block in enumerate(blocks) if (jump := _jump(block.text)) is not None}
        outer, self.flow = self.flow, Flow(blocks, jumps, recorder)
        self.frame_blocks(blocks)
        for block in self.running_through(self.flow):
            text = block.text
            found = _PLAIN.fullmatch(text)
            if found is None or not self.usual(found.groups(), text, block.number):
                self.follow(text.upper(), text, block.number)
        last = blocks[-1].number if blocks else 0
        self._no_corner(last)
        self._end_cycle(last)
        if self.flow.ended is not None and self.running:
            recorder.find("CF109", "M2 or M30 in a called program", self.flow.ended)
        if recorder.axes is None and not self.running:
            recorder.find("CF108", "rotary words that belong to no pair of axes", last)
        self.flow = outer

    def frame_blocks(self, blocks: list[Block]) -> None:
        """BEGIN PGM in the first block, END PGM in the last, and neither anywhere else."""
        find = self.recorder.find
        last = blocks[-1].number if blocks else 0
        begins = [index for index, block in enumerate(blocks) if block.text.upper().startswith("BEGIN PGM")]
        ends = [index for index, block in enumerate(blocks) if block.text.upper().startswith("END PGM")]
        names = []
        for index in (*begins[:1], *ends[:1]):
            text = blocks[index].text.upper()
            found = _BEGIN.match(text) or _END.match(text)
            if found is None:
                find("CF101", f"block not understood: {text[:60]}", blocks[index].number)
            else:
                names.append(found.groups())
        if not begins:
            find("CF101", "no BEGIN PGM block", last)
        elif begins[0] != 0:
            find("CF119", "text before BEGIN PGM", blocks[0].number)
        if len(begins) > 1:
            find("CF119", "a second program begins in the same file", blocks[begins[1]].number)
        if not ends:
            find("CF101", "no END PGM block: the program may be cut off", last)
        elif ends[0] < len(blocks) - 1:
            find("CF119", "text after END PGM", blocks[ends[0] + 1].number)
        if begins and names:
            self.name = self.name or names[0][0]
            self.unit = INCH if names[0][1] == "INCH" else 1.0
        if len(names) == 2 and names[0] != names[1]:
            find("CF119", "END PGM names another program or unit than BEGIN PGM", blocks[ends[0]].number)

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
            self.set_feed(feed, block)
        if self.side != "R0" and "R0" in text:
            self.side = "R0"
            self.recorder.set(self.recorder.sides, "R0", block)
        if self._cycle[0]:
            self._end_cycle(block)
        self.plain(*words, feed == "MAX", block)
        return True

    def follow(self, text: str, written: str, block: int) -> None:
        """Follow one block."""
        if self._cycle[0] and not text.startswith("CYCL DEF"):
            self._end_cycle(block)
        for form, act in self._forms:
            if found := form.match(text):
                if self.corner is not None and form is not _MOTION:
                    self._no_corner(block)
                act(found, written, block)
                return
        if re.match(
            r"(CTP|LT|LCT|APPR|DEP|SPL|FL|FC|FLT|FCT|FPOL|LBL|CALL LBL|FN|SEL|CYCL CALL|FUNCTION|ROUND|CALL)\b", text
        ):
            self.recorder.find("CF102", f"{text.split()[0]} block is not followed: {text[:60]}", block)
            if not re.match(r"(FN|LBL)\b", text):
                self.recorder.move(dict.fromkeys("XYZABC"), None, False, block)
        else:
            self.recorder.find("CF101", f"block not understood: {text[:60]}", block)

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

    # --- tool, functions, parameters --------------------------------------------------------------------------------

    def tool_call(self, written: str, block: int) -> None:
        """TOOL CALL with a number or name changes the tool; without, only speed, feed and deltas."""
        find = self.recorder.find
        found = _TOOL_CALL.match(_upper_but_names(written))
        if found is None:
            find("CF101", f"block not understood: {written[:60]}", block)
            self.recorder.call_tool(None, written[9:60].strip(), block)
            return
        words = _TOOL_WORD.findall(found["rest"])
        names = [name for name, _ in words]
        if len(set(names)) < len(names):
            find("CF109", "a word stands twice in the tool call", block)
        changes = found["name"] is not None or found["number"] is not None
        if found["axis"] != "Z" and (changes or found["axis"]):
            find("CF102", f"tool axis {found['axis'] or 'left out'}: only Z is followed", block)
        if changes:
            text = found["number"]
            self.select_tool(None if text is None else text.replace(",", "."), found["name"], block)
        for name, value in words:
            if name == "S":
                self.set_speed(value, block)
            elif name == "F":
                self.set_feed(value, block)
                self.tool_feed = self.recorder.feed
        self.check_deltas([(name, value) for name, value in words if name[0] == "D"], block)

    def tcpm(self, found: re.Match[str] | None, block: int) -> None:
        """FUNCTION TCPM, or its end."""
        if found is None:
            self.recorder.control(False)
            self.recorder.spatial = False
            return
        feed, axis, path = found.groups()
        if feed == "CONT":
            self.recorder.find("CF115", "F CONT: feeds are those of the machine's axes, not of the tool point", block)
        self.recorder.control(True, Interpolation.VECTOR if path == "VECTOR" else Interpolation.AXIS)
        self.recorder.spatial = axis == "SPAT"

    def stop(self, rest: str, block: int) -> None:
        """STOP, perhaps with M functions."""
        self.recorder.event("STOP", block)
        if rest.strip():
            self.motion(self.split(rest), False, False, block)

    def function(self, found: re.Match[str], written: str, block: int) -> None:
        """FN n: Q = ..."""
        self.assign(found[2], partial(self.parameters.numbered, int(found[1]), found[3]), block)

    def jump(self, found: re.Match[str], written: str, block: int) -> None:
        """FN 9 to FN 12."""
        function, first, comparison, second = int(found[1]), found[2], found[3], found[4]
        if COMPARED[function] != comparison:
            self.recorder.find("CF101", f"block not understood: {written[:60]}", block)
            return
        label = found[5].lstrip("0") or "0" if found[5] else found[6]
        self.jump_if(self.parameters.holds(function, first, second), label, written, block)

    # --- arcs -------------------------------------------------------------------------------------------------------

    def polar(self, kind: str, words: Words, block: int) -> None:
        """LP and CP."""
        if kind == "CP":
            self.helix(words, block)
        elif self.polar_end(words, block):
            words.polar = {}
            self.motion(words, False, False, block)
        else:
            self.recorder.move(dict.fromkeys("XYZ"), None, False, block)

    def corner_block(self, kind: str, found: re.Match[str], written: str, block: int) -> None:
        """RND and CHF; a feed of their own holds for them alone, and is not followed."""
        if found[2] is not None:
            self.recorder.find("CF102", f"F in {kind} is not followed", block)
        size = self.parameters.value(found[1])
        self.set_corner(kind, None if size is None else size * self.unit, block)

    # --- coordinate systems -----------------------------------------------------------------------------------------

    def plane(self, text: str, block: int) -> None:
        """The PLANE function in all its forms."""
        recorder = self.recorder
        kind, _, rest = text.strip().partition(" ")
        moved = re.search(r"\b(STAY|MOVE|TURN)\b.*$", rest)
        tail = moved[0] if moved else ""
        if _MOVED.match(tail) is None:
            recorder.find("CF101", f"block not understood: PLANE {text[:60]}", block)
            self.not_followed("a tilted plane by this block", block)
            return
        if kind == "RESET":
            if rest[: len(rest) - len(tail)].strip():
                recorder.find("CF101", f"words not understood: {rest[:60]}", block)
            matrix: Matrix | None = Frame().tilt
            if recorder.unfollowed.startswith("a tilted plane"):
                recorder.unfollowed = ""
            self.reset_tilt(block)
        else:
            matrix = self.plane_matrix(kind, rest[: len(rest) - len(tail)])
            if matrix is None:
                self.not_followed(f"a tilted plane by PLANE {kind}", block)
                return
            if recorder.unfollowed.startswith("a tilted plane"):
                recorder.unfollowed = ""
            self.tilt(matrix, block)
        if not tail.startswith("STAY"):
            if recorder.controlled:
                recorder.find("CF113", f"PLANE {kind} turns axes while tool centre point control is active", block)
            rapid = re.search(r"F\s*MAX", tail) is not None
            if matrix == Frame().tilt:
                recorder.turn_upright(rapid, block)
            else:
                recorder.turn_into_plane(rapid, block)

    def plane_matrix(self, kind: str, text: str) -> Matrix | None:
        """The tilt that a PLANE function asks for; None where it is not followed."""
        values: dict[str, float] = {}
        place = 0
        text = text.rstrip()
        while place < len(text):
            found = _ANGLE_WORDS.match(text, place)
            value = None if found is None else self.parameters.value(found[2])
            if found is None or value is None or found[1] in values:
                return None
            values[found[1]] = value
            place = found.end()
        names, angles = set(values), {name: radians(value) for name, value in values.items()}
        if kind == "SPATIAL" and names == {"SPA", "SPB", "SPC"}:
            return spatial(angles["SPA"], angles["SPB"], angles["SPC"])
        if kind == "EULER" and names == {"EULPR", "EULNU", "EULROT"}:
            return euler(angles["EULPR"], angles["EULNU"], angles["EULROT"])
        if kind in ("RELATIV", "RELATIVE") and len(names) == 1 and names <= {"SPA", "SPB", "SPC"}:
            (name,) = names
            return further(self.recorder.frame.tilt, "XYZ"["ABC".index(name[-1])], angles[name])
        if kind == "VECTOR" and names == {"BX", "BY", "BZ", "NX", "NY", "NZ"}:
            base, normal = (tuple(values[f"{first}{letter}"] for letter in "XYZ") for first in "BN")
            return spanned(_three(base), _three(normal))
        return None

    def cycle(self, written: str, block: int) -> None:
        """The cycles that set frames and tolerances, dwell and orientation; any other is a finding."""
        find = self.recorder.find
        found = _CYCLE.match(written.upper())
        if found is None:
            find("CF101", f"block not understood: {written[:60]}", block)
            return
        cycle, line, rest = int(found[1]), found[2], (found[3] or "").strip()
        if cycle == 247 and line is None:
            self._end_cycle(block)
            preset = _PRESET.match(rest)
            if preset is None:
                find("CF101", f"block not understood: {written[:60]}", block)
            else:
                self.set_preset(preset[1], block)
            return
        lines = {7: self._shift, 8: self._mirror, 9: self._dwell, 10: self._rotation, 13: self._orientation}
        lines |= {19: self._tilt, 26: self._scaling, 32: self._tolerance}
        if cycle not in lines or line is None:
            self._end_cycle(block)
            find("CF102", f"cycle {cycle} is not followed", block)
            if cycle in (11, 12, 14) or line is None:
                self.recorder.unfollowed = f"cycle {cycle}"
            return
        if line == "0":
            self._end_cycle(block)
            self._cycle = (cycle, 0)
            return
        if self._cycle != (cycle, int(line) - 1):
            find("CF101", f"line {line} of cycle {cycle} does not follow the line before it", block)
        self._cycle = (cycle, int(line))
        lines[cycle](int(line), rest, block)

    def _end_cycle(self, block: int) -> None:
        """A cycle whose lines are not whole is none."""
        cycle, line = self._cycle
        self._cycle = (0, 0)
        if cycle and line == 0:
            self.recorder.find("CF101", f"cycle {cycle} without its line {cycle}.1", block)
        if cycle == 32 and line == 1 and self.recorder.tolerances[-1].value is not None:
            self.recorder.find("CF117", "cycle 32 without TA", block)

    def _shift(self, line: int, rest: str, block: int) -> None:
        self.shift_datum(self.split(rest), block)

    def _mirror(self, line: int, rest: str, block: int) -> None:
        letters = rest.split()
        if line > 1 or set(letters) - {"X", "Y"}:
            self.not_followed(f"mirroring of {rest[:20]}", block)
        else:
            self.mirror("".join(sorted(letters)), block)

    def _dwell(self, line: int, rest: str, block: int) -> None:
        self._only(rf"[A-Z.]*\s*{VALUE}$", rest, block)
        self.recorder.event("dwell (cycle 9)", block)

    def _orientation(self, line: int, rest: str, block: int) -> None:
        self._only(rf"[A-Z]*\s*{VALUE}$", rest, block)
        self.recorder.event("orientation of the spindle (cycle 13)", block)

    def _rotation(self, line: int, rest: str, block: int) -> None:
        found = re.fullmatch(rf"(I?)ROT\s*({VALUE})", rest)
        self.rotate(None if found is None else self.parameters.value(found[2]), bool(found and found[1]), block)

    def _tilt(self, line: int, rest: str, block: int) -> None:
        words = self.split(rest)
        matrix = self.spatial_angles(words, block)
        if matrix is not None:
            self.tilt(matrix, block)

    def _scaling(self, line: int, rest: str, block: int) -> None:
        factors = {"X": 1.0, "Y": 1.0, "Z": 1.0}
        for letter, text in re.findall(rf"([XYZ])\s*({NUMBER})", rest):
            factors[letter] = number(text)
        whole = re.fullmatch(rf"(?:\s*[XYZ]\s*{NUMBER})*", rest) is not None
        self.scale((factors["X"], factors["Y"], factors["Z"]) if whole else None, block)

    def _tolerance(self, line: int, rest: str, block: int) -> None:
        if line == 1:
            found = re.fullmatch(rf"(?:T\s*({VALUE}))?", rest)
            self._only(rf"(?:T\s*{VALUE})?$", rest, block)
            self.set_tolerance(found[1] if found else None, block)
        else:
            found = re.fullmatch(rf"(?:HSC-MODE\s*:\s*[01]\s*)?TA\s*({VALUE})", rest)
            if found is None or line > 2:
                self.recorder.find("CF101", f"words not understood: {rest[:60]}", block)
            else:
                self.set_rotary_tolerance(found[1], block)

    def _only(self, form: str, rest: str, block: int) -> None:
        if re.match(form, rest) is None:
            self.recorder.find("CF101", f"words not understood: {rest[:60]}", block)


def _three(values: Iterable[float]) -> Vector:
    x, y, z = values
    return (x, y, z)


def _upper_but_names(text: str) -> str:
    """Capitals everywhere but between quotes."""
    return "".join(part if odd else part.upper() for part, odd in _quoted(text))


def _quoted(text: str) -> Iterable[tuple[str, bool]]:
    for index, part in enumerate(re.split(r'("[^"]*")', text)):
        yield part, index % 2 == 1


def _jump(text: str) -> Jump | None:
    """What a block does to the order of blocks."""
    head = text[:1].upper()
    # Most blocks are motion: what cannot be of interest leaves first.
    if head not in "LCMES" or (head == "L" and text[1:2] in " N" and "M" not in text.upper().replace("FMAX", "")):
        return None
    text = text.upper()
    if found := _LABEL.match(text):
        return Jump("label", found[1].lstrip("0") or "0" if found[1] else found[2])
    if found := _CALL.match(text):
        name = found[1].lstrip("0") or "0" if found[1] else found[2]
        return Jump("call", name, int((found[4] or "0")[:9]) if found[3] else None)
    if text.startswith("END PGM"):
        return Jump("last")
    if head in "LMS" and _ENDING.match(text):
        return Jump("end")
    return None
