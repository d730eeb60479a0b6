"""The order of a program for the iTNC 530, which conversational and ISO programs share.

A tool is called and the control brought to a known state (no tool centre point control, no tilted plane, datum,
tolerance) before anything moves; every positioning of the rotary axes happens fully retracted and without tool centre
point control; that is on exactly from there to the last pose of the retract. The first move under it goes by rapid from
the retracted position to the first pose of the path, where the whole tool is above the part along machine Z, as it is
at the limit: so it is on all of the straight line between them. No X Y positioning precedes it: without tool centre
point control, X and Y would not mean part coordinates once a table has turned.

On a machine with a head axis the spindle is turned upright before every retract, above the part and under tool centre
point control, so that the retract along the tool axis is one along machine Z. How the head stands at the start of a
program is not known: the tool is retracted as it is, turned upright, and retracted again.
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import groupby
from typing import NamedTuple

from postprocessors.errors import PostError
from postprocessors.facts import facts
from postprocessors.heidenhain.control import BLOCK_LIMIT, DECIMALS, check_name, check_program, check_text
from postprocessors.heidenhain.rides import Ride, rides_of
from postprocessors.machines.machine import Machine
from postprocessors.post import Post, ProgramFile, ProgramOptions, check_options, own_option
from postprocessors.toolpath import Cutter, Purpose, Stretch, ToolPath

_COMMENT = "; "
_NUMBER_SPACE = 12
"""Characters of a block that its number, and what ends it, may take."""
_POINT = re.compile(r"(?<=[A-Z+-])(\d+)\.(?=\d)")
"""The decimal point of a word; not of the name of a cycle (CYCL DEF 32.0)."""


class Dialect(ABC):
    """How the control wants its blocks: without number, without what ends them."""

    post: Post
    on: str
    """Tool centre point control on; `off` switches it off."""
    off: str
    call: str
    """What runs another program, before its name; only where the post splits."""

    @abstractmethod
    def opening(self, path: ToolPath) -> Iterator[str]:
        """Name and blank."""

    @abstractmethod
    def tool_call(self, cutter: Cutter) -> str:
        """Tool and speed."""

    @abstractmethod
    def datum(self, options: ProgramOptions) -> Iterator[str]:
        """Preset, or shift of the datum."""

    @abstractmethod
    def datum_reset(self) -> Iterator[str]:
        """No shift of the datum any more."""

    @abstractmethod
    def tolerance(self, options: ProgramOptions, cutter: Cutter) -> Iterator[str]:
        """Cycle 32."""

    @abstractmethod
    def tolerance_reset(self) -> Iterator[str]:
        """Cycle 32 as the builder set it."""

    @abstractmethod
    def retract(self, machine: Machine) -> str:
        """As far up as the machine goes."""

    def structure(self, stretches: Sequence[Stretch]) -> Iterator[str]:
        """What the control's list of contents shows of one cut, if anything."""
        return iter(())

    @abstractmethod
    def turn(self, words: str, start: bool) -> str:
        """Rotary axes to their places; `start` the spindle as well."""

    @abstractmethod
    def poses(self, ride: Ride) -> list[str]:
        """Points and axes of a ride as words."""

    @abstractmethod
    def first(self, pose: str) -> str:
        """The first pose of a ride, at rapid, without compensation."""

    @abstractmethod
    def sided(self, pose: str, side: str) -> str:
        """A pose from whose block on RL, RR or no compensation (R0) holds."""

    @abstractmethod
    def rapid(self, pose: str) -> str:
        """A pose at rapid."""

    @abstractmethod
    def cut(self, pose: str, feed: int | None) -> str:
        """A pose at feed; None: the feed stays."""

    @abstractmethod
    def text(self, blocks: list[str]) -> list[str]:
        """Lines of the file, with numbers."""

    @abstractmethod
    def closing(self, path: ToolPath) -> str:
        """The last block."""


def write_programs(
    path: ToolPath, machine: Machine, options: ProgramOptions, dialect: Dialect
) -> tuple[ProgramFile, ...]:
    """The program of a path, or the one that calls its parts, and the parts."""
    check_options(dialect.post, options)
    check_program(path, options)
    # Chosen over the whole program, however it is split.
    work = [
        _Work(operation.cutter, rides)
        for operation, rides in zip(path.operations, rides_of(path, machine, options), strict=True)
    ]
    if options.split == "none":
        return (ProgramFile(path.name, _program(path, work, machine, options, dialect, called=False)),)
    if options.split == "sweep":
        work = [
            _Work(cutter, list(rides))
            for cutter, several in work
            for _, rides in groupby(several, key=lambda ride: ride.stretches[0].cut)
        ]
    digits = len(str(len(work)))
    names = [f"{path.name}_{number:0{digits}d}" for number in range(1, len(work) + 1)]
    for name in names:
        check_name(name)
    parts = []
    for name, piece in zip(names, work, strict=True):
        operations = tuple(operation for operation in path.operations if operation.cutter == piece.cutter)
        part = replace(path, name=name, operations=operations)
        parts.append(ProgramFile(name, _program(part, [piece], machine, options, dialect, called=True)))
    blocks = [*dialect.opening(path), *_facts(path, machine, options), *(f"{dialect.call} {name}" for name in names)]
    return ProgramFile(path.name, _text([*blocks, "M30", dialect.closing(path)], options, dialect)), *parts


class _Work(NamedTuple):
    """One tool, and what it rides."""

    cutter: Cutter
    rides: list[Ride]


