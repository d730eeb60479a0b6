"""From sweeps and passes to the neutral tool path and the text of the program."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import groupby
from typing import Literal

import numpy as np
import numpy.typing as npt

from conflank_cli.ball_pass import Pass
from conflank_cli.copies import Cut, over_copies
from conflank_cli.cores import beside
from conflank_cli.errors import InputError
from conflank_cli.formats import post_of, program_options
from conflank_cli.geometry.collision import Collider
from conflank_cli.geometry.footpoint import Projector
from conflank_cli.geometry.screening import Screen
from conflank_cli.job import Job
from conflank_cli.machine_frame import Frame, machine_of
from conflank_cli.posting.feeds import FedCut, as_printed, block_feeds
from conflank_cli.posting.links import (
    LINK_CHECKS,
    Link,
    SafePlane,
    away_directions,
    clearest,
    hull_points,
    is_climb,
    is_free,
    near_links,
)
from conflank_cli.posting.mounting import axis_positions, mounting_of
from conflank_cli.posting.overhead import Overhead
from conflank_cli.posting.ride import PassRide, Ride
from conflank_cli.posting.spacing import legs_of, planned_axes, space_blocks, words_of
from conflank_cli.posting.summary import MachineRun, machine_run
from conflank_cli.scene import Scene
from conflank_cli.sweep import Sweep
from conflank_cli.tool import Tool
from postprocessors.errors import PostError
from postprocessors.kinematics.linear_axes import has_head, up_in_part, upright_words
from postprocessors.kinematics.timing import unwound
from postprocessors.kinematics.two_rotary import (
    SWING_LIMIT,
    Run,
    WindingError,
    choose_words,
    forward,
    swing,
    within_range,
)
from postprocessors.machines.machine import Machine
from postprocessors.post import ProgramFile
from postprocessors.toolpath import Cutter, Operation, Purpose, Stretch, ToolPath

Array = npt.NDArray[np.float64]

UPRIGHT_SAMPLES = 33
"""Places at which the tilt of the tool is taken while the head comes upright."""
BLANK_RATIO = 150.0
"""Largest ratio of the blank's sides (the control refuses 200)."""


def post_program(scene: Scene, sweeps: Sequence[Sweep], passes: Sequence[Pass] = ()) -> tuple[str, ToolPath]:
    """The text of the program to run, and the tool path behind it.

    Raises
    ------
    InputError: the control or the machine could not execute it.
    """
    (program, *_), path, _ = post_programs(scene, sweeps, passes)
    return program.text, path


def post_programs(
    scene: Scene, sweeps: Sequence[Sweep], passes: Sequence[Pass] = ()
) -> tuple[tuple[ProgramFile, ...], ToolPath, MachineRun]:
    """The programs that the scene's job asks for, the one to run first, the tool path, and how the machine runs it.

    Raises
    ------
    InputError: the control or the machine could not execute it.
    """
    job = scene.job
    post = post_of(job)
    try:
        machine = machine_of(job)
        path = _numbered(plan_to_toolpath(scene, sweeps, machine, passes), job.program.tool_numbers)
        run = machine_run(job, machine, path)
        return post.write(path, machine, program_options(job, post)), path, run
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


