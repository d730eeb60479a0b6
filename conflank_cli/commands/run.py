"""`conflank run`: the whole pipeline, from a job to a program that has been verified."""

from __future__ import annotations

import time
from importlib import import_module
from typing import TYPE_CHECKING

import click

from conflank_cli import completion, options
from conflank_cli.options import Talk

if TYPE_CHECKING:
    from conflank_cli.scene import Scene

MEANWHILE = ("conflank_cli.commands.stages", "conflank_cli.detection")
"""What is imported while the part is being read."""
LATER = (
    "conflank_cli.optimization",
    "conflank_cli.selection",
    "conflank_cli.posting",
    "conflank_cli.verification.judge",
)
"""What is imported beside detection."""


@click.command(epilog="\b\nExample:\n  conflank run job.toml --out out")
@click.argument("job_file", metavar="JOB", shell_complete=completion.files(*completion.JOB))
@click.option(
    "--out",
    "folder_out",
    metavar="DIR",
    type=click.Path(),
    default="out",
    show_default=True,
    help="Folder for the files.",
)
@click.option("--report/--no-report", "with_report", default=True, show_default=True, help="Write report.html too.")
@options.as_json
@options.common
def run(job_file: str, folder_out: str, with_report: bool, as_json: bool, talk: Talk) -> int:
    """Run all stages of a job and verify the program.

    Writes candidates.npz, motions.npz, plan.npz, the program NAME.H (or .I, .APT, with its parts),
    NAME.H.verification.json and report.html into DIR, all of them or none. Exit code 1 means that the verification has
    findings, or that something forbids every sweep: then there is no program. --json prints the plan's
    summary, what is known of the program before it runs, and the verification.
    """
    from concurrent.futures import ThreadPoolExecutor
    from pathlib import Path

    from conflank_cli.commands.inputs import files_of, read_job, read_scene, start_kernel
    from conflank_cli.errors import EXIT_DONE, EXIT_FINDINGS, UsageError
    from conflank_cli.output import check_folder, check_output, write_outputs

    start = time.perf_counter()
    kernel = start_kernel()
    job, folder = read_job(job_file)
    # What the job says is imported already; the rest is while its part is being read.
    from conflank_cli.formats import post_of
    from conflank_cli.machine_frame import machine_of

    inputs = files_of(job_file, job, folder)
    out = Path(folder_out)
    program = job.program.name + post_of(job).suffix
    names = ("candidates.npz", "motions.npz", "plan.npz", program, f"{program}.verification.json", "report.html")
    check_folder("--out", out)
    if out.exists():
        for name in names:
            check_output(out / name, inputs)
    # A machine that does not exist should not be found out after all the computing.
    machine_of(job)
    with talk.timed("read"):
        scene = read_scene(job, folder, talk, kernel, MEANWHILE, _rehearse)
    from conflank_cli.commands.stages import run_detect, run_optimize, run_passes, run_post, run_select, run_verify

    with ThreadPoolExecutor(1) as aside:
        later = aside.submit(_prepare, scene)
        candidates, candidates_summary = run_detect(scene, talk)
        motions, motions_summary = run_optimize(scene, candidates, talk)
        later.result()
    from conflank_cli.artifacts.npz import encode_artifact
    from conflank_cli.commands.documents import of_posting, print_document
    from conflank_cli.commands.plan_map import summary_tables
    from conflank_cli.commands.tables import facts_of, judgement
    from conflank_cli.verification.posed import pose_program

    plan, plan_summary, coverage = run_select(scene, motions, talk)
    passes, plan_summary = run_passes(scene, plan, plan_summary, talk)
    contents: dict[str, bytes | str] = {
        "candidates.npz": encode_artifact("candidates", scene, candidates, candidates_summary),
        "motions.npz": encode_artifact("motions", scene, motions, motions_summary),
        "plan.npz": encode_artifact("plan", scene, plan, plan_summary, coverage=coverage, passes=passes),
    }
    verification, summary = None, None
    if plan or passes:
        programs, summary = run_post(scene, plan, passes, program, talk)
        verification = run_verify(programs[program].encode("ascii"), program, scene, talk, programs.get)
        contents |= {**programs, f"{program}.verification.json": verification.to_json().decode()}
        if with_report:
            from conflank_cli.report.document import report_html

            with talk.timed("report"):
                posed = pose_program(programs[program], scene, programs.get)
                contents["report.html"] = report_html(scene, posed, programs[program], verification, coverage)
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"--out {out}", f"{error.strerror}", "a folder that can be made", "Name another.") from None
    write_outputs([(out / name, content) for name, content in contents.items()], inputs)

    if "report.html" not in contents and (out / "report.html").exists():
        talk.note(f"note: {out / 'report.html'} is of an earlier run")
    if verification is None or summary is None:
        talk.note(summary_tables(plan_summary) + "\nno program    something forbids every sweep")
    else:
        talk.note(f"{judgement(verification)}\n{facts_of(summary)}\nprogram       {out / program}")
    talk.note(f"computed in   {time.perf_counter() - start:.1f} s")
    if as_json:
        print_document(
            {
                "files": [str(out / name) for name in contents],
                "plan": plan_summary,
                "posting": None if summary is None else of_posting(summary),
                "verification": verification,
            }
        )
    return EXIT_FINDINGS if verification is None or verification.findings else EXIT_DONE


def _prepare(scene: Scene) -> None:
    """Make ready for sweeps what later stages need, while there are none yet."""
    for name in LATER:
        import_module(name)
    from conflank_cli.selection.judging import Judge
    from conflank_cli.verification.places import Places
    from conflank_cli.verification.sampling import POINTS_PER_FACE

    Judge.of(scene)
    Places.of(scene, POINTS_PER_FACE)


def _rehearse() -> None:
    from conflank_cli.commands.first_run import rehearse_aside

    rehearse_aside()
