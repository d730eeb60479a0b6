"""`conflank report`: what a program does, as a page to look at."""

from __future__ import annotations

import click

from conflank_cli import completion, options
from conflank_cli.options import Talk


@click.command(epilog="\b\nExample:\n  conflank report out/plan.npz out/BLADE1.H -o report.html")
@options.sources(*completion.ARTIFACT, *completion.JOB, *completion.PROGRAM, *completion.JUDGEMENT)
@click.option(
    "-o",
    "--output",
    metavar="FILE",
    default="report.html",
    show_default=True,
    help="Where to write the report; -: standard output.",
    shell_complete=completion.files(".html"),
)
@click.option("--reach", "with_reach", is_flag=True, help="Add the map of what the tools reach (takes a minute).")
@options.as_json
@options.common
def report(sources: tuple[str, ...], output: str, with_reach: bool, as_json: bool, talk: Talk) -> None:
    """Write a page that shows a program: gap, cuts, moving cutter, charts.

    One file of HTML that needs no network. FILEs, in any order: a plan (its program is posted), a job (all stages are
    run), a program of either, ours or foreign, and its verification (JSON; otherwise the program is verified).
    """
    from conflank_cli.commands.documents import print_document, refuse_both
    from conflank_cli.commands.material import gather
    from conflank_cli.commands.reach_map import reach_maps
    from conflank_cli.commands.tables import judgement
    from conflank_cli.output import check_output, write_output
    from conflank_cli.report.document import ReachOfFace, report_html

    refuse_both(as_json, output, "the report")
    check_output(output, sources)
    material = gather(sources, talk)
    verification = material.verified(talk)
    reach: list[ReachOfFace] = []
    if with_reach:
        numbers = [face.number for face in material.scene.faces]
        reach = [
            ReachOfFace(numbers.index(each.face), each.tool, each.engaged, 2.0 * each.tolerance, each.found)
            for each in reach_maps(material.scene, 1500, talk.progress)
        ]
    with talk.timed("report"):
        page = report_html(material.scene, material.posed, material.text, verification, material.coverage, reach)
    write_output(page, output, [*sources, *material.inputs])
    if output != "-":
        talk.note(f"{judgement(verification)}\nreport        {output}")
    if as_json:
        print_document({"files": [output], "verification": verification})
