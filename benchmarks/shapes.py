"""Surfaces made from numbers: the material of kernel tests and benchmarks."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from conflank_cli.geometry.surface import BSplineSurface

Array = npt.NDArray[np.float64]


def clamped_knots(degree: int, spans: int, low: float = 0.0, high: float = 1.0) -> Array:
    """Clamped uniform knot vector with `spans` spans on [low, high], shape (spans + 2 degree + 1,)."""
    return np.concatenate([np.full(degree, low), np.linspace(low, high, spans + 1), np.full(degree, high)])


def greville(knots: Array, degree: int) -> Array:
    """Greville abscissae: where each control point sits in parameter space, shape (len(knots) - degree - 1,)."""
    count = len(knots) - degree - 1
    return np.array([knots[k + 1 : k + degree + 1].mean() for k in range(count)])


def smooth_surface(
    rng: np.random.Generator,
    degrees: tuple[int, int] = (3, 3),
    spans: tuple[int, int] = (5, 3),
    *,
    rational: bool = False,
    knots: tuple[Array, Array] | None = None,
    size: tuple[float, float] = (60.0, 30.0),
    bulge: float = 4.0,
) -> BSplineSurface:
    """A blade-sized, gently doubly curved surface with a random smooth height and random weights.

    Parameters
    ----------
    rng: source of the shape.
    degrees, spans: per direction; `knots` overrides `spans`.
    rational: weights between 0.7 and 1.4.
    size: extent along u and v, mm.
    bulge: height of each of the low waves that make the shape, mm.
    """
    ku, kv = knots or (clamped_knots(degrees[0], spans[0]), clamped_knots(degrees[1], spans[1]))
    fu, fv = greville(ku, degrees[0]), greville(kv, degrees[1])
    fu = (fu - ku[0]) / (ku[-1] - ku[0])
    fv = (fv - kv[0]) / (kv[-1] - kv[0])
    x, y = np.meshgrid(fu, fv, indexing="ij")
    z = np.zeros_like(x)
    for m in range(3):
        for n in range(3):
            phase, amount = rng.uniform(0.0, 2.0 * np.pi), rng.normal() * bulge / (1.0 + m * m + n * n)
            z += amount * np.cos(np.pi * (m * x + n * y) / 2.0 + phase)
    shear = rng.uniform(-0.3, 0.3)
    poles = np.stack([size[0] * (x + shear * y), size[1] * (y + 0.1 * np.sin(2.0 * x)), z], axis=-1)
    weights = np.exp(rng.uniform(np.log(0.7), np.log(1.4), x.shape)) if rational else None
    return BSplineSurface(degrees[0], degrees[1], ku, kv, np.ascontiguousarray(poles), weights)


def moved(surface: BSplineSurface, rotation: Array, shift: Array) -> BSplineSurface:
    """The surface after x -> rotation x + shift."""
    poles = np.ascontiguousarray(surface.poles @ rotation.T + shift)
    return BSplineSurface(surface.degree_u, surface.degree_v, surface.knots_u, surface.knots_v, poles, surface.weights)
