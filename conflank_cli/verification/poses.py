"""From a program's moves to the continuous motion of a cutter on the part, cut into short cells.

Between two blocks the tip goes straight. The axis goes either along the great circle (PATHCTRL VECTOR, LN) or as the
rotary axes do when each moves evenly (PATHCTRL AXIS, M128). Both are built, whatever the program asks for.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from math import radians

import numpy as np
import numpy.typing as npt

from conflank_cli.verification.kinematics import Axes, Frame, axis_of, great_circle, to_cad
from conflank_cli.verification.program import Interpolation, Moves

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

CELL_LENGTH = 1.0
"""Longest way of the tip within a cell, mm: short enough for tight bounds on groups of cells."""

CELL_TURN = radians(0.5)
"""Largest turn of the axis, or of a rotary axis, within a cell. The parabola through three axes of a cell is then off
by less than the cube of it over 100, 7e-9 rad: 0.001 um on a tool 100 mm long."""

SAME = 1e-8
"""Poses between which no point of the cutter moves further are one, mm: 0.00001 um."""

GROUP = 8
"""Cells in a group, and groups in a wide group."""


@dataclass(frozen=True, slots=True)
class Poses:
    """Poses on the part, N of them, in the CAD frame.

    Attributes
    ----------
    tip: tip points, (N, 3) mm.
    axis: unit vectors from tip to spindle, (N, 3).
    moves: the program's moves they come from.
    letters, frame: how rotary positions become axes.
    """

    tip: Array
    axis: Array
    moves: Moves
    letters: Axes
    frame: Frame


def poses_on_part(moves: Moves, letters: Axes, frame: Frame, tip_below_point: Array) -> Poses:
    """Forward kinematics of all moves.

    Parameters
    ----------
    moves, letters: as read.
    frame: where the CAD frame lies in the program's.
    tip_below_point: distance from the programmed point down the axis to the tip, (N,) mm: 0 where the tip itself is
        programmed, the ball's radius where its centre is.
    """
    axis = np.where(np.isfinite(moves.vector), moves.vector, axis_of(letters, moves.rotary))
    tip, axis = to_cad(frame, moves.point - tip_below_point[:, None] * axis, axis)
    return Poses(tip, axis, moves, letters, frame)


@dataclass(frozen=True, slots=True)
class Cells:
    """Continuous motion in short cells, M of them, as the kernel reads it.

    Attributes
    ----------
    cells: (M, 16), see `conflank_cli.geometry.kernels.verified_gap`.
    move: the move each cell belongs to, (M,).
    begin, width: where the cell begins on its move and how much of it it takes, (M,), as shares of the move.
    """

    cells: Array
    move: Integers
    begin: Array
    width: Array


def axis_between(poses: Poses, move: Integers, share: Array, interpolation: Interpolation) -> Array:
    """Axis on the way into moves, (K, 3), at shares (K,) of the way; a move that is not joined is its own end."""
    joined = poses.moves.joined[move]
    before = np.where(joined, move - 1, move)
    rotary = poses.moves.rotary
    by_rotary = np.isfinite(rotary[before]).all(axis=1) & np.isfinite(rotary[move]).all(axis=1)
    axis = great_circle(poses.axis[before], poses.axis[move], share)
    if interpolation is Interpolation.AXIS and by_rotary.any():
        chosen = move[by_rotary]
        start = rotary[before[by_rotary]]
        angles = start + share[by_rotary, None] * (rotary[chosen] - start)
        axis[by_rotary] = to_cad(poses.frame, np.zeros((len(chosen), 3)), axis_of(poses.letters, angles))[1]
    return axis


def build_cells(poses: Poses, move: Integers, interpolation: Interpolation) -> Cells:
    """Cells of the given moves (K,), in order."""
    joined = poses.moves.joined[move]
    before = np.where(joined, move - 1, move)
    way = np.linalg.norm(poses.tip[move] - poses.tip[before], axis=1)
    turn = np.linalg.norm(poses.axis[move] - poses.axis[before], axis=1)
    swing = np.abs(poses.moves.rotary[move] - poses.moves.rotary[before]).max(axis=1, initial=0.0)
    swing = np.where(np.isfinite(swing), swing, 0.0)
    count = np.ceil(np.maximum(way / CELL_LENGTH, np.maximum(turn, swing) / CELL_TURN)).astype(np.int64)
    count = np.maximum(count, 1)
    owner = np.repeat(np.arange(len(move)), count)
    local = np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count)
    begin, end = local / count[owner], (local + 1) / count[owner]
    moves = move[owner]
    tips = [
        poses.tip[before[owner]] + share[:, None] * (poses.tip[moves] - poses.tip[before[owner]])
        for share in (begin, end)
    ]
    axes = [axis_between(poses, moves, share, interpolation) for share in (begin, 0.5 * (begin + end), end)]
    table = np.zeros((len(owner), 16))
    table[:, 0:3] = tips[0]
    table[:, 3:6] = tips[1] - tips[0]
    table[:, 6:9] = axes[0]
    table[:, 9:12] = axes[2] - axes[0]
    table[:, 12:15] = axes[1] - 0.5 * (axes[0] + axes[2])
    return Cells(table, moves, begin, end - begin)


def join_cells(parts: list[Cells]) -> Cells:
    """Cells of several stretches as one."""
    return Cells(
        np.concatenate([part.cells for part in parts]),
        np.concatenate([part.move for part in parts]),
        np.concatenate([part.begin for part in parts]),
        np.concatenate([part.width for part in parts]),
    )


def unbroken(cells: Cells) -> Cells:
    """The same motion with every unbroken run filled up to whole wide groups, by repeating its last cell.

    A group across a jump would reach over the whole jump and could never be skipped.
    """
    table = cells.cells
    gaps = np.linalg.norm(table[1:, 0:3] - table[:-1, 0:3] - table[:-1, 3:6], axis=1)
    bounds = np.concatenate([[0], np.flatnonzero(gaps > CELL_LENGTH) + 1, [len(table)]])
    runs = []
    for low, high in pairwise(bounds.tolist()):
        filled = -(-(high - low) // GROUP**2) * GROUP**2
        runs.append(np.minimum(np.arange(low, low + filled), high - 1))
    order = np.concatenate(runs)
    return Cells(table[order], cells.move[order], cells.begin[order], cells.width[order])


def with_slack(cells: Array, reach: float) -> Array:
    """Fill in the slack for a body that reaches `reach` mm from the tip.

    A point fixed to the part moves along a curve in the tool's frame, whose second derivative by tau is at most
    2 |step| |turn| + reach (|turn|^2 + 8 |bow|). The distance is convex along the tangents of that curve; half of the
    second derivative is what it can fall short of that within the cell.
    """
    step, turn, bow = (np.linalg.norm(cells[:, k : k + 3], axis=1) for k in (3, 9, 12))
    filled = cells.copy()
    filled[:, 15] = (2.0 * step * turn + reach * (turn**2 + 8.0 * bow)) / 2.0
    return filled


def _bound(poses: Array, centres: Array, low: float, high: float, radius: float) -> Array:
    """Most that any point of a body (heights low .. high, radius) moves from each centre pose to each pose, mm."""
    tip = poses[..., :3] - centres[..., :3]
    axis = poses[..., 3:] - centres[..., 3:]
    ends = [np.linalg.norm(tip + height * axis, axis=-1) for height in (low, high)]
    return np.asarray(np.maximum(*ends) + radius * np.linalg.norm(axis, axis=-1))


def cell_ways(cells: Array, low: float, high: float, radius: float) -> tuple[Array, npt.NDArray[np.bool_]]:
    """The most any point of a body moves from the beginning of each cell within it and to that of the next, (M,) mm.

    And whether it does not move from the end of a cell to the beginning of the next, (M,).

    cells: (M, 16). low, high, radius: the body lies between these heights above the tip and within this radius, mm.
    """
    starts, ends = _starts(cells), _ends(cells)
    way = _bound(ends, starts, low, high, radius) + _bow(cells, low, high, radius)
    way[:-1] = np.maximum(way[:-1], _bound(starts[1:], starts[:-1], low, high, radius))
    joined = np.append(_bound(starts[1:], ends[:-1], low, high, radius) < SAME, False)
    return way, joined


def group_cells(cells: Array, low: float, high: float, radius: float) -> tuple[Array, Array, Array, Array]:
    """Poses and reaches of the groups and of the wide groups, as the kernel reads them.

    Parameters
    ----------
    cells, low, high, radius: as `cell_ways`.
    """
    count = len(cells)
    bow, starts, ends = _bow(cells, low, high, radius), _starts(cells), _ends(cells)
    result: list[Array] = []
    for size in (GROUP, GROUP * GROUP):
        group = np.arange(count) // size
        groups = int(group[-1]) + 1 if count else 0
        middle = np.minimum(np.arange(groups) * size + size // 2, count - 1)
        centres = starts[middle]
        # The reach needs each cell's ends and its bow; the body's way between them lies within their convex hull.
        way = bow + np.maximum(*(_bound(pose, centres[group], low, high, radius) for pose in (starts, ends)))
        result += [np.ascontiguousarray(centres), np.maximum.reduceat(way, np.arange(groups) * size)]
    return result[0], result[1], result[2], result[3]


def _starts(cells: Array) -> Array:
    """Poses (M, 6) at which cells begin."""
    return np.concatenate([cells[:, 0:3], cells[:, 6:9]], axis=1)


def _ends(cells: Array) -> Array:
    """Poses (M, 6) at which cells end."""
    return np.concatenate([cells[:, 0:3] + cells[:, 3:6], cells[:, 6:9] + cells[:, 9:12]], axis=1)


def _bow(cells: Array, low: float, high: float, radius: float) -> Array:
    """The most any point of a body is moved by the bow of the axis in each cell, (M,) mm."""
    return np.asarray(np.linalg.norm(cells[:, 12:15], axis=1) * (max(abs(low), abs(high)) + radius))
