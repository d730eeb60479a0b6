"""From sweeps to the neutral tool path and the text of the program."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby

import numpy as np
import numpy.typing as npt

from conflank_cli.copies import over_copies
from conflank_cli.errors import InputError
from conflank_cli.formats import post_of, program_options
from conflank_cli.geometry.collision import Collider
from conflank_cli.geometry.footpoint import Projector
from conflank_cli.geometry.screening import Screen
from conflank_cli.job import Job
from conflank_cli.machine_frame import Frame, copy_rotation, machine_of
from conflank_cli.posting.feeds import block_feeds
from conflank_cli.posting.links import Link, SafePlane, away_directions, clearest, hull_points, is_climb
from conflank_cli.posting.mounting import axis_positions, mounting_of
from conflank_cli.posting.ride import Ride
from conflank_cli.posting.spacing import legs_of, planned_axes, space_blocks
from conflank_cli.scene import Scene
from conflank_cli.sweep import Sweep
from conflank_cli.tool import Tool
from postprocessors.errors import PostError
from postprocessors.kinematics.travel import check_travel
from postprocessors.kinematics.two_rotary import Run, choose_words, runs_through
from postprocessors.kinematics.visits import visits_with_words
from postprocessors.machines.machine import Machine
from postprocessors.post import ProgramFile
from postprocessors.toolpath import Cutter, Operation, Purpose, Stretch, ToolPath

Array = npt.NDArray[np.float64]

BLANK_RATIO = 150.0
"""Largest ratio of the blank's sides (the control refuses 200)."""


def post_program(scene: Scene, sweeps: Sequence[Sweep]) -> tuple[str, ToolPath]:
    """The text of the program to run, and the tool path behind it.

    Raises
    ------
    InputError: the control or the machine could not execute it.
    """
    (program, *_), path = post_programs(scene, sweeps)
    return program.text, path


def post_programs(scene: Scene, sweeps: Sequence[Sweep]) -> tuple[tuple[ProgramFile, ...], ToolPath]:
    """The programs that the scene's job asks for, the one to run first, and the tool path behind them.

    Raises
    ------
    InputError: the control or the machine could not execute it.
    """
    job = scene.job
    post = post_of(job)
    try:
        machine = machine_of(job)
        path = _numbered(plan_to_toolpath(scene, sweeps, machine), job.program.tool_numbers)
        check_travel(machine, visits_with_words(machine, path), mounting_of(job))
        return post.write(path, machine, program_options(job, post)), path
    except PostError as error:
        raise InputError(error.where, error.found, error.expected, error.next_step) from error


def _numbered(path: ToolPath, numbers: Mapping[str, int]) -> ToolPath:
    """The path with the numbers that the machine has its tools under, where they are given."""
    if not numbers:
        return path
    operations = tuple(
        replace(operation, cutter=replace(operation.cutter, number=numbers[operation.cutter.name]))
        for operation in path.operations
    )
    return replace(path, operations=operations)


def plan_to_toolpath(scene: Scene, sweeps: Sequence[Sweep], machine: Machine) -> ToolPath:
    """Turn sweeps into a tool path in program coordinates, in the given order.

    Parameters
    ----------
    scene: the job, its faces and tools.
    sweeps: what to cut on each copy; without copies cut k of the path is sweeps[k - 1].
    machine: its rotary words are one of the two interpolations that the spacing of blocks must bear.

    Raises
    ------
    InputError: there is no sweep, or a sweep names a tool or a face that the scene does not have.
    NumericalError: a sweep needs endlessly short blocks (it passes the machine's singular pose at an angle).
    PostError: an orientation is out of the machine's reach, or its axes cannot follow at any feed.
    """
    if not sweeps:
        raise InputError("plan", "no sweep", "at least one", "Lower the coverage asked for, or widen the tolerance.")
    tools = {tool.name: tool for tool in scene.tools}
    frame = Frame.of(scene.job.setup)
    screen, collider = Screen.of(scene), Collider.of(scene)
    program = scene.job.program
    projectors = [Projector.of(face.surface) for face in scene.faces]
    copies = scene.job.setup.copies
    standing = hull_points(scene, projectors)
    hull = np.vstack([frame.turned(copy_rotation(copies, number)).points(standing) for number in copies.order])
    low, high = hull.min(axis=0), hull.max(axis=0)
    centre = 0.5 * (low + high)
    radius = float(np.linalg.norm(hull - centre, axis=1).max())
    pieces: list[_Piece] = []
    for number, (sweep, rotation) in enumerate(over_copies(copies, sweeps), start=1):
        if sweep.tool not in tools or not 0 <= sweep.face < len(scene.faces):
            found = f"tool {sweep.tool}, face {sweep.face}"
            raise InputError(f"sweep {number}", found, "a tool and a face of the scene", "Run the stages again.")
        ride = Ride(sweep.motion, tools[sweep.tool], frame.turned(rotation))
        projector, sense = projectors[sweep.face], scene.faces[sweep.face].sense
        climbs = is_climb(ride, away_directions(ride, projector, sense))
        if program.cutting != "both" and climbs != (program.cutting == "climb"):
            ride = replace(ride, backwards=True)
        for leg in legs_of(ride, machine, f"sweep {number}"):
            away = away_directions(leg, projector, sense)
            pieces.append(_Piece(number, leg, away[0], away[-1]))
    plane = SafePlane(centre, radius + program.safe.clearance, program.safe.clearance)
    stretches = _with_links(pieces, plane, screen, collider, machine, scene.job)
    operations = tuple(
        Operation(_cutter(tool), tuple(stretch for _, visit in group for stretch in visit))
        for tool, group in groupby(
            zip((piece.ride.tool for piece in pieces), stretches, strict=True), key=lambda item: item[0]
        )
    )
    blank_low, blank_high = _blank(low, high)
    faces = tuple(sorted({scene.faces[sweep.face].number for sweep in sweeps}))
    return ToolPath(program.name, scene.part_name, faces, frame.text, blank_low, blank_high, operations)


