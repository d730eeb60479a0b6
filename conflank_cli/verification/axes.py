"""What the axes of the job's machine have to do for a program: speed, acceleration, jerk, and the time it takes.

Block k moves an axis by dq_k. At its feed F_k it takes dt_k = way of the tip / F_k (where the tip stands, degrees of
the rotary axis that turns most / F_k). From the text alone

    speed         v_k = dq_k / dt_k
    acceleration  a_k = (v_{k+1} - v_k) / ((dt_k + dt_{k+1}) / 2)
    jerk          j_k = (a_{k+1} - a_k) / ((dt_k + dt_{k+1} + dt_{k+2}) / 3)

which is exact for parabolas and cubics, however uneven the blocks are. It is taken over runs of blocks at feed that
follow one another. A run begins and ends at the pace of a rapid or at rest, which is the control's own business.

*Rounding.* Coordinates and rotary words have four decimals (some posts write three), and half a digit of each may be
rounding. Each speed may then be off by that at both ends of dq_k, and by as much of the way that its time is counted
of; accelerations and jerks by the sum of what their speeds may be. That much is subtracted before a value is compared
with its limit, so that a block of a few digits is no finding. Feeds are what the text says; nothing is subtracted for
them.

*Time.* Every unbroken run of moves goes from rest to rest. A rapid takes what its slowest axis needs. Up to the nominal
pace the axes speed up and brake within their acceleration; at a corner no axis changes its speed by more than its
acceleration does in tau = max(acceleration / jerk), the time over which set points are averaged to limit jerk, and
which is added once for every run.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from conflank_cli.scene import Scene
from conflank_cli.tool import Tool
from conflank_cli.verification.findings import Finding
from conflank_cli.verification.machine import MachineModel
from conflank_cli.verification.posed import PosedProgram
from conflank_cli.verification.poses import Poses
from conflank_cli.verification.program import Moves, Program

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]
Integers = npt.NDArray[np.int64]

DIGITS = (1e-3, 1e-4)
"""mm and degrees: the last digit of coordinates or of rotary words is the first of these that all steps are whole
multiples of, or else the last."""
WHOLE = 1e-4
"""Share of a digit by which a multiple of it may be off: words are kept in binary, rotary ones in radians."""
SLACK = 0.005
"""Share by which a limit may be passed: the bound on rounding is of first order."""
STANDING = 1e-9
"""mm or radians: an axis that moves less stands."""
TOO_FAST = 1.05
"""Times the tool's feed that the fastest point in contact may have: feeds are whole numbers."""
TOO_SLOW = 0.5
"""Times the tool's feed below which a feed needs a reason."""
REASON = 0.8
"""Share of an axis' limit, or of what a block can take, that is a reason."""
BESIDE = 3
"""Blocks before and after a slow stretch in which its reason may lie: a jerk belongs to three of them."""
_KINDS = (("CF403", "speed", ""), ("CF404", "acceleration", "2"), ("CF405", "jerk", "3"))


@dataclass(frozen=True, slots=True)
class Driven:
    """A program as the job's machine runs it, N moves.

    Attributes
    ----------
    seconds: of each move, (N,); 0 where its way is not known.
    load: (N,), largest share of any limit of an axis, or of what the control does in a block, that a move at feed is
        part of, feeds rounded to whole numbers either way.
    findings: axes that would have to do more than they can, feeds that the machine does not have.
    """

    seconds: Array
    load: Array
    findings: tuple[Finding, ...]


