"""Judge a program from its text: what it cuts, what it leaves, what it comes near."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from math import radians

import msgspec
import numpy as np
import numpy.typing as npt

from conflank_cli.cores import beside, threads
from conflank_cli.scene import Scene
from conflank_cli.tool import Tool
from conflank_cli.verification import pattern
from conflank_cli.verification.findings import Finding
from conflank_cli.verification.gap import (
    Below,
    Body,
    BodyMotion,
    ball_body,
    below_either,
    cone_body,
    cutting_body,
    section_bodies,
    spatial_order,
)
from conflank_cli.verification.kinematics import Frame, from_cad
from conflank_cli.verification.poses import Cells, Poses, axis_between, build_cells, join_cells, poses_on_part
from conflank_cli.verification.program import RETRACT_CHECKED, Interpolation, Moves, Program
from conflank_cli.verification.reader import read_program
from conflank_cli.verification.result import (
    ClearanceFigures,
    Clearances,
    CutFigures,
    FaceFigures,
    GapFigures,
    Place,
    Pose,
    Triple,
    Verification,
)
from conflank_cli.verification.sampling import (
    DESIGN_SPACING,
    POINTS_PER_FACE,
    FaceSample,
    MeshSample,
    Surroundings,
    largest,
    sample_face,
)

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

RAPID_RATE = 20_000.0
"""Assumed rate of rapids, mm/min; a program does not state it, and the time is no finding."""

REACH = 0.5
"""Gaps of single cuts are exact up to this, mm; beyond it a cut has nothing to do with a point."""

_SAME_WAY = 1e-5
"""Ways of the axis that nowhere differ by more than this are one, mm at the far end of the cutter: 0.01 um."""

_SAME_FRAME = 1e-3
"""Frames that differ by less than this are the same, mm or degrees: the header gives four decimals."""

_SAME_TOOL = 1e-3
"""Cutters whose sizes differ by less than this are the same, mm."""

_NEAR = 5.0
"""The mesh is sampled this far around what the tool passes through, mm; beyond it nothing is near."""

_COARSE_POINTS = 2000
"""Points of a face by which it is told which copy of it a cut is for, about."""

FINEST = 0.15
"""Points of a mesh are so far apart at last, mm: between them a cutter of radius r comes nearer by 0.0038 mm^2 / r at
most, 2.5 um at 1.5 mm."""

_COVER = 0.58
"""No place on a triangle is further from its nearest corner than this share of its longest side."""

_FEW = 64
"""One point in so many is measured first, to tell how near the nearest of all is at most."""

_ROUNDING = 1e-7
"""Slack of a limit for floating-point noise, mm."""


@dataclass(frozen=True, slots=True)
class PosedProgram:
    """A program with the poses on the part that follow from its text.

    Attributes
    ----------
    program: the text, read.
    tools: the cutter of every tool call, None where it is not known.
    poses: all poses, in the CAD frame.
    by_copy: the same as each copy in the job's [setup] sees them, turned back to the first.
    findings: what is wrong or unknown so far.
    """

    program: Program
    tools: tuple[Tool | None, ...]
    poses: Poses
    by_copy: tuple[Poses, ...]
    findings: tuple[Finding, ...]


@dataclass(frozen=True, slots=True)
class Places:
    """Where a scene is judged, whatever the program.

    Attributes
    ----------
    samples: points on each design face.
    around: what stands around the faces.
    """

    samples: tuple[FaceSample, ...]
    around: Surroundings

    @classmethod
    @lru_cache(maxsize=1)
    def of(cls, scene: Scene, points_per_face: int) -> Places:
        """Those of a scene; kept for whoever asks next."""
        samples = tuple(sample_face(face, points_per_face) for face in scene.faces)
        return cls(samples, Surroundings.of(scene.check))


@dataclass(frozen=True, slots=True)
class _Stretch:
    """All moves of one cut with one tool, or those outside any cut (cut -1)."""

    tool: Tool
    cut: int
    cells: tuple[Cells, ...]


@dataclass(frozen=True, slots=True)
class _Swept:
    """Gap at N points: in all, with the move and share it occurs at; by each cut, with the move; without the passes."""

    gap: Array
    move: Integers
    share: Array
    by_cut: Array
    move_by_cut: Integers
    flank: Array


def _triple(values: Array) -> Triple:
    # Zero has one sign, so that equal results are written equally.
    return (float(values[0]) + 0.0, float(values[1]) + 0.0, float(values[2]) + 0.0)


def _micrometres(value: float) -> float:
    return round(1000.0 * float(value), 4) + 0.0


def _tools_of(program: Program, scene: Scene) -> tuple[list[Tool | None], list[Finding]]:
    """The cutter of every tool call: sizes from the program's header, shank and holder from the job's drawer."""
    tools: list[Tool | None] = []
    findings: list[Finding] = []
    for call in program.tool_calls:
        stated = [
            tool
            for tool in program.header.tools
            if tool.number == call.number or (call.name is not None and tool.name == call.name)
        ]
        drawer = [
            tool
            for tool in scene.tools
            if (tool.name == stated[0].name if stated else tool.number == call.number or tool.name == call.name)
        ]
        label = f"tool {call.number if call.number is not None else call.name}"
        if not stated:
            text = f"{label} is not stated in the header (; TOOL n name R_MIN .. R_MAX .. LENGTH ..)"
            if len(drawer) == 1:
                text += f"; judged with {drawer[0].name} of the job"
            findings.append(Finding("CF103", text, call.block))
            tools.append(drawer[0] if len(drawer) == 1 else None)
            continue
        size = stated[0]
        if not (0.0 < size.r_min <= size.r_max and size.length > 0.0):
            findings.append(Finding("CF109", f"{label}: R_MIN, R_MAX and LENGTH make no cutter", call.block))
            tools.append(None)
            continue
        if not drawer:
            findings.append(
                Finding("CF110", f"{label} {size.name} is not in the job: its shank and holder are unknown", call.block)
            )
            tools.append(Tool(size.name, size.r_min, size.r_max, size.length, number=size.number))
            continue
        own = drawer[0]
        if (
            max(abs(own.r_min - size.r_min), abs(own.r_max - size.r_max), abs(own.length - size.length)) > _SAME_TOOL
            or scene.job.program.tool_numbers.get(own.name, own.number) != size.number
        ):
            findings.append(
                Finding("CF110", f"{label} {size.name} is another than the job's tool of that name", call.block)
            )
        tools.append(replace(own, r_min=size.r_min, r_max=size.r_max, length=size.length, number=size.number))
    return tools, findings


def _frame_of(program: Program, scene: Scene) -> tuple[Frame, list[Finding]]:
    """The frame the header states; without it the job's, and a finding."""
    setup = scene.job.setup
    own = Frame(setup.rotate_deg, setup.translate)
    stated = program.header.frame
    if stated is None:
        text = "the frame is not stated in the header (; FRAME ..); judged in the frame of the job's [setup]"
        return own, [Finding("CF104", text)]
    off = max(
        float(np.degrees(np.abs(stated.matrix - own.matrix)).max()),
        float(np.abs(np.subtract(stated.translate, own.translate)).max()),
    )
    if off > _SAME_FRAME:
        return stated, [Finding("CF110", "the header's frame is another than the job's [setup]", None, None, off)]
    return stated, []


