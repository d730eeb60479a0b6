"""Blades as envelopes of inscribed spheres: a camber surface and the radius of the blade about it.

A blade section is classically a camber line plus a thickness law: circles centred on the camber line, touching both
sides. Here the circles are spheres, centred on the camber *surface* c(x, h) with radius rho(x, h); both sides are their
envelope, and the round edges are the envelopes of the spheres along the two edges of the camber surface. Sides and
edges touch the same spheres in the same points, so they join with a common tangent plane, by construction.

Symbols: x in [0, 1] runs from the leading to the trailing edge, h in [0, 1] from hub to tip (or shroud). Both may be
exceeded a little, so that solids can be trimmed. Lengths in mm, angles in radians.

Source: NASA SP-36, Johnsen and Bullock (eds.), Aerodynamic Design of Axial-Flow Compressors (1965) (mean line
plus thickness, round edges tangent to both sides); Pottmann and Peternell, Applications of Laguerre geometry in CAGD,
Computer Aided Geometric Design 15 (1998) (envelopes of one- and two-parameter families of spheres).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
from scipy.interpolate import BSpline, make_interp_spline

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

    point, along_x, along_h: c, c_x, c_h, shape (..., 3); normal: unit c_x x c_h, shape (..., 3); radius, radius_x,
    radius_h: rho and its derivatives, shape (...).
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


Contact = Callable[[Array, Array], tuple[Array, Array]]
"""(u, h) of shape (...) -> points on the blade and unit normals out of it, each (..., 3)."""


def side_contact(law: BladeLaw, sheet: float) -> Contact:
    """One side, u = x: where the sphere about c(x, h) touches it. The sheet is SUCTION or PRESSURE."""

    def contact(x: Array, h: Array) -> tuple[Array, Array]:
        jet = camber_jet(law, x, h)
        tangential = _towards_thinner(jet)
        direction = tangential + sheet * np.sqrt(1.0 - _dot(tangential, tangential))[..., None] * jet.normal
        return jet.point + jet.radius[..., None] * direction, direction

    return contact


def edge_contact(law: BladeLaw, x_edge: float) -> Contact:
    """A round edge; x_edge is 0 for the leading, 1 for the trailing edge.

    u in [0, 1] turns along each touching circle from the contact with the suction side, around the outside, to the
    contact with the pressure side.
    """

    def contact(turn: Array, h: Array) -> tuple[Array, Array]:
        jet = camber_jet(law, np.full_like(h, x_edge), h)
        length = np.linalg.norm(jet.along_h, axis=-1)
        tangent = jet.along_h / length[..., None]
        slope = jet.radius_h / length
        outward = np.cross(tangent, jet.normal)
        outward *= np.sign(_dot(outward, jet.along_x) * (x_edge - 0.5))[..., None]
        circle = np.sqrt(1.0 - slope**2)
        start = np.arcsin(_dot(_towards_thinner(jet), outward) / circle)
        angle = start + turn * (np.pi - 2.0 * start)
        around = np.cos(angle)[..., None] * jet.normal + np.sin(angle)[..., None] * outward
        direction = -slope[..., None] * tangent + circle[..., None] * around
        return jet.point + jet.radius[..., None] * direction, direction

    return contact


def points_only(contact: Contact) -> Callable[[Array, Array], Array]:
    """A patch without its normals."""
    return lambda u, h: contact(u, h)[0]


def height_at_radius(contact: Contact, u: Array, wheel_radius: float, clearance: float = 0.0) -> Array:
    """The h where a patch, offset outwards by `clearance`, has the distance `wheel_radius` from the Z axis; shape of u.

    By bisection over h in [-0.2, 1.2]: that distance grows with h.
    """
    low, high = np.full_like(u, -0.2), np.full_like(u, 1.2)
    for _ in range(60):
        middle = 0.5 * (low + high)
        point, normal = contact(u, middle)
        above = np.linalg.norm((point + clearance * normal)[..., :2], axis=-1) > wheel_radius
        low, high = np.where(above, low, middle), np.where(above, middle, high)
    return np.asarray(0.5 * (low + high))


@dataclass(frozen=True, slots=True)
class RolledPatch:
    """A patch of the blade from the fillet's contact line to the tip, and the fillet below it, as exact formulas.

    contact: the patch; hub_radius, tip_radius: wheel radii, mm; fillet: radius of the ball that rolls along hub and
    blade, mm.

    Source: Rossignac and Requicha, Constant-radius blending in solid modelling, Computers in Mechanical Engineering
    (1984): the ball's centre runs along the intersection of both offset surfaces.
    """

    contact: Contact
    hub_radius: float
    tip_radius: float
    fillet: float

    def flank(self, u: Array, v: Array) -> Array:
        """Points (..., 3); v = 0 on the fillet's contact line, 1 at the tip, proportional to h in between."""
        low = height_at_radius(self.contact, u, self.hub_radius + self.fillet, self.fillet)
        high = height_at_radius(self.contact, u, self.tip_radius)
        return self.contact(u, low + v * (high - low))[0]

    def blend(self, u: Array, v: Array) -> Array:
        """Points (..., 3) of the fillet; v = 0 on the hub, 1 on the blade."""
        low = height_at_radius(self.contact, u, self.hub_radius + self.fillet, self.fillet)
        point, normal = self.contact(u, low)
        centre = point + self.fillet * normal
        to_hub = -centre * np.array([1.0, 1.0, 0.0]) / (self.hub_radius + self.fillet)
        # Both contacts lie on the ball's great circle across its path, so the arc between them is the fillet.
        angle = np.arccos(np.clip(-_dot(to_hub, normal), -1.0, 1.0))
        direction = (np.sin((1.0 - v) * angle)[..., None] * to_hub - np.sin(v * angle)[..., None] * normal) / np.sin(
            angle
        )[..., None]
        return np.asarray(centre + self.fillet * direction)


