"""What a plan covers of a face, point by point, and why it does not cover the rest."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]


class Reason(IntEnum):
    """Why a point is left. The numbers stand in artifacts and keep their meaning."""

    COVERED = 0
    NOT_CHOSEN = 1
    SMALL = 2
    OVERCUT = 3
    COLLISION = 4
    MACHINE = 5
    NO_SWEEP = 6
    NO_LINE = 7


REASON_WORDS = {
    Reason.COVERED: "covered",
    Reason.NOT_CHOSEN: "not needed for the coverage asked for",
    Reason.SMALL: "only in patches below the smallest that is worth a sweep",
    Reason.OVERCUT: "every sweep over it cuts too deep elsewhere",
    Reason.COLLISION: "collision",
    Reason.MACHINE: "out of the machine's reach",
    Reason.NO_SWEEP: "a line fits, but no sweep along it was found",
    Reason.NO_LINE: "no line fits",
}


@dataclass(frozen=True, slots=True)
class FaceCoverage:
    """Points of a trimmed face, and what a plan does there.

    Attributes
    ----------
    uv (N, 2), points (N, 3) mm, areas (N,) mm2: each point stands for so much of the face.
    sweep: (N,) number of the sweep of the plan, from 0, that leaves least of those that cover the point; -1 for none.
    reason: (N,) why a point is left, as a `Reason`; COVERED where it is not.
    """

    uv: Array
    points: Array
    areas: Array
    sweep: IntArray
    reason: IntArray

    def area(self, reason: Reason) -> float:
        """Area for which a reason holds, mm2."""
        return float(self.areas[self.reason == reason].sum())
