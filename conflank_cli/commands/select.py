"""`conflank select`: from motions to the few that cover the faces."""

from __future__ import annotations

import click

from conflank_cli import completion, options
from conflank_cli.options import Talk


@click.command(epilog="\b\nExample:\n  conflank select motions.npz -o plan.npz")
@options.source("MOTIONS", *completion.ARTIFACT)
@options.output("the plan (NPZ)", *completion.ARTIFACT)
@options.job_override("[selection] and all tables after it")
@options.picture("what covers what, and why the rest is left,")
@options.as_json
@options.common
def select(source: str, output: str, job_file: str | None, picture: str | None, as_json: bool, talk: Talk) -> int:
    """Choose the sweeps that cover the design faces, put them in order, and lay passes over what they leave.

    Passes are cut with the ball; they are laid where [selection] ball_passes is enabled.

    MOTIONS is what conflank optimize writes. A table on standard error says how many sweeps there have to be at least,
    and what is left and why; Exit code 1
    means that something forbids every sweep: the plan is empty, and the table names what is in the way.
    """
    from conflank_cli.artifacts import read_artifact, write_artifact
    from conflank_cli.commands.documents import of_stage, print_document, refuse_both
    from conflank_cli.commands.inputs import override
    from conflank_cli.commands.plan_map import draw, summary_tables
    from conflank_cli.commands.stages import run_passes, run_select
    from conflank_cli.errors import EXIT_DONE, EXIT_FINDINGS
    from conflank_cli.output import check_output, write_output
    from conflank_cli.report.picture_file import picture_suffix

    refuse_both(as_json, output, "the plan")
    check_output(output, [source], binary=True)
    if picture is not None:
        picture_suffix(picture)
        check_output(picture, [source, output], binary=True)
    scene, sweeps, _ = read_artifact(source, "motions")
    scene = override(scene, "select", job_file, talk)
    plan, summary, coverage = run_select(scene, sweeps, talk)
    passes, summary = run_passes(scene, plan, summary, talk)
    write_artifact("plan", scene, plan, summary, output, [source], coverage=coverage, passes=passes)
    if picture is not None:
        write_output(draw(scene, plan, coverage, picture), picture, [source])
    talk.note(summary_tables(summary).rstrip("\n"))
    if as_json:
        print_document(of_stage(scene, plan, summary, [output, *([picture] if picture else [])]))
    return EXIT_DONE if plan or passes else EXIT_FINDINGS