def _same_axis_way(poses: Poses, move: Integers, height: float) -> bool:
    """Whether both interpolations agree on all the given moves, at a height above the tip."""
    ways = [
        axis_between(poses, move, np.full(len(move), share), Interpolation.AXIS)
        - axis_between(poses, move, np.full(len(move), share), Interpolation.VECTOR)
        for share in (0.25, 0.5, 0.75)
    ]
    return max(float(np.linalg.norm(way, axis=1).max(initial=0.0)) for way in ways) * height < _SAME_WAY


def _stretches(poses: Poses, tools: list[Tool | None], owned: npt.NDArray[np.bool_] | None = None) -> list[_Stretch]:
    """The moves by tool and cut; only those in `owned` (N,) if it is given."""
    moves = poses.moves
    result = []
    for call, cut in sorted(set(zip(moves.tool.tolist(), moves.cut.tolist(), strict=True))):
        tool = tools[call] if call >= 0 else None
        if tool is None:
            continue
        chosen = np.flatnonzero((moves.tool == call) & (moves.cut == cut) & (True if owned is None else owned))
        if not len(chosen):
            continue
        modes = [Interpolation.VECTOR]
        if not _same_axis_way(poses, chosen, tool.length - tool.tip_height):
            modes.append(Interpolation.AXIS)
        result.append(_Stretch(tool, cut, tuple(build_cells(poses, chosen, mode) for mode in modes)))
    return result


