"""Judge a program from its text: what it cuts, what it leaves, what it comes near."""

from __future__ import annotations

import hashlib
from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from conflank_cli.cores import threads
from conflank_cli.scene import Scene
from conflank_cli.tool import Tool
from conflank_cli.verification import pattern
from conflank_cli.verification.axes import Driven, contact_feeds, drive, labelled_cuts
from conflank_cli.verification.clearance import clearances_of, no_clearances
from conflank_cli.verification.contact import in_contact
from conflank_cli.verification.extremes import face_extremes, gap_on
from conflank_cli.verification.figures import (
    ROUNDING,
    contact_length,
    control_tolerance,
    micrometres,
    place_of,
    worst_gouges,
)
from conflank_cli.verification.findings import Finding
from conflank_cli.verification.places import Places
from conflank_cli.verification.posed import pose_program
from conflank_cli.verification.poses import Poses
from conflank_cli.verification.program import RETRACT_CHECKED, Moves, Program
from conflank_cli.verification.record import against
from conflank_cli.verification.result import (
    Clearances,
    CutFigures,
    FaceFigures,
    GapFigures,
    Place,
    Verification,
)
from conflank_cli.verification.sampling import (
    POINTS_PER_FACE,
    sample_face,
)
from conflank_cli.verification.swept import SweptMotions, moves_by_cut

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

WITHIN_MOVE = 0.01
"""A move that has a point of the face nearest to it farther than this share from both of its ends cuts there."""

_COARSE_POINTS = 2000
"""Points of a face by which it is told which copy of it a cut is for, about."""


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode("utf-8", "surrogateescape")).hexdigest()


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
    driven = drive(posed, scene)
    findings += driven.findings
    copies = scene.job.setup.copies
    if copies.order == (0,):
        return _judge(program, posed.poses, tools, scene, findings, driven, name, digest, points_per_face)
    surface = np.concatenate([sample_face(face, _COARSE_POINTS).points for face in scene.faces])
    owned = pattern.moves_by_copy(list(posed.by_copy), tools, surface)
    each = [
        _judge(program, poses, tools, pattern.around(scene, turn), [], driven, name, digest, points_per_face, own)
        for poses, turn, own in zip(posed.by_copy, pattern.turns(copies), owned, strict=True)
    ]
    return pattern.joined(each, copies, findings)


