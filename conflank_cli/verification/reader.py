"""Reads programs in whichever of the known languages they are written."""

from __future__ import annotations

import re
from collections.abc import Iterable

from conflank_cli.verification.apt import read_apt
from conflank_cli.verification.conversational import Called, read_conversational
from conflank_cli.verification.iso import read_iso
from conflank_cli.verification.kinematics import Axes
from conflank_cli.verification.program import Program

_ISO = re.compile(r"\s*(?:N\d+\s*)?%|\s*N\d+\s*(?:;|G\d|[TM]\d)")
_APT = re.compile(r"^\s*(?:PARTNO|GOTO\s*/|LOADTL\s*/|MULTAX|FEDRAT\s*/|UNITS\s*/)", re.MULTILINE)


def read_program(
    text: str, called: Called | None = None, machine: Axes | None = None, harmless: Iterable[int] = ()
) -> Program:
    """Read a program: ISO where it begins with ``%`` or N numbers, APT where it looks so, else conversational.

    Parameters
    ----------
    text: the whole file.
    called: from the name of a file to the text of a program that this one calls; None where there is none.
    machine: the rotary axes of the machine that it is for; where it is not known they are told from the header or from
        the letters in use.
    harmless: M functions of that machine that change nothing that is judged.

    Returns
    -------
    What it states about itself, the poses that follow from it, and findings for all that does not.
    """
    head = text.lstrip("\ufeff\x00 \r\n\t")
    if _ISO.match(head):
        return read_iso(text, machine, harmless)
    if "BEGIN PGM" not in head[:10_000] and _APT.search(head):
        return read_apt(text)
    return read_conversational(text, called, machine, harmless)