def _together(stretches: list[_Stretch]) -> list[_Stretch]:
    """All moves of each tool as one stretch: one search over everything is quicker than one for every cut."""
    result = []
    for tool in dict.fromkeys(stretch.tool for stretch in stretches):
        own = [stretch for stretch in stretches if stretch.tool == tool]
        modes = max(len(stretch.cells) for stretch in own)
        chosen = [[stretch.cells[min(mode, len(stretch.cells) - 1)] for stretch in own] for mode in range(modes)]
        result.append(_Stretch(tool, -1, tuple(join_cells(cells) for cells in chosen)))
    return result


def _swept_gap(points: Array, stretches: list[_Stretch], kinds: list[str]) -> _Swept:
    """The gap, worse of the two interpolations at every point and for every cut."""
    count = len(points)
    modes = max((len(stretch.cells) for stretch in stretches), default=1)
    gaps = np.full((modes, count), np.inf)
    flanks = np.full((modes, count), np.inf)
    moves = np.full((modes, count), -1, dtype=np.int64)
    shares = np.zeros((modes, count))
    by_cut = np.full((modes, len(kinds), count), np.inf)
    move_by_cut = np.full((len(kinds), count), -1, dtype=np.int64)
    order = spatial_order(points)
    ordered = np.ascontiguousarray(points[order])
    within = np.full(count, REACH)
    found = [below_either(ordered, stretch.cells, cutting_body(stretch.tool), within) for stretch in stretches]
    together = _together(stretches)
    for mode in range(modes):

        def of_mode(each: list[Below], mode: int = mode) -> Below:
            return each[min(mode, len(each) - 1)]

        for stretch, either in zip(stretches, found, strict=True):
            own = of_mode(either)
            hit = order[own.chosen]
            if stretch.cut >= 0:
                nearer = own.distance < by_cut[mode, stretch.cut, hit]
                by_cut[mode, stretch.cut, hit[nearer]] = own.distance[nearer]
                move_by_cut[stretch.cut, hit[nearer]] = own.move[nearer]
            if stretch.cut < 0 or kinds[stretch.cut] == "sweep":
                flanks[mode, hit] = np.minimum(flanks[mode, hit], own.distance)
            nearer = own.distance < gaps[mode, hit]
            hit = hit[nearer]
            gaps[mode, hit], moves[mode, hit], shares[mode, hit] = (
                own.distance[nearer], own.move[nearer], own.share[nearer],
            )  # fmt: skip
        # Beyond the reach of every cut the gap is still a figure of its own: how much stock stands there.
        far = order[~np.isfinite(gaps[mode, order])]
        for stretch in together if len(far) else ():
            cells = stretch.cells[min(mode, len(stretch.cells) - 1)]
            own = BodyMotion.of(cells, cutting_body(stretch.tool)).below(points[far], gaps[mode, far])
            hit = far[own.chosen]
            gaps[mode, hit], moves[mode, hit], shares[mode, hit] = own.distance, own.move, own.share

    def worse(values: Array) -> Array:
        return np.asarray(np.take_along_axis(values, np.abs(values).argmax(axis=0)[None], axis=0)[0])

    pick = np.abs(gaps).argmax(axis=0)[None]
    return _Swept(
        gap=np.take_along_axis(gaps, pick, axis=0)[0],
        move=np.take_along_axis(moves, pick, axis=0)[0],
        share=np.take_along_axis(shares, pick, axis=0)[0],
        by_cut=worse(by_cut),
        move_by_cut=move_by_cut,
        flank=worse(flanks),
    )