def plan_to_toolpath(scene: Scene, sweeps: Sequence[Sweep], machine: Machine, passes: Sequence[Pass] = ()) -> ToolPath:
    """Turn sweeps, and after them passes, into a tool path in program coordinates, in the given order.

    Parameters
    ----------
    scene: the job, its faces and tools.
    sweeps, passes: what to cut on each copy; without copies cut k of the path is sweeps[k - 1], and passes count on
        from there.
    machine: its rotary words are one of the two interpolations that the spacing of blocks must bear.

    Raises
    ------
    InputError: there is nothing to cut, or a cut names a tool or a face that the scene does not have.
    NumericalError: a sweep needs endlessly short blocks (it passes the machine's singular pose at an angle).
    PostError: an orientation is out of the machine's reach, or its axes cannot follow at any feed.
    """
    if not sweeps and not passes:
        raise InputError("plan", "no sweep", "at least one", "Lower the coverage asked for, or widen the tolerance.")
    tools = {tool.name: tool for tool in scene.tools}
    frame = Frame.of(scene.job.setup)
    screen, collider = Screen.of(scene), Collider.of(scene)
    program = scene.job.program
    projectors = [Projector.of(face.surface) for face in scene.faces]
    copies = scene.job.setup.copies
    hull = frame.points(hull_points(scene, projectors))
    low, high = hull.min(axis=0), hull.max(axis=0)
    centre = 0.5 * (low + high)
    radius = float(np.linalg.norm(hull - centre, axis=1).max())
    pieces: list[_Piece] = []
    cuts: list[Cut] = [*sweeps, *passes]
    for number, (cut, rotation) in enumerate(over_copies(copies, cuts), start=1):
        label = f"{'sweep' if isinstance(cut, Sweep) else 'pass'} {number}"
        if cut.tool not in tools or not 0 <= cut.face < len(scene.faces):
            found = f"tool {cut.tool}, face {cut.face}"
            raise InputError(label, found, "a tool and a face of the scene", "Run the stages again.")
        projector, sense = projectors[cut.face], scene.faces[cut.face].sense
        tool, turned = tools[cut.tool], frame.turned(rotation)
        ride: Ride | PassRide
        material: Literal["", "left", "right"] = ""
        if isinstance(cut, Sweep):
            ride = Ride(cut.motion, tool, turned)
            climbs = is_climb(ride, away_directions(ride, projector, sense))
            if program.cutting != "both" and climbs != (program.cutting == "climb"):
                ride, climbs = replace(ride, backwards=True), not climbs
            material = "right" if climbs else "left"
        else:
            # A pass goes to and fro; only a sweep has one way round.
            ride = PassRide.of(cut, tool, turned)
        for leg in legs_of(ride, machine, label):
            away = away_directions(leg, projector, sense)
            pieces.append(_Piece(number, leg, material, away[0], away[-1]))
    plane = SafePlane(centre, radius + program.safe.clearance, program.safe.clearance)
    overhead = Overhead(hull, program.safe.clearance)
    stretches = _with_links(pieces, plane, overhead, screen, collider, machine, scene.job)
    operations = tuple(
        Operation(_cutter(tool), tuple(stretch for _, visit in group for stretch in visit))
        for tool, group in groupby(
            zip((piece.ride.tool for piece in pieces), stretches, strict=True), key=lambda item: item[0]
        )
    )
    blank_low, blank_high = _blank(low, high)
    faces = tuple(sorted({scene.faces[cut.face].number for cut in cuts}))
    return ToolPath(program.name, scene.part_name, faces, frame.text, blank_low, blank_high, operations)


@dataclass(frozen=True, slots=True)
class _Piece:
    """As much of a cut as can be run without unwinding a rotary axis, and which way is off the face at its ends."""

    cut: int
    ride: Ride | PassRide
    material: Literal["", "left", "right"]
    away_in: Array
    away_out: Array

    @property
    def label(self) -> str:
        return f"{self.ride.purpose.value} {self.cut}"