def drive(posed: PosedProgram, scene: Scene) -> Driven:
    """Run a program on the job's machine.

    Parameters
    ----------
    posed: the program with its poses and rotary positions.
    scene: its job tells where part and tools are mounted. Where it does not, the way of the tip on the part stands for
        those of X, Y and Z.
    """
    machine, moves = posed.machine, posed.program.moves
    if len(moves.block) == 0:
        return Driven(np.zeros(0), np.zeros(0), ())
    half = 0.5 * _digit(moves.point, moves.joined), 0.5 * _digit(np.degrees(posed.rotary), moves.joined)
    axes, wrong = _positions(posed, scene, half[0], np.radians(half[1]))
    steps = np.diff(axes, axis=0, prepend=axes[:1])
    steps[:, 3:] = _shorter_ways(steps[:, 3:], machine)
    way = np.linalg.norm(np.diff(moves.point, axis=0, prepend=moves.point[:1]), axis=1)
    known = moves.joined & np.isfinite(steps).all(axis=1)
    known[0] = False
    steps[~known] = 0.0
    stands = known & (way < STANDING) & (np.abs(steps) < STANDING).all(axis=1)
    fed = known & ~stands & ~moves.rapid & np.isfinite(moves.feed) & (moves.feed > 0.0)
    length = np.where(way < STANDING, np.degrees(np.abs(steps[:, 3:]).max(axis=1)), way)
    at_feed = np.where(fed, 60.0 * length / np.where(fed, moves.feed, 1.0), 0.0)
    least = np.maximum((np.abs(steps) / machine.limits.speed).max(axis=1), machine.block_time)
    seconds = _times(machine, steps, np.maximum(least, at_feed), known, stands)
    run = _Fed.of(steps, at_feed, length, wrong, half[0], fed, stands)
    load, findings = _asked(posed, run)
    if scene.job.program.foreign is not None:
        # Whoever posts with sharp corners leaves it to the control to slow down there; `seconds` says what comes of it.
        findings = [finding for finding in findings if finding.code == _KINDS[0][0]]
    return Driven(seconds, load, (*_above_machine(moves, machine), *findings))


def _digit(values: Array, joined: Flags) -> float:
    """The last digit of words, of which all joined steps between `values` (N, K) are multiples."""
    steps = np.diff(values, axis=0)[joined[1:]]
    steps = steps[np.isfinite(steps)]
    for digit in DIGITS:
        if np.abs(steps / digit - np.round(steps / digit)).max(initial=0.0) < WHOLE:
            return digit
    return DIGITS[-1]


def _positions(posed: PosedProgram, scene: Scene, half: float, half_turn: float) -> tuple[Array, Array]:
    """Positions of the five axes at all moves, mm and radians, and by how much rounding the words may change them.

    Both (N, 5). half, half_turn: what rounding may change coordinates (mm) and rotary words (radians) by.
    """
    machine, moves, rotary = posed.machine, posed.program.moves, posed.rotary
    keys = scene.job.machine
    lengths = [np.nan if tool is None else keys.gauge_length.get(tool.name, np.nan) for tool in posed.tools]
    length = np.array([*lengths, np.nan])[moves.tool]
    lines = moves.point.copy()
    wrong = np.tile([half, half, half, half_turn, half_turn], (len(lines), 1))
    mounted = np.isfinite(length) & np.isfinite(rotary).all(axis=1)
    if keys.zero is not None and mounted.any():
        zero = np.array(keys.zero)
        axis = machine.tool_axis(rotary[mounted])
        centre = posed.program.header.reference == "SPHERE CENTRE"
        radius = np.array([0.0 if tool is None or not centre else tool.ball_radius for tool in (*posed.tools, None)])
        tip = moves.point[mounted] - radius[moves.tool[mounted]][:, None] * axis
        lines[mounted] = machine.nose(tip, rotary[mounted], zero, length[mounted])
        # Three coordinates at once, turned into the machine's directions, and what both rotary words do to them.
        wrong[mounted, :3] = sqrt(3.0) * half
        for turn in half_turn * np.eye(2):
            moved = machine.nose(tip, rotary[mounted] + turn, zero, length[mounted])
            wrong[mounted, :3] += np.abs(moved - lines[mounted])
    # APT data is for no machine in particular: only the way of the tip is known.
    return np.hstack([lines, rotary if posed.program.control else np.zeros_like(rotary)]), wrong


def _shorter_ways(turns: Array, machine: MachineModel) -> Array:
    """Steps (N, 2) of the rotary axes, radians: an endless axis whose words lie in one turn goes the shorter way."""
    result = turns.copy()
    for column, axis in enumerate(machine.rotary):
        if not np.isfinite(axis.high):
            result[:, column] -= 2.0 * np.pi * np.round(turns[:, column] / (2.0 * np.pi))
    return result


