"""Reader of cutter location data as text: APT, and the CLSF of NX.

Every statement is followed, is on the list of those that change nothing, or is a finding. A statement that is not
followed and may have moved the cutter leaves it at a place that is not known.

Source: ISO 3592 and ISO 4343 (post processor words), as text; for CLSF the words that NX writes into its files.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from math import nan

from conflank_cli.verification.blocks import Block, lines_of
from conflank_cli.verification.findings import Finding
from conflank_cli.verification.numbers import MOST_FEED, MOST_TOOL, number
from conflank_cli.verification.program import (
    CutLabel,
    HeaderReader,
    Interpolation,
    Program,
)
from conflank_cli.verification.recorder import Recorder
from conflank_cli.verification.words import INCH, Vector

_HARMLESS = frozenset(
    (
        *("MACHIN", "CUTTER", "INTOL", "OUTTOL", "TOLER", "NOPOST", "CLPRNT", "REMARK", "LEADER", "SEQNO", "SELCTL"),
        *("SELECT", "DISPLY", "CLEARP", "TPRINT"),
        # NX: name of an operation, sizes of its tool (those that count are the job's), what its screen shows.
        *("TOOL PATH", "TLDATA", "PAINT"),
    )
)
"""Statements that change neither the motion nor the state of the machine."""

_FRAMES = frozenset(("COPY", "INDEX", "TRACUT", "TRANS", "ORIGIN", "ROTATE", "MSYS"))
"""Statements that put what comes after them somewhere else, until they are taken back."""

_BY_WORDS = frozenset(("PARTNO", "PPRINT", "REMARK", "TPRINT", "LEADER"))
"""Statements whose text may follow without a slash."""

_IDENTITY = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0)
"""MSYS that is the coordinate system of the part: origin, x and y."""

_COOLANT = {"ON": 8, "FLOOD": 8, "MIST": 7, "OFF": 0}

_MOST = 999_999.0
"""Largest coordinate that a data file may have, mm: what posts of such data take."""

_NUMBER = re.compile(r"\s*[+-]?(?:\d+(?:\.\d*)?|\.\d+)(?:[EeDd][+-]?\d{1,3})?\s*")


def split_statements(text: str) -> tuple[list[Block], list[Finding]]:
    """Statements by the line they begin in; ``$`` continues a line, ``$$`` begins a comment."""
    blocks: list[Block] = []
    pending, begun = "", 0
    lines, findings = lines_of(text)
    for line_number, line in enumerate(lines, start=1):
        content, mark, comment = line.partition("$$")
        content = content.strip()
        begun = begun if pending else line_number
        if content.endswith("$"):
            pending += content[:-1].rstrip()
            continue
        content, pending = pending + content, ""
        if content or mark:
            blocks.append(Block(begun, content, (comment.strip(),) if mark else (), False))
    if pending:
        blocks.append(Block(begun, pending, (), False))
    return blocks, findings


def read_apt(text: str) -> Program:
    """Read cutter location data.

    Parameters
    ----------
    text: the whole file.

    Returns
    -------
    What it states about itself, the poses that follow from it, and findings for all that does not.
    """
    blocks, findings = split_statements(text)
    header = HeaderReader()
    reading = _Reading(header)
    recorder = reading.recorder
    for finding in findings:
        recorder.findings[finding.code, finding.text] = finding
    for block in blocks:
        reading.follow(block)
    last = blocks[-1].number if blocks else 0
    if not reading.ended:
        recorder.find("CF101", "no FINI or END-OF-PATH: the data may be cut off", last)
    return Program(
        name=reading.name,
        header=header.header(),
        moves=recorder.moves(),
        cuts=tuple(recorder.cuts),
        tool_calls=tuple(recorder.tool_calls),
        letters="",
        tolerance=None,
        unknown_moves=recorder.unknown_moves,
        findings=tuple(recorder.findings.values()),
        unknown=tuple(recorder.unknown),
        events=tuple(recorder.events),
        control=False,
    )


class _Reading:
    """The state of one reading."""

    def __init__(self, header: HeaderReader) -> None:
        self.header = header
        self.recorder = Recorder(set(), True)
        self.recorder.control(True, Interpolation.VECTOR)
        self.axis: Vector = (0.0, 0.0, 1.0)
        self.point: Vector | None = None
        self.name = ""
        self.unit: float | None = None
        self.rapid = False
        self.speed: float | None = None
        self.way: float | None = None
        self.ended = False
        self.finished = False
        self._rules = {
            "GOTO": self.goto,
            "FROM": self.start,
            "GODLTA": self.step,
            "TLAXIS": self.tool_axis,
            "MULTAX": self.many_axes,
            "RAPID": self.at_rapid,
            "FEDRAT": self.feed,
            "RETRCT": self.retract,
            "GOHOME": self.home,
            "UNITS": self.units,
            "LOADTL": self.load,
            "TOOLNO": self.load,
            "LOAD": self.load_tool,
            "SPINDL": self.spindle,
            "COOLNT": self.coolant,
            "STOP": self.stop,
            "OPSTOP": self.stop,
            "DELAY": self.delay,
            "CUTCOM": self.compensation,
            "MSYS": self.system,
            "END": self.end,
            "FINI": self.finish,
        }

    def follow(self, block: Block) -> None:
        """Follow one statement."""
        for comment in block.comments:
            self.comment(comment)
        if not block.text:
            return
        if self.finished:
            self.recorder.find("CF119", "statements after FINI", block.number, "after FINI")
        major, slash, rest = block.text.partition("/")
        major = " ".join(major.upper().split())
        if not slash and major[:6] in _BY_WORDS:
            major, rest = major[:6], block.text.strip()[6:]
        if major not in _HARMLESS and major not in ("PARTNO", "PPRINT"):
            self.ended = False
        if major == "PARTNO":
            self.name = self.name or rest.strip()
        elif major == "PPRINT":
            self.comment(rest.strip())
        elif major in self._rules:
            if not self._rules[major]([word.strip().upper() for word in rest.split(",")], block.number):
                self.recorder.find("CF101", f"statement not understood: {block.text[:60]}", block.number)
        elif major == "END-OF-PATH":
            # NX ends an operation so, and its file with the last one.
            self.ended = True
        elif major not in _HARMLESS:
            self.unknown(major, rest, block.number)

    def comment(self, text: str) -> None:
        """A fact of the header, or a label of a cut."""
        label = self.header.read(text)
        if isinstance(label, CutLabel):
            self.recorder.label(label)

    def unknown(self, major: str, rest: str, block: int) -> None:
        """A statement without a rule: whatever it does, the machine may do it."""
        self.recorder.find("CF102", f"{major[:20]} is not followed", block)
        if major not in _FRAMES:
            # It may have moved the cutter.
            self.recorder.move(dict.fromkeys("XYZ"), None, False, block)
        elif "OFF" not in rest.upper() and "NOMORE" not in rest.upper():
            self.recorder.unfollowed = major

    # --- motion -----------------------------------------------------------------------------------------------------

    def goto(self, minor: Sequence[str], block: int) -> bool:
        """GOTO/x,y,z[,i,j,k]."""
        values = _values(minor)
        if len(values) not in (3, 6):
            self.recorder.move(dict.fromkeys("XYZ"), None, False, block)
            return False
        if len(values) == 6:
            self.axis = (values[3], values[4], values[5])
        unit = self.scale(block)
        self.go((values[0] * unit, values[1] * unit, values[2] * unit), block)
        return True

    def start(self, minor: Sequence[str], block: int) -> bool:
        """FROM: where the tool stands at the beginning; nothing is cut on the way there."""
        self.rapid = True
        return self.goto(minor, block)

    def step(self, minor: Sequence[str], block: int) -> bool:
        """GODLTA/dx,dy,dz."""
        values = _values(minor)
        if len(values) != 3:
            self.recorder.move(dict.fromkeys("XYZ"), None, False, block)
            return False
        if self.point is None:
            self.recorder.find("CF105", "increment from a position that is not known", block)
            self.recorder.move(dict.fromkeys("XYZ"), None, False, block)
            return True
        unit = self.scale(block)
        x, y, z = (place + way * unit for place, way in zip(self.point, values, strict=True))
        self.go((x, y, z), block)
        return True

    def go(self, point: Vector, block: int) -> None:
        """Move there; a rapid holds for one move."""
        if max(abs(value) for value in point) > _MOST:
            self.recorder.find("CF109", f"coordinate beyond {_MOST:g} mm", block, "coordinate")
            self.recorder.lose_place(block)
            return
        if not self.rapid and self.recorder.feed != self.recorder.feed:
            self.recorder.find("CF112", "move at a feed that is not known", block)
        x, y, z = point
        self.point = point
        self.recorder.move({"X": x, "Y": y, "Z": z}, self.axis, self.rapid, block)
        self.rapid = False

    def scale(self, block: int) -> float:
        """Millimetres in a unit of the data."""
        if self.unit is None:
            self.unit = 1.0
            self.recorder.find("CF102", "no UNITS before the first coordinates: read as millimetres", block)
        return self.unit

    def tool_axis(self, minor: Sequence[str], block: int) -> bool:
        """TLAXIS/i,j,k: for the statements that do not say it themselves."""
        values = _values(minor)
        if len(values) == 3:
            self.axis = (values[0], values[1], values[2])
        return len(values) == 3

    def many_axes(self, minor: Sequence[str], block: int) -> bool:
        """MULTAX: on, or off with the tool along z."""
        if minor[0] == "OFF":
            self.axis = (0.0, 0.0, 1.0)
        return minor[0] in ("", "ON", "OFF") and len(minor) == 1

    def at_rapid(self, minor: Sequence[str], block: int) -> bool:
        """RAPID: the next move. Whether the feed of before goes on after it is not the same everywhere."""
        self.rapid = True
        self.recorder.feed = nan
        return minor[0] == "" and len(minor) == 1

    def retract(self, minor: Sequence[str], block: int) -> bool:
        """RETRCT: along the tool axis to the limit."""
        self.recorder.to_limit(block)
        self.point = None
        return minor[0] == "" and len(minor) == 1

    def home(self, minor: Sequence[str], block: int) -> bool:
        """GOHOME: straight to a place that is the machine's."""
        if self.recorder.stands:
            self.recorder.find("CF105", "GOHOME without a retract before it: its way is not known", block)
        self.recorder.lose_place(block)
        self.point = None
        return minor[0] == "" and len(minor) == 1

    def system(self, minor: Sequence[str], block: int) -> bool:
        """MSYS: the coordinate system of an operation; only that of the part is followed."""
        values = _values(minor)
        if len(values) != len(_IDENTITY):
            return False
        if values != list(_IDENTITY):
            self.recorder.find("CF102", "MSYS other than the coordinate system of the part is not followed", block)
        self.recorder.unfollowed = "" if values == list(_IDENTITY) else "MSYS"
        return True

    def compensation(self, minor: Sequence[str], block: int) -> bool:
        """CUTCOM: off, or a finding."""
        if list(minor) != ["OFF"]:
            self.recorder.find("CF102", f"CUTCOM/{','.join(minor)[:40]} is not followed", block)
        return True

    # --- state ------------------------------------------------------------------------------------------------------

    def units(self, minor: Sequence[str], block: int) -> bool:
        """UNITS/MM or INCHES, once."""
        unit = {"MM": 1.0, "INCH": INCH, "INCHES": INCH}.get(minor[0])
        if unit is not None and self.unit not in (None, unit):
            self.recorder.find("CF109", "UNITS other than before", block)
        self.unit = unit or self.unit
        return unit is not None and len(minor) == 1

    def load_tool(self, minor: Sequence[str], block: int) -> bool:
        """LOAD/TOOL,n as NX writes it."""
        return minor[0] == "TOOL" and self.load(minor[1:], block)

    def load(self, minor: Sequence[str], block: int) -> bool:
        """LOADTL/n: another tool, by number or name, and what the machine is told about it."""
        recorder = self.recorder
        first, others = (minor[0], list(minor[1:])) if minor else ("", [])
        tool = int(first) if re.fullmatch(r"\d{1,5}", first) and int(first) <= MOST_TOOL else None
        recorder.control(False)
        recorder.call_tool(tool, None if tool is not None else first, block)
        recorder.control(True, Interpolation.VECTOR)
        self.point = None
        while others and _NUMBER.fullmatch(others[0]):
            # Numbers without a word name the tool again, or its place.
            others.pop(0)
        for word, value in zip(others[::2], [*others[1::2], ""], strict=False):
            own = word == "ADJUST" and value == first
            nothing = word in ("ZOFF", "ADJUST") and bool(_values([value])) and _values([value]) == [0.0]
            if not (own or nothing or word in ("LENGTH", "MANUAL", "AUTO")):
                recorder.find("CF102", f"{word},{value} of the tool call is not followed", block)
        return bool(first)

    def feed(self, minor: Sequence[str], block: int) -> bool:
        """FEDRAT: a number, and what it means (mm/min unless it says so)."""
        if self.rapid:
            self.recorder.find("CF115", "RAPID and FEDRAT before one move: which of them holds is not known", block)
        self.rapid = False
        values = _values([word for word in minor if _NUMBER.fullmatch(word)])
        words = {word for word in minor if not _NUMBER.fullmatch(word)}
        self.recorder.feed = nan
        if len(values) != 1 or not words <= {"MMPM", "IPM", "PERMIN", "FPM"} or len(words) != len(minor) - 1:
            self.recorder.find("CF102", f"FEDRAT/{','.join(minor)[:40]} is not followed", block)
            return True
        inches = "IPM" in words or ("MMPM" not in words and self.unit == INCH)
        feed = values[0] * (INCH if inches else 1.0)
        if 0.0 < feed <= MOST_FEED:
            self.recorder.feed = feed
        else:
            self.recorder.find("CF115", f"FEDRAT/{','.join(minor)[:40]} is no feed that a machine could drive", block)
        return True

    def spindle(self, minor: Sequence[str], block: int) -> bool:
        """SPINDL/speed,RPM,CLW in any order, ON, OFF."""
        recorder = self.recorder
        if list(minor) == ["OFF"]:
            if recorder.spindle != 0.0:
                recorder.event("SPINDL/OFF", block)
            recorder.spindle = 0.0
            return True
        values = _values([word for word in minor if _NUMBER.fullmatch(word)])
        words = [word for word in minor if not _NUMBER.fullmatch(word)]
        ways = [word for word in words if word in ("CLW", "CCLW")]
        known = {"RPM", "ON", "CLW", "CCLW"}
        if len(values) > 1 or len(ways) > 1 or not set(words) <= known or (not values and not words):
            recorder.find("CF114", f"SPINDL/{','.join(minor)[:40]} is not followed", block)
            recorder.spindle = nan
            return True
        if values:
            self.speed = values[0] if values[0] > 0.0 else None
        if ways:
            self.way = 1.0 if ways[0] == "CLW" else -1.0
        if self.speed is None or self.way is None:
            recorder.find("CF114", f"SPINDL/{','.join(minor)[:40]} leaves speed or direction open", block)
            recorder.spindle = nan
            return True
        if recorder.spindle * self.way < 0.0:
            recorder.event("SPINDL: the spindle turns round", block)
        recorder.spindle = self.way * self.speed
        return True

    def coolant(self, minor: Sequence[str], block: int) -> bool:
        """COOLNT: flood, mist or off."""
        if len(minor) != 1 or minor[0] not in _COOLANT:
            self.recorder.find("CF121", f"COOLNT/{','.join(minor)[:40]} is not followed", block)
        self.recorder.coolant = _COOLANT.get(minor[0], 0)
        return True

    def stop(self, minor: Sequence[str], block: int) -> bool:
        """STOP, OPSTOP: the machine waits, its spindle and coolant off."""
        self.recorder.event("stop", block)
        self.recorder.spindle, self.recorder.coolant = 0.0, 0
        return minor[0] == "" and len(minor) == 1

    def delay(self, minor: Sequence[str], block: int) -> bool:
        """DELAY/seconds: the machine waits."""
        self.recorder.event("dwell (DELAY)", block)
        return len(_values([word for word in minor if word != "REV"])) == 1

    def end(self, minor: Sequence[str], block: int) -> bool:
        """END: the machine's program ends."""
        self.recorder.spindle, self.recorder.coolant = 0.0, 0
        return minor[0] == "" and len(minor) == 1

    def finish(self, minor: Sequence[str], block: int) -> bool:
        """FINI: the data end."""
        self.ended = self.finished = True
        return minor[0] == "" and len(minor) == 1


def _values(minor: Sequence[str]) -> list[float]:
    """Numbers; empty where something else is among them."""
    if not all(_NUMBER.fullmatch(word) for word in minor):
        return []
    return [number(word.upper().replace("D", "E")) for word in minor]
