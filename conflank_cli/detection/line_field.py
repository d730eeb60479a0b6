"""The line field: at a contact point, the axes along which the distance to the face grows linearly to second order."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
import numpy.typing as npt

from conflank_cli.geometry.workface import WorkFace
from conflank_cli.tool import Tool

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
Directions = Callable[[Array, Array], Iterator[tuple[Array, Mask, Array]]]

# Angle between lines that are tried where the bend leaves room to turn.
TURN = np.radians(15.0)
# Sine of the angle below which a direction counts as principal: rounding.
PRINCIPAL = 1e-9


@dataclass(frozen=True, slots=True)
class SeedLines:
    """Candidate axes.

    Attributes
    ----------
    p: points on the axes in the plane of r_min, shape (N, 3), mm.
    d: unit directions tip to spindle, shape (N, 3).
    uv: parameters of the contact points, shape (N, 2).
    height: height on the axis of the sphere that touches there, shape (N,), mm.
    sample: index of the contact point each came from, shape (N,).
    curvature: |second derivative of the distance along the axis| that is left, shape (N,), 1/mm; 0 where the offset
        surface is saddle shaped.
    """

    p: Array
    d: Array
    uv: Array
    height: Array
    sample: npt.NDArray[np.int64]
    curvature: Array


def seed_lines(face: WorkFace, tool: Tool, uv: Array, heights: Array, allowance: float = 0.0) -> SeedLines:
    """Lines through contact points by the second-order condition.

    Parameters
    ----------
    face: the face.
    tool: the cutter.
    uv: contact parameters, shape (N, 2).
    heights: heights of sphere centres on the axis to try at every contact, shape (H,), mm.
    allowance: stock to leave, mm.

    With unit normal n towards the cutter and curvatures κ signed positive where the face bends towards n, the distance
    to the face at offset ρ has the Hessian Σ -κ_i / (1 - ρ κ_i) e_i e_iᵀ. An axis on which the distance grows with
    slope sin α has ⟨d, n⟩ = sin α, and its tangential part w makes wᵀ H w vanish: two lines where H is indefinite, of
    either orientation. Where H is definite the direction of least curvature is the best there is.
    Where 1 - ρ κ <= 0 the sphere does not fit, and no line is returned.

    Source: do Carmo, Differential Geometry of Curves and Surfaces (1976), section 3-2 (asymptotic directions); Bo,
    Bartoň, Pottmann (2017), section 3.
    """
    return _lines(face, tool, uv, heights, allowance, _asymptotic)


def turned_lines(
    face: WorkFace, tool: Tool, uv: Array, heights: Array, bend: Array, allowance: float = 0.0
) -> SeedLines:
    """Lines on either side of those of `seed_lines`, about `TURN` apart, on which the distance bends by little.

    Parameters as there, and

    bend: |wᵀ H w| that is let pass at each contact, shape (N,), 1/mm. Where it leaves no room to turn there is no line.
    """
    return _lines(face, tool, uv, heights, allowance, partial(_turned, bend))


def _lines(
    face: WorkFace, tool: Tool, uv: Array, heights: Array, allowance: float, directions: Directions
) -> SeedLines:
    """Lines whose tangential parts are at the angles that `directions` yields for both eigenvalues of H."""
    frame = face.projector.evaluate(uv[:, 0], uv[:, 1])
    su, sv = frame[:, 1], frame[:, 2]
    normal = np.cross(su, sv)
    normal *= (face.sense / np.linalg.norm(normal, axis=1))[:, None]
    t1 = su / np.linalg.norm(su, axis=1)[:, None]
    t2 = np.cross(normal, t1)
    # Second fundamental form in the orthonormal basis t1, t2: B = J^-T (second derivatives . n) J^-1.
    jacobian = np.stack(
        [
            np.stack([np.einsum("ni,ni->n", su, t1), np.einsum("ni,ni->n", sv, t1)], axis=1),
            np.stack([np.einsum("ni,ni->n", su, t2), np.einsum("ni,ni->n", sv, t2)], axis=1),
        ],
        axis=1,
    )
    second = np.einsum("nki,ni->nk", frame[:, 3:], normal)
    form = np.stack([second[:, [0, 1]], second[:, [1, 2]]], axis=1)
    inverse = np.linalg.inv(jacobian)
    curvature, vectors = np.linalg.eigh(np.swapaxes(inverse, 1, 2) @ form @ inverse)
    e1 = vectors[:, 0, 0, None] * t1 + vectors[:, 1, 0, None] * t2
    e2 = vectors[:, 0, 1, None] * t1 + vectors[:, 1, 1, None] * t2

    sine = np.sin(tool.half_angle)
    cosine = np.cos(tool.half_angle)
    parts: list[tuple[Array, Array, Array, npt.NDArray[np.int64], Array]] = []
    for height in heights:
        radius = float(tool.sphere_radius(height)) + allowance
        room = 1.0 - radius * curvature
        fits = np.all(room > 0.02, axis=1)
        hessian = -curvature / np.where(room > 0.02, room, 1.0)
        for angle, use, left in directions(hessian[:, 0], hessian[:, 1]):
            use = use & fits
            along = np.cos(angle)[:, None] * e1 + np.sin(angle)[:, None] * e2
            for orientation in (1.0, -1.0):
                d = sine * normal + cosine * orientation * along
                p = frame[:, 0] + radius * normal - height * d
                parts.append(
                    (p[use], d[use], np.full(int(use.sum()), height), np.flatnonzero(use), cosine**2 * left[use])
                )
    p, d, height, sample, left = (np.concatenate([part[k] for part in parts]) for k in range(5))
    return SeedLines(p, d, uv[sample], height, sample, left)


def _asymptotic(first: Array, second: Array) -> Iterator[tuple[Array, Mask, Array]]:
    """Angles φ (N,) where wᵀ H w is least, which of them are new lines, and |wᵀ H w|, for w = cos φ e1 + sin φ e2."""
    saddle = first * second < 0.0
    angle = np.where(saddle, np.arctan(np.sqrt(np.abs(first / np.where(second == 0.0, 1.0, second)))), 0.0)
    angle = np.where(~saddle & (np.abs(second) < np.abs(first)), np.pi / 2, angle)
    left = np.where(saddle, 0.0, np.minimum(np.abs(first), np.abs(second)))
    yield angle, np.ones_like(saddle), left
    # Without a saddle both signs are the same line.
    yield -angle, saddle, left


def _turned(bend: Array, first: Array, second: Array) -> Iterator[tuple[Array, Mask, Array]]:
    """The same for angles away from those of `_asymptotic`, up to where |wᵀ H w| is `bend` (N,).

    It is first cos² φ + second sin² φ = m + r cos 2φ, so that happens at cos 2φ = (±bend - m) / r. Where even the least
    is more than `bend`, that angle is the least one's again.
    """
    middle, _, _ = next(_asymptotic(first, second))
    mean, half = 0.5 * (first + second), 0.5 * (first - second)
    # Equal curvatures: every direction is like any other, and all are within `bend` or none.
    half = np.where(half == 0.0, np.finfo(float).tiny, half)
    for sign in (1.0, -1.0):
        with np.errstate(over="ignore"):
            end = 0.5 * np.arccos(np.clip((sign * bend - mean) / half, -1.0, 1.0))
        count = np.floor(np.abs(end - middle) / TURN + 0.5)
        for k in range(1, max(int(count.max()), 1) + 1):
            angle = middle + (end - middle) * k / np.maximum(count, 1.0)
            left = np.abs(mean + half * np.cos(2.0 * angle))
            yield angle, count >= k, left
            # Along a principal direction both signs are the same line.
            yield -angle, (count >= k) & (np.abs(np.sin(2.0 * angle)) > PRINCIPAL), left
