"""From an ordered sequence of lines to a motion: the cubic ruled surface through them."""

from __future__ import annotations

from bisect import bisect_left
from functools import cache
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.interpolate import BSpline

from conflank_cli.detection.settling import Contact
from conflank_cli.geometry.normal_equations import NormalEquations, basis_at
from conflank_cli.limits import Limits
from conflank_cli.motion import DEGREE, Motion, uniform_knots

Array = npt.NDArray[np.float64]

# The fewest control points are taken with which the motion is no further from its lines, along the surface normal,
# than this share of the tighter tolerance at all but STRAY of the spheres: the lines are refined one by one, and where
# a different part of the flute begins to fit they jump.
SHARE, STRAY = 0.5, 0.02
FEWEST, MOST = 6, 32
# At least so many lines to a control point, unless rigidity asks for more: the scatter of lines is not to be followed.
LINES_EACH = 2
# |pq| keeps to the flute's length within this, mm.
RIGID = 1e-3
# Weights against the contact's, which is 1 for a line that fits along its whole flute. Along the surface a line may lie
# anywhere: there it holds the motion only loosely, and third derivatives are held down. Rigidity is a condition.
ALONG, FAIR, STIFF = 1e-3, 1e-4, 1e5
# Rounds in which rigidity is asked for about the directions that the round before has led to, between lines as well.
ROUNDS = 8


class _Basis(NamedTuple):
    """Cubic B-splines at times (K,): the first control point that acts (K,) and the values of four (K, 4)."""

    t: Array
    first: npt.NDArray[np.int64]
    values: Array

    @classmethod
    def at(cls, t: Array, count: int) -> _Basis:
        """`count` control points on uniform knots."""
        return cls(t, *basis_at(uniform_knots(count), t)[:2])

    def __matmul__(self, control: Array) -> Array:
        around = control[self.first[:, None] + np.arange(DEGREE + 1)]
        return np.asarray((self.values[:, :, None] * around).sum(axis=1))


@cache
def _dense(count: int) -> _Basis:
    """Six times in each knot span and the end."""
    return _Basis.at(np.linspace(0.0, 1.0, 6 * (count - DEGREE) + 1), count)


@cache
def _third_derivatives(count: int) -> Array:
    """Products (n, n) of the third derivatives of the splines, summed over the knot spans (they are constant there)."""
    spans = count - DEGREE
    middles = (np.arange(spans) + 0.5) / spans
    values = BSpline(uniform_knots(count), np.eye(count), DEGREE)(middles, nu=DEGREE) / spans**DEGREE
    return np.asarray(values.T @ values)


def _smooth(equations: NormalEquations, weight: float) -> None:
    """Hold the third derivatives down, with time counted in knot spans."""
    pairs = _third_derivatives(len(equations.right) // 6)
    for k in range(DEGREE + 1):
        below = np.diagonal(pairs, -k)
        equations.band[6 * k, : 6 * len(below)] += weight * np.repeat(below, 6)


def fit_motion(contact: Contact, length: float, limits: Limits) -> Motion:
    """Cubic B-splines p(t), q(t) through lines in order, with as few control points as the tolerance needs.

    Parameters
    ----------
    contact: K >= 4 lines and how they touch the face.
    length: |pq|, mm.
    limits: their tighter tolerance decides how many control points there are.

    What counts is the distance from the lines along the surface normal, at spheres within tolerance; where a line
    stands off the face or beside it, and along the face, the motion may cut corners. t runs with the travel of the
    middle of the axis. |pq| = length within RIGID unless MOST control points do not give it, which takes lines that
    turn back and forth from one to the next.

    Source: Piegl and Tiller, The NURBS Book (1997), section 9.4 (weighted least squares).
    """
    p, d = contact.p, contact.d
    ends = np.hstack([p, p + length * d])
    middle = p + 0.5 * length * d
    travel = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(middle, axis=0), axis=1))])
    t = travel / travel[-1]
    # What a sphere moves by along its normal, of what p and q move by.
    s = contact.heights[:, None] / length
    rows = np.concatenate([(1.0 - s) * contact.normal, s * contact.normal], axis=2)
    aims = (rows * ends[:, None, :]).sum(axis=2)
    weights = contact.weight / len(s)
    within = (contact.on > 0.5) & (contact.error >= -limits.over) & (contact.error <= limits.under)
    close = SHARE * min(limits.over, limits.under)

    def through(count: int, rounds: int) -> Array:
        """The fit with so many control points, rigid after enough rounds."""
        dense = _dense(count)
        between = np.stack([np.interp(dense.t, t, ends[:, k]) for k in range(6)], axis=1)
        equations = NormalEquations.of(count)
        lines = _Basis.at(t, count)
        # The control points themselves are solved for, so residuals are those of all at zero: minus what is aimed at.
        equations.add(lines.first, lines.values, rows, -aims, weights)
        each = np.full(between.shape, ALONG * len(t) / len(dense.t))
        equations.add(dense.first, dense.values, np.tile(np.eye(6), (len(dense.t), 1, 1)), -between, each)
        _smooth(equations, FAIR)
        control = _rigid(equations, dense, between, length)
        for _ in range(rounds):
            axes = dense @ control
            if _stretched(axes, length) <= RIGID:
                break
            control = _rigid(equations, dense, axes, length)
        return control

    def is_close(count: int) -> bool:
        offset = _Basis.at(t, count) @ through(count, 0)
        away = np.abs((rows * offset[:, None, :]).sum(axis=2) - aims)[within]
        return bool(np.count_nonzero(away > close) <= STRAY * away.size)

    most = max(min(MOST, len(p) // LINES_EACH + DEGREE, len(p) - 1), DEGREE + 1)
    counts = range(min(FEWEST, most), most)
    count = (*counts, most)[bisect_left(counts, True, key=is_close)]
    control = through(count, ROUNDS)
    while _stretched(_dense(count) @ control, length) > RIGID and count < MOST:
        count = min(count + count // 4, MOST)
        control = through(count, ROUNDS)
    return Motion(uniform_knots(count), np.ascontiguousarray(control[:, :3]), np.ascontiguousarray(control[:, 3:]))


def _rigid(contacts: NormalEquations, basis: _Basis, ends: Array, length: float) -> Array:
    """Control points (n, 6) of the fit with <q - p, d> = length, d being the directions of axes with ends (K, 6)."""
    axes = ends[:, 3:] - ends[:, :3]
    axes /= np.linalg.norm(axes, axis=1)[:, None]
    equations = contacts.copy()
    shape = (len(axes), 1)
    equations.add(
        basis.first,
        basis.values,
        np.hstack([-axes, axes])[:, None, :],
        np.full(shape, -length),
        np.full(shape, STIFF / len(axes)),
    )
    return equations.step()


def _stretched(ends: Array, length: float) -> float:
    """How far the length of an axis is off at most, mm."""
    return float(np.abs(np.linalg.norm(ends[:, 3:] - ends[:, :3], axis=1) - length).max())
