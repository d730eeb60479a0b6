"""How near each component of the cutter comes to what it must not touch."""

from __future__ import annotations

from functools import partial

import msgspec
import numpy as np
import numpy.typing as npt

from conflank_cli.cores import beside
from conflank_cli.scene import Scene
from conflank_cli.tool import Tool
from conflank_cli.verification.figures import ROUNDING, of_program, place_of, triple
from conflank_cli.verification.findings import Finding
from conflank_cli.verification.gap import (
    Body,
    BodyMotion,
    ball_body,
    cone_body,
    section_bodies,
    spatial_order,
)
from conflank_cli.verification.poses import Poses, join_cells
from conflank_cli.verification.result import (
    ClearanceFigures,
    Clearances,
    Place,
)
from conflank_cli.verification.sampling import (
    DESIGN_SPACING,
    FaceSample,
    MeshSample,
    Places,
    largest,
)
from conflank_cli.verification.swept import CutMoves, by_tool

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

_NEAR = 5.0
"""The mesh is sampled this far around what the tool passes through, mm; beyond it nothing is near."""


FINEST = 0.15
"""Points of a mesh are so far apart at last, mm: between them a cutter of radius r comes nearer by 0.0038 mm^2 / r at
most, 2.5 um at 1.5 mm."""


_COVER = 0.58
"""No place on a triangle is further from its nearest corner than this share of its longest side."""


_FEW = 64
"""One point in so many is measured first, to tell how near the nearest of all is at most."""


def _clearance(
    stretches: list[CutMoves],
    poses: Poses,
    sample: MeshSample,
    limits: Array,
    pick: str,
    code: str,
    advice: str,
) -> tuple[ClearanceFigures, list[Finding]]:
    """Least distance of a component to sampled points, and a finding where the limit at a point is not kept.

    A point inside a triangle is off the face behind it by up to its sag. For the cutter, which is meant to touch, that
    is added to the distance, so that a mesh makes no gouges; for shank and holder, which are to stay away, it is taken
    off.
    """
    sign = 1.0 if pick in ("ball", "cone") else -1.0
    # What the axis does between blocks does not matter here: both ways are one motion.
    motions = [
        BodyMotion.of(join_cells(list(stretch.cells)), body)
        for stretch in stretches
        for body in _component(stretch.tool, pick)
    ]
    values = np.full(len(limits), np.inf)
    moves, shares = np.full(len(limits), -1, dtype=np.int64), np.zeros(len(limits))

    def measure(chosen: Integers, mark: Array) -> None:
        """Fill in the distances of the chosen points, sag counted, where they are below the mark."""
        for motion in motions if len(chosen) else ():
            sag = sign * sample.sag[chosen]
            found = motion.below(sample.points[chosen], np.minimum(mark, values[chosen]) - sag)
            where = chosen[found.chosen]
            values[where] = found.distance + sag[found.chosen]
            moves[where], shares[where] = found.move, found.share

    everything = np.arange(len(limits))
    # A few points first set the mark that the rest has to beat.
    measure(everything[::_FEW], np.full(len(everything[::_FEW]), np.inf))
    reach = np.maximum(limits, values.min(initial=np.inf))
    # Between its corners a piece may come nearer. Where that could matter it is halved, and its middles are measured.
    # The corners of a piece are of one face, and have the same limit.
    blind = np.zeros(len(limits))
    np.maximum.at(blind, sample.pieces, (_COVER * sample.longest + 2.0 * sample.piece_sag)[:, None])
    reach += blind
    measure(everything, reach)
    while len(sample.pieces) and len(motions):
        long = sample.longest
        mark = np.maximum(limits[sample.pieces[:, 0]], values.min())
        bound = -largest(-values[sample.pieces]) - _COVER * long - 2.0 * sample.piece_sag
        chosen = (long > FINEST) & (bound < mark)
        if not chosen.any():
            break
        old, limit, reach = len(limits), limits[sample.pieces[chosen][:, 0]], (mark + _COVER * long)[chosen]
        sample = sample.halved(chosen)
        limits = np.concatenate([limits, limit])
        values = np.concatenate([values, np.full(len(limit), np.inf)])
        moves = np.concatenate([moves, np.full(len(limit), -1, dtype=np.int64)])
        shares = np.concatenate([shares, np.zeros(len(limit))])
        order = spatial_order(sample.points[old:])
        measure(old + order, (reach + 2.0 * sample.piece_sag[: len(limit)])[order])
    least, least_at = np.inf, (-1, -1, 0.0)
    worst, worst_at, count = 0.0, (-1, -1, 0.0), 0
    hit = np.flatnonzero(moves >= 0)
    if len(hit):
        first = int(hit[values[hit].argmin()])
        least, least_at = float(values[first]), (first, int(moves[first]), float(shares[first]))
        lack = limits[hit] - ROUNDING - values[hit]
        count = int((lack > 0.0).sum())
        deepest = int(hit[lack.argmax()])
        if lack.max() > 0.0:
            worst, worst_at = float(lack.max()), (deepest, int(moves[deepest]), float(shares[deepest]))
    findings = []
    if worst_at[0] >= 0:
        n, move, _ = worst_at
        limit = float(limits[n])
        amount = limit - worst - ROUNDING
        block = int(poses.moves.block[move])
        face = int(sample.face[n])
        target = f"face {face}" if face >= 0 else "an obstacle"
        findings.append(
            Finding(
                code,
                f"{pick} {amount:.3f} mm from {target}, {limit:.3f} mm {advice}, block {block}"
                + of_program(poses, move),
                block,
                triple(np.round(sample.points[n], 6)),
                round(amount, 6),
                round(limit, 6),
                "mm",
                count,
            )
        )
    if least_at[0] < 0:
        return ClearanceFigures(None, None), findings
    place = place_of(poses, sample.points[least_at[0]], int(sample.face[least_at[0]]), least_at[1], least_at[2])
    return ClearanceFigures(round(least, 6), place), findings


