"""`conflank post`: from a plan to the program."""

from __future__ import annotations

import click

from conflank_cli import completion, options
from conflank_cli.options import Talk


@click.command(epilog="\b\nExample:\n  conflank post plan.npz -o BLADE1.H")
@options.source("PLAN", *completion.ARTIFACT)
@options.output("the program", *completion.PROGRAM)
@options.job_override("[setup], [machine] and [program]")
@options.as_json
@options.common
def post(source: str, output: str, job_file: str | None, as_json: bool, talk: Talk) -> None:
    """Write the program for the job's machine.

    PLAN is what conflank select writes. A program that the control or the machine cannot execute is not written. Where
    the job splits the program, -o names the one that calls the parts; they are written beside it.
    """
    from conflank_cli.artifacts import read_plan
    from conflank_cli.commands.documents import of_posting, print_document, refuse_both
    from conflank_cli.commands.inputs import override
    from conflank_cli.commands.stages import run_post
    from conflank_cli.commands.tables import prediction
    from conflank_cli.output import check_output, write_outputs

    refuse_both(as_json, output, "the program")
    check_output(output, [source])
    plan = read_plan(source)
    scene = override(plan.scene, "post", job_file, talk)
    check_split(scene.job.program.split, output)
    files, summary = run_post(scene, plan.sweeps, plan.passes, output, talk)
    # The calling program last: once it is there, so are its parts.
    write_outputs(reversed(files.items()), [source])
    talk.note(prediction(summary))
    if as_json:
        print_document({"files": list(files), **of_posting(summary)})


def check_split(split: str, output: str) -> None:
    """Refuse several programs to standard output."""
    from conflank_cli.errors import UsageError
    from conflank_cli.output import STANDARD

    if split != "none" and output == STANDARD:
        found = f'several programs ([program] split = "{split}")'
        raise UsageError("standard output", found, "one program", "Name the calling program with -o FILE.")
