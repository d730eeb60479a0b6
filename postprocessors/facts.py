"""What a program states about itself, for whoever reads it independently; every post wraps it in its own comments."""

from __future__ import annotations

import re
from collections.abc import Iterator

from postprocessors.machines.machine import Machine
from postprocessors.post import ProgramOptions
from postprocessors.toolpath import Cutter, ToolPath

DECIMALS = 4
"""Of lengths."""
_X, _Y, _Z = [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]
_USUAL = {"CA": [_Z, _X], "CB": [_Z, _Y], "AB": [_X, _Y]}
"""Pairs whose letters say all: tables and heads in ISO sense."""


def facts(path: ToolPath, machine: Machine, options: ProgramOptions, width: int) -> Iterator[str]:
    """The facts, one a line; a long list of faces takes lines of up to `width` characters, each of the same form."""
    yield f"CONFLANK {plain(options.version)}"
    part, faces = plain(path.part), list(path.faces)
    while True:
        room = width - len(f"PART {part} FACE ")
        text, count = str(faces[0]), 1
        while count < len(faces) and len(text) + 1 + len(str(faces[count])) <= room:
            text += f",{faces[count]}"
            count += 1
        yield f"PART {part} FACE {text}"
        faces = faces[count:]
        if not faces:
            break
    for cutter in cutters(path):
        cone = f"R_MIN {short(cutter.r_min)} R_MAX {short(cutter.r_max)} LENGTH {short(cutter.length)}"
        yield f"TOOL {cutter.number} {plain(cutter.name)} {cone}"
    yield "REFERENCE TIP"
    yield f"MACHINE {plain(machine.name)}"
    yield from _rotary(machine)
    yield f"STYLE {options.style}"
    yield f"FRAME {path.frame}"


def _rotary(machine: Machine) -> Iterator[str]:
    """Directions of the rotary axes, in the order of t = R(first) R(second) z, unless their letters tell them."""
    letters = "".join(rotary.letter for rotary in machine.rotary)
    directions = [[float(value) for value in rotary.sign * rotary.direction] for rotary in machine.rotary]
    if _USUAL.get(letters) != directions:
        for letter, direction in zip(letters, directions, strict=True):
            yield f"ROTARY {letter} " + " ".join(short(round(value, 12) + 0.0, 12) for value in direction)


def cutters(path: ToolPath) -> list[Cutter]:
    """The tools in order of first use, each once."""
    return list(dict.fromkeys(operation.cutter for operation in path.operations))


def plain(text: str) -> str:
    """Text that is safe in a comment: one word of printable ASCII (a tilde would continue a block)."""
    return re.sub(r"[^!-}]", "_", text)[:40] or "_"


def short(value: float, decimals: int = DECIMALS) -> str:
    """A number without trailing zeros."""
    return f"{value:.{decimals}f}".rstrip("0").rstrip(".")
