"""`conflank optimize`: from candidate sweeps to motions whose envelope is the face."""

from __future__ import annotations

import click

from conflank_cli import completion, options
from conflank_cli.options import Talk


@click.command(epilog="\b\nExample:\n  conflank optimize candidates.npz -o motions.npz")
@options.source("CANDIDATES", *completion.ARTIFACT)
@options.output("the motions (NPZ)", *completion.ARTIFACT)
@options.job_override("[tolerance], [optimization] and all tables after it")
@options.as_json
@options.common
def optimize(source: str, output: str, job_file: str | None, as_json: bool, talk: Talk) -> None:
    """Fit the motions of candidates to the face.

    The envelope of the moving cutter becomes the face, as nearly as a cone can cut it.
    CANDIDATES is what conflank detect writes.
    """
    from conflank_cli.artifacts import read_artifact, write_artifact
    from conflank_cli.commands.documents import of_stage, print_document, refuse_both
    from conflank_cli.commands.inputs import override
    from conflank_cli.commands.stages import run_optimize
    from conflank_cli.commands.tables import stage_table
    from conflank_cli.output import check_output

    refuse_both(as_json, output, "the motions")
    check_output(output, [source], binary=True)
    scene, sweeps, _ = read_artifact(source, "candidates")
    scene = override(scene, "optimize", job_file, talk)
    motions, summary = run_optimize(scene, sweeps, talk)
    write_artifact("motions", scene, motions, summary, output, [source])
    talk.note(stage_table(scene, motions))
    if as_json:
        print_document(of_stage(scene, motions, summary, [output]))