def contact_feeds(
    poses: Poses,
    program: Program,
    tools: Sequence[Tool | None],
    scene: Scene,
    cutting: Flags,
    labelled: Flags,
    load: Array,
) -> list[Finding]:
    """Feeds in contact that are not the tool's.

    Parameters
    ----------
    poses, program, tools: as posed.
    scene: its job tells where the feed is counted: at the fastest point of what cuts, or at the tip.
    cutting: (N,) moves that have left some of the surface as it is.
    labelled: (N,) moves of cuts that the program labels as such, of those that are to be checked.
    load: (N,), see `Driven`. A feed far below the tool's needs a reason among the axes, where cuts are labelled.
    """
    moves = poses.moves
    kind = np.array([*(cut.kind for cut in program.cuts), ""])[moves.cut]
    feeds = np.array([*(np.nan if tool is None else tool.feed_mm_min for tool in tools), np.nan])[moves.tool]
    checked = moves.joined & ~moves.rapid & (moves.feed > 0.0) & np.isfinite(feeds) & (labelled | cutting)
    checked[:1] = False
    at = np.flatnonzero(checked)
    tip, axis = poses.tip[at] - poses.tip[at - 1], poses.axis[at] - poses.axis[at - 1]
    way = np.linalg.norm(tip, axis=1)
    at, tip, axis, way = at[way > STANDING], tip[way > STANDING], axis[way > STANDING], way[way > STANDING]
    if len(at) == 0:
        return []
    fastest = way
    if scene.job.program.feed == "contact":
        # What cuts reaches from the tip to the end of the cone, of a pass to the middle of the ball.
        cone = np.array([*(0.0 if tool is None else tool.length - tool.tip_height for tool in tools), 0.0])
        ball = np.array([*(0.0 if tool is None else tool.ball_radius for tool in tools), 0.0])
        top = np.where(kind[at] == "sweep", cone[moves.tool[at]], ball[moves.tool[at]])
        fastest = np.maximum(way, np.linalg.norm(tip + top[:, None] * axis, axis=1))
    feed, wanted = moves.feed[at] * fastest / way, feeds[at]
    # A feed is a whole number, and a way is known to some digits: what either may make of it is no excess.
    rounding = 0.5 * fastest / way + 2.0 * feed * sqrt(3.0) * DIGITS[-1] / way
    findings = []
    fast = feed - rounding > TOO_FAST * wanted
    if fast.any():
        findings.append(_other_feed(moves, at, np.where(fast, feed / wanted, 0.0), feed, wanted, int(fast.sum())))
    slow = (feed + rounding < TOO_SLOW * wanted) & labelled[at]
    # In APT data rotary axes are not known, and may be the reason.
    slow &= ~_with_reason(slow, at, load[at]) & program.control
    if slow.any():
        findings.append(_other_feed(moves, at, np.where(slow, wanted / feed, 0.0), feed, wanted, int(slow.sum())))
    return findings


def labelled_cuts(program: Program) -> Flags:
    """Which moves (N,) belong to what the program labels as a sweep or a pass."""
    return np.isin(np.array([*(cut.kind for cut in program.cuts), ""])[program.moves.cut], ("sweep", "pass"))


def _with_reason(slow: Flags, at: Integers, load: Array) -> Flags:
    """Which blocks (K,) at moves `at` are slow because an axis, or the control, is near a limit in the same stretch."""
    # A stretch of slow blocks, and what is just before and after it: there the axes brake and speed up.
    first = np.flatnonzero(slow & ~np.append(False, slow[:-1] & (np.diff(at) == 1)))
    last = np.flatnonzero(slow & ~np.append(slow[1:] & (np.diff(at) == 1), False))
    reason = np.zeros(len(slow), dtype=np.bool_)
    for begin, end in zip(first.tolist(), last.tolist(), strict=True):
        reason[begin : end + 1] = load[max(begin - BESIDE, 0) : end + 1 + BESIDE].max() >= REASON
    return reason


