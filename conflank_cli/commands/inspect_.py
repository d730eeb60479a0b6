"""`conflank inspect`: what a part or an artifact holds."""

from __future__ import annotations

import click

from conflank_cli import completion, options
from conflank_cli.options import Talk


@click.command(epilog="\b\nExample:\n  conflank inspect blade.step")
@options.source("FILE", *completion.PART, *completion.ARTIFACT)
@options.as_json
@options.common
def inspect(source: str, as_json: bool, talk: Talk) -> None:
    """List the faces of a CAD part, or what an artifact holds.

    FILE is a part (.step .stp .igs .iges .brep .json) or a file that detect, optimize or select wrote.
    """
    from conflank_cli.commands.listing import list_artifact, list_part
    from conflank_cli.output import STANDARD

    if source == STANDARD or source.endswith(".npz"):
        click.echo(list_artifact(source, as_json), nl=False)
    else:
        click.echo(list_part(source, as_json), nl=False)
