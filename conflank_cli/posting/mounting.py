"""What a job says about where part and tools are on the machine, and what its axes then do."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from conflank_cli.job import Job
from postprocessors.kinematics.linear_axes import nose_positions
from postprocessors.kinematics.timing import unwound
from postprocessors.kinematics.travel import Mounting
from postprocessors.machines.machine import Machine

Array = npt.NDArray[np.float64]


def mounting_of(job: Job) -> Mounting:
    """The datum and the lengths of tools as the job gives them."""
    return Mounting(job.machine.zero, dict(job.machine.gauge_length))


def axis_positions(machine: Machine, mounting: Mounting, tool: str, tip: Array, words: Array) -> Array:
    """Positions of the five axes at N poses, (N, 5): X, Y, Z in mm, rotary words unwound in degrees.

    Where the datum or the tool's length is not known, what X, Y and Z do to make up for rotary motion is not known
    either; the way of the tip on the part then stands for theirs.
    """
    length = mounting.gauge_length.get(tool)
    if mounting.zero is None or length is None:
        lines = tip
    else:
        lines = nose_positions(machine, tip, words).at(np.asarray(mounting.zero), length)
    return np.hstack([lines, unwound(machine, words)])
