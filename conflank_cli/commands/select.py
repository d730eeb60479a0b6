"""`conflank select`: from motions to the few that cover the faces."""

from __future__ import annotations

import click

from conflank_cli import options
from conflank_cli.options import Talk


@click.command(epilog="\b\nExample:\n  conflank select motions.npz -o plan.npz")
@options.source("MOTIONS")
@options.output("the plan (NPZ)")
@options.job_override("[selection] and all tables after it")
@options.common
def select(source: str, output: str, job_file: str | None, talk: Talk) -> None:
    """Choose the sweeps that cover the design faces, and lay passes with the ball over what they leave.

    Passes are laid where [selection] ball_passes is enabled.

    MOTIONS is what conflank optimize writes.
    """
    from conflank_cli.artifacts import read_artifact, write_artifact
    from conflank_cli.commands.inputs import override
    from conflank_cli.commands.stages import run_passes, run_select
    from conflank_cli.output import check_output

    check_output(output, [source], binary=True)
    scene, sweeps, _ = read_artifact(source, "motions")
    scene = override(scene, "select", job_file, talk)
    plan, summary = run_select(scene, sweeps, talk)
    passes, summary = run_passes(scene, plan, summary, talk)
    write_artifact("plan", scene, plan, summary, output, [source], passes=passes)
