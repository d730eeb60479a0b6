"""The exact poses of one sweep or pass in the program's frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from conflank_cli.ball_pass import Pass
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


@dataclass(frozen=True, slots=True)
class PassRide:
    """The exact poses of one pass in the program's frame: from pose to pose the tip goes straight, the axis swings.

    Attributes
    ----------
    tip, axis: the poses, (N, 3) each, mm and unit.
    tool: the cutter.
    frame: the program's frame.
    """

    tip: Array
    axis: Array
    tool: Tool
    frame: Frame

    @classmethod
    def of(cls, item: Pass, tool: Tool, frame: Frame) -> PassRide:
        """The ride of a pass."""
        return cls(frame.points(item.tip), frame.directions(item.axis), tool, frame)

    @property
    def reach(self) -> float:
        """Height of the plane of r_max above the tip, mm."""
        return self.tool.length - self.tool.tip_height

    @property
    def times(self) -> Array:
        """Times of the pass's own poses, t in [0, 1]."""
        return np.linspace(0.0, 1.0, len(self.tip))

    def poses(self, t: npt.ArrayLike) -> tuple[Array, Array]:
        """Tip points and axes at t (N,), each (N, 3)."""
        place = np.asarray(t, dtype=np.float64) * (len(self.tip) - 1)
        first = np.clip(place.astype(np.int64), 0, len(self.tip) - 2)
        share = (place - first)[:, None]
        tip = self.tip[first] + share * (self.tip[first + 1] - self.tip[first])
        return tip, great_circle(self.axis[first], self.axis[first + 1], share)


def great_circle(start: Array, end: Array, share: Array) -> Array:
    """Unit vectors at shares of the way from start to end on great circles; broadcast over (..., 3)."""
    sine = np.linalg.norm(np.cross(start, end), axis=-1, keepdims=True)
    angle = np.arctan2(sine, np.sum(start * end, axis=-1, keepdims=True))
    # sin(x) / sin(angle) tends to x / angle, which sinc says without dividing by zero.
    scale = np.sinc(angle / np.pi)
    low, high = 1.0 - share, share
    return np.asarray(
        low * np.sinc(low * angle / np.pi) / scale * start + high * np.sinc(high * angle / np.pi) / scale * end
    )
