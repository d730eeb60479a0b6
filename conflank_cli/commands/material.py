"""What report, plot and export are made of: a scene, a program for it, and its verification, whichever are given."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import msgspec

from conflank_cli.artifacts.npz import decode_artifact, read_source
from conflank_cli.errors import InputError, UsageError
from conflank_cli.options import Talk
from conflank_cli.scene import Scene
from conflank_cli.sweep import Sweep
from conflank_cli.verification.result import Verification, from_json
from conflank_cli.verification.verify import PosedProgram, pose_program

_ZIP = b"PK\x03\x04"


@dataclass(frozen=True)
class Material:
    """A program with what it is for.

    Attributes
    ----------
    scene: the job with its geometry.
    name, text: of the program.
    verification: of the program, where one was given.
    inputs: files that the job names besides those that were given.
    """

    scene: Scene
    name: str
    text: str
    verification: Verification | None
    inputs: tuple[Path, ...] = ()

    @cached_property
    def posed(self) -> PosedProgram:
        """The program with its poses."""
        return pose_program(self.text, self.scene)

    def verified(self, talk: Talk) -> Verification:
        """The verification that was given, or one that is made now."""
        from conflank_cli.commands.stages import run_verify

        return self.verification or run_verify(_bytes(self.text), self.name, self.scene, talk)


@dataclass(frozen=True, slots=True)
class _Given:
    """The files by what they are; each at most once."""

    artifact: tuple[str, bytes] | None = None
    job: str | None = None
    program: tuple[str, bytes] | None = None
    verification: tuple[str, Verification] | None = None


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
    scene, sweeps, inputs = _scene_of(given, talk)
    name, text = _program_of(given, scene, sweeps, talk)
    verification = None
    if given.verification is not None:
        where, verification = given.verification
        if verification.program_sha256 != hashlib.sha256(_bytes(text)).hexdigest():
            raise InputError(
                where, f"the verification of another text of {verification.program}", f"that of {name}",
                "Leave it out: the program is verified then.",
            )  # fmt: skip
    return Material(scene, name, text, verification, inputs)


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
        try:
            return "verification", (where, from_json(data))
        except msgspec.DecodeError as error:
            raise InputError(
                where, f"JSON that is no verification ({error})", "what conflank verify writes", "Name another file."
            ) from None
    return "program", (where, data)


def _scene_of(given: _Given, talk: Talk) -> tuple[Scene, tuple[Sweep, ...] | None, tuple[Path, ...]]:
    from conflank_cli.cad.scene import load_scene
    from conflank_cli.commands.inputs import files_of, read_job

    if given.artifact is not None:
        if given.job is not None:
            raise UsageError(given.job, "a job besides an artifact, which carries one", "one of them", "Leave one out.")
        where, data = given.artifact
        # Any artifact tells what a program is for; only a plan has one.
        kind, scene, sweeps, _ = decode_artifact(data, where)
        if kind != "plan" and given.program is None:
            raise UsageError(where, f"{kind}, of which there is no program yet", "a plan", "Name out/plan.npz.")
        return scene, sweeps, ()
    if given.job is not None:
        job, folder = read_job(given.job)
        return load_scene(job, folder), None, tuple(files_of(given.job, job, folder))
    raise UsageError(
        "FILE", "nothing that says what the part is", "a plan or a job as well", "Add out/plan.npz or job.toml."
    )


def _program_of(given: _Given, scene: Scene, sweeps: tuple[Sweep, ...] | None, talk: Talk) -> tuple[str, str]:
    if given.program is not None:
        where, data = given.program
        return Path(where).name, data.decode("utf-8", "surrogateescape")
    from conflank_cli.commands.stages import run_detect, run_optimize, run_select
    from conflank_cli.posting import post_program

    if sweeps is None:
        candidates, _ = run_detect(scene, talk)
        motions, _ = run_optimize(scene, candidates, talk)
        sweeps = tuple(run_select(scene, motions, talk)[0])
    with talk.timed("post"):
        text, _ = post_program(scene, sweeps)
    return f"{scene.job.program.name}.{scene.job.program.format.upper()}", text
