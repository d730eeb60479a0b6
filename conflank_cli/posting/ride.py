"""The exact poses of one sweep or pass in the program's frame."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from conflank_cli.ball_pass import Pass
from conflank_cli.machine_frame import Frame
from conflank_cli.motion import Motion
from conflank_cli.tool import Tool
from postprocessors.toolpath import Purpose

Array = npt.NDArray[np.float64]

SAMPLES_PER_SPAN = 16
"""Samples of a motion for each knot span, from which the spacing is planned: its second derivative is linear there."""
SAMPLES_AT_LEAST = 129


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
    def purpose(self) -> Purpose:
        """What it is in a tool path."""
        return Purpose.SWEEP

    @property
    def reach(self) -> float:
        """Height of the plane of r_max above the tip, mm."""
        return self.tool.length - self.tool.tip_height

    @property
    def contact(self) -> tuple[float, float]:
        """Heights above the tip, mm, of the middle and of the upper end of what cuts."""
        return 0.5 * self.reach, self.reach

    @property
    def times(self) -> Array:
        """Times that stand for the whole motion, t in [0, 1]."""
        spans = len(np.unique(self.motion.knots)) - 1
        return np.linspace(0.0, 1.0, max(SAMPLES_AT_LEAST, SAMPLES_PER_SPAN * spans + 1))

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
        # |pq| may be off the tool's length by micrometres: the swept gap, too, puts the cone at p.
        tip = p + self.tool.tip_height * axis
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
    def purpose(self) -> Purpose:
        """What it is in a tool path."""
        return Purpose.PASS

    @property
    def reach(self) -> float:
        """Height of the plane of r_max above the tip, mm."""
        return self.tool.length - self.tool.tip_height

    @property
    def contact(self) -> tuple[float, float]:
        """Heights above the tip, mm, of the middle and of the upper end of what cuts: the ball, at its centre."""
        return self.tool.ball_radius, self.tool.ball_radius

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

    def beyond(self, distance: Array, after: bool) -> tuple[Array, Array]:
        """Tip points and axes, each (N, 3), as if the pass had begun earlier or gone on, without swing."""
        way = np.diff(self.tip[-2:] if after else self.tip[1::-1], axis=0)[0]
        way /= max(float(np.linalg.norm(way)), np.finfo(np.float64).tiny)
        end = -1 if after else 0
        return self.tip[end] + distance[:, None] * way, np.repeat(self.axis[end][None], len(distance), axis=0)

    def between(self, start: float, end: float) -> PassRide:
        """The part of it from t = start to t = end."""
        inner = self.times[(self.times > start) & (self.times < end)]
        tip, axis = self.poses(np.concatenate([[start], inner, [end]]))
        return replace(self, tip=tip, axis=axis)


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
