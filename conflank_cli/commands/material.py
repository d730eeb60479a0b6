"""What report, plot and export are made of: a scene, a program for it, and its verification, whichever are given."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

from conflank_cli.artifacts.npz import decode_artifact, decode_contents, decode_coverage, read_source
from conflank_cli.ball_pass import Pass
from conflank_cli.coverage import FaceCoverage
from conflank_cli.errors import InputError, NumericalError, UsageError
from conflank_cli.options import Talk
from conflank_cli.output import STANDARD
from conflank_cli.scene import Scene
from conflank_cli.sweep import Sweep
from conflank_cli.verification.posed import PosedProgram, pose_program
from conflank_cli.verification.result import Verification, from_json

Called = Callable[[str], str | None]

_ZIP = b"PK\x03\x04"


@dataclass(frozen=True)
class Material:
    """A program with what it is for.

    Attributes
    ----------
    scene: the job with its geometry.
    name, text: of the program.
    called: from the name of a file to the text of a program that this one calls.
    verification: of the program, where one was given.
    coverage: of the plan, one for each design face; none where there is no plan.
    inputs: files that the job names besides those that were given.
    """

    scene: Scene
    name: str
    text: str
    called: Called
    verification: Verification | None
    coverage: tuple[FaceCoverage, ...] = ()
    inputs: tuple[Path, ...] = ()

    @cached_property
    def posed(self) -> PosedProgram:
        """The program with its poses."""
        return pose_program(self.text, self.scene, self.called)

    def verified(self, talk: Talk) -> Verification:
        """The verification that was given, or one that is made now."""
        from conflank_cli.commands.stages import run_verify

        return self.verification or run_verify(_bytes(self.text), self.name, self.scene, talk, self.called)


@dataclass(frozen=True, slots=True)
class Plan:
    """What is to be cut."""

    sweeps: tuple[Sweep, ...]
    passes: tuple[Pass, ...]


@dataclass(frozen=True, slots=True)
class _Given:
    """The files by what they are; each at most once."""

    artifact: tuple[str, bytes] | None = None
    job: str | None = None
    program: tuple[str, str, bytes] | None = None
    verification: tuple[str, Verification] | None = None


@dataclass(frozen=True, slots=True)
class _Job:
    """A scene with the plan for it, where there is one; files that it is made of."""

    scene: Scene
    plan: Plan | None
    coverage: tuple[FaceCoverage, ...]
    inputs: tuple[Path, ...]


def _bytes(text: str) -> bytes:
    return text.encode("utf-8", "surrogateescape")


def gather(sources: Sequence[str], talk: Talk) -> Material:
    """Read files in any order and make what is missing between them.

    Raises
    ------
    UsageError: two files of one kind, or none that says what the part is.
    InputError: a file cannot be read, or the verification is that of another program.
    """
    given = _sorted(sources)
    job = _job_of(given, talk)
    name, text, called, coverage = _program_of(given, job, talk)
    verification = None
    if given.verification is not None:
        where, verification = given.verification
        if not _same_program(verification, text, called):
            raise InputError(
                where, f"the verification of another text of {verification.program}", f"that of {name}",
                "Leave it out: the program is verified then.",
            )  # fmt: skip
    return Material(job.scene, name, text, called, verification, coverage, job.inputs)


def _same_program(verification: Verification, text: str, called: Called) -> bool:
    """Whether a verification is that of a program and of those that it calls."""
    hashes = [(verification.program_sha256, text)]
    hashes += [(digest, called(name) or "") for name, digest in verification.called_sha256.items()]
    return all(digest == hashlib.sha256(_bytes(each)).hexdigest() for digest, each in hashes)


def read_sweeps(sources: Sequence[str]) -> tuple[Scene, tuple[Sweep, ...]]:
    """The scene and sweeps of one artifact.

    Raises
    ------
    UsageError: more than one file, or an artifact without a sweep.
    """
    if len(sources) > 1:
        raise UsageError(sources[1], "a second file", "one artifact", "Leave one out.")
    where, data = read_source(sources[0])
    _, scene, sweeps, _ = decode_artifact(data, where)
    if not sweeps:
        raise UsageError(where, "no sweep", "at least one", "Name another artifact.")
    return scene, sweeps


def _sorted(sources: Sequence[str]) -> _Given:
    given = _Given()
    for source in sources:
        kind, value = _recognised(source)
        if getattr(given, kind) is not None:
            raise UsageError(source, f"a second {kind}", "one file of each kind", "Leave one out.")
        given = replace(given, **{kind: value})
    return given


def _recognised(source: str) -> tuple[str, Any]:
    """What a file is, and what is needed of it."""
    if source.endswith(".toml"):
        return "job", source
    where, data = read_source(source)
    if data.startswith(_ZIP):
        return "artifact", (where, data)
    if data.lstrip().startswith(b"{"):
        return "verification", (where, from_json(data, where))
    return "program", (source, where, data)


def _job_of(given: _Given, talk: Talk) -> _Job:
    from conflank_cli.commands.inputs import files_of, read_job, read_scene, start_kernel

    if given.artifact is not None:
        if given.job is not None:
            raise UsageError(given.job, "a job besides an artifact, which carries one", "one of them", "Leave one out.")
        where, data = given.artifact
        contents = decode_contents(data, where)
        if contents.kind == "plan":
            plan = Plan(contents.sweeps, contents.passes)
            return _Job(contents.scene, plan, decode_coverage(data, where), ())
        # Any artifact tells what a program is for; only a plan has one.
        if given.program is None:
            raise UsageError(where, f"{contents.kind}, of which there is no program yet", "a plan", "Name a plan.")
        return _Job(contents.scene, None, (), ())
    if given.job is not None:
        kernel = start_kernel()
        job, folder = read_job(given.job)
        return _Job(read_scene(job, folder, talk, kernel), None, (), tuple(files_of(given.job, job, folder)))
    raise UsageError(
        "FILE", "nothing that says what the part is", "a plan or a job as well", "Add out/plan.npz or job.toml."
    )


def _program_of(given: _Given, job: _Job, talk: Talk) -> tuple[str, str, Called, tuple[FaceCoverage, ...]]:
    """Name and text of the program, those that it calls, and what the plan covers."""
    from conflank_cli.commands.stages import (
        program_beside,
        run_detect,
        run_optimize,
        run_passes,
        run_post,
        run_select,
    )
    from conflank_cli.formats import post_of

    if given.program is not None:
        source, where, data = given.program
        beside = Path() if source == STANDARD else Path(source).parent
        return where, data.decode("utf-8", "surrogateescape"), partial(program_beside, beside), job.coverage
    plan, coverage = job.plan, job.coverage
    if plan is None:
        candidates, _ = run_detect(job.scene, talk)
        motions, _ = run_optimize(job.scene, candidates, talk)
        sweeps, summary, covered = run_select(job.scene, motions, talk)
        passes, _ = run_passes(job.scene, sweeps, summary, talk)
        plan, coverage = Plan(tuple(sweeps), tuple(passes)), tuple(covered)
    if not plan.sweeps and not plan.passes:
        raise NumericalError("plan", "no cut", "at least one", "conflank select says what is in the way.")
    name = job.scene.job.program.name + post_of(job.scene.job).suffix
    files, _ = run_post(job.scene, plan.sweeps, plan.passes, name, talk)
    return name, files[name], files.get, coverage
