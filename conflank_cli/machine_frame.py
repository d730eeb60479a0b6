"""The machine of a job and the frame of the part on its table: which tool axes it can reach."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from conflank_cli.job import Copies, Job, Setup
from postprocessors.kinematics.two_rotary import within_range
from postprocessors.machines.machine import Machine, load_machine, parse_machine

Array = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Frame:
    """The frame on the machine table: x_program = rotation x_cad + translation (mm)."""

    rotation: Array
    translation: Array
    text: str

    @classmethod
    def of(cls, setup: Setup) -> Frame:
        """The frame of a job: XYZ intrinsic rotation, then translation."""
        rotation = Rotation.from_euler("XYZ", setup.rotate_deg, degrees=True).as_matrix()
        values = [*setup.rotate_deg, *setup.translate]
        if not any(values):
            return cls(np.eye(3), np.zeros(3), "CAD")
        text = "ROTATE {} {} {} TRANSLATE {} {} {}".format(*(f"{value:.9g}" for value in values))
        return cls(rotation, np.asarray(setup.translate, dtype=np.float64), text)

    def points(self, points: Array) -> Array:
        """Points (..., 3) in the program's frame."""
        return np.asarray(points @ self.rotation.T + self.translation)

    def turned(self, rotation: Array) -> Frame:
        """The frame of what is turned by a rotation (3, 3) in the CAD frame: x_program = this frame (rotation x)."""
        return Frame(np.asarray(self.rotation @ rotation), self.translation, self.text)

    def directions(self, directions: Array) -> Array:
        """Directions (..., 3) in the program's frame."""
        return np.asarray(directions @ self.rotation.T)


def machine_of(job: Job) -> Machine:
    """The machine of a job: from the text of its file, or shipped."""
    if job.machine.definition is not None:
        return parse_machine(job.machine.definition, job.machine.file or job.machine.name)
    return _shipped(job.machine.name)


@lru_cache(maxsize=8)
def _shipped(name: str) -> Machine:
    return load_machine(name)


def copy_rotation(copies: Copies, number: int) -> Array:
    """From copy 0 of a rotary pattern to copy `number`, (3, 3), in the CAD frame."""
    axis = np.asarray(copies.axis) / np.linalg.norm(copies.axis)
    return np.asarray(Rotation.from_rotvec(2.0 * np.pi * number / copies.count * axis).as_matrix())


def reachable_axes(job: Job, axes: Array) -> BoolArray:
    """Which tool axes (N, 3), unit vectors in the CAD frame, the job's machine can take within its rotary ranges.

    On every copy that is cut.
    """
    rotations = _copied(job.setup)
    every = np.concatenate([axes @ rotation.T for rotation in rotations])
    return np.asarray(within_range(machine_of(job), every).reshape(len(rotations), len(axes)).all(axis=0))


@lru_cache(maxsize=8)
def _copied(setup: Setup) -> tuple[Array, ...]:
    """Rotations (3, 3) of directions from the CAD frame to the program's, one for each copy that is cut."""
    frame, copies = Frame.of(setup), setup.copies
    return tuple(frame.turned(copy_rotation(copies, number)).rotation for number in copies.order)
