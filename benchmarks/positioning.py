"""Two positioning methods for ruled faces: a tool that touches both guide rails, and one that touches a ruling as well.

Both know a face by two guide rails, the lines between which the rulings run. A tool that touches two points, one on
each rail, and is tangent to the rails there leaves less than one that is laid along a ruling (`ruling_following`),
since the twist of the face is shared out between both ends. Where the two points may slide along their rails, the tool
can be made tangent in a third point, on the ruling in between: the triple tangent position.

Sources: S. Bedi, S. Mann, C. Menzel, *Flank milling with flat end milling cutters*, Computer-Aided Design 35 (2003);
C. Menzel, S. Bedi, S. Mann, *Triple tangent flank milling of ruled surfaces*, Computer-Aided Design 36 (2004). Both are
for cylinders; what follows from the same conditions for a cone is below.

A tool touches a line x with unit normal n (towards the tool, across the line) if the centre of one of its inscribed
spheres, at height h of the axis (p, d), is c = p + h d = x + ρ(h) n, with <d, n> = sin α. Along a cone there is one
freedom more than along a cylinder, the height at which the lower rail is touched, which is given. With D = c₂ - c₁ and
H = h₂ - h₁ two contacts ask for

    |D| = H ,   <D, n₁> = H sin α ,   <D, n₂> = H sin α ,

three equations for h₂ and the angles of n₁ and n₂ about their rails. A third contact, with the ruling, has
c₃ - c₁ = (h₃ - h₁) D / H and <D, n₃> = H sin α: four more, for its place on the ruling, the angle of n₃ about it, h₃,
and how far the first two have slid, one forward along its rail and the other as far back. (Were the slides free, and n₃
the normal of the face, a third contact that coincides with one of the others would do.)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import sin

import numpy as np
import numpy.typing as npt

from benchmarks.ruling_following import SPACING, Band
from conflank_cli.geometry.workface import WorkFace
from conflank_cli.motion import Motion, fitted
from conflank_cli.tool import Tool

Array = npt.NDArray[np.float64]
Residuals = Callable[[Array], Array]

LINES = 60  # positions along a band
ITERATIONS = 60
SOLVED = 1e-9  # mm
STEP = 1e-6  # of finite differences; unknowns are of the order of one, or mm
DAMPING = 1e-3  # at first


@dataclass(frozen=True, slots=True)
class Rails:
    """The guide rails of a band: lines of constant parameter, the lower one at the tip."""

    face: WorkFace
    band: Band

    @property
    def places(self) -> Array:
        """Where along the rails positions are asked for, (LINES,), as parameter of the face."""
        u0, u1, v0, v1 = self.band.box
        return np.linspace(u0, u1, LINES) if self.band.across == "u" else np.linspace(v0, v1, LINES)

    def at(self, along: Array, upper: bool) -> tuple[Array, Array, Array]:
        """Points, derivatives by the rail's parameter and unit normals of the face, each (M, 3)."""
        u0, u1, v0, v1 = self.band.box
        low, high = (v0, v1) if self.band.across == "u" else (u0, u1)
        other = np.full(len(along), high if upper == self.band.up else low)
        u, v = (along, other) if self.band.across == "u" else (other, along)
        frame = self.face.projector.evaluate(u, v)
        normal = self.face.sense * _unit(np.cross(frame[:, 1], frame[:, 2]))
        return frame[:, 0], frame[:, 1 if self.band.across == "u" else 2], normal

    def height(self) -> float:
        """Mean length of the rulings, mm."""
        low, high = (self.at(self.places, upper)[0] for upper in (False, True))
        return float(np.linalg.norm(high - low, axis=1).mean())


def two_points(face: WorkFace, tool: Tool, band: Band) -> Motion:
    """The motion whose tool touches both rails at the ends of each ruling, the ruling in the middle of the flute."""
    rails = Rails(face, band)
    along = rails.places
    return _motion(rails, tool, along, along, _two_contacts(rails, tool, along))


