"""From sweeps to the neutral tool path: setup, block spacing, feed, approach and retract.

The control moves the tip on a straight line between blocks and swings the axis either on a great circle or by
interpolating the rotary words, depending on its mode. Blocks are spaced so that the cutter's axis, from the tip to the
plane of r_max, stays within `CHORD_TOLERANCE` of the exact motion either way.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby

import numpy as np
import numpy.typing as npt

from conflank_cli.errors import InputError, NumericalError
from conflank_cli.formats import post_of, program_options
from conflank_cli.geometry.footpoint import Projector
from conflank_cli.geometry.screening import Screen
from conflank_cli.machine_frame import Frame, machine_of
from conflank_cli.motion import Motion
from conflank_cli.scene import Scene
from conflank_cli.sweep import Sweep
from conflank_cli.tool import Tool
from postprocessors.errors import PostError
from postprocessors.kinematics.two_rotary import Run, choose_words, forward
from postprocessors.machines.machine import Machine
from postprocessors.post import ProgramFile
from postprocessors.toolpath import Cutter, Operation, Purpose, Stretch, ToolPath

Array = npt.NDArray[np.float64]

CHORD_TOLERANCE = 3e-4
"""mm. With rounding to four decimals (0.09 µm of the tip, 0.06 µm by both angles at 50 mm) the posted axis stays within
the 0.5 µm that posting may cost."""
SAMPLES_PER_SPAN = 16
"""Samples of a motion for each knot span, from which the spacing is planned: its second derivative is linear there."""
SAMPLES_AT_LEAST = 129
CHECKS_PER_BLOCK = 7
"""Places within each block where the deviation is checked; it is a bump with one top, or two and a zero between."""
CHECK_SLACK = 0.97
"""What a check at seven places can miss of the top of such a bump is below 2 %."""
REFINEMENTS = 24
"""Rounds of halving blocks that are still too long; a sweep that needs more runs through the singular pose."""
FEED_FLOOR = 0.01
"""Least tip feed as a share of the contact feed: below it the tip all but stands while the axis swings."""
LEAST_FEED = 1.0
"""mm/min; programs carry whole numbers, and 0 would mean rapid."""
AWAY_SAMPLES = 9
"""Places along a sweep where the direction away from the face is taken."""
HULL_SAMPLES = 65
"""Rows and columns of points that stand for a face when its size is taken; they also give its border."""
LINK_SHARES = (1.0, 0.5, 0.25, 0.1)
"""Shares of the clearance by which a link stands off the face, tried in this order."""
LINK_LIFTS_DEG = (0.0, 30.0, 60.0, 80.0)
"""Angles by which the shift off the face leans up the tool axis."""
LINK_STEP = 1.0
"""Poses of a link are held against the part this far apart, mm."""
BLANK_RATIO = 150.0
"""Largest ratio of the blank's sides (the control refuses 200)."""


@dataclass(frozen=True, slots=True)
class Ride:
    """The exact poses of one sweep in the program's frame.

    Attributes
    ----------
    motion: the axis over time, t in [0, 1].
    tool: the cutter.
    frame: the program's frame.
    backwards: whether the sweep is cut against its t.
    """

    motion: Motion
    tool: Tool
    frame: Frame
    backwards: bool = False

    @property
    def reach(self) -> float:
        """Height of the plane of r_max above the tip, mm."""
        return self.tool.length - self.tool.tip_height

    def poses(self, t: npt.ArrayLike) -> tuple[Array, Array]:
        """Tip points and axes at t (N,), each (N, 3); t always runs in cutting direction."""
        t = np.asarray(t, dtype=np.float64)
        p, q = self.motion.ends(1.0 - t if self.backwards else t)
        axis = q - p
        axis /= np.linalg.norm(axis, axis=1, keepdims=True)
        # |pq| differs from the tool's length by up to a micrometre; anchoring the middle halves what each end sees.
        tip = 0.5 * (p + q) + (self.tool.tip_height - 0.5 * self.tool.length) * axis
        return self.frame.points(tip), self.frame.directions(axis)


