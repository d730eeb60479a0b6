"""What `conflank inspect` prints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from conflank_cli.artifacts.npz import decode_contents, document_text, read_source
from conflank_cli.cad.kernel_process import KernelProcess, Wanted
from conflank_cli.commands.plan_map import summary_tables
from conflank_cli.commands.tables import cell_text, judgement, text_table
from conflank_cli.sweep import Sweep
from conflank_cli.verification.result import from_json

if TYPE_CHECKING:
    from conflank_cli.cad.inspection import FaceReport


# What a stage measures begins so; the facts of the stages before it are in the JSON document.
_MEASURED = {
    "candidates": ("lines", "area_", "axis_error_"),
    "motions": ("axis_error_", "iterations"),
    "plan": ("length_", "covered_", "gap_", "certified_"),
}


def list_artifact(source: str, as_json: bool) -> str:
    """An artifact as tables of its faces, tools and sweeps, or its JSON document."""
    where, data = read_source(source)
    if as_json:
        return msgspec.json.format(document_text(data, where)) + "\n"
    kind, scene, sweeps, passes, summary = decode_contents(data, where)
    faces = [
        (face.number, face.name, face.surface.degree_u, face.surface.degree_v, "x".join(map(str, shape[:2])))
        for face, shape in ((face, face.surface.poles.shape) for face in scene.faces)
    ]
    tools = [(tool.name, tool.number, tool.r_min, tool.r_max, tool.length) for tool in scene.tools]
    every = dict.fromkeys(name for sweep in sweeps for name in sweep.facts)
    names = [name for name in every if name.startswith(_MEASURED[kind])]
    cuts = [
        (k, scene.faces[sweep.face].number, sweep.tool, len(sweep.motion.p), *map(sweep.facts.get, names))
        for k, sweep in enumerate(sweeps, start=1)
    ]
    ball = [
        (k, scene.faces[item.face].number, item.tool, len(item.tip), *item.facts.values())
        for k, item in enumerate(passes, start=len(sweeps) + 1)
    ]
    counted = f"{len(sweeps)} sweeps" + (f", {len(passes)} passes" if passes else "")
    parts = [
        f"{kind} of {scene.part_name}, {counted}\n",
        text_table(["face", "<name", "degree u", "degree v", "net"], faces),
        text_table(["<tool", "number", "r_min mm", "r_max mm", "length mm"], tools),
        text_table(["sweep", "face", "<tool", "controls", *names], cuts),
        text_table(["pass", "face", "<tool", "poses", *passes[0].facts], ball) if passes else "",
        _terms(sweeps) if kind == "motions" else "",
        summary_tables(summary) if kind == "plan" and "faces" in summary else "",
        _finished(summary.get("passes_by_face", [])),
        "".join(
            f"{name}: {cell_text(value)}\n"
            for name, value in summary.items()
            if not isinstance(value, dict) and name not in ("faces", "order", "passes_by_face")
        ),
        "".join(f"{count} x {result}\n" for result, count in summary.get("results", {}).items()),
    ]
    return "\n".join(part for part in parts if part)


def _finished(faces: Sequence[Mapping[str, Any]]) -> str:
    """What sweeps and passes cover together, and what is left and why, face by face."""
    if not faces:
        return ""
    reasons = list(dict.fromkeys(reason for face in faces for reason in face["left_mm2"]))
    rows = [
        (
            face["face"],
            100.0 * face["coverage_flank"],
            face["passes"],
            100.0 * face["coverage"],
            *(face["left_mm2"][reason] for reason in reasons),
        )
        for face in faces
    ]
    columns = ["face", "sweeps %", "passes", "with passes %", *(f"{reason} mm²" for reason in reasons)]
    return text_table(columns, rows)


def _is_term(name: str) -> bool:
    return name.startswith("term_")


def _terms(sweeps: Sequence[Sweep]) -> str:
    """The terms of the functional at the start and the end of the optimisation, where there are any."""
    starts = [name for name in (sweeps[0].facts if sweeps else {}) if _is_term(name) and name.endswith("_start")]
    if not starts:
        return ""
    rows = [
        (k, *(f"{sweep.facts[name]:.1e} > {sweep.facts[name.removesuffix('start') + 'end']:.1e}" for name in starts))
        for k, sweep in enumerate(sweeps, start=1)
    ]
    names = (name.removeprefix("term_").removesuffix("_start") for name in starts)
    return text_table(["sweep", *names], rows, "terms of the functional as mean squares, before and after")


def list_verification(source: str, as_json: bool) -> str:
    """What a program cuts, as conflank verify found it, as tables or as it is."""
    where, data = read_source(source)
    found = from_json(data, where)
    return found.to_json().decode() if as_json else judgement(found) + "\n"


def list_part(source: str, as_json: bool, kernel: KernelProcess | None) -> str:
    """The faces of a part as a table or JSON; it is read by the CAD kernel's process where there is one."""
    part_of = None if kernel is None else kernel.read(Wanted(Path(source)))
    # What describes parts loads compiled kernels, which an artifact has no use for.
    from conflank_cli.cad.inspection import describe
    from conflank_cli.cad.reader import read_part

    part = read_part(Path(source)) if part_of is None else part_of()
    reports = describe(part)
    if as_json:
        content = {"file": part.file, "sha256": part.sha256, "units": {"length": "mm"}, "faces": reports}
        return msgspec.json.format(msgspec.json.encode(content)).decode() + "\n"
    columns = ["face", "<name", "<type", "degree", "net", "area mm²", "size mm", "curvature 1/mm", "<outside"]
    rows = [_face_row(report) for report in reports]
    problems = [f"face {report.number}: {report.problem}\n" for report in reports if report.problem]
    return f"{part.file}: {len(reports)} faces\n\n" + text_table(columns, rows) + "".join(problems)


def _face_row(report: FaceReport) -> tuple[object, ...]:
    head = (report.number, report.name or report.colour, report.kind)
    if report.problem or report.size is None or report.curvature is None:
        return (*head, None, None, report.area, None, None, "unknown")
    return (
        *head,
        f"{report.degree_u}x{report.degree_v}",
        f"{report.poles_u}x{report.poles_v}" + (" rational" if report.rational else ""),
        report.area,
        " x ".join(f"{length:.2f}" for length in report.size),
        f"{report.curvature.low:+.4f} .. {report.curvature.high:+.4f}",
        f"{report.outside} SuxSv" if report.outside_known else "unknown",
    )
