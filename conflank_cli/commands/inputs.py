"""What commands read: jobs, scenes, artifacts, and the parts of a job that a later stage may replace."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

import click

from conflank_cli.options import Talk
from conflank_cli.output import STANDARD

if TYPE_CHECKING:
    from conflank_cli.cad.kernel_process import KernelProcess
    from conflank_cli.job import Job
    from conflank_cli.scene import Scene

DOWNSTREAM = {
    "optimize": ("tolerance", "optimization", "selection", "obstacles", "setup", "machine", "program"),
    "select": ("selection", "obstacles", "setup", "machine", "program"),
    "post": ("setup", "machine", "program"),
}
"""Tables of the job that --job replaces: those that no stage before this one has used."""


def read_job(source: str) -> tuple[Job, Path]:
    """A job and the folder its paths are relative to; from standard input that is the current folder."""
    from msgspec.structs import replace as replace_struct

    from conflank_cli.errors import InputError
    from conflank_cli.formats import post_of
    from conflank_cli.job import load_job, parse_job

    if source == STANDARD:
        job, folder = parse_job(sys.stdin.buffer.read(), "standard input", Path()), Path()
    else:
        job, folder = load_job(source), Path(source).parent
    # A format or style that does not exist should not be found out after all the computing.
    try:
        post = post_of(job)
    except InputError as error:
        where = f"{'standard input' if source == STANDARD else Path(source).name}: {error.where}"
        raise InputError(where, error.found, error.expected, error.next_step) from error
    if job.program.style is None:
        job = replace_struct(job, program=replace_struct(job.program, style=post.styles[0]))
    return job, folder


def files_of(source: str, job: Job, folder: Path) -> list[Path]:
    """The files a job is made of: none of them may be an output."""
    names = [job.part.file, *job.obstacles.meshes, *([job.machine.file] if job.machine.file else [])]
    return [folder / name for name in names] + ([] if source == STANDARD else [Path(source)])


def say_if_first(talk: Talk) -> bool:
    """Whether no compiled kernel is kept yet, wherever numba keeps them; if so, say what is being waited for."""
    from conflank_cli.geometry.kernels.footpoint import footpoints

    # Where numba is told not to compile, there is nothing to wait for.
    stats = getattr(footpoints, "stats", None)
    first = stats is not None and not any(Path(stats.cache_path).glob("*.nbi"))
    if first:
        talk.note("The kernels are compiled once, at the first run: about a minute more.")
    return first


def _wake_compiler() -> None:
    """Call a compiled kernel: the first one to be called waits 0.2 s for numba to get ready."""
    import numpy as np

    from conflank_cli.cad.quadrature import surface_frames
    from conflank_cli.geometry.surface import BSplineSurface, to_spans

    knots, corner = np.array([0.0, 0.0, 1.0, 1.0]), np.zeros(1)
    surface_frames(to_spans(BSplineSurface(1, 1, knots, knots, np.zeros((2, 2, 3)))), corner, corner)


def start_kernel() -> KernelProcess:
    """The process that reads a CAD file for this command, and ends with it; to be called as early as can be."""
    from conflank_cli.cad.kernel_process import KernelProcess

    return click.get_current_context().with_resource(KernelProcess())


def read_scene(
    job: Job,
    folder: Path,
    talk: Talk,
    kernel: KernelProcess,
    meanwhile: Sequence[str] = (),
    at_first: Callable[[], None] | None = None,
) -> Scene:
    """The scene of a job; says what is odd about its obstacles, and first of all what else there is to wait for.

    meanwhile: modules that the command will need; they are imported while the kernel's process reads.
    at_first: called where kernels are yet to be compiled.
    """
    from conflank_cli.cad.kernel_process import Wanted

    part = job.part
    design = [item.face for item in part.design]
    part_of = kernel.read(Wanted(folder / part.file, part.scale, design, part.check_faces))
    from conflank_cli.cad.obstacles import obstacle_notes
    from conflank_cli.cad.scene import load_scene

    for name in meanwhile:
        import_module(name)
    if say_if_first(talk) and at_first is not None:
        at_first()
    _wake_compiler()
    scene = load_scene(job, folder, part_of)
    for text in obstacle_notes(scene):
        talk.note(f"note: {text}")
    return scene


def override(scene: Scene, stage: str, job_file: str | None, talk: Talk) -> Scene:
    """The scene with those tables of another job file that are downstream of `stage`; says what it does not take."""
    if job_file is None:
        return scene
    from msgspec.structs import asdict
    from msgspec.structs import replace as replace_struct

    job, folder = read_job(job_file)
    taken, given = asdict(scene.job), asdict(job)
    late = DOWNSTREAM[stage]
    kept = [name for name in taken if name not in late and taken[name] != given[name]]
    if kept:
        talk.note(f"note: [{'], ['.join(kept)}] of {job_file} differ, but are settled before {stage}: not used")
    if "obstacles" in late and job.obstacles.meshes != scene.job.obstacles.meshes:
        from conflank_cli.cad.obstacles import with_obstacles

        scene = with_obstacles(scene, job, folder)
    return replace(scene, job=replace_struct(scene.job, **{name: given[name] for name in late}))
