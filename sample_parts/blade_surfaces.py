"""Blades as envelopes of inscribed spheres: a camber surface and the radius of the blade about it.

A blade section is classically a camber line plus a thickness law: circles centred on the camber line, touching both
sides. Here the circles are spheres, centred on the camber *surface* c(x, h) with radius rho(x, h); both sides are their
envelope, and the round edges are the envelopes of the spheres along the two edges of the camber surface. Sides and
edges touch the same spheres in the same points, so they join with a common tangent plane, by construction.

Symbols: x in [0, 1] runs from the leading to the trailing edge, h in [0, 1] from hub to tip (or shroud). Both may be
exceeded a little, so that solids can be trimmed. Lengths in mm, angles in radians.

Source: NASA SP-36, Johnsen and Bullock (eds.), Aerodynamic Design of Axial-Flow Compressors (1965), ch. VI (mean line
plus thickness, round edges tangent to both sides); Pottmann and Peternell, Applications of Laguerre geometry in CAGD,
Computer Aided Geometric Design 15 (1998), section 4 (envelopes of one- and two-parameter families of spheres).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
from scipy.interpolate import make_interp_spline

from conflank_cli.geometry.surface import BSplineSurface

Array = npt.NDArray[np.float64]
Numbers = npt.NDArray[Any]
"""float64, or complex128 where a derivative is taken by complex step."""

COMPLEX_STEP = 1e-30
"""No difference is formed, so the step only has to be small enough for its square to vanish."""

SUCTION, PRESSURE = 1.0, -1.0
"""Which of the two envelope sheets: along c_x x c_h or against it."""


class BladeLaw(Protocol):
    """A blade: camber surface and radius, as formulas that also accept complex numbers."""

    def camber(self, x: Numbers, h: Numbers) -> Numbers:
        """Centres of the inscribed spheres, shape (..., 3), for x, h of shape (...)."""
        ...

    def radius(self, x: Numbers, h: Numbers) -> Numbers:
        """Radii of the inscribed spheres, shape (...)."""
        ...


@dataclass(frozen=True, slots=True)
class CamberJet:
    """Camber surface and radius with first derivatives at real (x, h) of shape (...).

    point, along_x, along_h: c, c_x, c_h, shape (..., 3); normal: unit c_x x c_h; radius, radius_x, radius_h: shape (...).
    """

    point: Array
    along_x: Array
    along_h: Array
    normal: Array
    radius: Array
    radius_x: Array
    radius_h: Array


def _dot(a: Array, b: Array) -> Array:
    return np.asarray(np.einsum("...i,...i->...", a, b))


def camber_jet(law: BladeLaw, x: Array, h: Array) -> CamberJet:
    """First derivatives of a blade law by complex step, exact to rounding."""
    step = 1j * COMPLEX_STEP
    by_x, by_h = law.camber(x + step, h + 0j), law.camber(x + 0j, h + step)
    radius_by_x, radius_by_h = law.radius(x + step, h + 0j), law.radius(x + 0j, h + step)
    along_x, along_h = by_x.imag / COMPLEX_STEP, by_h.imag / COMPLEX_STEP
    normal = np.cross(along_x, along_h)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    return CamberJet(
        by_x.real,
        along_x,
        along_h,
        normal,
        radius_by_x.real,
        radius_by_x.imag / COMPLEX_STEP,
        radius_by_h.imag / COMPLEX_STEP,
    )


def _towards_thinner(jet: CamberJet) -> Array:
    """Tangential part of the direction from a sphere's centre to its contact: minus the gradient of the radius.

    The contact c + rho w lies on the envelope where <w, c_x> = -rho_x and <w, c_h> = -rho_h.
    """
    e, f, g = _dot(jet.along_x, jet.along_x), _dot(jet.along_x, jet.along_h), _dot(jet.along_h, jet.along_h)
    determinant = e * g - f * f
    a = (g * jet.radius_x - f * jet.radius_h) / determinant
    b = (e * jet.radius_h - f * jet.radius_x) / determinant
    return np.asarray(-a[..., None] * jet.along_x - b[..., None] * jet.along_h)


def side_points(law: BladeLaw, sheet: float, x: Array, h: Array) -> Array:
    """Points of one side, shape (..., 3): where the spheres centred at c(x, h) touch it; sheet SUCTION or PRESSURE."""
    jet = camber_jet(law, x, h)
    tangential = _towards_thinner(jet)
    height = np.sqrt(1.0 - _dot(tangential, tangential))
    direction = tangential + sheet * height[..., None] * jet.normal
    return np.asarray(jet.point + jet.radius[..., None] * direction)


def edge_points(law: BladeLaw, x_edge: float, turn: Array, h: Array) -> Array:
    """Points of a round edge, shape (..., 3).

    x_edge: 0 for the leading, 1 for the trailing edge. turn in [0, 1] runs along each touching circle from the contact
    with the suction side to the contact with the pressure side, around the outside.
    """
    jet = camber_jet(law, np.full_like(h, x_edge), h)
    length = np.linalg.norm(jet.along_h, axis=-1)
    tangent = jet.along_h / length[..., None]
    slope = jet.radius_h / length
    outward = np.cross(tangent, jet.normal)
    outward *= np.sign(_dot(outward, jet.along_x) * (x_edge - 0.5))[..., None]
    circle = np.sqrt(1.0 - slope**2)
    start = np.arcsin(_dot(_towards_thinner(jet), outward) / circle)
    angle = start + turn * (np.pi - 2.0 * start)
    direction = -slope[..., None] * tangent + circle[..., None] * (
        np.cos(angle)[..., None] * jet.normal + np.sin(angle)[..., None] * outward
    )
    return np.asarray(jet.point + jet.radius[..., None] * direction)


def interpolate_bicubic(points: Array, sites_u: Array, sites_v: Array) -> BSplineSurface:
    """The bicubic C2 B-spline surface through a grid of points (not-a-knot ends), with one pole per point.

    points (nu, nv, 3) at parameters sites_u (nu,), sites_v (nv,). Boundary rows depend on boundary points alone, so faces
    that share a row of points share the curve exactly.

    Source: Piegl and Tiller, The NURBS Book (1997), section 9.2.5 (tensor-product interpolation, one direction at a time).
    """
    first = make_interp_spline(sites_u, points, k=3, axis=0)
    second = make_interp_spline(sites_v, np.moveaxis(first.c, 1, 0), k=3, axis=0)
    poles = np.ascontiguousarray(np.moveaxis(second.c, 0, 1))
    return BSplineSurface(3, 3, np.asarray(first.t), np.asarray(second.t), poles)


def side_surface(law: BladeLaw, sheet: float, sites_x: Array, sites_h: Array) -> BSplineSurface:
    """One side as one bicubic face; u = x, v = h."""
    x, h = np.meshgrid(sites_x, sites_h, indexing="ij")
    return interpolate_bicubic(side_points(law, sheet, x, h), sites_x, sites_h)


def edge_surface(law: BladeLaw, x_edge: float, sites_turn: Array, sites_h: Array) -> BSplineSurface:
    """A round edge as one bicubic face; u = turn, v = h."""
    turn, h = np.meshgrid(sites_turn, sites_h, indexing="ij")
    return interpolate_bicubic(edge_points(law, x_edge, turn, h), sites_turn, sites_h)


def _greville(knots: Array) -> Array:
    """Where a cubic's poles reproduce a linear function, scaled to [0, 1]."""
    abscissae = (knots[1:-3] + knots[2:-2] + knots[3:-1]) / 3.0
    return np.asarray((abscissae - abscissae[0]) / (abscissae[-1] - abscissae[0]))


