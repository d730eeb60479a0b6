"""Whether the axes of the job's machine go as far as a program asks."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from conflank_cli.verification.findings import Finding
from conflank_cli.verification.machine import MachineModel
from conflank_cli.verification.program import UnknownMove
from conflank_cli.verification.ways import Ways

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

ANGLE_ROUNDING = 1e-4
"""A word may pass the end of a range by this much, degrees: it has four decimals."""

PLACE_ROUNDING = 1e-3
"""A position may pass the end of a travel by this much, mm: words have four decimals, and a tilt acts on a long arm."""


def out_of_range(machine: MachineModel, ways: Ways) -> tuple[Finding, ...]:
    """A finding for each rotary axis that is sent out of its range, at the worst block.

    Parameters
    ----------
    machine: the job's machine.
    ways: all moves, and those without a pose, whose rotary words count as well.
    """
    moves, rotary, unknown = ways.moves, ways.rotary, ways.unknown
    findings = []
    for column, axis in enumerate(machine.rotary):
        words = [(float(move.words[axis.letter] or 0.0), move.block) for move in unknown if _has(move, axis.letter)]
        place = np.degrees(np.concatenate([rotary[:, column], [word for word, _ in words]]))
        block = np.concatenate([moves.block, [number for _, number in words]]).astype(np.int64)
        limits = (float(np.degrees(axis.low)), float(np.degrees(axis.high)))
        findings += _beyond("CF401", axis.letter, place, block, limits, ANGLE_ROUNDING, "deg")
    return tuple(findings)


def _has(move: UnknownMove, letter: str) -> bool:
    return move.words.get(letter) is not None


def out_of_travel(machine: MachineModel, ways: Ways, tip: Array, zero: Array, lengths: Array) -> tuple[Finding, ...]:
    """A finding for each of X, Y and Z that would have to leave its travel, at the worst block.

    Between two blocks the tip goes straight and the nose does not: the middle of each block counts as well. On ways off
    the part, which are followed on the machine itself, it is the other way round.

    Parameters
    ----------
    machine: the job's machine.
    ways: all moves, with the positions of the rotary axes.
    tip: tips in the program's frame, (N, 3) mm.
    zero: the program's datum in machine coordinates with the rotary axes at zero, (3,) mm.
    lengths: from tip to nose at each move, (N,) mm, NaN where not known.
    """
    moves, rotary = ways.moves, ways.rotary
    nose = machine.nose(tip, rotary, zero, lengths)
    block = moves.block
    inner = np.flatnonzero(moves.joined & ~ways.added & np.isfinite(rotary).all(axis=1))
    inner = inner[inner > 0]
    halfway = 0.5 * (rotary[inner - 1] + rotary[inner])
    middle = machine.nose(0.5 * (tip[inner - 1] + tip[inner]), halfway, zero, lengths[inner])
    nose, block = np.concatenate([nose, middle]), np.concatenate([block, block[inner]])
    findings: list[Finding] = []
    for column, letter in enumerate("XYZ"):
        findings += _beyond("CF402", letter, nose[:, column], block, machine.travel[column], PLACE_ROUNDING, "mm")
    return tuple(findings)


def _beyond(
    code: str, letter: str, place: Array, block: Integers, limits: tuple[float, float], rounding: float, unit: str
) -> list[Finding]:
    """One finding where positions (N,) leave their limits, at the one that is farthest out."""
    low, high = limits
    excess = np.where(np.isfinite(place), np.maximum(low - place, place - high), -np.inf)
    count = int((excess > rounding).sum())
    if not count:
        return []
    worst = int(excess.argmax())
    limit = high if place[worst] > high else low
    what = "range" if unit == "deg" else "travel"
    text = f"{letter}{place[worst]:+.4f} is out of the axis's {what} {low:g} .. {high:g} {unit}, block {block[worst]}"
    amount = round(float(place[worst]), 6)
    return [Finding(code, text, int(block[worst]), None, amount, round(limit, 6), unit, count)]