def _with_links(
    pieces: Sequence[_Piece],
    plane: SafePlane,
    overhead: Overhead,
    screen: Screen,
    collider: Collider,
    machine: Machine,
    job: Job,
) -> list[tuple[Stretch, ...]]:
    """Approach, cut and retract of each piece, after the link to it where there is one, with all feeds."""
    labels = [piece.label for piece in pieces]
    ways = beside([partial(_ways, piece, plane, screen, collider, machine) for piece in pieces])
    rides = [piece.ride for piece in pieces]
    links: list[Link | None] = [None] * len(pieces)
    # A program for each sweep begins and ends with a full retract.
    if job.program.safe.links == "near" and job.program.split != "sweep":
        links = _links_between(pieces, ways, plane, screen, collider, machine)
    follows = [link is not None for link in links]
    followed = [*follows[1:], False]
    # What is run before and after each cut; the safe plane only where it is reached.
    before = [_before(a, link) for (a, _), link in zip(ways, links, strict=True)]
    after = [_after(b, go_on) for (_, b), go_on in zip(ways, followed, strict=True)]
    ends = [(a.axis, b.axis) for a, b in zip(before, after, strict=True)]
    times = space_blocks(rides, machine, labels, ends, follows)
    poses = [ride.poses(t) for ride, t in zip(rides, times, strict=True)]
    tips = [np.vstack([a.tip, tip, b.tip]) for (tip, _), a, b in zip(poses, before, after, strict=True)]
    axes = [np.vstack([a.axis, axis, b.axis]) for (_, axis), a, b in zip(poses, before, after, strict=True)]
    words = words_of(machine, labels, axes, follows)
    # At feed from beside the face to beside it again; the safe plane and links are passed by rapid.
    fed = [
        slice(1 if link is None else len(link.tip) - 1, len(tip) if go_on else len(tip) - 1)
        for tip, link, go_on in zip(tips, links, followed, strict=True)
    ]
    cuts = [
        _fed_cut(piece, tip, axis, turns, at, machine, job)
        for piece, tip, axis, turns, at in zip(pieces, tips, axes, words, fed, strict=True)
    ]
    feeds = block_feeds(cuts, machine, job.program.feed)
    stretches = []
    for index, piece in enumerate(pieces):
        ride, link = piece.ride, links[index]
        tip, axis = tips[index], axes[index]
        start, first, last = fed[index].start, len(before[index].tip), len(tip) - len(after[index].tip) - 1
        feed = np.zeros(len(tip))
        feed[fed[index]] = feeds[index]
        # Into the first pose of a stretch leads nothing; it has the feed of its first block.
        sweep_feed, back_feed = feed[first : last + 1].copy(), feed[last:].copy()
        sweep_feed[0], back_feed[0] = sweep_feed[1], back_feed[1]
        opening = [Stretch(Purpose.LINK, piece.cut, link.tip, link.axis, np.zeros(len(link.tip)))] if link else []
        if link is None:
            feed[1] = 0.0
        entry = slice(start if link else 0, first + 1)
        visit = (
            *opening,
            Stretch(Purpose.APPROACH, piece.cut, tip[entry], axis[entry], feed[entry]),
            Stretch(ride.purpose, piece.cut, tip[first : last + 1], axis[first : last + 1], sweep_feed, piece.material),
            Stretch(Purpose.RETRACT, piece.cut, tip[last:], axis[last:], back_feed),
        )
        if has_head(machine):
            if link is None:
                visit = _from_above(visit, words[index][0], ride.tool, overhead, machine, piece.label)
            if not followed[index]:
                visit = _to_above(visit, words[index][-1], ride.tool, overhead, machine, piece.label)
        stretches.append(visit)
    return stretches


def _from_above(
    visit: tuple[Stretch, ...], words: Array, tool: Tool, overhead: Overhead, machine: Machine, label: str
) -> tuple[Stretch, ...]:
    """The same stretches, the first of which begins above the part with the axis and rotary words (2,) it has now."""
    start, *rest = visit
    (up,) = up_in_part(machine, words[None])
    above = overhead.above(start.tip[0], start.axis[0], up, 0.0, tool, label)
    if above is None:
        return visit
    tip, axis = np.vstack([above, start.tip]), np.vstack([start.axis[:1], start.axis])
    return replace(start, tip=tip, axis=axis, feed=np.concatenate([[0.0], start.feed])), *rest


