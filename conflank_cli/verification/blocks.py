"""From the bytes of a program to its blocks, split where the control splits them and nowhere else.

A line ends at LF or CR LF. Any other control character, and any character beyond ASCII, may be shown, dropped or taken
for an end of line by one control or editor and not by another: what the operator reads and what the machine runs would
then differ, so each is a finding.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from conflank_cli.verification.findings import Finding

_AT_THE_END = "\x00\x03\x04\x1a \t\r\n"
"""What serial transfers leave behind the last line: NUL, ETX, EOT and SUB."""

_STRANGE = re.compile(r"[^\x20-\x7e]")

_CONVERSATIONAL = re.compile(r"(/?)\s*(?:(\d+)(?=\s|$))?\s*(/?)\s*(.*)")
_ISO = re.compile(r"(/?)\s*(?:N\s*(\d+))?\s*(/?)\s*(.*)", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class Block:
    """One block: its number (or line), its text without comments, its comments, and whether it is skippable."""

    number: int
    text: str
    comments: tuple[str, ...]
    skippable: bool


def lines_of(text: str) -> tuple[list[str], list[Finding]]:
    """The lines of a program, and a finding for every kind of character that the control may take otherwise.

    Bytes that are no UTF-8, which come as lone surrogates (the text keeps its hash so), are letters of Latin-1 here: an
    old editor's umlaut in a comment may be quoted in a finding.
    """
    if not text.isascii() and any("\ud800" <= letter <= "\udfff" for letter in text):
        text = text.encode("utf-8", "surrogateescape").decode("latin-1")
    lines = [line.removesuffix("\r") for line in text.rstrip(_AT_THE_END).lstrip("\x00").split("\n")]
    found: dict[str, Finding] = {}
    if not text.isascii() or any(not line.isprintable() for line in lines):
        for number, line in enumerate(lines, start=1):
            for letter in _STRANGE.findall(line):
                words = (
                    f"character U+{ord(letter):04X} in line {number}: the control may not take it as it is read here"
                )
                first = found.setdefault(letter, Finding("CF119", words, number, count=0))
                found[letter] = Finding(first.code, first.text, first.block, count=first.count + 1)
    return lines, list(found.values())


def split_conversational(text: str) -> tuple[list[Block], list[Finding]]:
    """Blocks of a conversational program: numbers, skip marks, comments and continued lines (``~``) taken apart."""
    lines, findings = lines_of(text)
    blocks: list[Block] = []
    continued = False
    for line_number, line in enumerate(lines, start=1):
        content = line.strip()
        if not content:
            continue
        again = content.endswith("~")
        content = content[:-1].rstrip() if again else content
        code, mark, comment = content.partition(";")
        comments = (comment.strip(),) if mark else ()
        if continued:
            last = blocks[-1]
            blocks[-1] = Block(
                last.number, f"{last.text} {code.strip()}".strip(), last.comments + comments, last.skippable
            )
        else:
            blocks.append(_block(_CONVERSATIONAL, code, comments, line_number))
        continued = again
    return blocks, findings


def split_iso(text: str) -> tuple[list[Block], list[Finding]]:
    """Blocks of an ISO program: numbers, skip marks, comments and the mark of the end (``*``) taken apart."""
    lines, findings = lines_of(text)
    blocks: list[Block] = []
    for line_number, line in enumerate(lines, start=1):
        content = line.strip()
        if not content:
            continue
        content = content.removesuffix("*").rstrip()
        code, mark, comment = content.partition(";")
        comments = (comment.strip().removesuffix("*").rstrip(),) if mark else ()
        blocks.append(_block(_ISO, code.rstrip().removesuffix("*"), comments, line_number))
    return blocks, findings


def _block(form: re.Pattern[str], code: str, comments: tuple[str, ...], line_number: int) -> Block:
    found = form.match(code)
    assert found is not None
    before, name, after, rest = found.groups()
    # A number of any length is a name; only its beginning is of use.
    return Block(int(name[:15]) if name else line_number, rest.strip(), comments, bool(before or after))
