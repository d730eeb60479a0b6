"""A tool path as the machine runs it: from each approach to its retract, with the rotary words of all poses."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from postprocessors.errors import PostError
from postprocessors.kinematics.linear_axes import upright_words
from postprocessors.kinematics.two_rotary import Run, choose_words, forward
from postprocessors.machines.machine import Machine
from postprocessors.toolpath import Purpose, Stretch, ToolPath, visits

Array = npt.NDArray[np.float64]

UPRIGHT_SLACK = 1e-6
"""By which the axis of an upright pose may differ from that of its words: rounding."""


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
    words = words_of_visits(machine, [stretches for _, stretches in found])
    return tuple(
        VisitWords(
            visit_label(stretches),
            tool,
            stretches[0].cut,
            stretches,
            np.concatenate([s.tip for s in stretches]),
            chosen,
        )
        for (tool, stretches), chosen in zip(found, words, strict=True)
    )


def visit_run(stretches: tuple[Stretch, ...]) -> Run:
    """The poses of a visit whose rotary words are to be chosen: all but the upright one at its end."""
    if ends_upright(stretches):
        stretches = stretches[:-1]
    return Run(visit_label(stretches), visit_axes(stretches))


def ends_upright(stretches: tuple[Stretch, ...]) -> bool:
    """Whether a visit ends with the spindle brought upright."""
    return stretches[-1].purpose is Purpose.UPRIGHT


def words_of_visits(machine: Machine, found: Sequence[tuple[Stretch, ...]]) -> list[Array]:
    """Rotary words (N, 2), degrees, of all poses of each visit, chosen over the whole program.

    Raises
    ------
    PostError: a pose is out of reach or out of range, or an upright pose is not upright on this machine.
    """
    words = choose_words(machine, [visit_run(stretches) for stretches in found])
    for index, stretches in enumerate(found):
        if not ends_upright(stretches):
            continue
        last, wanted = upright_words(machine, words[index][-1:]), visit_axes(stretches[-1:])
        off = float(np.abs(forward(machine, last) - wanted).max())
        if len(wanted) != 1 or off > UPRIGHT_SLACK:
            x, y, z = wanted[-1]
            raise PostError(
                f"{visit_label(stretches)}, last pose",
                f"tool axis ({x:.6f}, {y:.6f}, {z:.6f})",
                f"one pose with the head axes of {machine.name} at 0",
                "Make the tool path for this machine.",
            )
        words[index] = np.vstack([words[index], last])
    return words


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
