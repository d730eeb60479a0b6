"""The way over the part: from the retracted tool to the start of an approach, and back, on any machine.

A retracted tool stands at the machine's Z limit over any X and Y. u is machine +Z as the part sees it while the rotary
axes stand as they do in the first pose E of an approach, a the tool axis there (tip to spindle). Only head axes make a
differ from u.

- *From above*. With the rotary axes at rest the tool is only shifted. If its lowest point along u is above everything
  at both ends of a straight move, it is so all the way. So the first rapid goes to F, where the tool, oriented as at E,
  is above all geometry along u. The limit of Z is at least as high as F, or F is out of travel.
- *Down to E*. E lies beyond the plane across a that touches the sphere around all geometry, and so does all of the
  tool, whose tip is its lowest point along a. Where a . u >= 0 the way from F to E is straight down: a shift along u
  does not bring the tool nearer to that plane. Where a . u < 0 (the spindle is lower than the tip) the way runs within
  the plane across a: F = E + s (u - (a . u) a).
- *Upright*. Before the retract the head axes turn to 0 about the tip at F. F is high enough for the largest tilt off u
  on the way (usually that at its start), and for every smaller one.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import acos, atan2, cos, hypot, pi, sin

import numpy as np
import numpy.typing as npt

from conflank_cli.tool import Tool
from postprocessors.errors import PostError

Array = npt.NDArray[np.float64]

STEEPEST_SINE = 0.1
"""Sine of the least angle between the tool axis and machine -Z: a tool that points up more steeply than that would have
to come in from ten times as far beside the part as it is to rise."""


@dataclass(frozen=True, slots=True)
class Overhead:
    """Everything that a tool must stay above, and by how much.

    corners: points whose convex hull holds all geometry, program frame, (N, 3), mm.
    clearance: what is kept, mm.
    """

    corners: Array
    clearance: float

    def above(self, tip: Array, axis: Array, up: Array, tilt: float, tool: Tool, label: str) -> Array | None:
        """Where the tip has to be for the whole tool to be above all geometry along `up`, (3,); None: where it is.

        Parameters
        ----------
        tip, axis: the pose on the safe plane, (3,) each.
        up: machine +Z seen from the part, (3,), unit.
        tilt: the largest tilt of the axis off `up`, radians, at which the tool has to be above everything.
        tool: its ball, cone, shank and holder.
        label: of the cut in messages.

        Raises
        ------
        PostError: the tool points nearly straight up; no way leads over the part.
        """
        cosine = float(np.clip(axis @ up, -1.0, 1.0))
        highest = float((self.corners @ up).max())
        rise = highest + self.clearance + depth_below_tip(tool, max(tilt, acos(cosine))) - float(tip @ up)
        if rise <= 0.0:
            return None
        if cosine >= 0.0:
            return np.asarray(tip + rise * up)
        sine = hypot(*np.cross(axis, up))
        if sine < STEEPEST_SINE:
            raise PostError(
                label,
                f"a tool axis {np.degrees(acos(-cosine)):.1f} degrees from machine -Z",
                f"at least {np.degrees(np.arcsin(STEEPEST_SINE)):.1f} degrees: no way leads over the part",
                "Turn the part in [setup].",
            )
        return np.asarray(tip + rise / sine**2 * (up - cosine * axis))


def depth_below_tip(tool: Tool, tilt: float) -> float:
    """How far the tool reaches below its tip, mm, at most, while it is tilted off the vertical by 0 to `tilt` radians.

    The ball's lowest point is r (1 - cos tilt) below the tip, a rim of radius r at height h above the tip
    r sin(tilt) - h cos(tilt); the latter grows up to the tilt pi - atan(r / h).
    """
    depth = tool.ball_radius * (1.0 - cos(tilt))
    height = -tool.tip_height
    rims = [(height, tool.r_min), (height + tool.length, tool.r_max)]
    height += tool.length
    for section in (*tool.shank, *tool.holder):
        rims.append((height, 0.5 * section.diameter_low))
        height += section.length
        rims.append((height, 0.5 * section.diameter_high))
    for height, radius in rims:
        most = min(tilt, pi - atan2(radius, height))
        depth = max(depth, radius * sin(most) - height * cos(most))
    return depth
