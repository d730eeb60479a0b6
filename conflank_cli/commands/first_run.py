"""The first run, which compiles the kernels: on two cores those of its later stages beside those of the first."""

from __future__ import annotations

import subprocess
import sys
from contextlib import suppress
from functools import partial

import click
import numpy as np

from conflank_cli import job as jobs
from conflank_cli.cores import cores
from conflank_cli.geometry.collision import Collider
from conflank_cli.geometry.face import CheckMesh, DesignFace
from conflank_cli.geometry.surface import BSplineSurface
from conflank_cli.motion import fitted
from conflank_cli.once import Once
from conflank_cli.posting import post_program
from conflank_cli.progress import SilentProgress
from conflank_cli.scene import Scene
from conflank_cli.selection import select
from conflank_cli.selection.obstruction import obstruction_of
from conflank_cli.sweep import Sweep
from conflank_cli.tool import CATALOGUE
from conflank_cli.verification.judge import verify_program
from conflank_cli.verification.result import Verification

# Sides of the face that is milled, and how far below it something is that must not be hit, mm.
LENGTH, DEPTH = 30.0, 20.0


def rehearse_aside() -> None:
    """Have another process rehearse, which ends with this command; what it compiles is there when it is needed."""
    if cores() < 2:
        return
    program = f"import sys; sys.path[:] = {sys.path!r}; from {__name__} import rehearse; rehearse()"
    nowhere = subprocess.DEVNULL
    # Without it the run takes longer, that is all.
    with suppress(OSError):
        # In a group of its own, like the process that reads: Ctrl-C on a terminal goes to a whole group.
        process = subprocess.Popen(
            [sys.executable, "-c", program], stdin=nowhere, stdout=nowhere, stderr=nowhere, process_group=0
        )
        click.get_current_context().call_on_close(partial(_end, process))


def _end(process: subprocess.Popen[bytes]) -> None:
    process.kill()
    process.wait()


def rehearse() -> Verification:
    """Select, post and verify a sweep of a cone that lies on a flat face: all kernels of these stages are called."""
    tool = CATALOGUE["T1"]
    alpha, width = tool.half_angle, tool.length / np.cos(tool.half_angle)
    x, y = np.array([0.0, LENGTH]), np.array([0.0, width])
    poles = np.stack([*np.meshgrid(x, y, indexing="ij"), np.zeros((2, 2))], axis=2)
    loop = np.array([[x[0], y[0]], [x[1], y[0]], [x[1], y[1]], [x[0], y[1]]])
    face = DesignFace(0, "", BSplineSurface(1, 1, x.repeat(2), y.repeat(2), poles), (loop,), 1)
    below = np.array([[0.0, 0.0, -DEPTH], [LENGTH, 0.0, -DEPTH], [0.0, width, -DEPTH]])
    check = CheckMesh(below, np.array([[0, 1, 2]], dtype=np.int32), np.ones(1, dtype=np.int32))
    job = jobs.Job(part=jobs.Part("", (jobs.Design(0),)), tools=jobs.Tools((tool.name,)))
    scene = Scene(job, "", (face,), (tool,), Once(lambda: check), {})

    t = np.linspace(0.0, 1.0, 40)
    p = np.stack([LENGTH * t, 0.0 * t, np.full(len(t), tool.r_min * np.cos(alpha))], axis=1)
    motion = fitted(t, np.hstack([p, p + tool.length * np.array([0.0, np.cos(alpha), np.sin(alpha)])]), 8)
    # What keeps a sweep from covering all of its face is looked for only where one does not.
    obstruction_of(Collider.of(scene), motion, tool)
    choice = select(scene, [Sweep(0, tool.name, motion)], SilentProgress())
    return verify_program(post_program(scene, choice.plan)[0], scene)
