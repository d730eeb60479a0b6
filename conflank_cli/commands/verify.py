"""`conflank verify`: what a program cuts, from its text."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import click

from conflank_cli import completion, options
from conflank_cli.options import Talk


@click.command(epilog="\b\nExample:\n  conflank verify BLADE1.H --job job.toml")
@options.source("PROGRAM", *completion.PROGRAM)
@click.option(
    "--job",
    "job_file",
    metavar="JOB",
    required=True,
    help="Job file with the part, tools and tolerances.",
    shell_complete=completion.files(*completion.JOB),
)
@click.option(
    "-o",
    "--output",
    metavar="FILE",
    help="Where to write the verification (JSON); default: PROGRAM.verification.json, standard output for a program "
    "from standard input.",
    shell_complete=completion.files(*completion.JUDGEMENT),
)
@options.as_json
@options.common
def verify(source: str, job_file: str, output: str | None, as_json: bool, talk: Talk) -> int:
    """Read a program back and state what it cuts.

    PROGRAM is any program for the control (.H, .I) or APT data, ours or foreign; programs that it calls are looked for
    beside it. Exit code 1 means that there are findings.
    """
    from conflank_cli.commands.inputs import files_of, read_job, read_scene, start_kernel
    from conflank_cli.errors import EXIT_DONE, EXIT_FINDINGS
    from conflank_cli.output import STANDARD, check_output, write_output

    if output is None:
        output = STANDARD if source == STANDARD else f"{source}.verification.json"
    kernel = start_kernel()
    from conflank_cli.artifacts.npz import read_source
    from conflank_cli.commands.documents import print_document
    from conflank_cli.commands.stages import program_beside, run_verify
    from conflank_cli.commands.tables import judgement

    job, folder = read_job(job_file)
    inputs: list[str | Path] = [source, *files_of(job_file, job, folder)]
    check_output(output, inputs)
    name, program = read_source(source)
    scene = read_scene(job, folder, talk, kernel, ["conflank_cli.verification.judge"])
    beside = Path() if source == STANDARD else Path(source).parent
    verification = run_verify(program, name, scene, talk, partial(program_beside, beside))
    # On standard output the document takes the place of the verification, which it holds.
    written = [] if output == STANDARD and as_json else [output]
    for name_out in written:
        write_output(verification.to_json().decode(), name_out, inputs)
    talk.note(judgement(verification))
    if as_json:
        print_document({"files": written, "verification": verification})
    return EXIT_FINDINGS if verification.findings else EXIT_DONE