# --- the job's program ----------------------------------------------------------------------------------------------


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
    sweeps: what to cut; cut k of the path is sweeps[k - 1].
    machine: its rotary words are one of the two interpolations that the spacing of blocks must bear.

    Raises
    ------
    InputError: there is no sweep, or a sweep names a tool or a face that the scene does not have.
    NumericalError: a sweep needs endlessly short blocks (it passes the machine's singular pose at an angle).
    PostError: an orientation is out of the machine's reach.
    """
    if not sweeps:
        raise InputError("plan", "no sweep", "at least one", "Lower the coverage asked for, or widen the tolerance.")
    tools = {tool.name: tool for tool in scene.tools}
    frame = Frame.of(scene.job.setup)
    screen = Screen.of(scene)
    program = scene.job.program
    projectors = [Projector.of(face.surface) for face in scene.faces]
    hull = frame.points(_hull(scene, projectors))
    low, high = hull.min(axis=0), hull.max(axis=0)
    centre = 0.5 * (low + high)
    radius = float(np.linalg.norm(hull - centre, axis=1).max())
    rides, ends = [], []
    for number, sweep in enumerate(sweeps, start=1):
        if sweep.tool not in tools or not 0 <= sweep.face < len(scene.faces):
            found = f"tool {sweep.tool}, face {sweep.face}"
            raise InputError(f"sweep {number}", found, "a tool and a face of the scene", "Run the stages again.")
        ride = Ride(sweep.motion, tools[sweep.tool], frame)
        away = away_directions(ride, projectors[sweep.face], scene.faces[sweep.face].sense)
        if program.cutting != "both" and is_climb(ride, away) != (program.cutting == "climb"):
            ride, away = Ride(sweep.motion, ride.tool, frame, backwards=True), away[::-1]
        rides.append(ride)
        ends.append((away[0], away[-1]))
    times = space_blocks(rides, machine)
    poses = [ride.poses(t) for ride, t in zip(rides, times, strict=True)]
    words = choose_words(machine, _runs(poses))
    stretches: list[tuple[Tool, tuple[Stretch, ...]]] = []
    for cut, (ride, (tip, axis), word, (away_in, away_out)) in enumerate(
        zip(rides, poses, words, ends, strict=True), start=1
    ):
        feed = contact_feed(tip, axis, word, ride, machine)
        plane = _SafePlane(centre, radius + program.safe.clearance, program.safe.clearance)
        inward = _clearest(plane.links(tip[0], axis[0], away_in), axis[0], ride, screen)
        outward = _clearest(plane.links(tip[-1], axis[-1], away_out), axis[-1], ride, screen)[::-1]
        slow = float(feed[0])
        still_in, still_out = (np.repeat(axis[index][None], 3, axis=0) for index in (0, -1))
        stretches.append(
            (
                ride.tool,
                (
                    Stretch(Purpose.APPROACH, cut, inward, still_in, np.array([0.0, 0.0, slow])),
                    Stretch(Purpose.SWEEP, cut, tip, axis, feed),
                    Stretch(Purpose.RETRACT, cut, outward, still_out, np.array([slow, float(feed[-1]), 0.0])),
                ),
            )
        )
    operations = tuple(
        Operation(_cutter(tool), tuple(stretch for _, cut in group for stretch in cut))
        for tool, group in groupby(stretches, key=lambda item: item[0])
    )
    blank_low, blank_high = _blank(low, high)
    faces = tuple(sorted({scene.faces[sweep.face].number for sweep in sweeps}))
    return ToolPath(program.name, scene.part_name, faces, frame.text, blank_low, blank_high, operations)


def _cutter(tool: Tool) -> Cutter:
    return Cutter(tool.number, tool.name, tool.r_min, tool.r_max, tool.length, tool.spindle_rpm)


# --- directions -----------------------------------------------------------------------------------------------------


def away_directions(ride: Ride, projector: Projector, sense: int) -> Array:
    """Unit directions away from the face and across the axis, at `AWAY_SAMPLES` places along the sweep, (M, 3).

    From the face's nearest point to the axis at mid flute; where the axis runs through the surface there (no face is
    so thin that a sweep does), the surface's normal on the cutter's side.
    """
    tip, axis = ride.poses(np.linspace(0.0, 1.0, AWAY_SAMPLES))
    middle = tip + 0.5 * ride.reach * axis
    # Projection happens in the CAD frame, where the surface is.
    foot = projector.project((middle - ride.frame.translation) @ ride.frame.rotation)
    normal = sense * ride.frame.directions(foot.normal)
    away = middle - ride.frame.points(foot.foot)
    away = np.where(np.linalg.norm(away, axis=1, keepdims=True) > 0.1 * ride.tool.r_min, away, normal)
    away -= np.einsum("ij,ij->i", away, axis)[:, None] * axis
    return np.asarray(away / np.linalg.norm(away, axis=1, keepdims=True))


def is_climb(ride: Ride, away: Array) -> bool:
    """Whether the sweep climb-mills with a spindle that turns clockwise seen from above (M3).

    The spindle turns about -d (d from tip to spindle), so the edge at the contact, -a from the axis (a away from the
    face), runs along (-d) x (-a) = d x a. Climb milling means that it runs against the feed f there: f . (a x d) > 0.
    With d up, feed north and the face to the east (a = west), a x d is north: the material lies to the right.
    """
    tip, axis = ride.poses(np.linspace(0.0, 1.0, len(away)))
    middle = tip + 0.5 * ride.reach * axis
    step = np.diff(middle, axis=0)
    forth = np.cross(away, axis)
    return float(np.einsum("ij,ij->", step, 0.5 * (forth[1:] + forth[:-1]))) > 0.0


# --- block spacing --------------------------------------------------------------------------------------------------


def space_blocks(rides: Sequence[Ride], machine: Machine) -> list[Array]:
    """Times of the blocks of each sweep, as few as hold `CHORD_TOLERANCE`, evenly loaded.

    The deviation of a block grows with the square of its length, so its second-order coefficient gives the density of
    blocks that loads all of them alike; what still fails then (near the singular pose the rotary words have no such
    coefficient) is halved.

    Raises
    ------
    NumericalError: blocks get endlessly short.
    """
    times = [_planned_times(ride, machine, f"sweep {number}") for number, ride in enumerate(rides, start=1)]
    limit = CHECK_SLACK * CHORD_TOLERANCE
    for _ in range(REFINEMENTS):
        # The words of the whole program: which of two solutions a sweep gets may depend on its neighbours.
        words = choose_words(machine, _runs([ride.poses(t) for ride, t in zip(rides, times, strict=True)]))
        done = True
        for index, ride in enumerate(rides):
            t = times[index]
            fails = block_deviation(ride, t, words[index], machine) > limit
            if fails.any():
                done = False
                times[index] = np.sort(np.concatenate([t, 0.5 * (t[:-1] + t[1:])[fails]]))
        if done:
            return times
    raise NumericalError(
        "posting",
        f"blocks that are still too long after {REFINEMENTS} halvings",
        "a motion whose rotary axes follow it",
        "The sweep passes the pose where the first rotary axis is along the tool: turn the part in [setup].",
    )


def _planned_times(ride: Ride, machine: Machine, label: str) -> Array:
    """Times that load all blocks alike, with the least count for which none exceeds the tolerance (or nearly).

    `label` names the sweep in messages.
    """
    spans = len(np.unique(ride.motion.knots)) - 1
    count = max(SAMPLES_AT_LEAST, SAMPLES_PER_SPAN * spans + 1)
    t = np.linspace(0.0, 1.0, count)
    tip, axis = ride.poses(t)
    words = choose_words(machine, [Run(label, axis)])[0]
    width = 2.0 / (count - 1)
    pairs = np.stack([np.arange(count - 2), np.arange(2, count)], axis=1)
    deviation = _deviation(ride, tip[pairs], axis[pairs], words[pairs], tip[1:-1, None], axis[1:-1, None], machine)
    density = np.sqrt(deviation / (CHECK_SLACK * CHORD_TOLERANCE)) / width
    density = np.concatenate([density[:1], density, density[-1:]])
    # A straight stretch has no density of its own; a small one keeps the inverse of the integral defined.
    density = np.maximum(density, max(1e-3 * float(density.max()), np.finfo(np.float64).tiny))
    load = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]) * np.diff(t))])
    blocks = max(1, int(np.ceil(load[-1])))
    for _ in range(6):
        times = np.interp(np.linspace(0.0, load[-1], blocks + 1), load, t)
        times[0], times[-1] = 0.0, 1.0
        words = choose_words(machine, [Run(label, ride.poses(times)[1])])[0]
        worst = float(block_deviation(ride, times, words, machine).max()) / (CHECK_SLACK * CHORD_TOLERANCE)
        # Where even a third more blocks would not do, single blocks are to blame, and those get halved later.
        if worst <= 1.0 or worst > 1.8:
            break
        blocks = max(blocks + 1, int(np.ceil(blocks * np.sqrt(worst))))
    return np.asarray(times)


def _runs(poses: Sequence[tuple[Array, Array]]) -> list[Run]:
    return [Run(f"sweep {number}", axis) for number, (_, axis) in enumerate(poses, start=1)]


def block_deviation(ride: Ride, t: Array, words: Array, machine: Machine) -> Array:
    """Largest deviation (mm) of each block between t[i] and t[i + 1] from the exact motion, shape (N - 1,).

    Both interpolations of the axis, at `CHECKS_PER_BLOCK` places, at the tip and at the plane of r_max; between these
    heights the deviation is smaller.
    """
    tip, axis = ride.poses(t)
    fractions = np.arange(1, CHECKS_PER_BLOCK + 1) / (CHECKS_PER_BLOCK + 1)
    inner = t[:-1, None] + np.diff(t)[:, None] * fractions
    inner_tip, inner_axis = ride.poses(inner.ravel())
    pairs = np.stack([np.arange(len(t) - 1), np.arange(1, len(t))], axis=1)
    shape = (*inner.shape, 3)
    return _deviation(
        ride, tip[pairs], axis[pairs], words[pairs], inner_tip.reshape(shape), inner_axis.reshape(shape), machine
    )


def _deviation(
    ride: Ride, tip: Array, axis: Array, words: Array, inner_tip: Array, inner_axis: Array, machine: Machine
) -> Array:
    """Deviation of N blocks from K exact poses within each, mm, (N,).

    tip, axis (N, 2, 3) and words (N, 2, 2) at the ends; inner_tip, inner_axis (N, K, 3) exact. When a pose is passed
    does not matter, only that it is: each exact pose is compared with the place in the block that is level with its
    middle.
    """
    reach = ride.reach
    count, places, _ = inner_tip.shape
    start = tip[:, 0] + 0.5 * reach * axis[:, 0]
    chord = tip[:, 1] + 0.5 * reach * axis[:, 1] - start
    along = np.einsum("nki,ni->nk", inner_tip + 0.5 * reach * inner_axis - start[:, None], chord)
    share = (along / np.maximum(np.einsum("ni,ni->n", chord, chord), np.finfo(np.float64).tiny)[:, None])[..., None]
    share = np.clip(share, 0.0, 1.0)
    tips = tip[:, None, 0] + share * (tip[:, None, 1] - tip[:, None, 0])
    error_tip = np.linalg.norm(tips - inner_tip, axis=2)

    step = words[:, 1] - words[:, 0]
    for column, rotary in enumerate(machine.rotary):
        if rotary.range_deg is None:
            step[:, column] -= 360.0 * np.round(step[:, column] / 360.0)
    by_words = forward(machine, (words[:, None, 0] + share * step[:, None]).reshape(-1, 2)).reshape(count, places, 3)
    sine = np.linalg.norm(np.cross(axis[:, 0], axis[:, 1]), axis=1)
    angle = np.arctan2(sine, np.einsum("ni,ni->n", axis[:, 0], axis[:, 1]))[:, None, None]
    # sin(x) / sin(angle) tends to x / angle, which sinc says without dividing by zero.
    scale = np.sinc(angle / np.pi)
    by_circle = (1.0 - share) * np.sinc((1.0 - share) * angle / np.pi) / scale * axis[:, None, 0]
    by_circle += share * np.sinc(share * angle / np.pi) / scale * axis[:, None, 1]
    worst = error_tip.max(axis=1)
    for axes in (by_words, by_circle):
        error_top = np.linalg.norm(tips - inner_tip + reach * (axes - inner_axis), axis=2)
        worst = np.maximum(worst, error_top.max(axis=1))
    return np.asarray(worst)


# --- feed -----------------------------------------------------------------------------------------------------------


def contact_feed(tip: Array, axis: Array, words: Array, ride: Ride, machine: Machine) -> Array:
    """Feed of the tip into each pose, mm/min, (N,), for which the fastest point of the flute has the tool's feed.

    Not below `FEED_FLOOR`; limited by the machine's feed, block time and rotary speeds. The first pose gets the feed of
    the second.
    """
    wanted = ride.tool.feed_mm_min
    low = np.linalg.norm(np.diff(tip, axis=0), axis=1)
    high = np.linalg.norm(np.diff(tip + ride.reach * axis, axis=0), axis=1)
    # |step| is a convex function of height, so the fastest point is at one of the ends.
    fastest = np.maximum(np.maximum(low, high), np.finfo(np.float64).tiny)
    turn = np.diff(words, axis=0)
    for column, rotary in enumerate(machine.rotary):
        if rotary.range_deg is None:
            turn[:, column] -= 360.0 * np.round(turn[:, column] / 360.0)
    speeds = np.array([rotary.max_speed_deg_min for rotary in machine.rotary])
    minutes = np.maximum((np.abs(turn) / speeds).max(axis=1), machine.block_time_ms / 60000.0)
    feed = np.maximum(wanted * low / fastest, FEED_FLOOR * wanted)
    feed = np.minimum(np.minimum(feed, low / minutes), machine.max_feed_mm_min)
    feed = np.maximum(feed, LEAST_FEED)
    return np.concatenate([feed[:1], feed])


def stretch_seconds(stretch: Stretch, rapid_mm_min: float) -> float:
    """Time for a stretch at its programmed feeds, seconds; rapid moves at `rapid_mm_min`. Acceleration is ignored."""
    length = np.linalg.norm(np.diff(stretch.tip, axis=0), axis=1)
    feed = np.where(stretch.feed[1:] > 0.0, stretch.feed[1:], rapid_mm_min)
    return float(60.0 * (length / feed).sum())


# --- approach, retract, blank ---------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _SafePlane:
    """Where tools come from: `height` from the centre of all geometry along whatever tool axis."""

    centre: Array
    height: float
    clearance: float

    def links(self, tip: Array, axis: Array, away: Array) -> Iterator[Array]:
        """Ways from the safe plane down beside a pose and to the pose, tip points (3, 3) each, the plainest first.

        Beside the pose means shifted off the face by the clearance. On the way down whatever part of the cutter passes
        a place is thinner than the part that stands there in the end, so it stays clear of what the pose is clear of.
        Where another part of the workpiece is near, a shorter shift that also lifts may still be free.
        """
        for share in LINK_SHARES:
            for lift in np.radians(LINK_LIFTS_DEG):
                beside = tip + share * self.clearance * (np.cos(lift) * away + np.sin(lift) * axis)
                height = max(self.height - float((beside - self.centre) @ axis), self.clearance)
                yield np.stack([beside + height * axis, beside, tip])


def _clearest(links: Iterable[Array], axis: Array, ride: Ride, screen: Screen) -> Array:
    """The first link on which nothing is hit, or the one with the fewest hits: verification then names them."""
    best, fewest = np.zeros((3, 3)), np.inf
    for link in links:
        down = _points_between(link[1], link[0], LINK_STEP)
        tips = np.concatenate([_points_between(link[2], link[1], LINK_STEP), down])
        axes = np.broadcast_to(axis, tips.shape)
        p = (tips - ride.tool.tip_height * axes - ride.frame.translation) @ ride.frame.rotation
        hits = int(np.sum(~screen.free(p, axes @ ride.frame.rotation, ride.tool)))
        if hits < fewest:
            best, fewest = link, hits
        if hits == 0:
            break
    return best


def _points_between(start: Array, end: Array, step: float) -> Array:
    """Points on a straight line, at most `step` mm apart, both ends included, (N, 3)."""
    count = int(np.ceil(np.linalg.norm(end - start) / step)) + 1
    return np.asarray(start + np.linspace(0.0, 1.0, max(count, 2))[:, None] * (end - start))


def _hull(scene: Scene, projectors: Sequence[Projector]) -> Array:
    """Points that stand for all geometry of the scene, CAD frame, (N, 3)."""
    points = [scene.check.vertices.reshape(-1, 3)]
    for face, projector in zip(scene.faces, projectors, strict=True):
        border = np.vstack(face.loops)
        u = np.linspace(border[:, 0].min(), border[:, 0].max(), HULL_SAMPLES)
        v = np.linspace(border[:, 1].min(), border[:, 1].max(), HULL_SAMPLES)
        grid = np.stack(np.meshgrid(u, v, indexing="ij"), axis=-1).reshape(-1, 2)
        places = np.vstack([border, grid])
        points.append(projector.evaluate(places[:, 0], places[:, 1])[:, 0])
    return np.vstack(points)


def _blank(low: Array, high: Array) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Corners of the blank, whole millimetres outward, no side too thin for the control's graphics."""
    low, high = np.floor(low), np.ceil(high)
    size = np.maximum(high - low, np.ceil((high - low).max() / BLANK_RATIO))
    high = low + np.maximum(size, 1.0)
    return (float(low[0]), float(low[1]), float(low[2])), (float(high[0]), float(high[1]), float(high[2]))
