"""The scallop between two passes of a ball: its height from their distance, and the other way round."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from conflank_cli.job import Tolerance

Array = npt.NDArray[np.float64]

# What posting may change of the gap, mm.
POSTING = 0.0005


@dataclass(frozen=True, slots=True)
class Aim:
    """What a pass leaves, mm off the design face (allowance included): at its line of contact, and at the crests."""

    contact: float
    crest: float

    @property
    def height(self) -> float:
        """Height of the scallop, mm."""
        return self.crest - self.contact

    @classmethod
    def of(cls, tolerance: Tolerance, scallop: float) -> Aim:
        """Contact on the face and crests as high as asked, where the tolerance has room for them.

        Both are moved, and the height is cut, where it has not: all stays within the band less what posting may change.
        """
        low, high = POSTING - tolerance.overcut, tolerance.undercut - POSTING
        height = min(scallop, high - low)
        contact = float(np.clip(0.0, low, high - height))
        return cls(tolerance.allowance + contact, tolerance.allowance + contact + height)


def line_distance(height: float, radius: float, curvature: npt.ArrayLike) -> Array:
    """Distance along the face at which neighbouring lines of a ball leave scallops of a height.

    Parameters
    ----------
    height: of the crest over the face, mm; below `radius`.
    radius: of the ball, mm.
    curvature: normal curvature of the face across the feed, 1/mm, positive where it bends away from the cutter;
        -1/radius (the ball fits no more) or less gives infinity.

    Returns
    -------
    arc length on the face from line to line, mm.

    In the plane across the feed the face is a circle about O of radius 1/c, the ball's centre lies 1/c + R from O and
    the crest 1/c + h, R from the centre. The law of cosines in this triangle gives the half angle between the lines,

        1 - cos(φ/2) = h (2R - h) / (2 (1/c + R)(1/c + h)) = 2 sin²(φ/4),

    and s = φ/c; it holds for negative c too, and tends to 2 √(h (2R - h)) as c vanishes.

    Source: Suresh and Yang, Constant scallop-height machining of free-form surfaces, Journal of Engineering for
    Industry 116 (1994), who go on to approximate it.
    """
    c = np.asarray(curvature, dtype=np.float64)
    room = (1.0 + c * radius) * (1.0 + c * height)
    fits = room > 0.0
    half = np.sqrt(height * (2.0 * radius - height) / np.where(fits, room, 1.0))
    # A ball that nearly fills the hollow needs no second line; asin has an end there.
    sine = np.minimum(0.5 * np.abs(c) * half, 1.0)
    # asin(x)/x through sinc's sister: no division by zero on a plane.
    ratio = np.where(sine > 1e-6, np.arcsin(sine) / np.maximum(sine, 1e-6), 1.0)
    return np.asarray(np.where(fits, 2.0 * half * ratio, np.inf))


def scallop_height(distance: float, radius: float, curvature: float) -> float:
    """Height of the crest between two lines `distance` mm apart along the face, mm: `line_distance` turned round.

    From the crest's place on the bisector, directly rather than by inversion, so that one can check the other.
    """
    if curvature == 0.0:
        return float(radius - np.sqrt(radius**2 - 0.25 * distance**2))
    rho = 1.0 / curvature
    half = 0.5 * distance * curvature
    across, along = (rho + radius) * np.sin(half), (rho + radius) * np.cos(half)
    return float(along - np.sqrt(radius**2 - across**2) - rho)
