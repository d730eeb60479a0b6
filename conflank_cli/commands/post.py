"""`conflank post`: from a plan to the program."""

from __future__ import annotations

import click

from conflank_cli import options
from conflank_cli.options import Talk


@click.command(epilog="\b\nExample:\n  conflank post plan.npz -o BLADE1.H")
@options.source("PLAN")
@options.output("the program")
@options.job_override("[setup], [machine] and [program]")
@options.common
def post(source: str, output: str, job_file: str | None, talk: Talk) -> None:
    """Write the program for the job's machine.

    PLAN is what conflank select writes. A program that the control or the machine cannot execute is not written. Where
    the job splits the program, -o names the one that calls the parts; they are written beside it.
    """
    from conflank_cli.artifacts import read_artifact
    from conflank_cli.commands.inputs import override
    from conflank_cli.commands.stages import run_post
    from conflank_cli.commands.tables import prediction
    from conflank_cli.output import check_output, write_output
    from conflank_cli.posting import summarize

    check_output(output, [source])
    scene, sweeps, _ = read_artifact(source, "plan")
    scene = override(scene, "post", job_file, talk)
    check_split(scene.job.program.split, output)
    files, path = run_post(scene, sweeps, output, talk)
    for name in files:
        check_output(name, [source])
    # The calling program last: once it is there, so are its parts.
    for name, text in reversed(files.items()):
        write_output(text, name, [source])
    talk.note(prediction(summarize(scene.job, path)))


def check_split(split: str, output: str) -> None:
    """Refuse several programs to standard output."""
    from conflank_cli.errors import UsageError
    from conflank_cli.output import STANDARD

    if split != "none" and output == STANDARD:
        found = f'several programs ([program] split = "{split}")'
        raise UsageError("standard output", found, "one program", "Name the calling program with -o FILE.")
