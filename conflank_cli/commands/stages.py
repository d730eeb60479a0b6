"""The stages as the commands call them: each with its bar, its summary, and a refusal where nothing came out."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from conflank_cli.ball_pass import Pass
from conflank_cli.coverage import FaceCoverage
from conflank_cli.errors import NumericalError
from conflank_cli.options import Talk
from conflank_cli.posting.summary import PostSummary
from conflank_cli.scene import Scene
from conflank_cli.sweep import Sweep
from conflank_cli.verification.result import Verification


def run_detect(scene: Scene, talk: Talk) -> tuple[list[Sweep], dict[str, Any]]:
    """Candidate sweeps and their summary.

    Raises
    ------
    NumericalError: no tool touches a face along a line anywhere.
    """
    from conflank_cli.detection import detect

    with talk.timed("detect"):
        sweeps = detect(scene, talk.progress)
    if not sweeps:
        raise NumericalError(
            "detect",
            "no line along which a tool in use touches a design face",
            "at least one",
            'Try smaller or more tapered tools, wider tolerances, or [detection] density = "exhaustive".',
        )
    return sweeps, _counts(scene, sweeps)


def run_optimize(scene: Scene, sweeps: Sequence[Sweep], talk: Talk) -> tuple[list[Sweep], dict[str, Any]]:
    """Optimised sweeps and their summary.

    Raises
    ------
    NumericalError: no candidate survived.
    """
    from conflank_cli.optimization import optimize

    with talk.timed("optimize"):
        motions, summary = optimize(scene, list(sweeps), talk.progress)
    if summary["left_out"]:
        talk.note(f"optimize: {summary['left_out']} of {len(sweeps)} candidates left out; conflank inspect says why")
    return motions, _counts(scene, motions) | summary


def run_select(
    scene: Scene, sweeps: Sequence[Sweep], talk: Talk
) -> tuple[list[Sweep], dict[str, Any], list[FaceCoverage]]:
    """The plan, its summary, and what it covers point by point. It is empty where something forbids every sweep.

    Raises
    ------
    NumericalError: no sweep covers anything, and nothing is in the way.
    """
    from conflank_cli.selection import select

    with talk.timed("select"):
        choice = select(scene, list(sweeps), talk.progress)
    plan, summary = choice.plan, choice.summary
    if not plan and not any(face["in_the_way_mm2"] for face in summary["faces"]):
        raise NumericalError(
            "select",
            f"no sweep of {len(sweeps)} that covers anything within the tolerances",
            "at least one",
            "Widen [tolerance] overcut and undercut, or try other tools.",
        )
    return plan, _counts(scene, plan) | summary, choice.coverage


def run_passes(
    scene: Scene, plan: Sequence[Sweep], summary: dict[str, Any], talk: Talk
) -> tuple[list[Pass], dict[str, Any]]:
    """The passes over what the sweeps of a plan leave, where the job wants them, and the plan's summary with theirs."""
    if not scene.job.selection.ball_passes.enabled:
        return [], summary
    from conflank_cli.passes import ball_passes

    with talk.timed("passes"):
        passes, more = ball_passes(scene, plan, talk.progress)
    return passes, summary | more


def run_post(
    scene: Scene, sweeps: Sequence[Sweep], passes: Sequence[Pass], output: str, talk: Talk
) -> tuple[dict[str, str], PostSummary]:
    """Texts by name of file (the program to run as `output`, then the parts it calls beside it), and what they do."""
    from conflank_cli.errors import UsageError
    from conflank_cli.formats import post_of
    from conflank_cli.posting import post_programs, summarize

    with talk.timed("post"):
        (program, *parts), path, known = post_programs(scene, sweeps, passes)
    suffix = post_of(scene.job).suffix
    files = {output: program.text}
    for part in parts:
        name = str(Path(output).with_name(part.name + suffix))
        if name in files:
            raise UsageError(f"-o {output}", "the name of a part that the program calls", "another", "Name another.")
        files[name] = part.text
    return files, summarize(scene.job, path, known)


def program_beside(folder: Path, name: str) -> str | None:
    """Text of a program in a folder, for one that calls it; None where there is none."""
    try:
        return (folder / name).read_bytes().decode("utf-8", "surrogateescape")
    except OSError:
        return None


def run_verify(
    program: bytes, name: str, scene: Scene, talk: Talk, called: Callable[[str], str | None] | None = None
) -> Verification:
    """The judgement of a program, ours or foreign, with those that it calls."""
    from conflank_cli.verification.judge import verify_program

    # Whatever bytes a foreign program's comments hold, the hash must be that of the file.
    text = program.decode("utf-8", "surrogateescape")
    with talk.timed("verify"), talk.progress.stage("verify", 1) as stage:
        verification = verify_program(text, scene, name, called=called)
        stage.advance()
    return verification


def _counts(scene: Scene, sweeps: Sequence[Sweep]) -> dict[str, Any]:
    """How many sweeps there are, by tool and by face."""
    return {
        "sweeps": len(sweeps),
        "by_tool": dict(Counter(sweep.tool for sweep in sweeps)),
        "by_face": dict(Counter(str(scene.faces[sweep.face].number) for sweep in sweeps)),
    }
