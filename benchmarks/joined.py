"""Two exact envelopes joined in one face: what two cuts leave behind that have nothing to do with each other.

The second case is placed so that it goes on where the first one ends, a strip further on, with the same normal and the
same direction of the flute. Both envelopes are continued over the strip by their closed forms and blended there with a
weight that is three times differentiable; outside the strip the face is one of the two.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.interpolate import make_interp_spline

from benchmarks.envelopes import MARGIN, PATCH, EnvelopeCase, contact, cylinder, random_envelopes, swept_gap
from conflank_cli.geometry.footpoint import Projector
from conflank_cli.geometry.surface import BSplineSurface
from conflank_cli.tool import CATALOGUE, Tool

Array = npt.NDArray[np.float64]

STRIP = 0.2  # of the length of an envelope: 5 to 10 mm
NODES = (81, 16)  # of the interpolation, along each envelope and over the flute
# Between spline and closed form on the halves, mm: a hundredth of the tolerance that they are judged at.
SURFACE_ERROR = 2e-4
# Overcut of either motion anywhere on the joined face, mm.
LARGEST_OVERCUT = 5e-3
DRAWN = 8  # cases of a tool that pairs are taken from
OF_EACH = 2  # faces a tool


@dataclass(frozen=True, slots=True)
class JoinedFace:
    """A face of two halves, each of which one sweep cuts.

    Attributes
    ----------
    tool: the tool.
    surface: u runs over the first half, the strip, the second half; v along the flute.
    sense: +1 where S_u x S_v points towards the tool.
    halves: ranges of u.
    """

    tool: Tool
    surface: BSplineSurface
    sense: int
    halves: tuple[tuple[float, float], tuple[float, float]]


def joined_faces(seed: int) -> list[JoinedFace]:
    """`OF_EACH` faces for each of T1, T2, T3 and a cylinder; equal seeds give equal faces."""
    faces = []
    for tool in (*CATALOGUE.values(), cylinder()):
        cases = random_envelopes(tool, DRAWN, seed + 1)
        pairs = ((a, b) for a in cases for b in cases if a is not b and a.sense == b.sense)
        found: list[JoinedFace] = []
        for a, b in pairs:
            face = join(a, b)
            if face is not None:
                found.append(face)
            if len(found) == OF_EACH:
                break
        faces += found
    return faces


def side_of(case: EnvelopeCase) -> int:
    """The side of the cut that a case was made with."""
    t, fraction = np.array([0.5]), np.array([0.5])
    there = Projector.of(case.surface).evaluate(t, fraction)[0, 0]
    distance = [np.linalg.norm(contact(case.tool, case.motion, t, fraction, side)[0][0] - there) for side in (1, -1)]
    return 1 if distance[0] < distance[1] else -1


def _frame(case: EnvelopeCase, side: int, t: float) -> tuple[Array, Array]:
    """Contact point at mid-flute, and the columns flute, across, normal there."""
    times, fractions = np.full(3, t), np.array([0.45, 0.5, 0.55])
    points, normals = contact(case.tool, case.motion, times, fractions, side)
    normal = normals[1]
    flute = points[2] - points[0]
    flute -= flute @ normal * normal
    flute /= np.linalg.norm(flute)
    return points[1], np.stack([flute, np.cross(normal, flute), normal], axis=1)


def join(first: EnvelopeCase, second: EnvelopeCase) -> JoinedFace | None:
    """Join two cases of one tool and one sense; None where the face is not regular or either motion cuts the other."""
    tool = first.tool
    sides = side_of(first), side_of(second)
    length = PATCH[1] - PATCH[0]
    start, axes = _frame(first, sides[0], PATCH[1] + STRIP * length)
    origin, own = _frame(second, sides[1], PATCH[0])
    rotation = axes @ own.T

    def moved(points: Array) -> Array:
        return (points - origin) @ rotation.T + start

    def shape(u: Array, v: Array) -> Array:
        share = np.clip((u - 1.0) / STRIP, 0.0, 1.0)
        weight = (share**4 * (35.0 - 84.0 * share + 70.0 * share**2 - 20.0 * share**3))[:, None]
        # Past the strip an envelope has no say, and may not exist.
        a = np.minimum(PATCH[0] + length * u, PATCH[1] + length * STRIP)
        b = np.maximum(PATCH[0] + length * (u - 1.0 - STRIP), PATCH[0] - length * STRIP)
        here = contact(tool, first.motion, a, v, sides[0])[0]
        there = moved(contact(tool, second.motion, b, v, sides[1])[0])
        return (1.0 - weight) * here + weight * there

    end = 2.0 + STRIP
    nu = round(end * (NODES[0] - 1)) + 1
    u, v = np.linspace(0.0, end, nu), np.linspace(MARGIN, 1.0 - MARGIN, NODES[1])
    points = shape(*_grid(u, v))
    if not np.isfinite(points).all():
        return None
    along_u = make_interp_spline(u, points.reshape(nu, len(v), 3), k=3, axis=0)
    along_v = make_interp_spline(v, np.moveaxis(along_u.c, 1, 0), k=3, axis=0)
    surface = BSplineSurface(3, 3, along_u.t, along_v.t, np.ascontiguousarray(np.moveaxis(along_v.c, 0, 1)))
    uu, vv = _grid(np.linspace(0.0, end, 3 * nu + 1), np.linspace(MARGIN, 1.0 - MARGIN, 33))
    frame = Projector.of(surface).evaluate(uu, vv)
    on_half = (uu <= 1.0) | (uu >= 1.0 + STRIP)
    if np.linalg.norm(frame[:, 0] - shape(uu, vv), axis=1)[on_half].max() > SURFACE_ERROR:
        return None
    area = np.cross(frame[:, 1], frame[:, 2])
    steady = np.sum(area * np.roll(area.reshape(3 * nu + 1, -1, 3), 1, axis=0).reshape(-1, 3), axis=1)
    if np.any(steady.reshape(3 * nu + 1, -1)[1:] <= 0.0):
        return None

    def first_axis(t: Array) -> tuple[Array, Array]:
        return first.motion.axis(PATCH[0] + length * t)

    def second_axis(t: Array) -> tuple[Array, Array]:
        p, d = second.motion.axis(PATCH[0] + length * t)
        return moved(p), d @ rotation.T

    uu, vv = _grid(np.linspace(0.0, end, 61), np.linspace(MARGIN, 1.0 - MARGIN, 9))
    sampled = Projector.of(surface).evaluate(uu, vv)[:, 0]
    for axis in (first_axis, second_axis):
        if swept_gap(tool, axis, sampled, 161)[0].min() < -LARGEST_OVERCUT:
            return None
    return JoinedFace(tool, surface, first.sense, ((0.0, 1.0), (1.0 + STRIP, end)))


def _grid(u: Array, v: Array) -> tuple[Array, Array]:
    """Tensor grid, flattened."""
    uu, vv = np.meshgrid(u, v, indexing="ij")
    return uu.ravel(), vv.ravel()