def _program(
    path: ToolPath, work: list[_Work], machine: Machine, options: ProgramOptions, dialect: Dialect, called: bool
) -> str:
    """One program; one that is `called` does not end the one that calls it."""
    blocks = [*dialect.opening(path), *_facts(path, machine, options)]
    for index, (cutter, rides) in enumerate(work):
        blocks += _tool(cutter, rides[0], machine, options, dialect, first=index == 0)
        for number, ride in enumerate(rides):
            blocks += _ride(ride, machine, options, dialect, first=number == 0)
        if options.coolant != "none":
            blocks.append("M9")
        blocks.append("M5")
    blocks += dialect.tolerance_reset()
    if not isinstance(options.datum, int):
        blocks += dialect.datum_reset()
    blocks.append("M127")
    if not called:
        blocks.append("M30")
    return _text([*blocks, dialect.closing(path)], options, dialect)


def _facts(path: ToolPath, machine: Machine, options: ProgramOptions) -> Iterator[str]:
    width = BLOCK_LIMIT - _NUMBER_SPACE - len(_COMMENT)
    return (_COMMENT + fact for fact in facts(path, machine, options, width))


def _text(blocks: list[str], options: ProgramOptions, dialect: Dialect) -> str:
    if own_option(dialect.post, options, "decimal", "point", "comma") == "comma":
        blocks = [block if block.startswith(_COMMENT) else _POINT.sub(r"\1,", block) for block in blocks]
    lines = dialect.text(blocks)
    check_text(lines)
    return "\r\n".join(lines) + "\r\n"


def _tool(
    cutter: Cutter, ride: Ride, machine: Machine, options: ProgramOptions, dialect: Dialect, first: bool
) -> Iterator[str]:
    """The tool, and the control in a known state; `first` of the program: nothing is known yet. `ride` comes next."""
    yield dialect.tool_call(cutter)
    yield dialect.off
    yield "PLANE RESET STAY"
    if first:
        yield from dialect.datum(options)
    yield from dialect.tolerance(options, cutter)
    yield dialect.retract(machine)
    if first:
        # M126 takes the shorter way where a display is reduced to 0 .. 360; counted turns must be taken as written.
        yield "M126" if any(rotary.output == "modulo" for rotary in machine.rotary) else "M127"
        upright = ride.begins_upright(machine)
        if upright is not None and machine.retract_z_mm is None:
            # How the head stood is not known; with the spindle upright the way to the limit is certain.
            yield dialect.turn(_turn_words(ride, *upright), start=False)
            yield dialect.retract(machine)


def _ride(ride: Ride, machine: Machine, options: ProgramOptions, dialect: Dialect, first: bool) -> Iterator[str]:
    """From the retracted position and back to it."""
    poses = dialect.poses(ride)
    yield from dialect.structure([stretch for stretch in ride.stretches if stretch.cut == ride.stretches[0].cut])
    yield dialect.turn(_turn_words(ride, *ride.turns[0]), start=first)
    yield dialect.on
    number, modal, side = 0, -1, "R0"
    sides = _sides(ride) if own_option(dialect.post, options, "radius", "off", "on") == "on" else {}
    for stretch in ride.stretches:
        if stretch.purpose is Purpose.LINK:
            yield from dialect.structure([other for other in ride.stretches if other.cut == stretch.cut])
        if stretch.purpose is not Purpose.UPRIGHT:
            yield f"; {stretch.purpose.name} {stretch.cut}"
        for _ in range(len(stretch.tip)):
            feed, pose = ride.feed[number], poses[number]
            if number == 0:
                yield dialect.first(pose)
                if first and options.coolant != "none":
                    yield options.coolant
            elif pose != poses[number - 1]:
                cuts = stretch.purpose is Purpose.SWEEP or (stretch.purpose is Purpose.APPROACH and feed > 0)
                asked = sides.get(stretch.cut, "R0") if cuts else "R0"
                if asked != side:
                    pose, side = dialect.sided(pose, asked), asked
                if feed == 0:
                    yield dialect.rapid(pose)
                else:
                    yield dialect.cut(pose, None if feed == modal else feed)
                    modal = feed
            number += 1
    if side != "R0":
        found = f"radius compensation {side} to the last pose of cut {ride.stretches[-1].cut}"
        raise PostError("[program] options.radius", found, "a retract after each sweep", "Leave the option off.")
    yield dialect.off
    yield dialect.retract(machine)


def _turn_words(ride: Ride, first: float, second: float) -> str:
    return f"{ride.letters[0]}{first:+.{DECIMALS}f} {ride.letters[1]}{second:+.{DECIMALS}f}"


def _sides(ride: Ride) -> dict[int, str]:
    """RL or RR by cut: the tool is to the left of the contour where the material lies to the right."""
    words = {"right": "RL", "left": "RR"}
    return {stretch.cut: words[stretch.material] for stretch in ride.stretches if stretch.material}


def signed(value: float) -> str:
    """A coordinate: signed, as few decimals as it needs."""
    return f"{round(value, DECIMALS) + 0.0:+.{DECIMALS}f}".rstrip("0").rstrip(".")


def rotary_words(ride: Ride) -> list[str]:
    """Points with rotary words."""
    words = "X%+.4f Y%+.4f Z%+.4f {}%+.4f {}%+.4f".format(*ride.letters)
    return [words % (*tip, *turn) for tip, turn in zip(ride.tip.tolist(), ride.turns.tolist(), strict=True)]


def vector_words(ride: Ride) -> list[str]:
    """Points with tool vectors."""
    words = "X%+.4f Y%+.4f Z%+.4f TX%+.7f TY%+.7f TZ%+.7f"
    return [words % (*tip, *axis) for tip, axis in zip(ride.tip.tolist(), ride.axis.tolist(), strict=True)]
