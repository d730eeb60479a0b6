"""A rotary pattern of blades from one plan: which cuts it makes where, and what stands in the way of all of them.

A plan is for copy 0, the part as the CAD file has it; copy k is that turned by k / count of a whole turn about an axis
through the origin of the CAD frame. What belongs to the part stands around every copy as it does around copy 0, and
turns with it. Foreign bodies stay where they are: a tool that cuts all copies meets them in as many places.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import groupby

import numpy as np
import numpy.typing as npt

from conflank_cli.ball_pass import Pass
from conflank_cli.geometry.face import CheckMesh
from conflank_cli.job import Copies
from conflank_cli.machine_frame import copy_rotation
from conflank_cli.scene import Scene
from conflank_cli.sweep import Sweep

Array = npt.NDArray[np.float64]
Cut = Sweep | Pass


def over_copies(copies: Copies, cuts: Sequence[Cut]) -> Iterator[tuple[Cut, Array]]:
    """Every cut of a plan on every copy that is cut, with that copy's rotation.

    As long as a tool is in the spindle it goes over all copies; on each of them its cuts keep their order.
    """
    rotations = [copy_rotation(copies, number) for number in copies.order]
    for _, group in groupby(cuts, key=lambda cut: cut.tool):
        run = list(group)
        for rotation in rotations:
            for cut in run:
                yield cut, rotation


def seen_from_first(scene: Scene) -> Scene:
    """The scene with foreign bodies wherever a copy that is cut sees them, turned back to copy 0."""
    copies, foreign = scene.job.setup.copies, scene.check.face < 0
    if copies.order == (0,) or not foreign.any():
        return scene
    bodies = scene.check.only(foreign)
    # Points are rows: times R is turning back.
    turned = [replace(bodies, vertices=bodies.vertices @ copy_rotation(copies, number)) for number in copies.order]
    return scene.checking(CheckMesh.joined([scene.check.only(~foreign), *turned]))