def cap_surface(sides: tuple[BSplineSurface, BSplineSurface], ends: tuple[BSplineSurface, BSplineSurface], row: int) -> BSplineSurface:
    """The Coons patch over the four boundary curves at one end of the span (row 0 or -1); it only closes the solid.

    sides: suction and pressure side; ends: leading- and trailing-edge faces, running from suction to pressure.

    Source: Farin, Curves and Surfaces for CAGD (2002), ch. 22 (bilinearly blended Coons patches).
    """
    low, high = sides[0].poles[:, row], sides[1].poles[:, row]
    front, back = ends[0].poles[:, row], ends[1].poles[:, row]
    g, k = _greville(sides[0].knots_u)[:, None, None], _greville(ends[0].knots_u)[None, :, None]
    between_sides = (1.0 - k) * low[:, None] + k * high[:, None]
    between_ends = (1.0 - g) * front[None] + g * back[None]
    corners = (1.0 - g) * ((1.0 - k) * low[0] + k * high[0]) + g * ((1.0 - k) * low[-1] + k * high[-1])
    return BSplineSurface(3, 3, sides[0].knots_u, ends[0].knots_u, between_sides + between_ends - corners)


def chord_surface(sides: tuple[BSplineSurface, BSplineSurface], sites: Array) -> BSplineSurface:
    """The ruled face that closes a blunt end at the last x, in the form of a round edge (from suction to pressure)."""
    ramp = sites[:, None, None]
    spline = make_interp_spline(sites, (1.0 - ramp) * sides[0].poles[-1][None] + ramp * sides[1].poles[-1][None], k=3)
    return BSplineSurface(3, 3, np.asarray(spline.t), sides[0].knots_v, np.asarray(spline.c))


def evaluate(surface: BSplineSurface, u: Array, v: Array, order_u: int = 0, order_v: int = 0) -> Array:
    """Values or partial derivatives of a polynomial B-spline surface on the grid u x v, shape (len(u), len(v), 3)."""
    from scipy.interpolate import BSpline

    along_u = BSpline(surface.knots_u, surface.poles, surface.degree_u, axis=0)(u, nu=order_u)
    along_v = BSpline(surface.knots_v, np.moveaxis(along_u, 1, 0), surface.degree_v, axis=0)(v, nu=order_v)
    return np.ascontiguousarray(np.moveaxis(along_v, 0, 1))


def crowded_sites(low: float, high: float, count: int) -> Array:
    """Interpolation sites that crowd towards both ends, where not-a-knot cubics err most; shape (count,).

    Three tenths uniform and seven tenths cosine: measured on the blisk, this cuts the error sixfold against uniform sites.
    """
    uniform = np.linspace(0.0, 1.0, count)
    cosine = 0.5 * (1.0 - np.cos(np.pi * uniform))
    return np.asarray(low + (high - low) * (0.3 * uniform + 0.7 * cosine))
