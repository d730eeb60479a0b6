"""Tensor-product B-spline surfaces, polynomial or rational, as per-span polynomial coefficients."""

from __future__ import annotations

from dataclasses import dataclass
from math import factorial
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class BSplineSurface:
    """A clamped, non-periodic B-spline surface S(u, v).

    Attributes
    ----------
    degree_u, degree_v: polynomial degrees, at least 1.
    knots_u, knots_v: full knot vectors with repetitions, shapes (nu + degree_u + 1,) and (nv + degree_v + 1,).
    poles: control points in mm, shape (nu, nv, 3).
    weights: positive weights, shape (nu, nv), or None where the surface is polynomial.
    """

    degree_u: int
    degree_v: int
    knots_u: Array
    knots_v: Array
    poles: Array
    weights: Array | None = None

    @property
    def domain(self) -> tuple[float, float, float, float]:
        """Parameter box (u0, u1, v0, v1)."""
        return (
            float(self.knots_u[self.degree_u]),
            float(self.knots_u[-self.degree_u - 1]),
            float(self.knots_v[self.degree_v]),
            float(self.knots_v[-self.degree_v - 1]),
        )


class Spans(NamedTuple):
    """A surface as polynomials, one block per knot span: what the kernels read.

    breaks_u (ku + 1,), breaks_v (kv + 1,): distinct knots.
    coefficients (ku, kv, m, n, 4): power basis in the span's local parameters a, b in [0, 1], at least cubic, so that
    m = max(pu, 3) + 1 and n = max(pv, 3) + 1; homogeneous coordinates (w x, w y, w z, w), or (x, y, z, 0) where the
    surface is polynomial.
    box (4,): u0, u1, v0, v1 of the surface proper; spans outside it are the smooth extension.
    """

    breaks_u: Array
    breaks_v: Array
    coefficients: Array
    box: Array


def _taylor_rows(knots: Array, degree: int, values: Array, breaks: Array) -> Array:
    """Taylor coefficients at the left end of each span, scaled to a local parameter in [0, 1].

    values (n, ...) are the B-spline coefficients; returns (spans, degree + 1, ...).
    """
    # Here, for the process that reads CAD files makes surfaces, and has no other use for SciPy, slow to import.
    from scipy.interpolate import BSpline

    spline = BSpline(knots, values, degree)
    width = np.diff(breaks)
    rows = np.empty((len(width), degree + 1, *values.shape[1:]))
    for order in range(degree + 1):
        scale = (width**order / factorial(order)).reshape(-1, *([1] * (values.ndim - 1)))
        # BSpline evaluates from the right at a knot, so the left end of a span sees its own polynomial.
        rows[:, order] = spline(breaks[:-1], nu=order) * scale
    return rows


def _extend(rows: Array, breaks: Array, before: float, after: float) -> tuple[Array, Array]:
    """Add one quadratic span at either end, continuing value, slope and curvature (the border span's Taylor terms)."""
    degree = rows.shape[1] - 1
    width = np.diff(breaks)
    parts, ends = [rows], [breaks]
    if before > 0.0:
        block = np.zeros_like(rows[:1])
        ratio = before / width[0]
        order2 = [rows[0, m] * ratio**m if m <= degree else np.zeros_like(rows[0, 0]) for m in range(3)]
        # Taylor about the far end of the new span, from f(x) = c0 + c1 (x - 1) + c2 (x - 1)^2 on x in [0, 1].
        taylor = [order2[0] - order2[1] + order2[2], order2[1] - 2.0 * order2[2], order2[2]]
        for m in range(min(degree, 2) + 1):
            block[0, m] = taylor[m]
        parts.insert(0, block)
        ends.insert(0, breaks[:1] - before)
    if after > 0.0:
        block = np.zeros_like(rows[:1])
        ratio = after / width[-1]
        last = rows[-1]
        for m in range(min(degree, 2) + 1):
            moment = sum(last[k] * factorial(k) / (factorial(m) * factorial(k - m)) for k in range(m, degree + 1))
            block[0, m] = moment * ratio**m
        parts.append(block)
        ends.append(breaks[-1:] + after)
    return np.concatenate(parts), np.concatenate(ends)


def to_spans(surface: BSplineSurface, extension: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)) -> Spans:
    """Convert to per-span polynomial coefficients, optionally with a smooth extension past the natural boundary.

    Parameters
    ----------
    surface: the surface.
    extension: parameter lengths to add before u0, after u1, before v0, after v1. The added spans continue value, slope
        and curvature across the boundary. They exist for the sake of motion (a cutter overhangs the face), never for
        the sake of error.

    Source: Piegl and Tiller, The NURBS Book (1997), section 2.5 (derivatives of B-splines); Taylor expansion per span.
    """
    values = surface.poles
    if surface.weights is not None:
        weights = surface.weights[..., None]
        values = np.concatenate([surface.poles * weights, weights], axis=2)
    u0, u1, v0, v1 = surface.domain
    breaks_u = np.unique(surface.knots_u[(surface.knots_u >= u0) & (surface.knots_u <= u1)])
    breaks_v = np.unique(surface.knots_v[(surface.knots_v >= v0) & (surface.knots_v <= v1)])
    rows = _taylor_rows(surface.knots_u, surface.degree_u, values, breaks_u)
    rows, breaks_u = _extend(rows, breaks_u, extension[0], extension[1])
    # (ku, pu+1, nv, D) -> along v: (kv, pv+1, ku, pu+1, D)
    columns = _taylor_rows(surface.knots_v, surface.degree_v, np.moveaxis(rows, 2, 0), breaks_v)
    columns, breaks_v = _extend(columns, breaks_v, extension[2], extension[3])
    blocks = columns.transpose(2, 0, 3, 1, 4)
    # Up to the third degree there is nothing to be won by fewer coefficients: the kernels know cubics best.
    coefficients = np.zeros((*blocks.shape[:2], *np.maximum(blocks.shape[2:4], 4), 4))
    coefficients[:, :, : blocks.shape[2], : blocks.shape[3], : blocks.shape[4]] = blocks
    return Spans(breaks_u, breaks_v, coefficients, np.array([u0, u1, v0, v1]))
