"""The exact poses of one sweep in the program's frame."""

from __future__ import annotations

from dataclasses import dataclass, replace

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
        return self._of_ends(*self.motion.ends(1.0 - t if self.backwards else t))

    def beyond(self, distance: Array, after: bool) -> tuple[Array, Array]:
        """Tip points and axes, each (N, 3), as if the cut had begun earlier, or gone on, as it is at that end.

        Both ends of the axis go straight on at the speed they have there; `distance` (N,), mm, is the way of the one
        that is faster.
        """
        t = 1.0 if after != self.backwards else 0.0
        # Outward in time: what comes before t = 0 or after t = 1 of the motion itself.
        outward = 1.0 if t == 1.0 else -1.0
        (p,), (q,) = self.motion.ends([t])
        (along_p,), (along_q,) = self.motion.ends([t], order=1)
        speed = max(float(np.linalg.norm(along_p)), float(np.linalg.norm(along_q)), np.finfo(np.float64).tiny)
        step = (outward * distance / speed)[:, None]
        return self._of_ends(p + step * along_p, q + step * along_q)

    def between(self, start: float, end: float) -> Ride:
        """The part of it from t = start to t = end, in cutting direction."""
        if (start, end) == (0.0, 1.0):
            return self
        times = (1.0 - end, 1.0 - start) if self.backwards else (start, end)
        return replace(self, motion=self.motion.restricted(*times))

    def _of_ends(self, p: Array, q: Array) -> tuple[Array, Array]:
        axis = q - p
        axis /= np.linalg.norm(axis, axis=1, keepdims=True)
        # |pq| differs from the tool's length by up to a micrometre; anchoring the middle halves what each end sees.
        tip = 0.5 * (p + q) + (self.tool.tip_height - 0.5 * self.tool.length) * axis
        return self.frame.points(tip), self.frame.directions(axis)
