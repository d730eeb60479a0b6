"""Tool axis to rotary words and back, for any two rotary axes, and the choice among solutions over a whole program.

    t = R(a, first) R(b, second) z

a and b are the directions of the machine's two rotary axes, z the spindle direction, t the tool axis in part
coordinates (tip to spindle). For an A/C table (a = z, b = x): t = (sin C sin A, -cos C sin A, cos A).

Arrays: axes are (N, 3), angles (N, 2) in radians, words (N, 2) in degrees with the axis' sign; the columns follow the
machine's `rotary`.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise, product
from math import ceil, floor, pi
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from postprocessors.errors import PostError
from postprocessors.machines.machine import Machine, Rotary

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

TURN = 2.0 * pi
REACH_SLACK = 1e-12
"""Relative overshoot of |D| / rho that is rounding, not an unreachable orientation."""
HOLD_SINE = 5e-7
"""Tilt (sine) below which the first axis is held: less than the last digit of a word with four decimals."""
SWING_LIMIT = 1e-3
"""Largest angle (radians) between the axis at mid-block by rotary words and by the great circle, for the two to count
as the same motion. Steps of 5 degrees stay below it; a change of branch away from the singular pose does not."""
SWING_COST = 1e4
"""Cost of one radian of such deviation, in seconds of rotary motion: more than any detour."""
HALF_TURN = pi * (1.0 - 1e-6)
"""Steps from here on have no shorter way once they are rounded."""
RANGE_SLACK = 1e-9
"""Radians by which an angle may pass a limit before it counts: rounding."""


class WindingError(PostError):
    """Poses that the machine can take one by one, but not one after the other without leaving the part."""


class Solutions(NamedTuple):
    """Both solutions for a sequence of tool axes.

    angles (2, N, 2): radians, each within -pi .. pi.
    singular (2, N): the first axis is along the tool axis, so that its angle means nothing.
    reachable (N,): whether there is a solution at all.
    """

    angles: Array
    singular: Flags
    reachable: Flags


class Run(NamedTuple):
    """Poses that follow each other with tool centre point control on; `label` names them in messages."""

    label: str
    axis: Array


def _wrap(angle: Array) -> Array:
    """Angle within -pi .. pi."""
    return np.asarray(angle - TURN * np.round(angle / TURN))


def _cross(one: Array, other: Array) -> Array:
    """Cross products (N, 3), of which one may be (3,): `numpy.cross` takes longer to look at its input."""
    a, b, c = one[..., 0], one[..., 1], one[..., 2]
    x, y, z = other[..., 0], other[..., 1], other[..., 2]
    return np.stack([b * z - c * y, c * x - a * z, a * y - b * x], axis=-1)


def _turned(direction: Array, angle: Array, vectors: Array) -> Array:
    """Vectors (N, 3) turned about the unit vector `direction` by `angle` (N,) (Rodrigues)."""
    cosine, sine = np.cos(angle)[:, None], np.sin(angle)[:, None]
    along = (vectors @ direction)[:, None] * direction
    return np.asarray(along + cosine * (vectors - along) + sine * _cross(direction, vectors))


def _axis_of(machine: Machine, angles: Array) -> Array:
    """Tool axes (N, 3) at angles (N, 2)."""
    first, second = machine.rotary
    spindle = np.broadcast_to([0.0, 0.0, 1.0], (len(angles), 3))
    return _turned(first.direction, angles[:, 0], _turned(second.direction, angles[:, 1], spindle))


def _signs(machine: Machine) -> Array:
    return np.array([axis.sign for axis in machine.rotary], dtype=np.float64)


def forward(machine: Machine, words: Array) -> Array:
    """Tool axes (N, 3) in part coordinates at rotary words (N, 2) in degrees."""
    return _axis_of(machine, np.radians(words) * _signs(machine))


def inverse(machine: Machine, axis: Array) -> Solutions:
    """Both pairs of angles for each tool axis (N, 3), in closed form.

    From a . t = a . R(b, second) z follows P cos(second) + Q sin(second) = D, with two solutions; the first angle then
    is the signed angle about a from R(b, second) z to t.
    """
    a, b = (rotary.direction for rotary in machine.rotary)
    spindle = np.array([0.0, 0.0, 1.0])
    # R(b, second) z = parts[0] + cos(second) parts[1] + sin(second) parts[2].
    parts = np.stack([b[2] * b, spindle - b[2] * b, np.cross(b, spindle)])
    _, cosine_part, sine_part = (float(part) for part in parts @ a)
    rho = float(np.hypot(cosine_part, sine_part))
    level = axis @ a - b[2] * float(a @ b)
    reachable = np.abs(level) <= rho * (1.0 + REACH_SLACK)
    half = np.arctan2(np.sqrt(np.maximum((rho - level) * (rho + level), 0.0)), level)
    second = _wrap(float(np.arctan2(sine_part, cosine_part)) + np.stack([half, -half]))
    weights = np.stack([np.ones_like(second), np.cos(second), np.sin(second)])
    # Sine and cosine of the first angle, both times the sine of the tilt; the former is that triple product.
    across = axis - (axis @ a)[:, None] * a
    sine = np.einsum("kbn,kn->bn", weights, parts @ _cross(axis, a).T)
    cosine = np.einsum("kbn,kn->bn", weights, parts @ across.T)
    tilt = np.linalg.norm(np.einsum("kbn,kc->cbn", weights, _cross(parts, a)), axis=0)
    return Solutions(np.stack([np.arctan2(sine, cosine), second], axis=-1), tilt < HOLD_SINE, reachable)


def within_range(machine: Machine, axis: Array) -> Flags:
    """Which tool axes (N, 3) some solution reaches within the ranges of both rotary axes, (N,).

    Where the first axis is along the tool axis any of its angles will do.
    """
    angles, singular, reachable = inverse(machine, axis)
    inside = np.broadcast_to(reachable, singular.shape)
    for column, rotary in enumerate(machine.rotary):
        if rotary.range_deg is not None:
            low, high = np.radians(rotary.range_deg)
            turned = rotary.sign * angles[:, :, column] + TURN * np.array(_turns(rotary))[:, None, None]
            within = ((turned >= low - RANGE_SLACK) & (turned <= high + RANGE_SLACK)).any(axis=0)
            inside = inside & (within | singular if column == 0 else within)
    return np.asarray(inside.any(axis=0))


def tilt_all_round(machine: Machine) -> int:
    """Largest tilt of the tool off the spindle direction, whole degrees, up to which every orientation is in range."""
    azimuth = np.radians(np.arange(360.0))
    for tilt in range(181):
        sine, cosine = np.sin(np.radians(tilt)), np.cos(np.radians(tilt))
        axis = np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), np.full(360, cosine)], axis=1)
        if not within_range(machine, axis).all():
            return tilt - 1
    return 180


def _hold(angle: Array, singular: Flags) -> Array:
    """Angle (N,) with the values at singular poses taken from the pose before, or after where none is before."""
    if not singular.any():
        return angle
    if singular.all():
        return np.zeros_like(angle)
    index = np.where(singular, -1, np.arange(len(angle)))
    index = np.maximum.accumulate(index)
    index[index < 0] = int(np.flatnonzero(~singular)[0])
    return np.asarray(angle[index])


def swing(machine: Machine, axis: Array, words: Array) -> Array:
    """Angle at the middle of each step between the axis by rotary words and by the great circle, radians, (N - 1,).

    An endless axis takes the shorter way. This is a look at the middle only; it tells steps that follow the path from
    steps that whip around, and does not bound the deviation within a step.
    """
    angles = np.radians(words) * _signs(machine)
    step = np.diff(angles, axis=0)
    for column, rotary in enumerate(machine.rotary):
        if rotary.range_deg is None:
            step[:, column] = _wrap(step[:, column])
    return _swing(machine, axis, angles[:-1], step)


def _swing(machine: Machine, axis: Array, start: Array, step: Array) -> Array:
    middle = axis[:-1] + axis[1:]
    length = np.linalg.norm(middle, axis=1, keepdims=True)
    middle = middle / np.maximum(length, np.finfo(np.float64).tiny)
    return np.asarray(np.linalg.norm(_axis_of(machine, start + 0.5 * step) - middle, axis=1))


class _Segment(NamedTuple):
    """Poses first .. last - 1 of a run over which neither solution can be left nor breaks.

    angles (2, n, 2): unwrapped; cost (2,): seconds of rotary motion; swing (2, 2): cost of entering solution [to] from
    solution [from] of the segment before (0 at the start of a run); starts: whether it opens a run.
    """

    run: int
    first: int
    last: int
    angles: Array
    cost: Array
    swing: Array
    starts: bool


def _segments(machine: Machine, runs: Sequence[Run]) -> list[_Segment]:
    """Cut the runs where the solution may be changed or must be entered anew."""
    speed = np.radians([rotary.max_speed_deg_min / 60.0 for rotary in machine.rotary])
    segments: list[_Segment] = []
    for number, run in enumerate(runs):
        solutions = inverse(machine, run.axis)
        if not solutions.reachable.all():
            pose = int(np.flatnonzero(~solutions.reachable)[0])
            x, y, z = run.axis[pose]
            raise PostError(
                f"{run.label}, pose {pose + 1}",
                f"tool axis ({x:.6f}, {y:.6f}, {z:.6f})",
                f"an orientation that {machine.name} can reach",
                "Turn the part in [setup] or choose another machine.",
            )
        angles = solutions.angles
        for branch in range(2):
            angles[branch, :, 0] = _hold(angles[branch, :, 0], solutions.singular[branch])
        cost = np.zeros((2, 2, len(run.axis) - 1))
        for old, new in product(range(2), range(2)):
            step = _wrap(angles[new, 1:] - angles[old, :-1])
            cost[old, new] = _swing(machine, run.axis, angles[old, :-1], step)
        own = np.maximum(cost[0, 0], cost[1, 1])
        cross = np.minimum(cost[0, 1], cost[1, 0])
        cuts = np.flatnonzero((own > SWING_LIMIT) | (cross <= SWING_LIMIT)) + 1
        borders = [0, *(int(cut) for cut in cuts), len(run.axis)]
        for first, last in pairwise(borders):
            unwrapped = np.unwrap(angles[:, first:last], axis=1)
            seconds = (np.abs(np.diff(unwrapped, axis=1)) / speed).sum(axis=(1, 2))
            inner = np.array([cost[branch, branch, first : last - 1].sum() for branch in range(2)])
            entry = np.zeros((2, 2)) if first == 0 else SWING_COST * cost[:, :, first - 1]
            segments.append(_Segment(number, first, last, unwrapped, seconds + SWING_COST * inner, entry, first == 0))
    return segments


def _turns(rotary: Rotary) -> list[int]:
    """Whole turns that may have to be added to an angle within -pi .. pi to fill the range of the axis."""
    if rotary.range_deg is None:
        return [0]
    low, high = np.radians(rotary.range_deg)
    return list(range(floor((low - pi) / TURN), ceil((high + pi) / TURN) + 1))


def choose_words(machine: Machine, runs: Sequence[Run]) -> list[Array]:
    """Rotary words (degrees) for each run, chosen over the whole program.

    Dynamic programming over {two solutions x turns of each limited axis}: within a run an angle never jumps by half a
    turn, a change of solution is free only where both describe the same motion (at the singular pose), and among what
    is left the least rotary motion wins, between the runs too. Where the first axis is along the tool axis it holds.

    Parameters
    ----------
    machine: the machine.
    runs: poses in program order; each run has at least one.

    Returns
    -------
    One (N, 2) array for each run: words with `modulo` output lie in 0 .. 360, words of an endless axis with
    `continuous` output count turns.

    Raises
    ------
    PostError: an orientation is unreachable, out of range, or cannot be reached without leaving the run.

    What it does not promise: that the steps are small enough for either interpolation (see `swing`).
    """
    if not runs:
        return []
    signs = _signs(machine)
    speed = np.radians([rotary.max_speed_deg_min / 60.0 for rotary in machine.rotary])
    endless = [rotary.range_deg is None for rotary in machine.rotary]
    low, high = np.full(2, -np.inf), np.full(2, np.inf)
    for column, rotary in enumerate(machine.rotary):
        if rotary.range_deg is not None:
            limits = sorted(np.radians(rotary.range_deg) * signs[column])
            low[column], high[column] = limits[0] - RANGE_SLACK, limits[1] + RANGE_SLACK
    turns = np.array(
        [
            (first * signs[0], second * signs[1])
            for first, second in product(*(_turns(rotary) for rotary in machine.rotary))
        ]
    )
    branch = np.repeat([0, 1], len(turns))
    offset = TURN * np.tile(turns, (2, 1))

    segments = _segments(machine, runs)
    total = np.zeros(len(branch))
    back: list[npt.NDArray[np.int64]] = []
    previous = np.zeros((len(branch), 2))
    for position, segment in enumerate(segments):
        start = segment.angles[branch, 0] + offset
        inside = (
            (segment.angles.min(axis=1)[branch] + offset >= low) & (segment.angles.max(axis=1)[branch] + offset <= high)
        ).all(axis=1)
        step = start[None, :, :] - previous[:, None, :]
        for column in range(2):
            if endless[column]:
                step[:, :, column] = _wrap(step[:, :, column])
        move = (np.abs(step) / speed).sum(axis=2) + segment.swing[branch[:, None], branch[None, :]]
        if not segment.starts:
            move = np.where((np.abs(step) < HALF_TURN).all(axis=2), move, np.inf)
        reached = total[:, None] + move
        origin = reached.argmin(axis=0)
        total = np.where(inside, reached[origin, np.arange(len(branch))] + segment.cost[branch], np.inf)
        back.append(origin)
        if not np.isfinite(total).any():
            raise _out_of_range(machine, runs[segment.run], segments, position, low, high)
        previous = segment.angles[branch, -1] + offset

    words = [np.empty((len(run.axis), 2)) for run in runs]
    state = int(total.argmin())
    for segment, origin in zip(reversed(segments), reversed(back), strict=True):
        words[segment.run][segment.first : segment.last] = segment.angles[branch[state]] + offset[state]
        state = int(origin[state])
    last = np.zeros(2)
    for angles in words:
        for column in (index for index in range(2) if endless[index]):
            angles[:, column] = np.unwrap(angles[:, column])
            angles[:, column] += TURN * np.round((last[column] - angles[0, column]) / TURN)
            last[column] = angles[-1, column]
        angles *= np.degrees(signs)
        for column, rotary in enumerate(machine.rotary):
            if rotary.output == "modulo":
                angles[:, column] = np.mod(angles[:, column], 360.0)
    return words


def legs(machine: Machine, run: Run) -> list[tuple[int, int]]:
    """First and last pose of the pieces, as few as can be, in which the machine can run through a sequence of poses.

    Between two pieces the tool leaves, the rotary axes unwind, and it comes back to the pose where it left: each piece
    begins with the last pose of the one before. Whatever can be run through can be so in part, so that the longest
    piece from the start, then the longest from there, and so on makes the fewest.

    Raises
    ------
    PostError: a pose is out of reach or out of range.
    WindingError: two poses next to each other have no way between them.
    """
    found: list[tuple[int, int]] = []
    first, end = 0, len(run.axis) - 1
    while not found or found[-1][1] < end:
        last = end
        if not runs_through(machine, Run(run.label, run.axis[first:])):
            good, bad = first, end
            while bad - good > 1:
                middle = (good + bad) // 2
                if runs_through(machine, Run(run.label, run.axis[first : middle + 1])):
                    good = middle
                else:
                    bad = middle
            if good == first:
                choose_words(machine, [Run(run.label, run.axis[first : first + 2])])
            # Between two poses an angle may pass a little beyond both: one pose of distance from the limit.
            last = good - 1 if good > first + 1 else good
        found.append((first, last))
        first = last
    return found


def runs_through(machine: Machine, run: Run) -> bool:
    """Whether the machine can run through poses, each of which it can take, without leaving the part."""
    try:
        choose_words(machine, [run])
    except WindingError:
        return False
    return True


def _out_of_range(
    machine: Machine, run: Run, segments: list[_Segment], position: int, low: Array, high: Array
) -> PostError:
    """Why no state is left after the segment at `position`: the first pose out of range, or the run as a whole."""
    limited = [
        f"{rotary.letter} {rotary.range_deg[0]:g} .. {rotary.range_deg[1]:g}"
        for rotary in machine.rotary
        if rotary.range_deg is not None
    ]
    turn = "Turn the part in [setup], or choose a machine with a larger range."
    segment = segments[position]
    signs = _signs(machine)
    inside = np.ones(segment.angles.shape[:2], dtype=np.bool_)
    for column in range(2):
        if not np.isfinite(low[column]):
            continue
        centre = 0.5 * (low[column] + high[column])
        nearest = centre + _wrap(segment.angles[:, :, column] - centre)
        inside &= (nearest >= low[column]) & (nearest <= high[column])
    outside = np.flatnonzero(~inside.any(axis=0))
    if len(outside):
        pose = int(outside[0])
        both = np.degrees(_wrap(segment.angles[:, pose])) * signs
        found = " or ".join(
            " ".join(f"{r.letter}{word:+.4f}" for r, word in zip(machine.rotary, words, strict=True)) for words in both
        )
        return PostError(f"{run.label}, pose {segment.first + pose + 1}", found, ", ".join(limited), turn)
    return WindingError(
        f"{run.label}, pose {segment.first + 1} and after",
        "no way through without unwinding a rotary axis",
        ", ".join(limited) or "a continuous motion",
        turn,
    )
