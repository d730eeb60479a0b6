"""The rigid motion of a tool axis: two cubic B-splines that trace its ends."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.interpolate import BSpline, make_lsq_spline

Array = npt.NDArray[np.float64]
DEGREE = 3


def uniform_knots(count: int) -> Array:
    """Clamped uniform knot vector on [0, 1] for `count` cubic control points, shape (count + 4,)."""
    return np.concatenate([np.zeros(DEGREE), np.linspace(0.0, 1.0, count - DEGREE + 1), np.ones(DEGREE)])


@dataclass(frozen=True, slots=True)
class Motion:
    """The ruled surface R(t, s) = (1 - s) p(t) + s q(t) of an axis in motion, t in [0, 1].

    Attributes
    ----------
    knots: clamped cubic knot vector, shape (n + 4,).
    p: control points of the axis end in the plane of r_min, shape (n, 3), mm.
    q: control points of the axis end in the plane of r_max, shape (n, 3), mm.
    """

    knots: Array
    p: Array
    q: Array

    @property
    def spline(self) -> BSpline:
        """p(t) and q(t) side by side; made without SciPy's checks, which take longer than an evaluation."""
        return BSpline.construct_fast(self.knots, np.hstack([self.p, self.q]), DEGREE)

    def ends(self, t: npt.ArrayLike, order: int = 0) -> tuple[Array, Array]:
        """Points p(t) and q(t), or their derivatives of the given order, each shape (len(t), 3)."""
        both = self.spline(np.asarray(t, dtype=np.float64), nu=order)
        return np.ascontiguousarray(both[..., :3]), np.ascontiguousarray(both[..., 3:])

    def restricted(self, start: float, end: float) -> Motion:
        """The same motion between two times, as a motion on [0, 1]: exact, by knot insertion."""
        spline = self.spline
        for t in (start, end):
            if 0.0 < t < 1.0:
                present = int(np.sum(spline.t == t))
                if present < DEGREE:
                    spline = spline.insert_knot(t, DEGREE - present)
        first = int(np.searchsorted(spline.t, start, side="right")) - DEGREE - 1
        last = int(np.searchsorted(spline.t, end, side="left"))
        inner = spline.t[(spline.t > start) & (spline.t < end)]
        knots = np.concatenate([np.full(DEGREE + 1, start), inner, np.full(DEGREE + 1, end)])
        control = spline.c[first:last]
        scaled = (knots - start) / (end - start)
        return Motion(scaled, np.ascontiguousarray(control[:, :3]), np.ascontiguousarray(control[:, 3:]))

    def respaced(self, count: int) -> Motion:
        """The nearest motion with `count` control points on uniform knots, by least squares."""
        t = np.linspace(0.0, 1.0, 8 * count)
        return fitted(t, np.hstack(self.ends(t)), count)


def fitted(t: Array, ends: Array, count: int) -> Motion:
    """Least-squares motion with `count` control points, uniform knots, through ends (K, 6), p then q, at t (K,)."""
    knots = uniform_knots(count)
    control = make_lsq_spline(t, ends, knots, DEGREE).c
    return Motion(knots, np.ascontiguousarray(control[:, :3]), np.ascontiguousarray(control[:, 3:]))