def _other_feed(moves: Moves, at: Integers, off: Array, feed: Array, wanted: Array, count: int) -> Finding:
    worst = int(off.argmax())
    block = int(moves.block[at[worst]])
    text = f"{feed[worst]:.0f} mm/min in contact in block {block}, {wanted[worst]:g} are the tool's in the job"
    if feed[worst] < wanted[worst]:
        text += ", and no axis is near a limit"
    return Finding("CF115", text, block, None, round(float(feed[worst]), 3), float(wanted[worst]), "mm/min", count)


def _above_machine(moves: Moves, machine: MachineModel) -> list[Finding]:
    """Feeds that the machine does not have."""
    above = ~moves.rapid & (moves.feed > machine.max_feed * (1.0 + STANDING))
    if not above.any():
        return []
    worst = int(np.where(above, moves.feed, 0.0).argmax())
    text = f"F{moves.feed[worst]:.9g} in block {moves.block[worst]}; {machine.name} has {machine.max_feed:g} mm/min"
    block, count = int(moves.block[worst]), int(above.sum())
    return [Finding("CF115", text, block, None, float(moves.feed[worst]), machine.max_feed, "mm/min", count)]


class _Fed(NamedTuple):
    """The blocks at feed, K of them.

    at (K,): their moves; together (K - 1,): whether two of them follow one another; speed (K, 5), mm and radians a
    second; off (K, 5): what rounding words may have changed it by; whole (K, 5): what half a mm/min changes it by;
    seconds (K, 1).
    """

    at: Integers
    together: Flags
    speed: Array
    off: Array
    whole: Array
    seconds: Array

    @classmethod
    def of(
        cls, steps: Array, seconds: Array, length: Array, wrong: Array, half: float, fed: Flags, stands: Flags
    ) -> _Fed:
        at = np.flatnonzero(fed)
        # Moves that stand are left out and break nothing; rapids and unknown ways do.
        broken = np.cumsum(~(fed | stands))[at]
        speed = steps[at] / seconds[at, None]
        # The way is a difference of two places; where it is all but rounding, nothing is known of the speed.
        share = np.minimum(2.0 * sqrt(3.0) * half / length[at, None], 1.0)
        off = (wrong[at] + wrong[at - 1]) / seconds[at, None] + np.abs(speed) * share
        whole = np.abs(steps[at]) / (120.0 * length[at, None])
        return cls(at, broken[1:] == broken[:-1], speed, off, whole, seconds[at, None])


def _asked(posed: PosedProgram, fed: _Fed) -> tuple[Array, list[Finding]]:
    """Loads (N,) of all moves, and one finding for every axis and limit that is passed at feed."""
    machine = posed.machine
    load = np.zeros(len(posed.program.moves.block))
    if len(fed.at) == 0:
        return load, []
    dt = fed.seconds
    h, g = 0.5 * (dt[1:] + dt[:-1]), (dt[2:] + dt[1:-1] + dt[:-2]) / 3.0
    a = np.diff(fed.speed, axis=0) / h
    values = fed.speed, a, np.diff(a, axis=0) / g
    off, whole = ((by, (by[1:] + by[:-1]) / h, _second(by, h) / g) for by in (fed.off, fed.whole))
    # A jerk that is taken over the middle block alone may be the larger one: whoever chose the feed may have done so.
    shorter = np.ones_like(dt), np.ones_like(h), np.minimum(dt[1:-1] / g, 1.0)
    places = (np.ones(len(dt), dtype=np.bool_), fed.together, fed.together[1:] & fed.together[:-1])
    findings: list[Finding] = []
    for order, (inside, value, limit) in enumerate(zip(places, values, machine.limits, strict=True)):
        amount = np.where(inside[:, None], np.maximum(np.abs(value) - off[order], 0.0), 0.0)
        near = (np.abs(value) + whole[order]) / shorter[order] / limit
        share = np.where(inside, near.max(axis=1), 0.0)
        for k in range(order + 1):
            chosen = fed.at[k : k + len(share)]
            load[chosen] = np.maximum(load[chosen], share)
        if len(share):
            findings += _passed(posed, order, amount, fed.at[order:], limit)
    load[fed.at] = np.maximum(load[fed.at], machine.block_time / dt[:, 0])
    return load, findings