def gaps_of(posed: PosedProgram, points: Array) -> tuple[Array, Array]:
    """Swept gap at points (N, 3), as it is judged: of all the program (N,), and of each of its cuts (cuts, N), mm.

    The gap of a cut is inf where it comes no nearer than `REACH`. Where there are copies the worst of them counts.
    """
    kinds = [cut.kind for cut in posed.program.cuts]
    swept = [_swept_gap(points, _stretches(poses, list(posed.tools)), kinds) for poses in posed.by_copy]
    every = np.stack([each.gap for each in swept])
    worst = np.take_along_axis(every, np.abs(every).argmax(axis=0)[None], axis=0)[0]
    # A cut is made for one of the copies, and far from the others.
    return np.asarray(worst), np.min([each.by_cut for each in swept], axis=0)


def _place(poses: Poses, point: Array, face: int, move: int, share: float) -> Place:
    """Name a place and the pose there, in the program's frame."""
    if move < 0:
        return Place(_triple(point), face)
    before = move - 1 if poses.moves.joined[move] else move
    tip = poses.tip[before] + share * (poses.tip[move] - poses.tip[before])
    mode = Interpolation(int(poses.moves.interpolation[move]))
    axis = axis_between(poses, np.array([move]), np.array([share]), mode)
    tips, axes = from_cad(poses.frame, tip[None], axis)
    return Place(
        _triple(np.round(point, 6)),
        face,
        int(poses.moves.block[move]),
        round(share, 6),
        Pose(_triple(np.round(tips[0], 6)), _triple(np.round(axes[0], 9))),
        poses.moves.program(move),
    )


def move_times(poses: Poses) -> Array:
    """Seconds each move takes, (N,): way of the programmed point over feed, rapids at the assumed rate."""
    moves = poses.moves
    if len(moves.block) == 0:
        return np.zeros(0)
    way = np.linalg.norm(np.diff(moves.point, axis=0, prepend=moves.point[:1]), axis=1)
    rate = np.where(moves.rapid, RAPID_RATE, moves.feed)
    known = moves.joined & np.isfinite(rate) & (rate > 0.0)
    return np.where(known, 60.0 * way / np.where(known, rate, 1.0), 0.0)


def _contact_length(poses: Poses, moves: Integers) -> float:
    """Way of the tip from the first to the last of the given moves, mm."""
    if len(moves) == 0:
        return 0.0
    first, last = int(moves.min()), int(moves.max())
    span = np.arange(first, last + 1)
    joined = span[poses.moves.joined[span]]
    return float(np.linalg.norm(poses.tip[joined] - poses.tip[joined - 1], axis=1).sum())


def _of_program(poses: Poses, move: int) -> str:
    program = poses.moves.program(move)
    return "" if program is None else f" of {program}"


def _worst_gouges(
    gap: Array, swept: _Swept, sample_of: Integers, poses: Poses, points: Array, faces: list[int], limit: float
) -> list[Finding]:
    """One finding for every face and cut that gouges it, at the deepest place."""
    findings = []
    deep = np.flatnonzero(gap < -limit - _ROUNDING)
    cuts = poses.moves.cut[swept.move[deep]]
    for face, cut in sorted(set(zip(sample_of[deep].tolist(), cuts.tolist(), strict=True))):
        chosen = deep[(sample_of[deep] == face) & (cuts == cut)]
        worst = int(chosen[gap[chosen].argmin()])
        block = int(poses.moves.block[swept.move[worst]])
        findings.append(
            Finding(
                "CF201",
                f"gouge of {-1000.0 * gap[worst]:.1f} um in face {faces[face]}, block {block}"
                + _of_program(poses, int(swept.move[worst])),
                block,
                _triple(np.round(points[worst], 6)),
                _micrometres(-gap[worst]),
                _micrometres(limit),
                "um",
                len(chosen),
            )
        )
    return findings


