"""Figures of a judgement: places, times, lengths, steps, the worst gouges."""

from __future__ import annotations

from math import radians

import numpy as np
import numpy.typing as npt

from conflank_cli.tool import Tool
from conflank_cli.verification.findings import Finding
from conflank_cli.verification.kinematics import from_cad
from conflank_cli.verification.poses import Poses, axis_between
from conflank_cli.verification.program import Interpolation, Program
from conflank_cli.verification.result import (
    Place,
    Pose,
    Triple,
)
from conflank_cli.verification.swept import SweptGap

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

ROUNDING = 1e-7
"""Slack of a limit for floating-point noise, mm."""


def triple(values: Array) -> Triple:
    """Three numbers as they are written."""
    # Zero has one sign, so that equal results are written equally.
    return (float(values[0]) + 0.0, float(values[1]) + 0.0, float(values[2]) + 0.0)


def micrometres(value: float) -> float:
    """A length in mm as it is written in um."""
    return round(1000.0 * float(value), 4) + 0.0


def place_of(poses: Poses, point: Array, face: int, move: int, share: float) -> Place:
    """Name a place and the pose there, in the program's frame."""
    if move < 0:
        return Place(triple(point), face)
    before = move - 1 if poses.moves.joined[move] else move
    tip = poses.tip[before] + share * (poses.tip[move] - poses.tip[before])
    mode = Interpolation(int(poses.moves.interpolation[move]))
    axis = axis_between(poses, np.array([move]), np.array([share]), mode)
    tips, axes = from_cad(poses.frame, tip[None], axis)
    return Place(
        triple(np.round(point, 6)),
        face,
        int(poses.moves.block[move]),
        round(share, 6),
        Pose(triple(np.round(tips[0], 6)), triple(np.round(axes[0], 9))),
        poses.moves.program(move),
    )


def contact_length(poses: Poses, moves: Integers) -> float:
    """Way of the tip from the first to the last of the given moves of a cut, mm, without what leads off the part."""
    if len(moves) == 0:
        return 0.0
    first, last = int(moves.min()), int(moves.max())
    span = np.arange(first, last + 1)
    joined = span[poses.moves.joined[span] & (poses.moves.cut[span] == poses.moves.cut[first])]
    return float(np.linalg.norm(poses.tip[joined] - poses.tip[joined - 1], axis=1).sum())


def of_program(poses: Poses, move: int) -> str:
    """Names the called program that a move stands in, at the end of a sentence."""
    program = poses.moves.program(move)
    return "" if program is None else f" of {program}"


def worst_gouges(
    gap: Array, swept: SweptGap, sample_of: Integers, poses: Poses, points: Array, faces: list[int], limit: float
) -> list[Finding]:
    """One finding for every face and cut that gouges it, at the deepest place."""
    findings = []
    deep = np.flatnonzero(gap < -limit - ROUNDING)
    cuts = poses.moves.cut[swept.move[deep]]
    for face, cut in sorted(set(zip(sample_of[deep].tolist(), cuts.tolist(), strict=True))):
        chosen = deep[(sample_of[deep] == face) & (cuts == cut)]
        worst = int(chosen[gap[chosen].argmin()])
        block = int(poses.moves.block[swept.move[worst]])
        findings.append(
            Finding(
                "CF201",
                f"gouge of {-1000.0 * gap[worst]:.1f} um in face {faces[face]}, block {block}"
                + of_program(poses, int(swept.move[worst])),
                block,
                triple(np.round(points[worst], 6)),
                micrometres(-gap[worst]),
                micrometres(limit),
                "um",
                len(chosen),
            )
        )
    return findings


def control_tolerance(program: Program, tools: list[Tool]) -> float | None:
    """T + h TA in mm, h the height of the tallest cutter; None where the cycle is not set or not whole."""
    if program.tolerance is None or program.tolerance[1] is None or not tools:
        return None
    height = max(tool.length - tool.tip_height for tool in tools)
    return program.tolerance[0] + height * radians(program.tolerance[1])
