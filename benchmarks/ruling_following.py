"""The default to compare with: a cutter that follows the isoparametric rulings of a face.

At every time the generator that touches the face is tangent to an isoparametric line in the middle of its height, and
the axis is that generator tilted by the half angle and moved off the face by the cone. It is what a good strategy for
ruled faces does when it is given a face that is none.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, sin
from typing import Literal

import numpy as np
import numpy.typing as npt

from conflank_cli.geometry.workface import WorkFace
from conflank_cli.motion import Motion, fitted
from conflank_cli.optimization.gauss_newton import error_field
from conflank_cli.tool import Tool

Array = npt.NDArray[np.float64]

LINES = 200  # that a motion is fitted through
SPACING = 3.0  # mm of travel between control points: what is left of the fit is below 0.1 um


@dataclass(frozen=True, slots=True)
class Band:
    """A band of a face that one sweep cuts: a box in the face's parameters (u0, u1, v0, v1).

    The generator lies along the lines of constant `across`, pointing from tip to spindle to larger values of the other
    parameter where `up`, else to smaller ones.
    """

    box: tuple[float, float, float, float]
    across: Literal["u", "v"]
    up: bool


def ruling_following(face: WorkFace, tool: Tool, band: Band) -> Motion:
    """The motion that follows the rulings of a band."""
    u0, u1, v0, v1 = band.box
    t = np.linspace(0.0, 1.0, LINES)
    if band.across == "u":
        u, v, derivative = u0 + t * (u1 - u0), np.full(LINES, 0.5 * (v0 + v1)), 2
    else:
        u, v, derivative = np.full(LINES, 0.5 * (u0 + u1)), v0 + t * (v1 - v0), 1
    frame = face.projector.evaluate(u, v)
    normal = face.sense * _unit(np.cross(frame[:, 1], frame[:, 2]))
    generator = _unit(frame[:, derivative]) * (1.0 if band.up else -1.0)
    alpha = tool.half_angle
    d = cos(alpha) * generator + sin(alpha) * normal
    inwards = cos(alpha) * normal - sin(alpha) * generator
    # In the middle of the flute the surface of the cone is this far from the axis, across it.
    radius = 0.5 * (tool.r_min + tool.r_max)
    middle = frame[:, 0] + radius * inwards
    p = middle - 0.5 * tool.length * d
    travel = float(np.linalg.norm(np.diff(frame[:, 0], axis=0), axis=1).sum())
    return fitted(t, np.hstack([p, p + tool.length * d]), max(round(travel / SPACING) + 3, 6))


def band_errors(
    face: WorkFace, tool: Tool, motion: Motion, box: tuple[float, float, float, float], samples: tuple[int, int]
) -> Array:
    """Axis errors, mm, of those of m x n samples whose footpoints lie in a box of the face, on the face."""
    field = error_field(face, tool, motion, 0.0, samples)[0]
    u0, u1, v0, v1 = box
    inside = (field.u >= u0) & (field.u <= u1) & (field.v >= v0) & (field.v <= v1)
    return np.asarray(field.error[inside & (field.on > 0.5)])


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1)[:, None])
