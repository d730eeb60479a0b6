"""`conflank plot`: figures of a job."""

from __future__ import annotations

import click

from conflank_cli import completion, options
from conflank_cli.options import Talk

FIGURES = ("lines", "convergence", "coverage", "gap", "sweeps", "axes")


@click.command(epilog="\b\nExample:\n  conflank plot gap out/plan.npz out/BLADE1.H -o gap.png")
@click.argument("what", type=click.Choice(FIGURES))
@options.sources(*completion.ARTIFACT, *completion.JOB, *completion.PROGRAM, *completion.JUDGEMENT)
@click.option(
    "-o",
    "--output",
    metavar="FILE",
    required=True,
    help="Where to write the figure: .png, .svg or .pdf.",
    shell_complete=completion.files(*completion.PICTURE),
)
@options.as_json
@options.common
def plot(what: str, sources: tuple[str, ...], output: str, as_json: bool, talk: Talk) -> None:
    """Draw a figure of a job.

    \b
    lines        axes along the sweeps of candidates, motions or a plan
    convergence  the largest candidate's gap, step by step of its optimisation
    coverage     what each cut covers of each face, over u and v
    gap          each face with the gap in colours, and its range
    sweeps       coverage and mean gap after each cut
    axes         rotary axes, programmed point and feed over time

    FILE is an artifact for the first two, and for the others what conflank report takes: a plan or job, a program.
    """
    from conflank_cli.commands.documents import print_document
    from conflank_cli.commands.material import gather, read_sweeps
    from conflank_cli.output import check_output, write_output
    from conflank_cli.report import figures
    from conflank_cli.report.picture_file import picture_suffix

    suffix = picture_suffix(output, "-o")
    check_output(output, sources, binary=True)
    inputs: list[object] = [*sources]
    if what in ("lines", "convergence"):
        scene, sweeps = read_sweeps(sources)
        with talk.timed("plot"):
            draw = {"lines": figures.lines_figure, "convergence": figures.convergence_figure}[what]
            figure = draw(scene, sweeps)
    else:
        material = gather(sources, talk)
        inputs += material.inputs
        programs = {
            "coverage": figures.coverage_figure,
            "gap": figures.gap_figure,
            "sweeps": figures.sweeps_figure,
            "axes": figures.axes_figure,
        }
        with talk.timed("plot"):
            figure = programs[what](material.scene, material.posed)
    write_output(figures.encoded(figure, suffix), output, [str(name) for name in inputs])
    talk.note(f"figure        {output}")
    if as_json:
        print_document({"files": [output], "what": what})