def _to_above(
    visit: tuple[Stretch, ...], words: Array, tool: Tool, overhead: Overhead, machine: Machine, label: str
) -> tuple[Stretch, ...]:
    """The stretches, and from the last pose, with words (2,), to above the part, where the spindle turns upright."""
    *rest, end = visit
    (up,) = up_in_part(machine, words[None])
    upright = upright_words(machine, words[None])
    ways = unwound(machine, np.vstack([words[None], upright]))
    turning = forward(machine, ways[:1] + np.linspace(0.0, 1.0, UPRIGHT_SAMPLES)[:, None] * (ways[1:] - ways[:1]))
    tilt = float(np.arccos(np.clip(turning @ up, -1.0, 1.0)).max())
    above = overhead.above(end.tip[-1], end.axis[-1], up, tilt, tool, label)
    if above is not None:
        tip, axis = np.vstack([end.tip, above]), np.vstack([end.axis, end.axis[-1:]])
        end = replace(end, tip=tip, axis=axis, feed=np.concatenate([end.feed, [0.0]]))
    return *rest, end, Stretch(Purpose.UPRIGHT, end.cut, end.tip[-1:], forward(machine, upright), np.zeros(1))


def _fed_cut(piece: _Piece, tip: Array, axis: Array, words: Array, at: slice, machine: Machine, job: Job) -> FedCut:
    """What is run at feed, as it is printed: the poses `at` of a piece with its ways."""
    datum = job.program.datum
    tip = as_printed(tip[at], np.zeros(3) if isinstance(datum, int) else np.asarray(datum, dtype=np.float64))
    words = as_printed(words[at], np.zeros(2))
    positions = axis_positions(machine, mounting_of(job), piece.ride.tool.name, tip, words)
    return FedCut(tip, axis[at], positions, piece.ride, f"{piece.label} with its approach")


def _before(way: Link, link: Link | None) -> Link:
    """Poses before a cut, without its first: from the safe plane, or along the link from the cut before."""
    if link is None:
        return Link(way.tip[:-1], way.axis[:-1])
    # The link ends where the way from the safe plane would arrive beside the face.
    return Link(np.vstack([link.tip, way.tip[2:-1]]), np.vstack([link.axis, way.axis[2:-1]]))


def _after(way: Link, followed: bool) -> Link:
    """Poses after a cut, without its last: to the safe plane, or to beside the face where a link begins."""
    first = 1 if followed else 0
    return Link(way.tip[first:-1][::-1], way.axis[first:-1][::-1])


def _links_between(
    pieces: Sequence[_Piece],
    ways: Sequence[tuple[Link, Link]],
    plane: SafePlane,
    screen: Screen,
    collider: Collider,
    machine: Machine,
) -> list[Link | None]:
    """The link into each piece from the one before, where one is free and the rotary axes run through it."""

    def into(index: int) -> Link | None:
        old, new = pieces[index - 1], pieces[index]
        # Legs of one cut part because an axis has to unwind; copies lie in frames of their own.
        if old.cut == new.cut or old.ride.tool != new.ride.tool or _other_copy(old, new):
            return None
        (_, out), (way_in, _) = ways[index - 1], ways[index]
        for link in near_links(out, way_in, plane.clearance):
            left = np.vstack([planned_axes(old.ride), _after(out, True).axis])
            run = Run(new.label, np.vstack([left, _before(way_in, link).axis, planned_axes(new.ride)]))
            # What a control makes of it lies between a turn on great circles and one of even rotary axes.
            other = _by_rotary_axes(machine, run, link, len(left))
            if other is not None and all(is_free(way, new.ride, screen, collider) for way in (link, other)):
                return link
        return None

    links = [None, *beside([partial(into, index) for index in range(1, len(pieces))])]
    # Each pair can be run through; of more than two in a row an axis may reach the end of its range.
    start = 0
    while start < len(pieces):
        end = start + 1
        while end < len(pieces) and links[end] is not None:
            end += 1
        runs = [
            np.vstack([_before(ways[k][0], links[k]).axis, planned_axes(pieces[k].ride), _after(ways[k][1], True).axis])
            for k in range(start, end)
        ]
        count = _run_together(machine, runs)
        if start + count < len(pieces):
            links[start + count] = None
        start += count
    return links


