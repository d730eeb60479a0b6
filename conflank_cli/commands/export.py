"""`conflank export`: surfaces and tables for other programs."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from conflank_cli import completion, options
from conflank_cli.options import Talk

if TYPE_CHECKING:
    from conflank_cli.scene import Scene
    from conflank_cli.sweep import Sweep

FORMATS = {
    "ruled": (".stl", ".ply", ".glb", ".step"),
    "envelope": (".stl", ".ply", ".glb", ".step"),
    "gap": (".ply", ".glb"),
    "cuts": (".csv",),
    "poses": (".csv",),
}
"""What can be exported, with the suffixes of the formats that can hold it."""


@click.command(epilog="\b\nExample:\n  conflank export envelope out/plan.npz -o envelope.glb")
@click.argument("what", type=click.Choice(list(FORMATS)))
@options.sources(*completion.ARTIFACT, *completion.JOB, *completion.PROGRAM, *completion.JUDGEMENT)
@click.option(
    "-o",
    "--output",
    metavar="FILE",
    required=True,
    help="Where to write; the suffix is the format.",
    shell_complete=completion.files(".stl", ".ply", ".glb", ".step", ".csv"),
)
@options.as_json
@options.common
def export(what: str, sources: tuple[str, ...], output: str, as_json: bool, talk: Talk) -> None:
    """Write surfaces and tables for other programs.

    \b
    ruled     ruled surfaces of the sweeps of an artifact  .stl .ply .glb .step
    envelope  what their cutters leave beside the face     .stl .ply .glb .step
    gap       faces with a program's gap in colours        .ply .glb
    cuts      the table of a program's cuts                .csv
    poses     a program's poses, feeds and times           .csv

    FILE is an artifact for the first two, and for the others what conflank report takes: a plan or job, a program.
    """
    from pathlib import Path

    from conflank_cli.commands.documents import print_document
    from conflank_cli.commands.material import gather, read_sweeps
    from conflank_cli.errors import UsageError
    from conflank_cli.output import check_output, write_output
    from conflank_cli.report import models, spreadsheets
    from conflank_cli.report.gap_map import gap_map, grid_shape

    suffix = Path(output).suffix.lower()
    if suffix not in FORMATS[what]:
        known = " ".join(FORMATS[what])
        raise UsageError(f"-o {output}", f"suffix {suffix!r}", f"one that can hold {what}: {known}", "Rename the file.")
    check_output(output, sources, binary=True)
    inputs = [*sources]
    data: bytes | str
    if what in ("ruled", "envelope"):
        scene, sweeps = read_sweeps(sources)
        data = _surfaces(what, scene, sweeps, suffix)
    else:
        material = gather(sources, talk)
        inputs += [str(name) for name in material.inputs]
        tolerance = material.scene.job.tolerance
        if what == "gap":
            shown = [
                gap_map(material.posed, face, grid_shape(face), tolerance.allowance) for face in material.scene.faces
            ]
            sheets = [models.gap_sheet(each, tolerance.overcut, tolerance.undercut) for each in shown]
            data = models.encoded_meshes(sheets, suffix[1:])
        elif what == "cuts":
            data = spreadsheets.cuts_csv(material.verified(talk))
        else:
            data = spreadsheets.poses_csv(material.posed, material.scene)
    write_output(data, output, inputs)
    talk.note(f"{what:<13} {output}")
    if as_json:
        print_document({"files": [output], "what": what})


def _surfaces(what: str, scene: Scene, sweeps: tuple[Sweep, ...], suffix: str) -> bytes:
    """Ruled surfaces or envelopes of sweeps in a format."""
    from conflank_cli.report import models

    tools = {tool.name: tool for tool in scene.tools}
    sheets, faces = [], []
    for index, sweep in enumerate(sweeps):
        name, tool, face = f"sweep {index + 1}", tools[sweep.tool], scene.faces[sweep.face]
        if suffix == ".step":
            made = (
                models.ruled_face(sweep.motion)
                if what == "ruled"
                else models.envelope_face(models.envelope_points(sweep.motion, tool, face))
            )
            faces.append((name, made))
        elif what == "ruled":
            sheets.append(models.ruled_sheet(name, sweep.motion, index))
        else:
            sheets.append(models.envelope_sheet(name, sweep.motion, tool, face, index))
    return models.encoded_step(faces) if suffix == ".step" else models.encoded_meshes(sheets, suffix[1:])
