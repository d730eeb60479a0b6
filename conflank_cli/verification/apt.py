"""Reader of APT cutter location data as text: GOTO with tool axes, and the words around it.

Source: ISO 3592 and ISO 4343 (post processor words), as text.
"""

from __future__ import annotations

import re
from math import isfinite

from conflank_cli.verification.blocks import Block, lines_of
from conflank_cli.verification.findings import Finding
from conflank_cli.verification.numbers import NUMBER, number
from conflank_cli.verification.program import (
    CutLabel,
    HeaderReader,
    Interpolation,
    Program,
)
from conflank_cli.verification.recorder import Recorder
from conflank_cli.verification.words import INCH, Vector

_HARMLESS = (
    "PARTNO PPRINT MACHIN CUTTER SPINDL COOLNT INTOL OUTTOL TOLER NOPOST CLPRNT REMARK LEADER SEQNO STOP OPSTOP DELAY "
    "SELCTL SELECT DISPLY CLEARP TPRINT"
)
"""Words that do not move the cutter."""
_NUMBERS = re.compile(rf"\s*{NUMBER}(?:[EeDd][+-]?\d+)?\s*")


def split_statements(text: str) -> tuple[list[Block], list[Finding]]:
    """Statements by the line they begin in; ``$`` continues a line, ``$$`` begins a comment."""
    blocks: list[Block] = []
    pending, begun = "", 0
    lines, findings = lines_of(text)
    for line_number, line in enumerate(lines, start=1):
        content, mark, comment = line.strip("\x00\x1a").partition("$$")
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
    for finding in findings:
        reading.recorder.findings[finding.code, finding.text] = finding
    for block in blocks:
        reading.follow(block)
        if reading.ended:
            break
    recorder = reading.recorder
    last = blocks[-1].number if blocks else 0
    if not reading.ended:
        recorder.find("CF101", "no FINI: the data may be cut off", last)
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
        self.ended = False

    def follow(self, block: Block) -> None:
        """Follow one statement."""
        for comment in block.comments:
            self.comment(comment)
        major, _, rest = block.text.partition("/")
        major = major.strip().upper()
        if not major:
            return
        if major == "GOTO":
            self.goto(rest, block.number, False)
        elif not self.word(major, rest, block.number):
            self.recorder.find("CF102", f"{major[:20]} is not followed", block.number)
            if major not in ("CUTCOM", "COPY", "INDEX", "TRACUT", "TRANS", "ORIGIN", "ROTATE", "INSERT"):
                # It may have moved the cutter.
                self.recorder.move(dict.fromkeys("XYZ"), None, False, block.number)
            elif major != "INSERT" and "OFF" not in rest.upper() and "NOMORE" not in rest.upper():
                self.recorder.unfollowed = major

    def comment(self, text: str) -> None:
        """A fact of the header, or a label of a cut."""
        label = self.header.read(text)
        if isinstance(label, CutLabel):
            self.recorder.label(label)

    def word(self, major: str, rest: str, block: int) -> bool:
        """All statements but GOTO; whether it is one that is known."""
        recorder = self.recorder
        minor = [word.strip().upper() for word in rest.split(",")]
        if major.startswith(("PARTNO", "PPRINT")) and not rest:
            # These words may stand without a slash.
            major, rest = major[:6], major[6:].strip()
        if major == "PARTNO":
            self.name = self.name or rest.strip()
        elif major == "PPRINT":
            self.comment(rest.strip())
        elif major == "UNITS":
            self.unit = INCH if minor[0].startswith("IN") else 1.0
        elif major in ("LOADTL", "TOOLNO"):
            found = re.match(r"\s*(\d+)", rest)
            recorder.control(False)
            recorder.call_tool(int(found[1]) if found else None, None if found else rest.strip(), block)
            recorder.control(True, Interpolation.VECTOR)
        elif major == "RAPID":
            self.rapid = True
        elif major == "FEDRAT":
            self.feed(minor, block)
        elif major in ("RETRCT", "GOHOME"):
            recorder.to_limit(block)
            self.point = None
        elif major == "MULTAX":
            if minor[0] == "OFF":
                self.axis = (0.0, 0.0, 1.0)
        elif major == "TLAXIS":
            values = _values(rest)
            if len(values) == 3:
                self.axis = (values[0], values[1], values[2])
            else:
                recorder.find("CF101", f"statement not understood: TLAXIS/{rest[:40]}", block)
        elif major == "FROM":
            self.goto(rest, block, True)
        elif major == "GODLTA":
            values = _values(rest)
            if len(values) == 3 and self.point is not None:
                x, y, z = (a + b * self.scale(block) for a, b in zip(self.point, values, strict=True))
                self.go((x, y, z), block)
            else:
                recorder.find("CF105", "increment from a position that is not known", block)
                recorder.move(dict.fromkeys("XYZ"), None, False, block)
        elif major in ("FINI", "END"):
            self.ended = self.ended or major == "FINI"
        elif major == "CUTCOM":
            return minor[0] == "OFF"
        else:
            return major in _HARMLESS.split()
        return True

    def feed(self, minor: list[str], block: int) -> None:
        """FEDRAT: a number, and what it means (mm/min unless it says so)."""
        self.rapid = False
        values = [number(word) for word in minor if _NUMBERS.fullmatch(word)]
        words = [word for word in minor if not _NUMBERS.fullmatch(word)]
        if len(values) != 1 or any(word not in ("MMPM", "IPM", "PERMIN", "FPM") for word in words):
            self.recorder.feed = float("nan")
            self.recorder.find("CF102", f"FEDRAT/{','.join(minor)[:40]} is not followed", block)
            return
        inches = "IPM" in words or (not set(words) & {"MMPM"} and self.unit == INCH)
        self.recorder.feed = values[0] * (INCH if inches else 1.0)

    def goto(self, rest: str, block: int, start: bool) -> None:
        """GOTO/x,y,z[,i,j,k], or FROM."""
        values = _values(rest)
        if len(values) not in (3, 6):
            self.recorder.find("CF101", f"statement not understood: GOTO/{rest[:40]}", block)
            self.recorder.move(dict.fromkeys("XYZ"), None, False, block)
            return
        if len(values) == 6:
            self.axis = (values[3], values[4], values[5])
        unit = self.scale(block)
        point = (values[0] * unit, values[1] * unit, values[2] * unit)
        if start:
            # Where the tool stands at the beginning: nothing is cut on the way there.
            self.rapid = True
        self.go(point, block)

    def scale(self, block: int) -> float:
        """Millimetres in a unit of the data."""
        if self.unit is None:
            self.unit = 1.0
            self.recorder.find("CF102", "no UNITS before the first coordinates: read as millimetres", block)
        return self.unit

    def go(self, point: Vector, block: int) -> None:
        """Move there; a rapid holds for one move."""
        x, y, z = point
        self.point = point
        self.recorder.move({"X": x, "Y": y, "Z": z}, self.axis, self.rapid, block)
        self.rapid = False


def _values(text: str) -> list[float]:
    """Numbers between commas; empty where something else is among them."""
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        return []
    return values if all(isfinite(value) for value in values) else []
