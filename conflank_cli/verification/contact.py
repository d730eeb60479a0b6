"""What must not happen while the cutter touches the faces: rapids, stops, dwells, a spindle that stops."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from conflank_cli.tool import Tool
from conflank_cli.verification.findings import Finding
from conflank_cli.verification.gap import BodyMotion, cutting_body
from conflank_cli.verification.poses import Poses, build_cells
from conflank_cli.verification.program import Interpolation, Program

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

TOUCHING = 0.05
"""A cutter that is nearer than this to what it leaves is taken to be in the cut, mm."""


def in_contact(
    program: Program, poses: Poses, tools: Sequence[Tool | None], surface: Array, undercut: float
) -> list[Finding]:
    """Findings for rapids and events in contact.

    Parameters
    ----------
    program: as it was read.
    poses: its poses on the part.
    tools: the cutter of every tool call, None where it is not known.
    surface: points on the design faces, allowance added, (P, 3) mm.
    undercut: stock that may be left, mm; a cutter `TOUCHING` above that touches.
    """
    moves = poses.moves
    within = undercut + TOUCHING
    findings: list[Finding] = []
    labelled = np.flatnonzero(moves.rapid & (moves.cut >= 0))
    if len(labelled):
        cut = program.cuts[int(moves.cut[labelled[0]])]
        text = f"rapid within {cut.kind} {cut.number}"
        findings.append(Finding("CF120", text, int(moves.block[labelled[0]]), count=len(labelled)))
    rapids = np.flatnonzero(moves.rapid & (moves.cut < 0))
    touching = _touching(poses, rapids, tools, surface, within)
    if len(touching):
        text = "rapid while the cutter touches the face"
        findings.append(Finding("CF120", text, int(moves.block[touching[0]]), count=len(touching)))
    return findings + _events(program, poses, tools, surface, within)


def _events(
    program: Program, poses: Poses, tools: Sequence[Tool | None], surface: Array, within: float
) -> list[Finding]:
    """Stops and the like where the cutter stands at the face."""
    places = {event.before - 1 for event in program.events if event.before > 0}
    if not places:
        return []
    # The pose by itself: as if the way to it were not known.
    standing = replace(poses, moves=replace(poses.moves, joined=np.zeros_like(poses.moves.joined)))
    touching = set(_touching(standing, np.array(sorted(places)), tools, surface, within).tolist())
    return [
        Finding("CF120", f"{event.what} while the cutter touches the face", event.block)
        for event in program.events
        if event.before - 1 in touching
    ]


def _touching(poses: Poses, chosen: Integers, tools: Sequence[Tool | None], surface: Array, within: float) -> Integers:
    """Moves among the chosen ones on which the cutter comes nearest to some point, and within so much of it, (M,)."""
    moves = poses.moves
    found: list[Integers] = []
    for call in np.unique(moves.tool[chosen]).tolist():
        tool = tools[call] if call >= 0 else None
        if tool is not None:
            cells = build_cells(poses, chosen[moves.tool[chosen] == call], Interpolation.VECTOR)
            near = BodyMotion.of(cells, cutting_body(tool)).below(surface, np.full(len(surface), within))
            found.append(near.move)
    return np.unique(np.concatenate(found)) if found else np.zeros(0, dtype=np.int64)
