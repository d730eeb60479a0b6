"""Moves whose way the text alone does not tell: followed on the machine where that is known, else proven or found.

A program moves the cutter on the part by its text, and away from it by the machine: to the limit (M140), to machine
coordinates (M91), by turning a table with X, Y and Z at rest. Where the job states how the part and the tool are
mounted (`zero`, `gauge_length`), all of that has a way on the part, which is judged like any other. Where it does not,
there is one argument. A fully retracted tool is above everything that stands on the table, however the rotary axes
stand. A straight move with the rotary axes at rest shifts the cutter without turning it, so that all of it stays above
a plane if it is so at both ends: a pose at which the whole cutter, holder included, lies above everything *along the
machine's Z* can be reached from the retracted position, and left for it. Whatever is neither followed nor proven is a
finding, and so is every feed move of unknown pose.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import radians, sqrt
from typing import TypeVar

import msgspec
import numpy as np
import numpy.typing as npt

from conflank_cli.tool import Tool
from conflank_cli.verification.findings import Finding
from conflank_cli.verification.machine import MachineModel
from conflank_cli.verification.program import RETRACT_CHECKED, Event, Interpolation, Moves, Program, UnknownMove
from conflank_cli.verification.standing import Standing, discs, lowest

Array = npt.NDArray[np.float64]

ABOVE = 0.02
"""A cutter counts as above everything from this height on, mm: a face rises less than that between its points."""

SAME_TURN = 1e-5
"""Positions of rotary axes nearer than this are one, radians: ten times the rounding of four decimals of a degree."""

SAME_AXIS = 1e-4
"""Tool axes nearer than this are one, radians: a turn by it moves the top of a cutter by a few hundredths of a mm."""

TURN_STEP = radians(2.0)
"""Largest turn of the rotary axes between two poses by which a turn at rest is followed."""

CHORD = 0.01
"""The tip runs on an arc when a table turns, and straight between two poses: it is off the arc by this at most, mm."""

HEIGHT_ROUNDING = 1e-3
"""A height of retract is one from which the word may differ by this much, mm."""

_Scalar = TypeVar("_Scalar", bound=np.generic)

_LOST = "the way to it does not follow from the text"


@dataclass(frozen=True, slots=True)
class Mounted:
    """What the ways of a program depend on besides its text.

    Attributes
    ----------
    machine: the job's machine.
    standing: what stands on the table.
    tools: the cutter of every tool call, None where it is not known.
    zero: the program's datum in machine coordinates with the rotary axes at zero, (3,) mm; None where not known.
    lengths: from tip to nose for every tool call, mm; None where not known.
    below: from the programmed point down the axis to the tip, for every tool call, mm.
    named: rotary letters that the program names.
    no_machine: whether the program states tool axes for no machine in particular (APT).
    """

    machine: MachineModel
    standing: Standing
    tools: tuple[Tool | None, ...]
    zero: Array | None
    lengths: tuple[float | None, ...]
    below: tuple[float, ...]
    named: frozenset[str]
    no_machine: bool


@dataclass(frozen=True, slots=True)
class Ways:
    """A program with the ways that could be followed.

    Attributes
    ----------
    moves: as read, with the poses that stand for ways in between; these belong to no cut.
    added: which of `moves` stand for ways in between, (N,).
    rotary: positions of the rotary axes at all of `moves`, (N, 2) radians, in the machine's order; NaN where not known.
    unknown, events: as read, counted anew.
    unknown_moves: how many moves were neither followed nor proven free.
    findings: those moves.
    """

    moves: Moves
    added: npt.NDArray[np.bool_]
    rotary: Array
    unknown: tuple[UnknownMove, ...]
    events: tuple[Event, ...]
    unknown_moves: int
    findings: tuple[Finding, ...]


def follow_ways(program: Program, mounted: Mounted) -> Ways:
    """Follow or prove every move of a program whose way its text does not tell.

    Parameters
    ----------
    program: as read, the columns of `moves.rotary` in the machine's order.
    mounted: what is known of machine, part and tools.
    """
    walk = _Walk(program, mounted)
    walk.through()
    return walk.result()


@dataclass(slots=True)
class _State:
    """Where the cutter may be between two known poses.

    retracted: fully, above everything; sure: for certain along the machine's Z. nose: where X, Y and Z may stand,
    machine coordinates, (3,) each; empty where that is not known. pose: the move at whose end the cutter still is, or
    -1. rotary: positions, NaN where not known. in_plane: whether the control has turned the axes as a tilted plane
    asks. call: the tool call in force. lost: whether nothing at all is known.
    """

    rotary: Array
    call: int = -1
    retracted: bool = False
    sure: bool = True
    nose: list[Array] = field(default_factory=list)
    pose: int = -1
    lost: bool = False
    in_plane: bool = False


@dataclass(frozen=True, slots=True)
class _Row:
    """A pose that stands for a way, before the move `at`: programmed point, rotary positions."""

    at: int
    point: Array
    rotary: Array
    block: int
    program: str
    call: int
    joined: bool


class _Walk:
    """One run through a program, from known pose to known pose."""

    def __init__(self, program: Program, mounted: Mounted) -> None:
        self.program = program
        self.moves = program.moves
        self.mounted = mounted
        self.machine = mounted.machine
        self.rotary = self.moves.rotary.copy()
        self.point = self.moves.point.copy()
        self.joined = self.moves.joined.copy()
        self.rows: list[_Row] = []
        self.found: dict[str, Finding] = {}
        self.count = 0

    def through(self) -> None:
        """Follow everything."""
        moves, count = self.moves, len(self.moves.block)
        between: dict[int, list[UnknownMove]] = {}
        for move in self.program.unknown:
            between.setdefault(move.before, []).append(move)
        starts = sorted({*np.flatnonzero(~moves.joined).tolist(), *between, 0})
        for place, start in enumerate(starts):
            state = self._state_before(start)
            if start and start not in between:
                # Something was left out that the program does.
                state.nose, state.pose, state.lost = [], -1, True
            for move in between.get(start, ()):
                self._follow(move, state)
            if start == count:
                break
            end = starts[place + 1] if place + 1 < len(starts) else count
            self._enter(start, state, bool(between.get(start)))
            self._turn_along(start, end, state)

    # --- states -----------------------------------------------------------------------------------------------------

    def _state_before(self, move: int) -> _State:
        """At the end of the known pose before a move; at the beginning axes that are never named stand at zero."""
        if move == 0:
            # Tool vectors move axes without naming them.
            unknown = not np.isfinite(self.moves.rotary).all()
            named = self.mounted.named
            start = [np.nan if unknown or letter in named else 0.0 for letter in self.machine.letters]
            return _State(np.array(start))
        state = _State(self.rotary[move - 1].copy(), int(self.moves.tool[move - 1]), pose=move - 1)
        state.nose = self._nose_at(move - 1)
        return state

    def _tool(self, state: _State) -> Tool | None:
        return self.mounted.tools[state.call] if 0 <= state.call < len(self.mounted.tools) else None

    def _length(self, state: _State) -> float | None:
        return self.mounted.lengths[state.call] if 0 <= state.call < len(self.mounted.lengths) else None

    def _tip(self, move: int) -> tuple[Array, Array]:
        """Tip and axis of a known pose, (1, 3) each, program's frame."""
        axis = self._axes(slice(move, move + 1))
        call = int(self.moves.tool[move])
        below = self.mounted.below[call] if call >= 0 else 0.0
        return self.point[move : move + 1] - below * axis, axis

    def _axes(self, chosen: slice) -> Array:
        vector = self.moves.vector[chosen]
        return np.where(np.isfinite(vector), vector, self.machine.tool_axis(self.rotary[chosen]))

    def _up(self, rotary: Array, axis: Array) -> Array:
        """The machine's Z at a pose, (1, 3); NaN where it is not known. Data for no machine has tables in mind."""
        return axis if self.mounted.no_machine or not self._heads else self.machine.up(rotary[None])

    @property
    def _heads(self) -> bool:
        return not all(axis.table for axis in self.machine.rotary)

    def _nose_at(self, move: int) -> list[Array]:
        length = self._length(_State(self.rotary[move], int(self.moves.tool[move])))
        if self.mounted.zero is None or length is None or not np.isfinite(self.rotary[move]).all():
            return []
        tip, _ = self._tip(move)
        return [self.machine.nose(tip, self.rotary[move][None], self.mounted.zero, length)[0]]

    def _lift(self, tool: Tool | None, tip: Array, axis: Array, up: Array) -> float:
        """How far the cutter is above everything that stands there, mm; NaN where that cannot be told."""
        if tool is None:
            return float("nan")
        return float(lowest(tool, tip, axis, up)[0]) - self.mounted.standing.height(up[0])

    def _lose(self, state: _State, move: UnknownMove | None, why: str, block: int, lack: float | None = None) -> None:
        """A move that is neither followed nor proven; from there on nothing is known."""
        self._find(why, block, "" if move is None else move.program, lack)
        state.retracted, state.nose, state.pose, state.lost = False, [], -1, True

    def _find(self, why: str, block: int, program: str = "", lack: float | None = None) -> None:
        self.count += 1
        before = self.found.get(f"{program} {why}")
        if before is not None:
            self.found[f"{program} {why}"] = msgspec.structs.replace(before, count=before.count + 1)
            return
        amount, limit = (None, None) if lack is None else (round(lack, 3), 0.0)
        text = f"{why}, block {block}{f' of {program}' * bool(program)}"
        self.found[f"{program} {why}"] = Finding("CF116", text, block, None, amount, limit, "mm" * (lack is not None))

    # --- moves ------------------------------------------------------------------------------------------------------

    def _follow(self, move: UnknownMove, state: _State) -> None:
        """One move of unknown way."""
        if move.kind == "tool":
            self._change_tool(move, state)
        elif move.kind == "limit":
            self._to_limit(move, state)
        elif move.kind == "machine":
            self._to_machine(move, state)
        elif move.kind == "turn":
            self._turn(move, state)
        elif move.kind == "across":
            self._across(move, state)
        elif move.kind == "machine 2":
            self._lose(state, move, "M92: where the builder's second datum lies is not known", move.block)
        else:
            what = "a feed move whose pose" if not move.rapid else "a move whose pose"
            self._lose(state, move, f"{what} does not follow from the text", move.block)
        if move.kind not in ("tool", "limit", "machine"):
            self._set_rotary(state, move.words)

    def _across(self, move: UnknownMove, state: _State) -> None:
        """X and Y across the tool axis at an unknown height: as high as before where that axis is the machine's Z."""
        known = bool(np.isfinite(state.rotary).all())
        straight = not self._heads or (known and bool(self.machine.upright(state.rotary[None])[0]))
        if not (state.retracted and (straight or self.mounted.no_machine)):
            self._lose(
                state, move, "a move across the tool axis that is not at the machine's retract height", move.block
            )
        state.nose, state.pose = [], -1

    def _set_rotary(self, state: _State, words: Mapping[str, float | None]) -> None:
        for column, letter in enumerate(self.machine.letters):
            if letter in words:
                value = words[letter]
                state.rotary[column] = np.nan if value is None else value
                state.in_plane = set(words.values()) == {None}
        if not np.isfinite(state.rotary).all():
            state.nose = []

    def _change_tool(self, move: UnknownMove, state: _State) -> None:
        """The place where tools are changed is above everything; the way there goes up first."""
        if not state.retracted and (state.pose >= 0 or state.nose):
            lift = float(np.min(self._lifts(state)))
            if not lift >= ABOVE:
                why = "a tool is called while the cutter is not above everything along the machine's Z"
                self._lose(state, move, why, move.block, lift if np.isfinite(lift) else None)
        state.retracted, state.sure, state.nose, state.pose, state.lost = True, True, [], -1, False
        state.call = min(state.call + 1, len(self.mounted.tools) - 1)

    def _lifts(self, state: _State) -> list[float]:
        """How far the cutter is above everything where it may stand, mm; NaN where that cannot be told."""
        tool, rotary = self._tool(state), state.rotary[None]
        if state.pose >= 0:
            tip, axis = self._tip(state.pose)
            return [self._lift(tool, tip, axis, self._up(self.rotary[state.pose], axis))]
        zero, length = self.mounted.zero, self._length(state)
        assert zero is not None and length is not None
        axis, up = self.machine.tool_axis(rotary), self.machine.up(rotary)
        return [self._lift(tool, self.machine.tip(nose[None], rotary, zero, length), axis, up) for nose in state.nose]

    def _to_limit(self, move: UnknownMove, state: _State) -> None:
        """M140 MB MAX. With a tilted head it is not sure whether the control goes along the tool or along Z."""
        known = bool(np.isfinite(state.rotary).all())
        straight = not self._heads or (known and bool(self.machine.upright(state.rotary[None])[0]))
        if self.mounted.no_machine:
            straight = True
        state.sure |= straight
        if state.nose:
            self._to_limit_on_machine(move, state, straight)
            return
        if state.pose >= 0:
            up = self.machine.up(state.rotary[None])
            if straight:
                self._rise(move, state)
            elif np.isfinite(up).all():
                self._rise_beside(move, state, up)
            else:
                self._lose(state, move, "a retract with rotary axes at positions that are not known", move.block)
        elif state.retracted and not straight:
            # At the top already, it goes no lower as long as the tool points down. Where the head stands after a tool
            # change is not in the text: not with the tip above the spindle, but which way it goes is open.
            state.sure = known and state.sure
            straight = not known or bool(self.machine.spindle(state.rotary[None])[0, 2] >= 0.0)
            if not straight:
                self._lose(state, move, "a retract along a tool axis that points down", move.block)
        state.retracted = straight
        state.pose = -1
        state.lost = not straight

    def _origin(self, move: UnknownMove, state: _State) -> tuple[int, bool]:
        """The pose that a retract to the limit starts at, and whether the move after it stands for the retract."""
        last, moves = state.pose, self.moves
        if last >= 1 and moves.joined[last] and moves.block[last] == move.block:
            way = float(np.linalg.norm(moves.point[last] - moves.point[last - 1]))
            if abs(way - RETRACT_CHECKED) < 1e-6:
                return last - 1, True
        return last, False

    def _rise(self, move: UnknownMove, state: _State, most: float = np.inf) -> None:
        """Along the tool axis, which is the machine's Z: until the cutter is above everything, and a good way more."""
        origin, stands = self._origin(move, state)
        tip, axis = self._tip(origin)
        tool = self._tool(state)
        lift = self._lift(tool, tip, axis, axis)
        way = min(max(RETRACT_CHECKED, -lift + 1.0), most) if np.isfinite(lift) else min(RETRACT_CHECKED, most)
        if stands:
            self.point[origin + 1] = self.point[origin] + way * axis[0]
        else:
            self._add(move, self.point[origin] + way * axis[0], self.rotary[origin], state, True)

    def _rise_beside(self, move: UnknownMove, state: _State, direction: Array) -> None:
        """The other way that a retract might take: from its start along a direction (1, 3), beside the one read."""
        origin, _ = self._origin(move, state)
        turn = self.rotary[origin]
        self._add(move, self.point[origin], turn, state, False)
        self._add(move, self.point[origin] + RETRACT_CHECKED * direction[0], turn, state, True)

    def _to_limit_on_machine(self, move: UnknownMove, state: _State, straight: bool) -> None:
        """To the first limit of travel along the tool axis, and where the head is tilted along Z as well."""
        origin, stands = self._origin(move, state)
        spindle = self.machine.spindle(state.rotary[None])[0]
        starts = self._nose_at(origin) if state.pose >= 0 else state.nose
        ends: list[Array] = []
        for start in starts:
            for direction in [spindle] if straight else [spindle, np.array([0.0, 0.0, 1.0])]:
                end = start + self._room(start, direction) * direction
                ends.append(end)
                if not stands or direction is not spindle:
                    self._way(move, [start, end], [state.rotary] * 2, state)
                elif straight:
                    # Above everything the rest of the way needs no look.
                    self._rise(move, state, self._room(start, spindle))
                else:
                    self.point[origin + 1] = self._on_part(end, state.rotary, state)
        state.nose, state.retracted, state.pose = ends, straight, -1

    def _room(self, nose: Array, direction: Array) -> float:
        """How far the nose can go along a direction until an axis is at its limit, mm."""
        room = [
            ((high if step > 0.0 else low) - place) / step
            for place, step, (low, high) in zip(nose, direction, self.machine.travel, strict=True)
            if abs(step) > 1e-9
        ]
        return max(float(min(room)), 0.0)

    def _to_machine(self, move: UnknownMove, state: _State) -> None:
        """M91."""
        words = move.words
        if None in words.values():
            self._lose(state, move, "machine coordinates whose values are not known", move.block)
            self._set_rotary(state, words)
            return
        down = words.get("Z") is not None and float(words["Z"] or 0.0) < self.machine.top - HEIGHT_ROUNDING
        before = state.rotary.copy()
        if state.nose:
            self._set_rotary(state, words)
            self._each_to(move, state, before, {letter: value for letter, value in words.items() if letter in "XYZ"})
            state.retracted = not down and ("Z" in words or state.retracted)
            return
        if not move.rapid:
            self._lose(state, move, "a feed move in machine coordinates", move.block)
        elif down:
            why = f"Z{float(words['Z'] or 0.0):+g} in machine coordinates is below the machine's retract height"
            self._lose(state, move, why, move.block)
        elif not state.retracted and set(words) != {"Z"}:
            self._lose(state, move, "a move in machine coordinates from a place that is not retracted", move.block)
        elif state.retracted or state.pose < 0 or self._rise_to_top(move, state):
            state.retracted, state.sure, state.pose, state.lost = True, True, -1, False
        self._set_rotary(state, words)

    def _rise_to_top(self, move: UnknownMove, state: _State) -> bool:
        """Straight up along the machine's Z from a known pose, until the cutter is above everything and more.

        Whether it is known where that is.
        """
        tip, axis = self._tip(state.pose)
        up = self._up(self.rotary[state.pose], axis)
        lift = self._lift(self._tool(state), tip, axis, up)
        if not np.isfinite(up).all():
            self._lose(state, move, "a retract along Z with rotary axes at positions that are not known", move.block)
            return False
        way = max(RETRACT_CHECKED, -lift + 1.0) if np.isfinite(lift) else RETRACT_CHECKED
        end = self.point[state.pose] + way * up[0]
        self._add(move, end, self.rotary[state.pose], state, True)
        return True

    def _turn(self, move: UnknownMove, state: _State) -> None:
        """Rotary axes with X, Y and Z at rest."""
        if state.nose and np.isfinite(state.rotary).all() and None not in move.words.values():
            before = state.rotary.copy()
            self._set_rotary(state, move.words)
            self._each_to(move, state, before, {})
        elif not move.rapid:
            self._lose(state, move, "a feed move of rotary axes without tool centre point control", move.block)
        elif not state.retracted:
            self._lose(state, move, "rotary axes turn while the tool is not fully retracted", move.block)

    def _each_to(self, move: UnknownMove, state: _State, before: Array, words: Mapping[str, float | None]) -> None:
        """From every place where the nose may be: X, Y, Z as given, and from rotary positions to those of the state."""
        ends = []
        for start in state.nose:
            end = start.copy()
            for letter, value in words.items():
                end["XYZ".index(letter)] = float(value or 0.0)
            ends.append(end)
            steps = self._steps(start, before, state.rotary, state)
            share = np.linspace(0.0, 1.0, steps + 1)[:, None]
            noses, turns_ = start + share * (end - start), before + share * (state.rotary - before)
            self._way(move, list(noses), list(turns_), state)
        state.nose, state.pose = ends, -1

    def _steps(self, nose: Array, before: Array, after: Array, state: _State) -> int:
        """Poses by which to follow a turn: a turn of each by `TURN_STEP` at most, and less where the tip is far out."""
        turn = float(np.abs(after - before).sum())
        reach = max(self._reaches(state, nose))
        return max(1, int(np.ceil(turn / min(TURN_STEP, sqrt(8.0 * CHORD / max(reach, 1.0))))))

    def _reaches(self, state: _State, nose: Array) -> list[float]:
        """How far the tip is at most from each rotary axis as it turns, mm."""
        length = self._length(state) or 0.0
        place = nose + np.array([0.0, 0.0, -length])
        return [
            float(np.linalg.norm(place - axis.pivot)) if axis.table else length + float(np.linalg.norm(axis.pivot))
            for axis in self.machine.rotary
        ]

    # --- ways on the part -------------------------------------------------------------------------------------------

    def _on_part(self, nose: Array, rotary: Array, state: _State) -> Array:
        """The programmed point with X, Y and Z at `nose`."""
        zero, length = self.mounted.zero, self._length(state)
        assert zero is not None and length is not None
        tip = self.machine.tip(nose[None], rotary[None], zero, length)
        below = self.mounted.below[state.call] if state.call >= 0 else 0.0
        return np.asarray((tip + below * self.machine.tool_axis(rotary[None]))[0])

    def _way(self, move: UnknownMove, noses: Sequence[Array], turns_: Sequence[Array], state: _State) -> None:
        """Poses of a way, where not all of it is above everything; `noses`, `turns_`: from first to last."""
        zero, length, tool = self.mounted.zero, self._length(state), self._tool(state)
        assert zero is not None and length is not None
        rotary = np.array(turns_)
        tip = self.machine.tip(np.array(noses), rotary, zero, length)
        axis = self.machine.tool_axis(rotary)
        clear = np.zeros(len(rotary) - 1, dtype=np.bool_)
        if tool is not None:
            up = self.machine.up(rotary)
            lift = lowest(tool, tip, axis, up) - (self.mounted.standing.points @ up.T).max(axis=0)
            turn = np.abs(np.diff(rotary, axis=0)).sum(axis=1)
            clear = np.minimum(lift[1:], lift[:-1]) > ABOVE + sagitta(self._reach(tool, state), turn)
        below = self.mounted.below[state.call] if state.call >= 0 else 0.0
        point = tip + below * axis
        for step in np.flatnonzero(~clear):
            if step == 0 or clear[step - 1]:
                self._add(move, point[step], rotary[step], state, False)
            self._add(move, point[step + 1], rotary[step + 1], state, True)

    def _reach(self, tool: Tool, state: _State) -> float:
        """How far anything on the table, and any part of the cutter, is at most from a rotary axis that carries it, mm.

        Both together; an axis that is carried by the other turns about another pivot.
        """
        zero, length = self.mounted.zero, self._length(state) or 0.0
        assert zero is not None
        first, second = self.machine.rotary
        apart = float(np.linalg.norm(np.subtract(first.pivot, second.pivot)))
        reach = 0.0
        if first.table:
            reach += float(np.linalg.norm(self.mounted.standing.points + zero - first.pivot, axis=1).max()) + apart
        if not second.table:
            widest = max(radius for _, radius in discs(tool))
            reach += length + widest + float(np.linalg.norm(second.pivot)) + apart
        return reach

    def _add(self, move: UnknownMove, point: Array, rotary: Array, state: _State, joined: bool) -> None:
        """A pose of the way of a move."""
        self.rows.append(_Row(move.before, point.copy(), rotary.copy(), move.block, move.program, state.call, joined))

    # --- entries ----------------------------------------------------------------------------------------------------

    def _enter(self, start: int, state: _State, moved: bool) -> None:
        """The first known pose after a way."""
        state.call = int(self.moves.tool[start])
        block, rapid = int(self.moves.block[start]), bool(self.moves.rapid[start])
        program = self.moves.program(start) or ""
        if state.nose:
            self._enter_from(UnknownMove(start, "", {}, rapid, block, program), state)
            return
        if not state.retracted:
            if not (state.lost and moved):
                self._find(f"{_LOST}, and it does not start from a full retract", block, program)
            return
        if not state.sure:
            self._find(f"{_LOST}: the last retract went along a tool axis that is not known", block, program)
            return
        tip, axis = self._tip(start)
        ups = [self._up(state.rotary, axis)]
        if state.in_plane and np.isnan(self.rotary[start]).any():
            # The axes stand in one of the two ways that point the tool along its axis in the plane.
            ups = [self._up(np.nan_to_num(rotary[0]), axis) for rotary in self.machine.positions(axis)]
        elif not self.mounted.no_machine and not self._at_rest(state, self.rotary[start], axis):
            self._find(f"{_LOST}: the rotary axes turn on the way down from the retract", block, program)
            return
        # NaN, where it cannot be told, stays NaN.
        lift = float(np.min([self._lift(self._tool(state), tip, axis, up) for up in ups]))
        if not lift >= ABOVE:
            kind = "rapid" if rapid else "feed move"
            why = f"a {kind} from a full retract to a pose that is not above everything along the machine's Z"
            self._find(why, block, program, lift if np.isfinite(lift) else None)

    def _at_rest(self, state: _State, given: Array, axis: Array) -> bool:
        """Whether the rotary axes stand where a pose wants them."""
        if not np.isfinite(state.rotary).all():
            return False
        if np.isfinite(given).all():
            return bool(np.abs(given - state.rotary).max() < SAME_TURN)
        return bool(np.linalg.norm(axis - self.machine.tool_axis(state.rotary[None])) < SAME_AXIS)

    def _enter_from(self, entry: UnknownMove, state: _State) -> None:
        """Straight to a pose from every place where the nose may be; nothing is added where all of it is above."""
        start = entry.before
        tip, axis = self._tip(start)
        tool, zero, length = self._tool(state), self.mounted.zero, self._length(state)
        assert zero is not None and length is not None
        own = state.rotary[None]
        rest, up, along = (
            self._at_rest(state, self.rotary[start], axis),
            self.machine.up(own),
            self.machine.tool_axis(own),
        )
        rising = [
            nose
            for nose in state.nose
            if not rest
            or not self._lift(tool, tip, axis, up) >= ABOVE
            or not self._lift(tool, self.machine.tip(nose[None], own, zero, length), along, up) >= ABOVE
        ]
        for index, nose in enumerate(rising):
            self._add(entry, self._on_part(nose, state.rotary, state), state.rotary, state, False)
            if index < len(rising) - 1:
                target = self.rotary[start] if np.isfinite(self.rotary[start]).all() else state.rotary
                self._add(entry, self.point[start], target, state, True)
            else:
                self.joined[start] = True

    def _turn_along(self, start: int, end: int, state: _State) -> None:
        """Positions of the rotary axes where the text gives tool vectors: the nearer solution, from pose to pose."""
        missing = np.asarray(~np.isfinite(self.rotary[start:end]).all(axis=1))
        last = state.rotary
        for first, stop in _runs(missing):
            before = self.rotary[start + first - 1] if first else last
            if np.isfinite(before).all() and not self.mounted.no_machine:
                axes = self.moves.vector[start + first : start + stop]
                self.rotary[start + first : start + stop] = self.machine.followed_positions(axes, before)

    # --- result -----------------------------------------------------------------------------------------------------

    def result(self) -> Ways:
        """Everything in order."""
        moves, rows = self.moves, sorted(self.rows, key=lambda row: row.at)
        at = np.array([row.at for row in rows], dtype=np.int64)
        count = len(rows)

        def with_rows(values: npt.NDArray[_Scalar], new: npt.ArrayLike) -> npt.NDArray[_Scalar]:
            return np.asarray(np.insert(values, at, new, axis=0)) if count else values

        nothing = np.full((count, 3), np.nan)
        turn = np.array([row.rotary for row in rows]).reshape(count, 2)
        vector = np.where(np.isfinite(turn).all(axis=1)[:, None], nothing, self._vectors_for(rows))
        joined = [row.joined for row in rows]
        result = Moves(
            point=with_rows(self.point, np.array([row.point for row in rows]).reshape(count, 3)),
            rotary=with_rows(moves.rotary, np.where(np.isfinite(vector[:, :2]), np.nan, turn)),
            vector=with_rows(moves.vector, vector),
            feed=with_rows(moves.feed, np.full(count, np.nan)),
            rapid=with_rows(moves.rapid, np.ones(count, dtype=np.bool_)),
            block=with_rows(moves.block, [row.block for row in rows]),
            cut=with_rows(moves.cut, np.full(count, -1)),
            tool=with_rows(moves.tool, [row.call for row in rows]),
            joined=with_rows(self.joined, joined),
            interpolation=with_rows(moves.interpolation, np.full(count, int(Interpolation.AXIS))),
            spindle=with_rows(moves.spindle, np.zeros(count)),
            coolant=with_rows(moves.coolant, np.zeros(count, dtype=np.int64)),
            called=tuple(
                (first + sum(row.at < first or (row.at == first and row.program != name) for row in rows), name)
                for first, name in moves.called
            ),
        )
        unknown = tuple(
            replace(move, before=move.before + int(np.sum(at <= move.before))) for move in self.program.unknown
        )
        events = tuple(
            # What happens after a pose stays with it: poses that are added come later.
            replace(event, before=event.before + int(np.sum(at < event.before)))
            for event in self.program.events
        )
        added = with_rows(np.zeros(len(self.joined), dtype=np.bool_), np.ones(count, dtype=np.bool_))
        return Ways(
            result, added, with_rows(self.rotary, turn), unknown, events, self.count, tuple(self.found.values())
        )

    def _vectors_for(self, rows: Sequence[_Row]) -> Array:
        """Tool axes of poses whose rotary positions are not known: those of the move before."""
        result = np.full((len(rows), 3), np.nan)
        for index, row in enumerate(rows):
            if row.at > 0:
                result[index] = self.moves.vector[row.at - 1]
        return result


def sagitta(reach: float, turn: Array) -> Array:
    """How far a point off its axes by `reach` mm can leave the straight line between two poses, (N,) mm.

    turn: how far both axes turn between the poses, added, (N,) radians. The second derivative of the place by a share
    of the way is no more than reach turn^2, and a curve leaves its chord by an eighth of that.
    """
    return np.asarray(reach * turn**2 / 8.0)


def _runs(flags: npt.NDArray[np.bool_]) -> Iterator[tuple[int, int]]:
    """First index and end of every stretch of flags that are set."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    yield from zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)