def _other_copy(old: _Piece, new: _Piece) -> bool:
    """Whether two pieces are cut on different copies of the part."""
    return not np.array_equal(old.ride.frame.rotation, new.ride.frame.rotation)


def _run_together(machine: Machine, runs: Sequence[Array]) -> int:
    """How many of these ways (N, 3), from the first on, the machine can run through one after the other."""
    good, bad = 1, len(runs) + 1
    while bad - good > 1:
        middle = len(runs) if bad > len(runs) else (good + bad) // 2
        if _words(machine, Run("cuts with their links", np.vstack(runs[:middle]))) is not None:
            good = middle
        else:
            bad = middle
    return good


def _by_rotary_axes(machine: Machine, run: Run, link: Link, first: int) -> Link | None:
    """The poses of a link where its rotary axes move evenly from block to block.

    The link begins at pose `first` of the run, which holds the cuts on both sides. None where the rotary axes cannot
    run through, or would whip around on the link.
    """
    words = _words(machine, run)
    if words is None:
        return None
    words = words[first : first + len(link.tip)]
    if _whips(machine, link.axis, words):
        return None
    number = np.arange(len(link.tip), dtype=np.float64)
    shares = np.linspace(0.0, number[-1], LINK_CHECKS * (len(number) - 1) + 1)
    turned = unwound(machine, words)
    words = np.stack([np.interp(shares, number, column) for column in turned.T], axis=1)
    tip = np.stack([np.interp(shares, number, column) for column in link.tip.T], axis=1)
    return Link(tip, forward(machine, words))


def _words(machine: Machine, run: Run) -> Array | None:
    """Rotary words (N, 2) of a way; None where the machine cannot take every pose of it, or not run through them."""
    if not within_range(machine, run.axis).all():
        return None
    try:
        return choose_words(machine, [run])[0]
    except WindingError:
        return None


def _whips(machine: Machine, axis: Array, words: Array) -> bool:
    """Whether the axis would leave its way (N, 3) between poses, for the rotary axes rush there, words (N, 2)."""
    return bool(swing(machine, axis, words).max() > SWING_LIMIT)


def _rushes(machine: Machine, run: Run, parts: Sequence[slice]) -> bool:
    """Whether the machine cannot follow a run evenly: run through all of it, and through these parts without a rush."""
    words = _words(machine, run)
    return words is None or any(_whips(machine, run.axis[part], words[part]) for part in parts)


def _ways(piece: _Piece, plane: SafePlane, screen: Screen, collider: Collider, machine: Machine) -> tuple[Link, Link]:
    """The ways to the first pose of a piece, and from its last (read backwards)."""
    ride, sides = piece.ride, ((False, piece.away_in), (True, piece.away_out))

    def both(links: Callable[[Ride | PassRide, bool, Array], Iterator[Sequence[Link]]]) -> list[Link]:
        return beside([partial(clearest, links(ride, *side), ride, screen, collider) for side in sides])

    inward, outward = both(plane.links)
    run = Run(piece.label, np.vstack([inward.axis, planned_axes(ride), outward.axis[::-1]]))
    ends = slice(0, len(inward.axis)), slice(len(run.axis) - len(outward.axis), len(run.axis))
    if _rushes(machine, run, ends):
        # On an arc the axis swings on past its ends, which a rotary axis at the end of its range cannot, and near the
        # pose of the first rotary axis only in a rush. A straight way has the axis of the cut's end.
        inward, outward = both(plane.straight)
    return inward, outward


def _cutter(tool: Tool) -> Cutter:
    return Cutter(tool.number, tool.name, tool.r_min, tool.r_max, tool.length, tool.spindle_rpm)


def _blank(low: Array, high: Array) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Corners of the blank, whole millimetres outward, no side too thin for the control's graphics."""
    low, high = np.floor(low), np.ceil(high)
    size = np.maximum(high - low, np.ceil((high - low).max() / BLANK_RATIO))
    high = low + np.maximum(size, 1.0)
    return (float(low[0]), float(low[1]), float(low[2])), (float(high[0]), float(high[1]), float(high[2]))
