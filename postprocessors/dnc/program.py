"""A program as it lies in a file: what is checked before it goes out, its lines, and what drip feed asks of it."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from hashlib import sha256
from math import dist, inf
from pathlib import Path

from postprocessors.dnc.profile import Profile
from postprocessors.dnc.wire import is_text
from postprocessors.errors import PostError

LONGEST_LINE = 1024
"""Characters; blocks of programs are a tenth of it, and a line without end would fill the memory."""
LARGEST = 1 << 30
"""Bytes of a program, which is kept in memory: a device without end must not fill it."""
BLOCK_OVERHEAD, LINE_OVERHEAD = 5, 2
"""Characters on the line besides the text: STX, ETB, BCC, DC1, ACK; or CR LF."""
STANDING_MM = 1e-3
"""Moves of the tip shorter than this are turns, which feed in mm/min does not describe."""

_BEGIN = re.compile(rb"\s*\d*\s*BEGIN PGM (\S+) (?:MM|INCH)\s*|%(\S+) G7[01]\b.*")
_END = re.compile(rb"\s*\d*\s*END PGM \S+ (?:MM|INCH)\s*|N9+ %\S+ G7[01]\b.*")
_JUMPS = (
    (re.compile(rb"\b(?:CALL\s+)?LBL\b"), "a label"),
    (
        re.compile(rb"\bCALL PGM\b|\bPGM CALL\b|\bSEL PGM\b|\bCALL SELECTED\b|\bCYCL DEF 12\b|%:|\bG39\b"),
        "a program call",
    ),
    (re.compile(rb"\bFN ?(?:9|10|11|12)\b|\bD(?:09|10|11|12)\b"), "a jump"),
    (re.compile(rb"\bG98\b|^N\d+ L\d+,\d+"), "a label"),
)
_WORD = re.compile(rb"\b(I?)([XYZ])([+-]?\d+(?:[.,]\d*)?|[+-]?[.,]\d+)")
_FEED = re.compile(rb"\bF(\d+(?:[.,]\d*)?)")


@dataclass(frozen=True, slots=True)
class Program:
    """A program that may go over the wire: the bytes that were read once, and what was found in them.

    Attributes
    ----------
    path: its file.
    data: its bytes. Whatever becomes of the file, these are what is hashed, checked and sent.
    name: as its first line has it, or the file's stem.
    named: whether the first line has it.
    ended: whether the last line ends a program.
    lines, longest: lines, characters of the longest line.
    plain: whether every line ends in CR LF, so that what the control gets is the file's bytes.
    sha256: of `data`.
    """

    path: Path
    data: bytes
    name: str
    named: bool
    ended: bool
    lines: int
    longest: int
    plain: bool
    sha256: str

    @property
    def size(self) -> int:
        """Bytes of the file."""
        return len(self.data)

    def text(self) -> Iterator[bytes]:
        """The lines without their ends."""
        for raw in _raw_lines(self.data):
            yield _stripped(raw)

    @property
    def sent_bytes(self) -> int:
        """Bytes that the control gets as text, each line with CR LF."""
        return self.size if self.plain else sum(len(line) + 2 for line in self.text())


def read_program(path: Path, profile: Profile, follow: bool = True) -> Program:
    """Read a program, once, and check that the protocol can carry it.

    Without `follow` a path that has become a link is not read.

    Raises
    ------
    PostError: not readable, empty, too large, or with characters that the protocol cannot carry.
    """
    data = _read(path, follow)
    count = longest = 0
    plain = True
    first = last = b""
    for raw in _raw_lines(data):
        count += 1
        plain &= raw.endswith(b"\r\n")
        last = _stripped(raw)
        longest = max(longest, len(last))
        if longest > LONGEST_LINE:
            found = f"more than {LONGEST_LINE} characters"
            raise PostError(f"{path}: line {count}", found, "a block of a program", "Is it a program?")
        first = first or last
        for place, character in enumerate(last, 1):
            if not is_text(character, profile.data_bits):
                found = f"character 0x{character:02X}"
                expected = f"printable characters of {profile.data_bits} bits"
                raise PostError(f"{path}: line {count}, column {place}", found, expected, "Take it out of the file.")
    if not count:
        raise PostError(str(path), "an empty file", "a program", "Check its path.")
    match = _BEGIN.fullmatch(first)
    name = (match[1] or match[2]).decode("latin-1") if match else path.name.partition(".")[0]
    return Program(
        path, data, name, match is not None, ends_program(last), count, longest, plain, sha256(data).hexdigest()
    )


def name_in(line: bytes) -> str | None:
    """The name that a first line gives its program; None if it is no first line."""
    match = _BEGIN.fullmatch(line)
    return (match[1] or match[2]).decode("latin-1") if match else None


def ends_program(line: bytes) -> bool:
    """Whether a line is the last one of a program."""
    return _END.fullmatch(line) is not None


def _read(path: Path, follow: bool) -> bytes:
    def opened(name: str, flags: int) -> int:
        return os.open(name, flags if follow else flags | getattr(os, "O_NOFOLLOW", 0))

    try:
        with open(path, "rb", opener=opened) as stream:
            data = stream.read(LARGEST + 1)
    except OSError as error:
        raise PostError(str(path), f"no readable file ({error.strerror})", "a program", "Check its path.") from None
    if len(data) > LARGEST:
        raise PostError(str(path), f"more than {LARGEST >> 20} MB", "a program", "Is it a program?")
    return data


def _raw_lines(data: bytes) -> Iterator[bytes]:
    """The lines with their ends."""
    start = 0
    while start < len(data):
        end = data.find(b"\n", start) + 1 or len(data)
        yield data[start:end]
        start = end


def _stripped(raw: bytes) -> bytes:
    """A line without its one line end."""
    return raw.removesuffix(b"\n").removesuffix(b"\r")


@dataclass(frozen=True, slots=True)
class FeedLimit:
    """What the line rate allows, mm/min.

    Attributes
    ----------
    sustained: all ways over all times on the line: the control's buffer evens out single blocks at best to this.
    least, least_line: of the block whose way is shortest for its length, and the number of its line.
    moves, over: moves with a feed, and how many of them are programmed faster than their own block's limit.
    """

    sustained: float
    least: float
    least_line: int
    moves: int
    over: int


def check_drip(program: Program) -> None:
    """Refuse what a control cannot execute while each block is deleted after it.

    Raises
    ------
    PostError: a jump, a label or a call.
    """
    for number, line in enumerate(program.text(), 1):
        code = line.partition(b";")[0].upper()
        for pattern, what in _JUMPS:
            if pattern.search(code):
                found = f"{what}: {line.decode('latin-1').strip()}"
                expected = "blocks that are executed once, in their order"
                raise PostError(f"{program.path}: line {number}", found, expected, "Send it whole: conflank dnc send.")


def feed_limit(program: Program, profile: Profile, turnaround_s: float = 0.0) -> FeedLimit:
    """The feed above which the machine waits for the line.

    `turnaround_s` is what the control and this computer need between two blocks, besides the characters.
    """
    at: dict[bytes, float] = {}
    feed = 0.0
    length = seconds = waiting = 0.0
    least, least_line = inf, 0
    moves = over = 0
    overhead = BLOCK_OVERHEAD if profile.blockwise else LINE_OVERHEAD
    for number, line in enumerate(program.text(), 1):
        code = line.partition(b";")[0]
        # A block that does not move takes its time on the line before the next that does.
        waiting += (len(line) + overhead) * profile.character_s + turnaround_s
        if found := _FEED.search(code):
            feed = float(found[1].replace(b",", b"."))
        words = _WORD.findall(code)
        if not words or b"CYCL" in code or b"BLK FORM" in code:
            continue
        before = dict(at)
        for relative, axis, value in words:
            at[axis] = float(value.replace(b",", b".")) + (at.get(axis, 0.0) if relative else 0.0)
        way = dist([before.get(axis, value) for axis, value in at.items()], list(at.values()))
        if not before:
            # Where the first move starts is not known, nor how long it takes.
            waiting = 0.0
        if way < STANDING_MM:
            continue
        if b"FMAX" not in code:
            limit = 60.0 * way / waiting
            length, seconds = length + way, seconds + waiting
            moves += 1
            over += feed > limit
            if limit < least:
                least, least_line = limit, number
        waiting = 0.0
    return FeedLimit(60.0 * length / seconds if seconds else inf, least, least_line, moves, over)