def _component(tool: Tool, name: str) -> tuple[Body, ...]:
    if name == "ball":
        return (ball_body(tool),)
    if name == "cone":
        return (cone_body(tool),)
    shank, holder = section_bodies(tool)
    return shank if name == "shank" else holder


def _reach_box(poses: Poses, tools: list[Tool]) -> tuple[Array, Array]:
    """Box around everything the tools pass through, with a rim."""
    high = max(tool.top - tool.tip_height for tool in tools)
    radius = max(
        max([tool.r_max, *(max(s.diameter_low, s.diameter_high) / 2 for s in (*tool.shank, *tool.holder))])
        for tool in tools
    )
    ends = np.concatenate([poses.tip, poses.tip + high * poses.axis])
    return ends.min(axis=0) - radius - _NEAR, ends.max(axis=0) + radius + _NEAR


def _sagged(figures: list[ClearanceFigures]) -> ClearanceFigures:
    known = [item for item in figures if item.least is not None]
    return min(known, key=lambda item: item.least or 0.0) if known else ClearanceFigures(None, None)


def _thinned(sample: FaceSample) -> npt.NDArray[np.bool_]:
    """Which points of a face to keep for shank and holder to be held against."""
    inner = int((sample.area > 0.0).sum())
    stride = max(1, int(DESIGN_SPACING**2 * inner / float(sample.area.sum())))
    return np.asarray((np.arange(len(sample.area)) % stride == 0) | (sample.area == 0.0))


def clearances_of(
    scene: Scene, poses: Poses, stretches: list[CutMoves], places: Places
) -> tuple[Clearances, list[Finding], tuple[float, Place] | None]:
    """Clearance of every component, its findings, and the deepest overcut into the faces next to the design faces."""
    margin, overcut = scene.job.obstacles.margin, scene.job.tolerance.overcut
    low, high = _reach_box(poses, [stretch.tool for stretch in stretches])
    mesh, samples = places.around.near(low, high), places.samples
    numbers = np.concatenate(
        [np.full(len(sample.points), face.number) for face, sample in zip(scene.faces, samples, strict=True)]
    ).astype(np.int64)
    spread = np.concatenate([_thinned(sample) for sample in samples])
    numbers = numbers[spread]
    design = MeshSample.of_points(np.concatenate([sample.points for sample in samples])[spread], numbers)
    stretches = by_tool(stretches)
    foreign = mesh.face < 0

    def around(name: str, code: str, kept: float) -> tuple[ClearanceFigures, list[Finding]]:
        cutter = name in ("ball", "cone")
        limits = np.where(foreign, kept, -overcut if cutter else kept)
        figures, found = _clearance(stretches, poses, mesh, limits, name, code, "is the least allowed")
        return figures, [
            msgspec.structs.replace(item, code="CF203")
            if cutter and item.limit is not None and item.limit < 0.0
            else item
            for item in found
        ]

    def faces(name: str, code: str, limit: float) -> tuple[ClearanceFigures, list[Finding]]:
        return _clearance(stretches, poses, design, np.full(len(numbers), limit), name, code, "is the least allowed")

    # Right above the cone a shank of the same radius runs out of the cut tangentially: it may graze what the cone has
    # just finished, but not cut it. The holder keeps its margin from everything. The longest task comes first.
    cone, ball, shank, shank_face, holder, holder_face = beside(
        [
            partial(around, "cone", "CF302", margin.cutter),
            partial(around, "ball", "CF301", margin.cutter),
            partial(around, "shank", "CF303", margin.shank),
            partial(faces, "shank", "CF303", -overcut),
            partial(around, "holder", "CF304", margin.holder),
            partial(faces, "holder", "CF304", margin.holder),
        ]
    )
    every = {"ball": [ball], "cone": [cone], "shank": [shank, shank_face], "holder": [holder, holder_face]}
    findings = [finding for each in every.values() for _, found in each for finding in found]
    result = {name: _sagged([figures for figures, _ in each]) for name, each in every.items()}
    next_to: tuple[float, Place] | None = None
    for name in ("ball", "cone"):
        near = result[name]
        if (
            near.least is not None
            and near.at is not None
            and near.least < 0.0
            and near.at.face >= 0
            and (next_to is None or near.least < -next_to[0])
        ):
            next_to = (-near.least, near.at)
    return Clearances(result["ball"], result["cone"], result["shank"], result["holder"]), findings, next_to


def no_clearances() -> tuple[Clearances, list[Finding], tuple[float, Place] | None]:
    """The same where no pose is known."""
    nothing = ClearanceFigures(None, None)
    return Clearances(nothing, nothing, nothing, nothing), [], None