def _second(by: Array, h: Array) -> Array:
    """The most that two accelerations may differ by, (K - 2, 5), where speeds are off by `by` (K, 5)."""
    once = (by[1:] + by[:-1]) / h
    return np.asarray(once[1:] + once[:-1])


def _passed(posed: PosedProgram, order: int, amount: Array, at: Integers, limit: Array) -> list[Finding]:
    """A finding for every axis whose limit is passed: amount (K, 5) at moves `at` (K,)."""
    code, what, power = _KINDS[order]
    moves, machine = posed.program.moves, posed.machine
    findings = []
    for column, letter in enumerate("XYZ" + machine.letters):
        over = amount[:, column] > limit[column] * (1.0 + SLACK)
        if not over.any():
            continue
        worst = int(amount[:, column].argmax())
        scale, unit = (1.0, "mm/s") if column < 3 else (180.0 / np.pi, "deg/s")
        most, allowed, block = amount[worst, column] * scale, limit[column] * scale, int(moves.block[at[worst]])
        text = f"{letter} would need a {what} of {most:.4g} {unit}{power} in block {block}; {machine.name} has"
        findings.append(
            Finding(
                code,
                f"{text} {allowed:.4g}",
                block,
                None,
                round(float(most), 6),
                round(float(allowed), 6),
                unit + power,
                int(over.sum()),
            )
        )
    return findings


def _times(machine: MachineModel, steps: Array, nominal: Array, known: Flags, stands: Flags) -> Array:
    """Seconds of each move, (N,), from rest to rest in every run of moves that follow one another.

    steps (N, 5); nominal (N,): seconds at the programmed pace; known (N,): which begin where the one before ends;
    stands (N,): which of them move nothing.
    """
    _, acceleration, jerk = machine.limits
    tau = float((acceleration / jerk).max())
    at = np.flatnonzero(known & ~stands)
    result = np.zeros(len(nominal))
    if len(at) == 0:
        return result
    tiny = np.finfo(np.float64).tiny
    v = steps[at] / nominal[at, None]
    # Pace is the share of the nominal speed; its largest change a second is what the axis nearest its limit allows.
    rates = (1.0 / np.maximum((np.abs(v) / acceleration).max(axis=1), tiny)).tolist()
    jump = (np.abs(np.diff(v, axis=0)) / (acceleration * tau)).max(axis=1)
    stops = np.diff(np.cumsum(~known)[at]) > 0
    times = nominal[at].tolist()
    pace = [0.0, *np.where(stops, 0.0, np.minimum(1.0, 1.0 / np.maximum(jump, tiny))).tolist(), 0.0]
    for k in range(len(times)):
        pace[k + 1] = min(pace[k + 1], sqrt(pace[k] ** 2 + 2.0 * rates[k] * times[k]))
    for k in range(len(times) - 1, -1, -1):
        pace[k] = min(pace[k], sqrt(pace[k + 1] ** 2 + 2.0 * rates[k] * times[k]))
    result[at] = [_block_time(pace[k], pace[k + 1], rates[k], times[k]) for k in range(len(times))]
    # Set points that are averaged over tau arrive that much later.
    result[at[np.append(stops, True)]] += tau
    return result


def _block_time(start: float, end: float, rate: float, time: float) -> float:
    """Seconds for a block of `time` at pace 1 from pace `start` to pace `end`, changed by `rate` a second at most.

    Up to the pace top, along at it, and down again: with top^2 = (start^2 + end^2) / 2 + rate time the way is just used
    up; above pace 1 the block goes on at 1 in between.
    """
    top = min(1.0, sqrt(0.5 * (start * start + end * end) + rate * time))
    ramps = (2.0 * top - start - end) / rate
    covered = (2.0 * top * top - start * start - end * end) / (2.0 * rate)
    return ramps + max(time - covered, 0.0) / top
