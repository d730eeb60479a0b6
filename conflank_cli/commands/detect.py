"""`conflank detect`: from a job to candidate sweeps."""

from __future__ import annotations

from typing import Literal

import click

from conflank_cli import completion, options
from conflank_cli.options import Talk


@click.command(epilog="\b\nExample:\n  conflank detect job.toml --density quick -o candidates.npz")
@options.source("JOB", *completion.JOB)
@options.output("the candidates (NPZ)", *completion.ARTIFACT)
@click.option(
    "--density",
    type=click.Choice(["quick", "normal", "exhaustive"]),
    help="How densely to look, instead of [detection] density of the job.",
)
@options.as_json
@options.common
def detect(
    source: str, output: str, density: Literal["quick", "normal", "exhaustive"] | None, as_json: bool, talk: Talk
) -> None:
    """Find candidate sweeps on the design faces of a job.

    JOB is a job file in TOML (docs/file-formats.md lists its keys).
    """
    from conflank_cli.commands.inputs import files_of, read_job, read_scene, start_kernel
    from conflank_cli.output import check_output

    kernel = start_kernel()
    from msgspec.structs import replace

    from conflank_cli.artifacts import write_artifact
    from conflank_cli.commands.documents import of_stage, print_document, refuse_both
    from conflank_cli.commands.stages import run_detect
    from conflank_cli.commands.tables import stage_table

    refuse_both(as_json, output, "the candidates")
    job, folder = read_job(source)
    if density is not None:
        job = replace(job, detection=replace(job.detection, density=density))
    inputs = files_of(source, job, folder)
    check_output(output, inputs, binary=True)
    scene = read_scene(job, folder, talk, kernel, ["conflank_cli.detection"])
    sweeps, summary = run_detect(scene, talk)
    write_artifact("candidates", scene, sweeps, summary, output, inputs)
    talk.note(stage_table(scene, sweeps))
    if as_json:
        print_document(of_stage(scene, sweeps, summary, [output]))