def _clearance(
    stretches: list[_Stretch],
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
        lack = limits[hit] - _ROUNDING - values[hit]
        count = int((lack > 0.0).sum())
        deepest = int(hit[lack.argmax()])
        if lack.max() > 0.0:
            worst, worst_at = float(lack.max()), (deepest, int(moves[deepest]), float(shares[deepest]))
    findings = []
    if worst_at[0] >= 0:
        n, move, _ = worst_at
        limit = float(limits[n])
        amount = limit - worst - _ROUNDING
        block = int(poses.moves.block[move])
        face = int(sample.face[n])
        target = f"face {face}" if face >= 0 else "an obstacle"
        findings.append(
            Finding(
                code,
                f"{pick} {amount:.3f} mm from {target}, {limit:.3f} mm {advice}, block {block}"
                + _of_program(poses, move),
                block,
                _triple(np.round(sample.points[n], 6)),
                round(amount, 6),
                round(limit, 6),
                "mm",
                count,
            )
        )
    if least_at[0] < 0:
        return ClearanceFigures(None, None), findings
    place = _place(poses, sample.points[least_at[0]], int(sample.face[least_at[0]]), least_at[1], least_at[2])
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


def _clearances(
    scene: Scene, poses: Poses, stretches: list[_Stretch], places: Places
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
    stretches = _together(stretches)
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


def _no_clearances() -> tuple[Clearances, list[Finding], tuple[float, Place] | None]:
    nothing = ClearanceFigures(None, None)
    return Clearances(nothing, nothing, nothing, nothing), [], None


def _control_tolerance(program: Program, tools: list[Tool]) -> float | None:
    """T + h TA in mm, h the height of the tallest cutter; None where the cycle is not set or not whole."""
    if program.tolerance is None or program.tolerance[1] is None or not tools:
        return None
    height = max(tool.length - tool.tip_height for tool in tools)
    return program.tolerance[0] + height * radians(program.tolerance[1])


def _step(samples: Sequence[FaceSample], swept: _Swept, covered: npt.NDArray[np.bool_]) -> float | None:
    """Largest difference of the gap across the border of two patches, mm."""
    if len(swept.by_cut) < 2:
        return None
    ruler = np.where(np.isfinite(swept.by_cut.min(axis=0)), swept.by_cut.argmin(axis=0), -1)
    first = 0
    steps = []
    for sample in samples:
        pairs = sample.neighbours + first
        a, b = pairs[:, 0], pairs[:, 1]
        border = (ruler[a] != ruler[b]) & (ruler[a] >= 0) & (ruler[b] >= 0) & covered[a] & covered[b]
        steps.append(np.abs(swept.gap[a] - swept.gap[b])[border])
        first += len(sample.points)
    every = np.concatenate(steps)
    return float(every.max()) if len(every) else None


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode("utf-8", "surrogateescape")).hexdigest()


def pose_program(text: str, scene: Scene, called: Callable[[str], str | None] | None = None) -> PosedProgram:
    """Read a program and find the cutter's poses on the part; what the text does not say comes from the scene's job.

    Parameters
    ----------
    text, scene, called: as `verify_program`.
    """
    program = read_program(text, called)
    findings = list(program.findings)
    tools, found = _tools_of(program, scene)
    findings += found
    frame, found = _frame_of(program, scene)
    findings += found
    if program.header.reference is None:
        findings.append(Finding("CF107", "the header does not state the reference point; judged as REFERENCE TIP"))
    moves = program.moves
    below = np.zeros(len(moves.block))
    if program.header.reference == "SPHERE CENTRE":
        radii = np.array([0.0 if tool is None else tool.ball_radius for tool in tools] + [0.0])
        below = radii[moves.tool]
    poses = poses_on_part(moves, program.letters, frame, below)
    copies = scene.job.setup.copies
    by_copy = tuple(
        poses_on_part(moves, program.letters, replace(frame, turned=turn), below) for turn in pattern.turns(copies)
    )
    return PosedProgram(program, tuple(tools), poses, by_copy, tuple(findings))


def verify_program(
    text: str,
    scene: Scene,
    name: str = "",
    points_per_face: int = POINTS_PER_FACE,
    called: Callable[[str], str | None] | None = None,
) -> Verification:
    """Judge a program.

    Parameters
    ----------
    text: the whole program.
    scene: the job and its geometry; its tools give shank and holder, its [setup] the frame the header should state.
    name: name of the program's file, for the record.
    points_per_face: points at which each design face is judged, about.
    called: from the name of a file to the text of a program that this one calls; None where there is none.

    Returns
    -------
    The judgement, of all copies together where the job's [setup] has several. It never repairs, and it takes nothing
    for known that the text does not say: what it had to take from the job instead is a finding.
    """
    posed = pose_program(text, scene, called)
    program, tools, findings = posed.program, list(posed.tools), list(posed.findings)
    digest = _digest(text)
    copies = scene.job.setup.copies
    if copies.order == (0,):
        return _judge(program, posed.poses, tools, scene, findings, name, digest, points_per_face)
    surface = np.concatenate([sample_face(face, _COARSE_POINTS).points for face in scene.faces])
    owned = pattern.moves_by_copy(list(posed.by_copy), tools, surface)
    each = [
        _judge(program, poses, tools, pattern.around(scene, turn), [], name, digest, points_per_face, own)
        for poses, turn, own in zip(posed.by_copy, pattern.turns(copies), owned, strict=True)
    ]
    return pattern.joined(each, copies, findings)


def _judge(
    program: Program,
    poses: Poses,
    tools: list[Tool | None],
    scene: Scene,
    findings: list[Finding],
    name: str,
    digest: str,
    points_per_face: int,
    owned: npt.NDArray[np.bool_] | None = None,
) -> Verification:
    """Judge poses on the faces of a scene. `owned`: moves (N,) that are held against what is around; all if None."""
    tolerance = scene.job.tolerance
    moves: Moves = poses.moves
    stretches = _stretches(poses, tools)
    used = [stretch.tool for stretch in stretches]
    if not stretches:
        findings.append(Finding("CF111", "no move with a known pose and a known tool"))
    places = Places.of(scene, points_per_face)
    samples = places.samples
    surface = np.concatenate([sample.points for sample in samples])
    normals = np.concatenate([sample.normals for sample in samples])
    area = np.concatenate([sample.area for sample in samples])
    face_of = np.repeat(np.arange(len(samples)), [len(sample.points) for sample in samples])
    numbers = [face.number for face in scene.faces]
    kinds = [cut.kind for cut in program.cuts]
    near = stretches if owned is None else _stretches(poses, tools, owned)

    def clear() -> tuple[Clearances, list[Finding], tuple[float, Place] | None]:
        return _clearances(scene, poses, near, places) if stretches and near else _no_clearances()

    with threads() as pool:
        clearing = pool.submit(clear)
        swept = _swept_gap(surface + tolerance.allowance * normals, stretches, kinds)
        clearances, too_near, next_to = clearing.result()
    gap = swept.gap

    def covers(values: Array) -> npt.NDArray[np.bool_]:
        return np.asarray((values >= -tolerance.overcut - _ROUNDING) & (values <= tolerance.undercut + _ROUNDING))

    covered = covers(gap)
    total = float(area.sum())
    coverage = float(area[covered].sum()) / total
    # A pass may gouge what a sweep has covered, but it cannot cover it for the sweep.
    coverage_flank = float(area[covers(swept.flank)].sum()) / total

    findings += _worst_gouges(gap, swept, face_of, poses, surface, numbers, tolerance.overcut)
    findings += too_near
    if coverage < scene.job.selection.coverage:
        findings.append(
            Finding(
                "CF202",
                f"{100.0 * coverage:.2f} % of the faces covered, {100.0 * scene.job.selection.coverage:.2f} % wanted",
                amount=round(coverage, 6),
                limit=scene.job.selection.coverage,
                unit="1",
            )
        )

    def at(n: int) -> Place:
        return _place(poses, surface[n], numbers[face_of[n]], int(swept.move[n]), float(swept.share[n]))

    deepest, highest = int(gap.argmin()), int(gap.argmax())
    overcut, overcut_at = max(0.0, -float(gap[deepest])), at(deepest) if gap[deepest] < 0.0 else None
    if next_to is not None and next_to[0] > overcut:
        overcut, overcut_at = next_to
    absolute = np.abs(gap[covered & (area > 0.0)])
    times = move_times(poses)
    sweeps: list[CutFigures] = []
    passes: list[CutFigures] = []
    for index, label in enumerate(program.cuts):
        chosen = [stretch for stretch in stretches if stretch.cut == index]
        values = swept.by_cut[index]
        own = covers(values)
        reached = values <= tolerance.undercut + _ROUNDING
        weights = area[own]
        touching = np.unique(swept.move_by_cut[index][own])
        figures = CutFigures(
            number=label.number,
            tool=chosen[0].tool.name if chosen else "",
            length_mm=round(_contact_length(poses, touching), 3),
            covered_mm2=round(float(weights.sum()), 3),
            gap_min_um=_micrometres(values[reached].min()) if reached.any() else None,
            gap_mean_abs_um=_micrometres(np.average(np.abs(values[own]), weights=weights)) if weights.sum() else None,
            gap_max_um=_micrometres(values[own].max()) if own.any() else None,
            time_s=round(float(times[moves.cut == index].sum()), 3),
        )
        (sweeps if label.kind == "sweep" else passes).append(figures)
    control = _control_tolerance(program, used)
    step = _step(samples, swept, covered)
    known = bool(stretches)
    return Verification(
        program=name or program.name,
        program_sha256=digest,
        called_sha256={part.name: _digest(part.text) for part in program.called},
        judged={
            "interpolation": "worse of great circle and even rotary motion",
            "tools": ", ".join(sorted({tool.name for tool in used})),
            "frame": "header" if program.header.frame is not None else "job",
            "reference": program.header.reference or "TIP",
            "rapid_rate_mm_min": RAPID_RATE,
            "retract_checked_mm": RETRACT_CHECKED,
            "points": float(len(surface)),
        },
        coverage=round(coverage, 9),
        coverage_flank=round(coverage_flank, 9),
        overcut_max_um=_micrometres(overcut),
        overcut_max_at=overcut_at,
        stock_max_um=_micrometres(gap[highest]) if known else None,
        stock_max_at=at(highest) if known else None,
        gap_um=GapFigures(
            _micrometres(np.average(absolute, weights=area[covered & (area > 0.0)])) if len(absolute) else None,
            _micrometres(np.quantile(absolute, 0.99)) if len(absolute) else None,
        ),
        step_max_um=None if step is None else _micrometres(step),
        faces=tuple(
            FaceFigures(
                face=numbers[k],
                area_mm2=round(float(area[face_of == k].sum()), 3),
                coverage=round(float(area[covered & (face_of == k)].sum() / area[face_of == k].sum()), 9),
                overcut_max_um=_micrometres(max(0.0, -float(gap[face_of == k].min()))),
                stock_max_um=_micrometres(gap[face_of == k].max()) if known else None,
            )
            for k in range(len(samples))
        ),
        sweeps=tuple(sweeps),
        passes=tuple(passes),
        clearance_mm=clearances,
        time_s=round(float(times.sum()), 3),
        control_tolerance_um=None if control is None else _micrometres(control),
        unknown_moves=program.unknown_moves,
        findings=tuple(findings),
    )
