"""A rotary pattern of blades: which copy each cut is for, and one judgement of the judgements of all copies.

Every copy is judged as if it were the part in the CAD file: the program's poses are turned back to it. Design faces are
held against all moves of the program. What else belongs to the part stands around each copy alike and is held against
the moves for that copy; foreign bodies do not turn with the part.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import pi

import msgspec
import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from conflank_cli.geometry.face import CheckMesh
from conflank_cli.job import Copies
from conflank_cli.scene import Scene
from conflank_cli.tool import Tool
from conflank_cli.verification.findings import Finding
from conflank_cli.verification.kinematics import about
from conflank_cli.verification.poses import Poses
from conflank_cli.verification.result import ClearanceFigures, Clearances, CutFigures, GapFigures, Place, Verification

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]

Turn = tuple[tuple[float, float, float], float]

_POSES = 9
"""Poses of a cut by which it is told which copy it is for."""


def turns(copies: Copies) -> list[Turn]:
    """Axis and angle of every copy that is cut."""
    return [(copies.axis, 2.0 * pi * number / copies.count) for number in copies.order]


def around(scene: Scene, turn: Turn) -> Scene:
    """The scene as it stands around a copy, seen from the part in the CAD file: foreign bodies are turned back."""
    foreign = scene.check.face < 0
    if not foreign.any():
        return scene
    bodies = scene.check.only(foreign)
    # Points are rows: times R is turning back.
    turned = replace(bodies, vertices=bodies.vertices @ about(*turn))
    return scene.checking(CheckMesh.joined([scene.check.only(~foreign), turned]))


def moves_by_copy(by_copy: Sequence[Poses], tools: Sequence[Tool | None], surface: Array) -> list[Flags]:
    """For each copy the moves (N,) that belong to it.

    A cut belongs to the copy whose design faces (points on them (P, 3) in `surface`) its axes are nearest to, at half
    the height of the cutter. On a way between cuts that leads to another copy a move belongs to the one that it is
    nearer to at its beginning and to the one that it is nearer to at its end.

    by_copy: the poses as each copy sees them.
    """
    moves = by_copy[0].moves
    tree = cKDTree(surface)
    cuts = moves.cut
    heights = np.array([0.0 if tool is None else 0.5 * tool.length for tool in tools] + [0.0])[moves.tool]

    def away(poses: Poses, chosen: Integers) -> Array:
        return np.asarray(tree.query(poses.tip[chosen] + heights[chosen, None] * poses.axis[chosen])[0])

    owner = np.full(int(cuts.max(initial=-1)) + 1, -1, dtype=np.int64)
    for cut in np.unique(cuts[cuts >= 0]):
        own = np.flatnonzero(cuts == cut)
        some = own[np.linspace(0, len(own) - 1, _POSES).astype(np.int64)]
        owner[cut] = int(np.argmin([away(poses, some).mean() for poses in by_copy]))
    known = np.flatnonzero(cuts >= 0)
    if not len(known):
        return [np.ones(len(cuts), dtype=np.bool_) for _ in by_copy]
    every = np.arange(len(cuts))
    before = owner[cuts[known[np.maximum(np.searchsorted(known, every, side="right") - 1, 0)]]]
    after = owner[cuts[known[np.minimum(np.searchsorted(known, every), len(known) - 1)]]]
    ends = before.copy()
    way = np.flatnonzero(before != after)
    if len(way):
        distance = np.stack([away(poses, way) for poses in by_copy])
        row = np.arange(len(way))
        nearer = distance[after[way], row] < distance[before[way], row]
        ends[way] = np.where(nearer, after[way], before[way])
    begins = np.where(moves.joined, np.concatenate([ends[:1], ends[:-1]]), ends)
    return [(ends == copy) | (begins == copy) for copy in range(len(by_copy))]


def joined(each: Sequence[Verification], copies: Copies, findings: Sequence[Finding]) -> Verification:
    """One judgement of those of the copies, in the order of `copies`; `findings` are those of the whole program."""
    numbers = copies.order
    each = [_turned(own, number, turn) for own, number, turn in zip(each, numbers, turns(copies), strict=True)]
    first = each[0]
    deepest = max(each, key=lambda own: own.overcut_max_um)
    highest = max(each, key=lambda own: -1.0 if own.stock_max_um is None else own.stock_max_um)
    shares = [own.coverage for own in each]
    gaps = [(own.gap_um.mean_abs, own.coverage) for own in each if own.gap_um.mean_abs is not None]
    weight = sum(share for _, share in gaps)
    mean = sum(gap * share for gap, share in gaps) / weight if weight else None
    steps = [own.step_max_um for own in each if own.step_max_um is not None]

    def best(kind: str) -> tuple[CutFigures, ...]:
        cuts = zip(*(getattr(own, kind) for own in each), strict=True)
        return tuple(max(same, key=lambda cut: cut.covered_mm2) for same in cuts)

    def least(name: str) -> ClearanceFigures:
        known = [figures for own in each if (figures := getattr(own.clearance_mm, name)).least is not None]
        return min(known, key=lambda figures: figures.least or 0.0) if known else ClearanceFigures(None, None)

    return msgspec.structs.replace(
        first,
        coverage=round(float(np.mean(shares)), 9),
        coverage_flank=round(float(np.mean([own.coverage_flank for own in each])), 9),
        overcut_max_um=deepest.overcut_max_um,
        overcut_max_at=deepest.overcut_max_at,
        stock_max_um=highest.stock_max_um,
        stock_max_at=highest.stock_max_at,
        gap_um=GapFigures(
            None if mean is None else round(mean, 4),
            max((own.gap_um.p99_abs for own in each if own.gap_um.p99_abs is not None), default=None),
        ),
        step_max_um=max(steps, default=None),
        faces=tuple(face for own in each for face in own.faces),
        sweeps=best("sweeps"),
        passes=best("passes"),
        clearance_mm=Clearances(*(least(name) for name in ("ball", "cone", "shank", "holder"))),
        findings=(*findings, *(finding for own in each for finding in own.findings)),
    )


def _turned(own: Verification, number: int, turn: Turn) -> Verification:
    """The judgement of a copy with its number, and points where they are on it."""
    matrix = about(*turn)

    def there(place: Place | None) -> Place | None:
        return None if place is None else msgspec.structs.replace(place, point=_point(matrix, place.point))

    def clear(figures: ClearanceFigures) -> ClearanceFigures:
        return ClearanceFigures(figures.least, there(figures.at))

    kept = own.clearance_mm
    return msgspec.structs.replace(
        own,
        overcut_max_at=there(own.overcut_max_at),
        stock_max_at=there(own.stock_max_at),
        faces=tuple(msgspec.structs.replace(face, copy=number) for face in own.faces),
        clearance_mm=Clearances(clear(kept.ball), clear(kept.cone), clear(kept.shank), clear(kept.holder)),
        findings=tuple(
            msgspec.structs.replace(
                finding,
                text=f"copy {number}: {finding.text}",
                place=None if finding.place is None else _point(matrix, finding.place),
            )
            for finding in own.findings
        ),
    )


def _point(matrix: Array, point: tuple[float, float, float]) -> tuple[float, float, float]:
    x, y, z = np.round(matrix @ np.array(point), 6) + 0.0
    return (float(x), float(y), float(z))
