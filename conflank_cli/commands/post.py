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

    PLAN is what conflank select writes. A program that the control or the machine cannot execute is not written.
    """
    from conflank_cli.artifacts import read_plan
    from conflank_cli.commands.inputs import override
    from conflank_cli.output import check_output, write_output
    from conflank_cli.posting import post_program

    check_output(output, [source])
    plan = read_plan(source)
    scene = override(plan.scene, "post", job_file, talk)
    with talk.timed("post"):
        text, _ = post_program(scene, plan.sweeps, plan.passes)
    write_output(text, output, [source])
