"""`conflank reach`: which part of each face a tool can touch how well."""

from __future__ import annotations

import click

from conflank_cli import completion, options
from conflank_cli.options import Talk


@click.command(epilog="\b\nExample:\n  conflank reach job.toml --picture reach.png")
@options.source("JOB", *completion.JOB)
@options.picture("the least axis error over every face")
@click.option("--points", default=1500, show_default=True, type=click.IntRange(50, 100000), help="Points on a face.")
@options.as_json
@options.common
def reach(source: str, picture: str | None, points: int, as_json: bool, talk: Talk) -> None:
    """Tell which area of each design face every tool of a job can flank-mill.

    At every point the least axis error of any line that touches there along a third, two thirds or nine tenths of the
    flute; the table gives the share of the area within half, once and twice the tolerance (the mean of unequal ones).
    Collision and the machine's reach are not looked at. JOB is a job file in TOML.
    """
    from conflank_cli.commands.inputs import files_of, read_job, read_scene, start_kernel
    from conflank_cli.output import check_output, write_output

    kernel = start_kernel()
    job, folder = read_job(source)
    inputs = files_of(source, job, folder)
    if picture is not None:
        check_output(picture, inputs, binary=True)
    scene = read_scene(job, folder, talk, kernel, ["conflank_cli.commands.reach_map"])
    from conflank_cli.commands.reach_map import as_document, as_table, draw, reach_maps

    maps = reach_maps(scene, points, talk.progress)
    if picture is not None:
        write_output(draw(maps, picture), picture, inputs)
    click.echo(as_document(maps).encode() if as_json else as_table(maps), nl=False)