@dataclass(frozen=True, slots=True)
class _Piece:
    """As much of a sweep as can be run without unwinding a rotary axis, and which way is off the face at its ends."""

    cut: int
    ride: Ride
    away_in: Array
    away_out: Array

    @property
    def label(self) -> str:
        return f"sweep {self.cut}"


def _with_links(
    pieces: Sequence[_Piece], plane: SafePlane, screen: Screen, collider: Collider, machine: Machine, job: Job
) -> list[tuple[Stretch, Stretch, Stretch]]:
    """Approach, sweep and retract of each piece: its blocks, its ways in and out, and the feeds of all of them."""
    labels = [piece.label for piece in pieces]
    ways = [_ways(piece, plane, screen, collider, machine) for piece in pieces]
    rides = [piece.ride for piece in pieces]
    # The last pose of a link is the first of the sweep, or the other way round.
    times = space_blocks(rides, machine, labels, [(a.axis[:-1], b.axis[-2::-1]) for a, b in ways])
    poses = [ride.poses(t) for ride, t in zip(rides, times, strict=True)]
    tips = [np.vstack([a.tip[:-1], tip, b.tip[-2::-1]]) for (tip, _), (a, b) in zip(poses, ways, strict=True)]
    axes = [np.vstack([a.axis[:-1], axis, b.axis[-2::-1]]) for (_, axis), (a, b) in zip(poses, ways, strict=True)]
    words = choose_words(machine, [Run(label, axis) for label, axis in zip(labels, axes, strict=True)])
    stretches = []
    for piece, (inward, outward), tip, axis, word in zip(pieces, ways, tips, axes, words, strict=True):
        ride, label = piece.ride, f"{piece.label} with its approach"
        positions = axis_positions(machine, mounting_of(job), ride.tool.name, tip, word)
        # At feed from beside the face to beside it again; the safe plane is reached by rapid.
        at = slice(1, len(tip) - 1)
        feed = np.zeros(len(tip))
        feed[at] = block_feeds(tip[at], axis[at], positions[at], ride, machine, job.program.feed, label)
        first, last = len(inward.tip) - 1, len(tip) - len(outward.tip)
        # Into the first pose of a stretch leads nothing; it has the feed of its first block.
        sweep_feed, back_feed = feed[first : last + 1].copy(), feed[last:].copy()
        sweep_feed[0], back_feed[0], feed[1] = sweep_feed[1], back_feed[1], 0.0
        ends = slice(0, first + 1), slice(first, last + 1), slice(last, len(tip))
        stretches.append(
            (
                Stretch(Purpose.APPROACH, piece.cut, tip[ends[0]], axis[ends[0]], feed[ends[0]]),
                Stretch(Purpose.SWEEP, piece.cut, tip[ends[1]], axis[ends[1]], sweep_feed),
                Stretch(Purpose.RETRACT, piece.cut, tip[ends[2]], axis[ends[2]], back_feed),
            )
        )
    return stretches


def _ways(piece: _Piece, plane: SafePlane, screen: Screen, collider: Collider, machine: Machine) -> tuple[Link, Link]:
    """The ways to the first pose of a piece, and from its last (read backwards)."""
    ride, sides = piece.ride, ((False, piece.away_in), (True, piece.away_out))
    inward, outward = (clearest(plane.links(ride, after, away), ride, screen, collider) for after, away in sides)
    axis = np.vstack([inward.axis, planned_axes(ride), outward.axis[::-1]])
    if not runs_through(machine, Run(piece.label, axis)):
        # On an arc the axis swings on past its ends, which a rotary axis at the end of its range cannot.
        inward, outward = (clearest(plane.straight(ride, after, away), ride, screen, collider) for after, away in sides)
    return inward, outward


def _cutter(tool: Tool) -> Cutter:
    return Cutter(tool.number, tool.name, tool.r_min, tool.r_max, tool.length, tool.spindle_rpm)


def _blank(low: Array, high: Array) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Corners of the blank, whole millimetres outward, no side too thin for the control's graphics."""
    low, high = np.floor(low), np.ceil(high)
    size = np.maximum(high - low, np.ceil((high - low).max() / BLANK_RATIO))
    high = low + np.maximum(size, 1.0)
    return (float(low[0]), float(low[1]), float(low[2])), (float(high[0]), float(high[1]), float(high[2]))
