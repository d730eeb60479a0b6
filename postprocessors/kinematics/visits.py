"""A tool path as the machine runs it: from each approach to its retract, with the rotary words of all poses."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from postprocessors.kinematics.two_rotary import Run, choose_words
from postprocessors.machines.machine import Machine
from postprocessors.toolpath import Purpose, Stretch, ToolPath, visits

Array = npt.NDArray[np.float64]


class VisitWords(NamedTuple):
    """One stay at the part, N poses of it.

    label: for messages; tool: its name; cut: number of its first cut; stretches: what it consists of; tip (N, 3) mm;
    words (N, 2) degrees.
    """

    label: str
    tool: str
    cut: int
    stretches: tuple[Stretch, ...]
    tip: Array
    words: Array


def visits_with_words(machine: Machine, path: ToolPath) -> tuple[VisitWords, ...]:
    """All visits of a tool path with their rotary words, chosen over the whole program.

    Raises
    ------
    PostError: a pose is out of reach or out of range.
    """
    found = [(operation.cutter.name, stretches) for operation in path.operations for stretches in visits(operation)]
    runs = [Run(visit_label(stretches), visit_axes(stretches)) for _, stretches in found]
    words = choose_words(machine, runs)
    return tuple(
        VisitWords(run.label, tool, stretches[0].cut, stretches, np.concatenate([s.tip for s in stretches]), chosen)
        for (tool, stretches), run, chosen in zip(found, runs, words, strict=True)
    )


def visit_label(stretches: tuple[Stretch, ...]) -> str:
    """How messages call a visit."""
    kind = "pass" if any(stretch.purpose is Purpose.PASS for stretch in stretches) else "sweep"
    first, last = stretches[0].cut, stretches[-1].cut
    if first != last:
        return f"cuts {first} to {last} with their links"
    return f"{kind} {first} with its approach"


def visit_axes(stretches: tuple[Stretch, ...]) -> Array:
    """Tool axes of a visit, (N, 3)."""
    axis = np.concatenate([stretch.axis for stretch in stretches])
    return np.asarray(axis / np.linalg.norm(axis, axis=1, keepdims=True))
