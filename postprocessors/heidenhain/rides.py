"""Rides: the stretches between two retracts to the limit, with the numbers that are printed for them.

A ride begins with the rotary axes brought to their places, fully retracted, and ends fully retracted again. A cut is
one ride, or several where it is left and entered again on the way (a retract followed by an approach).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import floor

import numpy as np
import numpy.typing as npt

from postprocessors.heidenhain.control import (
    COORDINATE_LIMIT,
    DECIMALS,
    FEED_LIMIT,
    VECTOR_DECIMALS,
    check_swing,
)
from postprocessors.kinematics.linear_axes import has_head, upright_words
from postprocessors.kinematics.visits import ends_upright, visit_axes, visit_label, visit_run, words_of_visits
from postprocessors.machines.machine import Machine
from postprocessors.path_checks import check_coordinates
from postprocessors.post import ProgramOptions
from postprocessors.toolpath import Stretch, ToolPath, visits

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Ride:
    """Stretches under tool centre point control, N poses in all, as they are printed.

    Attributes
    ----------
    stretches: as the tool path has them.
    letters: of the two rotary axes, in the order of the alphabet.
    turns: rotary words, (N, 2) degrees, in the order of the letters.
    tip: programmed points, (N, 3) mm, counted from the datum.
    axis: tool vectors, (N, 3).
    feed: whole mm/min; 0 means rapid.
    """

    stretches: tuple[Stretch, ...]
    letters: tuple[str, str]
    turns: Array
    tip: Array
    axis: Array
    feed: list[int]

    @property
    def upright(self) -> bool:
        """Whether the last pose is that in which the spindle stands upright."""
        return ends_upright(self.stretches)

    def begins_upright(self, machine: Machine) -> tuple[float, float] | None:
        """Rotary words, in the order of the letters: those of the first pose with head axes at 0; None without any."""
        if not has_head(machine):
            return None
        order = [self.letters.index(rotary.letter) for rotary in machine.rotary]
        words = upright_words(machine, self.turns[:1, order])[0]
        first, second = (float(words[order.index(column)]) for column in range(2))
        return first, second


def rides_of(path: ToolPath, machine: Machine, options: ProgramOptions) -> list[list[Ride]]:
    """The rides of every operation, with rotary words chosen over the whole program."""
    groups = [visits(operation) for operation in path.operations]
    every = [stretches for group in groups for stretches in group]
    words = words_of_visits(machine, every)
    for stretches, chosen in zip(every, words, strict=True):
        run = visit_run(stretches)
        # Where the head goes upright either way between the two poses will do.
        check_swing(machine, run, chosen[: len(run.axis)])
    remaining = iter(words)
    shift = np.zeros(3) if isinstance(options.datum, int) else np.array(options.datum, dtype=np.float64)
    return [[_ride(stretches, next(remaining), machine, shift) for stretches in group] for group in groups]


def _ride(stretches: tuple[Stretch, ...], words: Array, machine: Machine, shift: Array) -> Ride:
    tip = np.concatenate([stretch.tip for stretch in stretches]) - shift
    feed = np.concatenate([stretch.feed for stretch in stretches])
    check_coordinates(visit_label(stretches), tip, COORDINATE_LIMIT)
    letters = [rotary.letter for rotary in machine.rotary]
    order = sorted(range(2), key=lambda column: letters[column])
    return Ride(
        stretches=stretches,
        letters=(letters[order[0]], letters[order[1]]),
        turns=_printed_words(words, machine)[:, order],
        # Adding zero turns -0 into +0.
        tip=np.round(tip, DECIMALS) + 0.0,
        axis=_printed_vectors(visit_axes(stretches)),
        feed=_printed_feeds(feed, machine),
    )


def _printed_words(words: Array, machine: Machine) -> Array:
    words = np.round(words, DECIMALS) + 0.0
    for column, rotary in enumerate(machine.rotary):
        if rotary.output == "modulo":
            words[:, column] = np.where(words[:, column] >= 360.0, words[:, column] - 360.0, words[:, column])
    return words


def _printed_vectors(axis: Array) -> Array:
    """Rounded so that the length stays 1: the largest component follows from the other two."""
    rounded = np.round(axis, VECTOR_DECIMALS)
    rows, largest = np.arange(len(axis)), np.abs(axis).argmax(axis=1)
    rest = (rounded**2).sum(axis=1) - rounded[rows, largest] ** 2
    rounded[rows, largest] = np.copysign(np.sqrt(1.0 - rest), axis[rows, largest])
    return np.asarray(np.round(rounded, VECTOR_DECIMALS) + 0.0)


def _printed_feeds(feed: Array, machine: Machine) -> list[int]:
    """Whole mm/min, at least 1, at most what machine and control take; 0 means rapid."""
    limit = min(floor(machine.max_feed_mm_min), FEED_LIMIT)
    whole = np.where(feed > 0.0, np.clip(np.round(feed), 1.0, max(limit, 1.0)), 0.0)
    return [int(value) for value in whole]
