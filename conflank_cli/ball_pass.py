"""A pass: one continuous cut with the ball of a tool, as the stages hand it on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Pass:
    """One cut with the ball, over one spot of a face: streamlines to and fro, and the short ways between them.

    Between two poses the tip goes straight and the axis swings on a great circle: the poses are the pass itself, not
    samples of it.

    Attributes
    ----------
    face: index into the scene's faces (not the CAD face number).
    tool: name of the tool.
    tip: tip points in cutting order, shape (N, 3), mm, CAD frame.
    axis: unit vectors from tip to spindle, shape (N, 3).
    facts: what the stages measured, by name with the unit in the name; scalars only.
    """

    face: int
    tool: str
    tip: Array
    axis: Array
    facts: Mapping[str, float] = field(default_factory=dict)