def _judge(
    program: Program,
    poses: Poses,
    tools: list[Tool | None],
    scene: Scene,
    findings: list[Finding],
    driven: Driven,
    name: str,
    digest: str,
    points_per_face: int,
    owned: npt.NDArray[np.bool_] | None = None,
) -> Verification:
    """Judge poses on the faces of a scene. `owned`: moves (N,) that are held against what is around; all if None."""
    tolerance = scene.job.tolerance
    moves: Moves = poses.moves
    stretches = moves_by_cut(poses, tools)
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
    left = surface + tolerance.allowance * normals
    near = stretches if owned is None else moves_by_cut(poses, tools, owned)

    def clear() -> tuple[Clearances, list[Finding], tuple[float, Place] | None]:
        return clearances_of(scene, poses, near, places.targets) if stretches and near else no_clearances()

    def covers(values: Array) -> npt.NDArray[np.bool_]:
        return np.asarray((values >= -tolerance.overcut - ROUNDING) & (values <= tolerance.undercut + ROUNDING))

    with threads() as pool:
        clearing = pool.submit(clear)
        motions = SweptMotions.of(stretches, kinds)
        swept = motions.gap(left)
        step: float | None = None
        if stretches:
            extremes = face_extremes(scene.faces, samples, swept, covers, gap_on(motions, tolerance.allowance))
            step = extremes.step
            # The worst places of all are points like others, which stand for no area.
            swept = swept.then(extremes.swept)
            surface, area = np.concatenate([surface, extremes.points]), np.append(area, np.zeros(len(extremes.face)))
            face_of = np.append(face_of, extremes.face)
        clearances, too_near, next_to = clearing.result()
    gap = swept.gap
    covered = covers(gap)
    total = float(area.sum())
    coverage = float(area[covered].sum()) / total
    # A pass may gouge what a sweep has covered, but it cannot cover it for the sweep.
    coverage_flank = float(area[covers(swept.flank)].sum()) / total

    findings += in_contact(program, poses, tools, left, tolerance.undercut)
    findings += worst_gouges(gap, swept, face_of, poses, surface, numbers, tolerance.overcut)
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
        return place_of(poses, surface[n], numbers[face_of[n]], int(swept.move[n]), float(swept.share[n]))

    deepest, highest = int(gap.argmin()), int(gap.argmax())
    overcut, overcut_at = max(0.0, -float(gap[deepest])), at(deepest) if gap[deepest] < 0.0 else None
    if next_to is not None and next_to[0] > overcut:
        overcut, overcut_at = next_to
    absolute = np.abs(gap[covered & (area > 0.0)])
    times = driven.seconds
    cutting = np.zeros(len(moves.block), dtype=np.bool_)
    # A retract leaves the face at its start, and an approach comes to it at its end: they do not cut there.
    inside = (swept.share > WITHIN_MOVE) & (swept.share < 1.0 - WITHIN_MOVE)
    cutting[swept.move[covered & inside & (swept.move >= 0)]] = True
    labelled = labelled_cuts(program) if owned is None else labelled_cuts(program) & owned
    findings += contact_feeds(poses, program, tools, scene, cutting, labelled, driven.load)
    sweeps: list[CutFigures] = []
    passes: list[CutFigures] = []
    for index, label in enumerate(program.cuts):
        chosen = [stretch for stretch in stretches if stretch.cut == index]
        values = swept.by_cut[index]
        own = covers(values)
        reached = values <= tolerance.undercut + ROUNDING
        weights = area[own]
        touching = np.unique(swept.move_by_cut[index][own])
        figures = CutFigures(
            number=label.number,
            tool=chosen[0].tool.name if chosen else "",
            length_mm=round(contact_length(poses, touching), 3),
            covered_mm2=round(float(weights.sum()), 3),
            gap_min_um=micrometres(values[reached].min()) if reached.any() else None,
            gap_mean_abs_um=micrometres(np.average(np.abs(values[own]), weights=weights)) if weights.sum() else None,
            gap_max_um=micrometres(values[own].max()) if own.any() else None,
            time_s=round(float(times[moves.cut == index].sum()), 3),
        )
        (sweeps if label.kind == "sweep" else passes).append(figures)
    control = control_tolerance(program, used)
    known = bool(stretches)
    return Verification(
        program=name or program.name,
        program_sha256=digest,
        called_sha256={part.name: _digest(part.text) for part in program.called},
        against=against(scene),
        judged={
            "interpolation": "worse of great circle and even rotary motion",
            "tools": ", ".join(sorted({tool.name for tool in used})),
            "frame": "header" if program.header.frame is not None else "job",
            "reference": program.header.reference or "TIP",
            "machine": scene.job.machine.name,
            "retract_checked_mm": RETRACT_CHECKED,
            "points": float(sum(len(sample.points) for sample in samples)),
        },
        coverage=round(coverage, 9),
        coverage_flank=round(coverage_flank, 9),
        overcut_max_um=micrometres(overcut),
        overcut_max_at=overcut_at,
        stock_max_um=micrometres(gap[highest]) if known else None,
        stock_max_at=at(highest) if known else None,
        gap_um=GapFigures(
            micrometres(np.average(absolute, weights=area[covered & (area > 0.0)])) if len(absolute) else None,
            micrometres(np.quantile(absolute, 0.99)) if len(absolute) else None,
        ),
        step_max_um=None if step is None else micrometres(step),
        faces=tuple(
            FaceFigures(
                face=numbers[k],
                area_mm2=round(float(area[face_of == k].sum()), 3),
                coverage=round(float(area[covered & (face_of == k)].sum() / area[face_of == k].sum()), 9),
                overcut_max_um=micrometres(max(0.0, -float(gap[face_of == k].min()))),
                stock_max_um=micrometres(gap[face_of == k].max()) if known else None,
            )
            for k in range(len(samples))
        ),
        sweeps=tuple(sweeps),
        passes=tuple(passes),
        clearance_mm=clearances,
        time_s=round(float(times.sum()), 3),
        control_tolerance_um=None if control is None else micrometres(control),
        unknown_moves=program.unknown_moves,
        findings=tuple(findings),
    )
