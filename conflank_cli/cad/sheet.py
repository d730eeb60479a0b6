"""Sheets: B-spline surfaces as CAD files have them (periodic, closed, unclamped), and their unwrapping.

Stages want a clamped surface without seam. A sheet keeps the period, so that a range across the seam can be cut out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from conflank_cli.geometry.surface import BSplineSurface

Array = npt.NDArray[np.float64]

# Knots nearer than this share of the parameter range are one knot: writers round them to about 1e-10, and a span that
# short has no geometry in it.
SAME_KNOT = 1.0e-9
# Opposite borders nearer than this are one seam; STEP files promise 1e-5 mm or so.
SEAM_GAP_MM = 1.0e-4
# A seam whose tangent planes agree to about 5 degrees continues the surface; a sharper one is an edge of the face.
SMOOTH_SEAM_COSINE = 0.996
# On a face that closes, the surface handed out overlaps itself by this share of the period on either side.
OVERLAP = 0.05

Box = tuple[float, float, float, float]


@dataclass(frozen=True, slots=True)
class Sheet:
    """A B-spline surface, clamped in each direction that has no period.

    Attributes
    ----------
    degree_u, degree_v: polynomial degrees, at least 1.
    knots_u, knots_v: clamped: full knot vectors. With a period: one period (N + 1,) of the knots for N poles, where
        pole i belongs to the basis function that starts at knot i, and knot i + N is knot i plus the period.
    poles: (nu, nv, 3) mm. weights: (nu, nv) or None.
    period_u, period_v: parameter length after which the surface repeats smoothly, or None.
    """

    degree_u: int
    degree_v: int
    knots_u: Array
    knots_v: Array
    poles: Array
    weights: Array | None = None
    period_u: float | None = None
    period_v: float | None = None

    @property
    def domain(self) -> Box:
        """Parameter box (u0, u1, v0, v1): the natural one, or one period."""
        return float(self.knots_u[0]), float(self.knots_u[-1]), float(self.knots_v[0]), float(self.knots_v[-1])

    def closes(self, box: Box) -> tuple[bool, bool]:
        """Whether a face with this parameter box goes all the way round, in u and in v."""
        return (
            self.period_u is not None and box[1] - box[0] > self.period_u * (1.0 - 1.0e-6),
            self.period_v is not None and box[3] - box[2] > self.period_v * (1.0 - 1.0e-6),
        )

    def unwrapped(self, box: Box) -> BSplineSurface:
        """The clamped surface over at least this parameter box.

        In a direction without period that is the whole sheet: real surface past a trim is better than extrapolation.
        In a direction with one it is one whole period with the box in its middle, so that the seam lies as far away as
        it can; around a box of nearly a whole period there is an overlap of `OVERLAP` periods on either side.
        """
        values = self.poles
        if self.weights is not None:
            values = np.concatenate([self.poles * self.weights[..., None], self.weights[..., None]], axis=2)
        knots_u, knots_v = self.knots_u, self.knots_v
        if self.period_u is not None:
            low, high = _around(box[0], box[1], self.period_u)
            knots_u, values = unwrap(knots_u, self.degree_u, values, low, high)
        if self.period_v is not None:
            low, high = _around(box[2], box[3], self.period_v)
            knots_v, turned = unwrap(knots_v, self.degree_v, values.swapaxes(0, 1), low, high)
            values = turned.swapaxes(0, 1)
        weights = None
        if self.weights is not None:
            weights = np.ascontiguousarray(values[..., 3])
            values = values[..., :3] / weights[..., None]
        return BSplineSurface(self.degree_u, self.degree_v, knots_u, knots_v, np.ascontiguousarray(values), weights)


def _around(low: float, high: float, period: float) -> tuple[float, float]:
    margin = max(OVERLAP * period, 0.5 * (period - (high - low)))
    return low - margin, high + margin


def merge_near_knots(knots: Array) -> Array:
    """Knots nearer than `SAME_KNOT` of the range made equal, so that no span is all rounding."""
    merged = knots.copy()
    gap = SAME_KNOT * (knots[-1] - knots[0])
    for i in range(1, len(merged)):
        if merged[i] - merged[i - 1] <= gap:
            merged[i] = merged[i - 1]
    return merged


def insert_knot(knots: Array, degree: int, values: Array, x: float) -> tuple[Array, Array]:
    """Raise the multiplicity of the knot x by one without changing the spline.

    values (n, ...) are the coefficients. Source: Boehm, "Inserting new knots into B-spline curves", CAD 12 (1980).
    """
    last = int(np.searchsorted(knots, x, side="right")) - 1
    count = int(np.count_nonzero(knots == x))
    index = np.arange(last - degree + 1, last - count + 1)
    share = (x - knots[index]) / (knots[index + degree] - knots[index])
    share = share.reshape(-1, *([1] * (values.ndim - 1)))
    mixed = share * values[index] + (1.0 - share) * values[index - 1]
    # Row `last - count` of the old coefficients turns up in the mix and once more behind it.
    result = np.concatenate([values[: last - degree + 1], mixed, values[last - count :]])
    return np.insert(knots, last + 1, x), result


def clamp(knots: Array, degree: int, values: Array, low: float, high: float) -> tuple[Array, Array]:
    """Cut a spline with full knot vector to [low, high], clamped at both ends."""
    for x in (low, high):
        for _ in range(degree - int(np.count_nonzero(knots == x))):
            knots, values = insert_knot(knots, degree, values, x)
    first = int(np.searchsorted(knots, low, side="right")) - degree
    end = int(np.searchsorted(knots, high, side="left"))
    inner = knots[first : end + degree]
    return np.concatenate([[low], inner, [high]]), np.ascontiguousarray(values[first - 1 : end])


def unwrap(period_knots: Array, degree: int, values: Array, low: float, high: float) -> tuple[Array, Array]:
    """Cut the range [low, high] out of a periodic spline (knots and coefficients as in `Sheet`), clamped."""
    count = len(period_knots) - 1
    period = float(period_knots[-1] - period_knots[0])

    def knot(index: npt.NDArray[np.int64]) -> Array:
        return np.asarray(period_knots[index % count] + period * (index // count))

    turns = int(np.ceil((high - low) / period)) + 2
    start = int(np.floor((low - period_knots[0]) / period)) - 1
    index = np.arange((start - 1) * count - degree, (start + turns + 2) * count + degree + 1)
    knots = knot(index)
    # A border that is a knot but for rounding has to be that very knot.
    for near in knots[np.abs(knots - low) < SAME_KNOT * period][:1]:
        low = float(near)
    for near in knots[np.abs(knots - high) < SAME_KNOT * period][:1]:
        high = float(near)
    knots = np.where(np.abs(knots - low) < SAME_KNOT * period, low, knots)
    knots = np.where(np.abs(knots - high) < SAME_KNOT * period, high, knots)
    first = int(np.searchsorted(knots, low, side="right")) - 1 - degree
    last = int(np.searchsorted(knots, high, side="left")) - 1
    return clamp(knots[first : last + degree + 2], degree, values[index[first : last + 1] % count], low, high)


def close_smooth_seams(sheet: Sheet) -> Sheet:
    """Give a clamped sheet whose opposite borders meet smoothly its period, in either direction."""
    values = sheet.poles
    if sheet.weights is not None:
        values = np.concatenate([sheet.poles, sheet.weights[..., None]], axis=2)
    knots_u, knots_v, period_u, period_v = sheet.knots_u, sheet.knots_v, sheet.period_u, sheet.period_v
    if period_u is None and _meets(values):
        # The first coefficient is the last one; one of the degree + 1 end knots goes with it.
        period_u = float(knots_u[-1] - knots_u[0])
        values, knots_u = values[1:], knots_u[1 : len(values) + 1]
    if period_v is None and _meets(values.swapaxes(0, 1)):
        period_v = float(knots_v[-1] - knots_v[0])
        count = values.shape[1]
        values, knots_v = values[:, 1:], knots_v[1 : count + 1]
    return Sheet(
        sheet.degree_u,
        sheet.degree_v,
        knots_u,
        knots_v,
        np.ascontiguousarray(values[..., :3]),
        np.ascontiguousarray(values[..., 3]) if sheet.weights is not None else None,
        period_u,
        period_v,
    )


def _meets(values: Array) -> bool:
    """Whether the first and last row of control points are one smooth seam; values (n, m, 3), or 4 with weights."""
    if len(values) < 4:
        return False
    first, last = values[0], values[-1]
    if np.any(np.linalg.norm(first[:, :3] - last[:, :3], axis=1) > SEAM_GAP_MM):
        return False
    if values.shape[2] == 4 and np.any(np.abs(first[:, 3] - last[:, 3]) > SAME_KNOT * np.abs(first[:, 3])):
        return False
    leaving = values[1, :, :3] - first[:, :3]
    arriving = last[:, :3] - values[-2, :, :3]
    lengths = np.linalg.norm(leaving, axis=1) * np.linalg.norm(arriving, axis=1)
    sound = lengths > SEAM_GAP_MM**2
    cosines = np.einsum("ij,ij->i", leaving, arriving)[sound] / lengths[sound]
    return bool(np.any(sound) and np.all(cosines > SMOOTH_SEAM_COSINE))
