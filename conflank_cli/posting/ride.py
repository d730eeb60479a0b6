"""The exact poses of one sweep in the program's frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from conflank_cli.machine_frame import Frame
from conflank_cli.motion import Motion
from conflank_cli.tool import Tool

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Ride:
    """The exact poses of one sweep in the program's frame.

    Attributes
    ----------
    motion: the axis over time, t in [0, 1].
    tool: the cutter.
    frame: the program's frame.
    backwards: whether the sweep is cut against its t.
    """

    motion: Motion
    tool: Tool
    frame: Frame
    backwards: bool = False

    @property
    def reach(self) -> float:
        """Height of the plane of r_max above the tip, mm."""
        return self.tool.length - self.tool.tip_height

    def poses(self, t: npt.ArrayLike) -> tuple[Array, Array]:
        """Tip points and axes at t (N,), each (N, 3); t always runs in cutting direction."""
        t = np.asarray(t, dtype=np.float64)
        p, q = self.motion.ends(1.0 - t if self.backwards else t)
        axis = q - p
        axis /= np.linalg.norm(axis, axis=1, keepdims=True)
        # |pq| differs from the tool's length by up to a micrometre; anchoring the middle halves what each end sees.
        tip = 0.5 * (p + q) + (self.tool.tip_height - 0.5 * self.tool.length) * axis
        return self.frame.points(tip), self.frame.directions(axis)