def interpolate_bicubic(points: Array, sites_u: Array, sites_v: Array) -> BSplineSurface:
    """The bicubic C2 B-spline surface through a grid of points (not-a-knot ends), with one pole per point.

    points (nu, nv, 3) at parameters sites_u (nu,), sites_v (nv,). Boundary rows depend on boundary points alone, so
    faces that share a row of points share the curve exactly.

    Source: Piegl and Tiller, The NURBS Book (1997), section 9.2.5 (interpolation, one direction at a time).
    """
    first = make_interp_spline(sites_u, points, k=3, axis=0)
    second = make_interp_spline(sites_v, np.moveaxis(first.c, 1, 0), k=3, axis=0)
    poles = np.ascontiguousarray(np.moveaxis(second.c, 0, 1))
    return BSplineSurface(3, 3, np.asarray(first.t), np.asarray(second.t), poles)


def fit(points: Callable[[Array, Array], Array], sites_u: Array, sites_v: Array) -> BSplineSurface:
    """The bicubic surface through points(u, v) on a grid of sites."""
    u, v = np.meshgrid(sites_u, sites_v, indexing="ij")
    return interpolate_bicubic(points(u, v), sites_u, sites_v)


def _greville(knots: Array) -> Array:
    """Where a cubic's poles reproduce a linear function, scaled to [0, 1]."""
    abscissae = (knots[1:-3] + knots[2:-2] + knots[3:-1]) / 3.0
    return np.asarray((abscissae - abscissae[0]) / (abscissae[-1] - abscissae[0]))


def cap_surface(
    sides: tuple[BSplineSurface, BSplineSurface], ends: tuple[BSplineSurface, BSplineSurface], row: int
) -> BSplineSurface:
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
    along_u = BSpline(surface.knots_u, surface.poles, surface.degree_u, axis=0)(u, nu=order_u)
    along_v = BSpline(surface.knots_v, np.moveaxis(along_u, 1, 0), surface.degree_v, axis=0)(v, nu=order_v)
    return np.ascontiguousarray(np.moveaxis(along_v, 0, 1))


def crowded_sites(low: float, high: float, count: int) -> Array:
    """Interpolation sites that crowd towards both ends, where not-a-knot cubics err most; shape (count,).

    Three tenths uniform, seven tenths cosine: measured on the blisk, a sixth of the error of uniform sites.
    """
    uniform = np.linspace(0.0, 1.0, count)
    cosine = 0.5 * (1.0 - np.cos(np.pi * uniform))
    return np.asarray(low + (high - low) * (0.3 * uniform + 0.7 * cosine))
