"""`conflank inspect`: what a part or an artifact holds."""

from __future__ import annotations

from pathlib import PurePath

import click

from conflank_cli import completion, options
from conflank_cli.options import Talk

CAD = (".step", ".stp", ".igs", ".iges", ".brep")
"""What the CAD kernel reads."""


@click.command(epilog="\b\nExample:\n  conflank inspect blade.step")
@options.source("FILE", *completion.PART, *completion.ARTIFACT)
@options.as_json
@options.common
def inspect(source: str, as_json: bool, talk: Talk) -> None:
    """List the faces of a CAD part, or what an artifact or a verification holds.

    FILE is a part (.step .stp .igs .iges .brep .json), or a file that detect, optimize, select or verify wrote.
    """
    from conflank_cli.commands.inputs import start_kernel
    from conflank_cli.errors import InputError
    from conflank_cli.output import STANDARD

    del talk
    kind = PurePath(source).suffix.lower()
    # First of all, for it takes the longest.
    kernel = start_kernel() if kind in CAD else None
    from conflank_cli.commands.listing import list_artifact, list_part, list_verification

    if source == STANDARD or kind in completion.ARTIFACT:
        text = list_artifact(source, as_json)
    elif source.lower().endswith(completion.JUDGEMENT):
        text = list_verification(source, as_json)
    elif kind in (*completion.JOB, *completion.PROGRAM, *completion.PICTURE, ".html"):
        known = f"a part ({' '.join(completion.PART)}), an artifact (.npz) or a verification (.verification.json)"
        raise InputError(source, f"suffix {kind!r}", known, "Programs are for conflank verify, jobs for conflank run.")
    else:
        text = list_part(source, as_json, kernel)
    click.echo(text.encode() if as_json else text, nl=False)
