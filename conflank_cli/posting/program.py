"""From sweeps and passes to the neutral tool path and the text of the program."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from importlib.metadata import version
from itertools import groupby

import numpy as np
import numpy.typing as npt

from conflank_cli.ball_pass import Pass
from conflank_cli.errors import InputError
from conflank_cli.geometry.collision import Collider
from conflank_cli.geometry.footpoint import Projector
from conflank_cli.geometry.screening import Screen
from conflank_cli.job import Job
from conflank_cli.machine_frame import Frame, machine_of
from conflank_cli.posting.feeds import contact_feed
from conflank_cli.posting.links import SafePlane, away_directions, clearest, hull_points, is_climb
from conflank_cli.posting.ride import PassRide, Ride
from conflank_cli.posting.spacing import cut_runs, space_blocks
from conflank_cli.scene import Scene
from conflank_cli.sweep import Sweep
from conflank_cli.tool import Tool
from postprocessors.errors import PostError
from postprocessors.heidenhain.conversational import ProgramOptions, write_program
from postprocessors.kinematics.two_rotary import choose_words
from postprocessors.machines.machine import Machine
from postprocessors.toolpath import Cutter, Operation, Purpose, Stretch, ToolPath

Array = npt.NDArray[np.float64]

BLANK_RATIO = 150.0
"""Largest ratio of the blank's sides (the control refuses 200)."""


def program_options(job: Job) -> ProgramOptions:
    """How the job wants its program written."""
    program = job.program
    return ProgramOptions(
        version=version("conflank"),
        style=program.style,
        datum=program.datum,
        coolant=program.coolant,
        tolerance_mm=program.cycle32.t,
        tolerance_deg=program.cycle32.ta,
    )


def post_program(scene: Scene, sweeps: Sequence[Sweep], passes: Sequence[Pass] = ()) -> tuple[str, ToolPath]:
    """The text of the program that the scene's job asks for, and the tool path behind it.

    Raises
    ------
    InputError: the control or the machine could not execute it.
    """
    try:
        machine = machine_of(scene.job)
        path = plan_to_toolpath(scene, sweeps, machine, passes)
        return write_program(path, machine, program_options(scene.job)), path
    except PostError as error:
        raise InputError(error.where, error.found, error.expected, error.next_step) from error


def plan_to_toolpath(scene: Scene, sweeps: Sequence[Sweep], machine: Machine, passes: Sequence[Pass] = ()) -> ToolPath:
    """Turn sweeps, and after them passes, into a tool path in program coordinates, in the given order.

    Parameters
    ----------
    scene: the job, its faces and tools.
    sweeps, passes: what to cut; cut k of the path is sweeps[k - 1], and passes count on from there.
    machine: its rotary words are one of the two interpolations that the spacing of blocks must bear.

    Raises
    ------
    InputError: there is nothing to cut, or a cut names a tool or a face that the scene does not have.
    NumericalError: a sweep needs endlessly short blocks (it passes the machine's singular pose at an angle).
    PostError: an orientation is out of the machine's reach.
    """
    if not sweeps and not passes:
        raise InputError("plan", "no sweep", "at least one", "Lower the coverage asked for, or widen the tolerance.")
    tools = {tool.name: tool for tool in scene.tools}
    frame = Frame.of(scene.job.setup)
    screen, collider = Screen.of(scene), Collider.of(scene)
    program = scene.job.program
    projectors = [Projector.of(face.surface) for face in scene.faces]
    hull = frame.points(hull_points(scene, projectors))
    low, high = hull.min(axis=0), hull.max(axis=0)
    centre = 0.5 * (low + high)
    radius = float(np.linalg.norm(hull - centre, axis=1).max())
    rides: list[Ride | PassRide] = []
    ends = []
    cuts: list[tuple[Purpose, int, Sweep | Pass]] = [
        *((Purpose.SWEEP, number, sweep) for number, sweep in enumerate(sweeps, start=1)),
        *((Purpose.PASS, number, item) for number, item in enumerate(passes, start=len(sweeps) + 1)),
    ]
    for purpose, number, cut in cuts:
        if cut.tool not in tools or not 0 <= cut.face < len(scene.faces):
            found = f"tool {cut.tool}, face {cut.face}"
            where = f"{purpose.value} {number}"
            raise InputError(where, found, "a tool and a face of the scene", "Run the stages again.")
        ride = _ride(cut, tools[cut.tool], frame)
        away = away_directions(ride, projectors[cut.face], scene.faces[cut.face].sense)
        # A pass goes to and fro; only a sweep has one way round.
        if (
            isinstance(ride, Ride)
            and program.cutting != "both"
            and is_climb(ride, away) != (program.cutting == "climb")
        ):
            ride, away = replace(ride, backwards=True), away[::-1]
        rides.append(ride)
        ends.append((away[0], away[-1]))
    times = space_blocks(rides, machine)
    poses = [ride.poses(t) for ride, t in zip(rides, times, strict=True)]
    words = choose_words(machine, cut_runs(rides, poses))
    stretches: list[tuple[Tool, tuple[Stretch, ...]]] = []
    for (purpose, number, _), ride, (tip, axis), word, (away_in, away_out) in zip(
        cuts, rides, poses, words, ends, strict=True
    ):
        feed = contact_feed(tip, axis, word, ride, machine)
        plane = SafePlane(centre, radius + program.safe.clearance, program.safe.clearance)
        inward = clearest(plane.links(tip[0], axis[0], away_in), axis[0], ride, screen, collider)
        outward = clearest(plane.links(tip[-1], axis[-1], away_out), axis[-1], ride, screen, collider)[::-1]
        slow = float(feed[0])
        still_in, still_out = (np.repeat(axis[index][None], 3, axis=0) for index in (0, -1))
        stretches.append(
            (
                ride.tool,
                (
                    Stretch(Purpose.APPROACH, number, inward, still_in, np.array([0.0, 0.0, slow])),
                    Stretch(purpose, number, tip, axis, feed),
                    Stretch(Purpose.RETRACT, number, outward, still_out, np.array([slow, float(feed[-1]), 0.0])),
                ),
            )
        )
    operations = tuple(
        Operation(_cutter(tool), tuple(stretch for _, whole in group for stretch in whole))
        for tool, group in groupby(stretches, key=lambda item: item[0])
    )
    blank_low, blank_high = _blank(low, high)
    faces = tuple(sorted({scene.faces[cut.face].number for _, _, cut in cuts}))
    return ToolPath(program.name, scene.part_name, faces, frame.text, blank_low, blank_high, operations)


def _ride(cut: Sweep | Pass, tool: Tool, frame: Frame) -> Ride | PassRide:
    return Ride(cut.motion, tool, frame) if isinstance(cut, Sweep) else PassRide.of(cut, tool, frame)


def _cutter(tool: Tool) -> Cutter:
    return Cutter(tool.number, tool.name, tool.r_min, tool.r_max, tool.length, tool.spindle_rpm)


def _blank(low: Array, high: Array) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Corners of the blank, whole millimetres outward, no side too thin for the control's graphics."""
    low, high = np.floor(low), np.ceil(high)
    size = np.maximum(high - low, np.ceil((high - low).max() / BLANK_RATIO))
    high = low + np.maximum(size, 1.0)
    return (float(low[0]), float(low[1]), float(low[2])), (float(high[0]), float(high[1]), float(high[2]))