def three_points(face: WorkFace, tool: Tool, band: Band) -> Motion:
    """The motion whose tool touches both rails as far before a ruling as behind it, and in between the ruling."""
    rails = Rails(face, band)
    along = rails.places
    start = _two_contacts(rails, tool, along)
    (low, low_tangent, low_normal), (high, high_tangent, high_normal) = (rails.at(along, k) for k in (False, True))
    first = _first_height(rails, tool)
    ruling = _unit(high - low)
    normal = low_normal + high_normal
    normal = _unit(normal - np.einsum("ni,ni->n", normal, ruling)[:, None] * ruling)
    aside = np.cross(ruling, normal)
    by_mm = [1.0 / np.linalg.norm(tangent, axis=1) for tangent in (low_tangent, high_tangent)]

    def places(x: Array) -> tuple[Array, Array]:
        return along + by_mm[0] * x[:, 3], along - by_mm[1] * x[:, 3]

    def residuals(x: Array) -> Array:
        """Unknowns: both angles and h₂ as for two points; the slide, mm; share and angle on the ruling; h₃."""
        c1, c2, n1, n2 = _contacts(rails, tool, first, *places(x), x)
        share = x[:, 4, None]
        n3 = np.cos(x[:, 5])[:, None] * normal + np.sin(x[:, 5])[:, None] * aside
        c3 = (1.0 - share) * low + share * high + tool.sphere_radius(x[:, 6])[:, None] * n3
        d, rise = c2 - c1, x[:, 2] - first
        on_axis = c3 - c1 - ((x[:, 6] - first) / rise)[:, None] * d
        third = np.einsum("ni,ni->n", d, n3) - sin(tool.half_angle) * rise
        return np.column_stack([_two_conditions(d, n1, n2, rise, tool.half_angle), on_axis, third])

    zero = np.zeros(len(along))
    x = _solved(residuals, np.column_stack([start, zero, zero + 0.5, zero, 0.5 * (first + start[:, 2])]))
    return _motion(rails, tool, *places(x), x)


def _first_height(rails: Rails, tool: Tool) -> float:
    """Height of the sphere that touches the lower rail, mm: the ruling lies in the middle of the flute."""
    low, high = tool.centre_range
    return 0.5 * (low + high - min(rails.height(), high - low))


def _two_contacts(rails: Rails, tool: Tool, along: Array) -> Array:
    """Angles about the lower and the upper rail and the height h₂ of two contacts, (M, 3)."""
    first = _first_height(rails, tool)

    def residuals(x: Array) -> Array:
        c1, c2, n1, n2 = _contacts(rails, tool, first, along, along, x)
        return _two_conditions(c2 - c1, n1, n2, x[:, 2] - first, tool.half_angle)

    rulings = rails.at(along, True)[0] - rails.at(along, False)[0]
    length = np.linalg.norm(rulings, axis=1)
    return _solved(residuals, np.column_stack([np.zeros((len(along), 2)), first + length]))


def _two_conditions(d: Array, n1: Array, n2: Array, rise: Array, alpha: float) -> Array:
    return np.column_stack(
        [np.linalg.norm(d, axis=1) - rise, *(np.einsum("ni,ni->n", d, n) - sin(alpha) * rise for n in (n1, n2))]
    )


def _contacts(
    rails: Rails, tool: Tool, first: float, low: Array, high: Array, x: Array
) -> tuple[Array, Array, Array, Array]:
    """Sphere centres and normals of the contacts with both rails; `first`: height of the sphere on the lower one."""
    lower = np.full(len(x), first)
    centres, normals = [], []
    for along, upper, angle, height in ((low, False, x[:, 0], lower), (high, True, x[:, 1], x[:, 2])):
        point, tangent, normal = rails.at(along, upper)
        aside = np.cross(_unit(tangent), normal)
        n = np.cos(angle)[:, None] * normal + np.sin(angle)[:, None] * aside
        centres.append(point + tool.sphere_radius(height)[:, None] * n)
        normals.append(n)
    return centres[0], centres[1], normals[0], normals[1]


def _motion(rails: Rails, tool: Tool, low: Array, high: Array, x: Array) -> Motion:
    """The motion through positions that touch the rails at given places."""
    first = _first_height(rails, tool)
    c1, c2, _, _ = _contacts(rails, tool, first, low, high, x)
    d = _unit(c2 - c1)
    p = c1 - first * d
    ends = np.hstack([p, p + tool.length * d])
    travel = _length(0.5 * (ends[:, :3] + ends[:, 3:]))
    return fitted(np.linspace(0.0, 1.0, len(ends)), ends, min(max(round(travel / SPACING) + 3, 6), LINES // 2))


def _solved(residuals: Residuals, x: Array) -> Array:
    """Least squares of each row's residuals by itself, from x (M, K): Levenberg's method, all rows at once."""
    damping = np.full(len(x), DAMPING)
    r = residuals(x)
    for _ in range(ITERATIONS):
        if np.abs(r).max() < SOLVED:
            break
        columns = [(residuals(x + STEP * unit) - r) / STEP for unit in np.eye(x.shape[1])]
        jacobian = np.stack(columns, axis=2)
        matrix = np.einsum("nij,nik->njk", jacobian, jacobian) + damping[:, None, None] * np.eye(x.shape[1])
        step = -np.linalg.solve(matrix, np.einsum("nij,ni->nj", jacobian, r)[..., None])[..., 0]
        tried = residuals(x + step)
        better = (tried**2).sum(axis=1) < (r**2).sum(axis=1)
        x, r = np.where(better[:, None], x + step, x), np.where(better[:, None], tried, r)
        damping = np.clip(np.where(better, 0.1 * damping, 10.0 * damping), 1e-12, 1e6)
    return x


def _length(points: Array) -> float:
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1)[:, None])
