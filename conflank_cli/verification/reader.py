"""Reads programs in whichever of the known languages they are written."""

from __future__ import annotations

import re

from conflank_cli.verification.apt import read_apt
from conflank_cli.verification.conversational import Called, read_conversational
from conflank_cli.verification.iso import read_iso
from conflank_cli.verification.program import Program

_BEFORE = "\ufeff\x00 \r\n\t"
"""What may stand before the first word."""
_ISO = re.compile(r"\s*(?:N\d+\s*)?%|\s*N\d+\s*(?:;|G\d|[TM]\d)")
_APT = re.compile(r"^\s*(?:PARTNO|GOTO\s*/|LOADTL\s*/|MULTAX|FEDRAT\s*/|UNITS\s*/)", re.MULTILINE)


def is_apt(text: str) -> bool:
    """Whether a program is APT data: tool axes for no machine in particular."""
    head = text.lstrip(_BEFORE)
    return not _ISO.match(head) and "BEGIN PGM" not in head[:10_000] and _APT.search(head) is not None


def read_program(text: str, called: Called | None = None) -> Program:
    """Read a program: ISO where it begins with ``%`` or N numbers, APT where it looks so, else conversational.

    Parameters
    ----------
    text: the whole file.
    called: from the name of a file to the text of a program that this one calls; None where there is none.

    Returns
    -------
    What it states about itself, the poses that follow from it, and findings for all that does not.
    """
    if is_apt(text):
        return read_apt(text)
    if _ISO.match(text.lstrip(_BEFORE)):
        return read_iso(text)
    return read_conversational(text, called)
