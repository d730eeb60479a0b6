"""Points of B-spline surfaces by SciPy, independently of the project's own kernels, and which points a trim holds."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.interpolate import BSpline, NdBSpline

from conflank_cli.geometry.surface import BSplineSurface

Array = npt.NDArray[np.float64]


def _homogeneous(surface: BSplineSurface) -> Array:
    if surface.weights is None:
        return surface.poles
    return np.concatenate([surface.poles * surface.weights[..., None], surface.weights[..., None]], axis=2)


def _cartesian(value: Array, by_u: Array, by_v: Array) -> tuple[Array, Array, Array]:
    """Quotient rule where there is a fourth, homogeneous coordinate."""
    if value.shape[-1] == 3:
        return value, by_u, by_v
    weight = value[..., 3:]
    point = value[..., :3] / weight
    return (
        point,
        (by_u[..., :3] - point * by_u[..., 3:]) / weight,
        (by_v[..., :3] - point * by_v[..., 3:]) / weight,
    )


def evaluate_grid(surface: BSplineSurface, u: Array, v: Array) -> tuple[Array, Array, Array]:
    """S, S_u and S_v on the grid u x v, each (len(u), len(v), 3)."""
    spline = BSpline(surface.knots_u, _homogeneous(surface), surface.degree_u)

    def at(order_u: int, order_v: int) -> Array:
        columns = np.moveaxis(spline(u, nu=order_u), 1, 0)
        rows = BSpline(surface.knots_v, columns, surface.degree_v)(v, nu=order_v)
        return np.ascontiguousarray(np.moveaxis(rows, 0, 1))

    return _cartesian(at(0, 0), at(1, 0), at(0, 1))


def evaluate_points(surface: BSplineSurface, uv: Array) -> tuple[Array, Array, Array]:
    """S, S_u and S_v at parameter points (N, 2), each (N, 3)."""
    u0, u1, v0, v1 = surface.domain
    inside = np.clip(uv, [u0, v0], [u1, v1])
    spline = NdBSpline((surface.knots_u, surface.knots_v), _homogeneous(surface), (surface.degree_u, surface.degree_v))
    return _cartesian(*(np.asarray(spline(inside, nu=order)) for order in ((0, 0), (1, 0), (0, 1))))


def points_of(surface: BSplineSurface, uv: Array) -> Array:
    """S alone at parameter points (N, 2): (N, 3)."""
    if not len(uv):
        return np.zeros((0, 3))
    u0, u1, v0, v1 = surface.domain
    spline = NdBSpline((surface.knots_u, surface.knots_v), _homogeneous(surface), (surface.degree_u, surface.degree_v))
    value = np.asarray(spline(np.clip(uv, [u0, v0], [u1, v1])))
    return value if surface.weights is None else np.ascontiguousarray(value[:, :3] / value[:, 3:])


def inside_rows(loops: tuple[Array, ...], u: Array, v: Array) -> npt.NDArray[np.bool_]:
    """Even-odd rule on the grid u x v: (len(u), len(v))."""
    start = np.concatenate([loop for loop in loops])
    end = np.concatenate([np.roll(loop, -1, axis=0) for loop in loops])
    result = np.zeros((len(u), len(v)), dtype=np.bool_)
    for column, value in enumerate(v):
        crosses = (start[:, 1] > value) != (end[:, 1] > value)
        first, last = start[crosses], end[crosses]
        where = first[:, 0] + (value - first[:, 1]) / (last[:, 1] - first[:, 1]) * (last[:, 0] - first[:, 0])
        result[:, column] = np.searchsorted(np.sort(where), u) % 2 == 1
    return result


def inside_loops(loops: tuple[Array, ...], uv: Array, chunk: int = 4_000_000) -> npt.NDArray[np.bool_]:
    """Even-odd rule at points (N, 2): (N,). `chunk` points times stretches of the loops are looked at together."""
    start = np.concatenate([loop for loop in loops])
    end = np.concatenate([np.roll(loop, -1, axis=0) for loop in loops])
    level = end[:, 1] == start[:, 1]
    slope = (end[:, 0] - start[:, 0]) / np.where(level, 1.0, end[:, 1] - start[:, 1])
    result = np.zeros(len(uv), dtype=np.bool_)
    size = max(chunk // len(start), 1)
    for first in range(0, len(uv), size):
        u, v = uv[first : first + size, 0, None], uv[first : first + size, 1, None]
        crosses = (start[:, 1] > v) != (end[:, 1] > v)
        left = start[:, 0] + (v - start[:, 1]) * slope <= u
        result[first : first + size] = (crosses & left).sum(axis=1) % 2 == 1
    return result
