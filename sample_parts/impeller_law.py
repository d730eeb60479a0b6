"""The impeller blade: wrapped by a blade-angle law on stream surfaces between quarter ellipses.

Wheel axis along Z, inlet at the top (greater z), exit radial at the bottom. A stream surface h is the quarter ellipse
r = r2 - a(h) cos tau, z = z1 - b(h) sin tau, tau in [0, pi/2], with a and b linear between hub (h = 0) and shroud
(h = 1).

Blade angle beta against the meridional direction:

- at the inlet tan beta_1 = k r, a swirl-free flow of uniform axial speed seen from the wheel (Dixon and Hall, Fluid
  Mechanics and Thermodynamics of Turbomachinery, 7th ed. 2014, ch. 7);
- at the exit beta_2 = backsweep on every stream surface;
- in between beta = beta_1 + (beta_2 - beta_1) (3 x^2 - 2 x^3), with x = 2 tau / pi, so it is level at both ends
  (the usual polynomial laws: Aungier, Centrifugal Compressors, ASME Press 2000).

The wrap angle is the integral of tan(beta) / r along each stream surface, from the exit, where the edge is axial.

Why the blade is not ruled: hub, shroud and every stream surface between them wrap by their own integral, and the wrap
angle is not a linear function of h. Lines h -> (r, z) are straight in the meridional plane, but turning their points by
unequal, non-linear angles bends them in space: at the leading edge the camber surface is 3.6 mm off the straight line
between hub and shroud. (A ruled blade would take the law at hub and shroud alone and join them by straight lines.)

Thickness: falls linearly from hub to shroud; along the blade it rises smoothly from the round leading edge to its full
value and stays there; the exit is cut off blunt by turning.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi, radians, tan

import numpy as np
from blade_surfaces import Numbers

NODES, WEIGHTS = np.polynomial.legendre.leggauss(24)
"""Gauss-Legendre rule for the wrap angle; its integrand is smooth, so 24 nodes reach rounding."""


@dataclass(frozen=True, slots=True)
class ImpellerLaw:
    """Dimensions of the impeller, mm and degrees; pairs are (hub, shroud)."""

    blades: int = 8
    exit_radius: float = 60.0
    inlet_radius: tuple[float, float] = (15.0, 40.0)
    exit_width: float = 8.0
    inlet_height: float = 40.0
    """z of the leading edge above the hub's exit."""
    inlet_angle_shroud_deg: float = 56.0
    backsweep_deg: float = 35.0
    thickness: tuple[float, float] = (2.4, 1.2)
    edge_ratio: float = 0.5
    """Thickness of the leading edge over the full thickness."""

    def meridional(self, x: Numbers, h: Numbers) -> tuple[Numbers, Numbers, Numbers]:
        """Radius, z and d(arc length)/dx of stream surface h at x, shape (...)."""
        tau = 0.5 * pi * x
        a = self.exit_radius - self.inlet_radius[0] - (self.inlet_radius[1] - self.inlet_radius[0]) * h
        b = self.inlet_height - self.exit_width * h
        speed = 0.5 * pi * np.sqrt((a * np.sin(tau)) ** 2 + (b * np.cos(tau)) ** 2)
        return self.exit_radius - a * np.cos(tau), self.inlet_height - b * np.sin(tau), speed

    def blade_angle(self, x: Numbers, h: Numbers) -> Numbers:
        """Angle beta between blade and meridional direction, radians."""
        inlet_radius = self.inlet_radius[0] + (self.inlet_radius[1] - self.inlet_radius[0]) * h
        inlet = np.arctan(tan(radians(self.inlet_angle_shroud_deg)) * inlet_radius / self.inlet_radius[1])
        return np.asarray(inlet + (radians(self.backsweep_deg) - inlet) * x**2 * (3.0 - 2.0 * x))

    def wrap(self, x: Numbers, h: Numbers) -> Numbers:
        """Wrap angle from the exit, radians."""
        half = 0.5 * (1.0 - x)
        total = np.zeros_like(x * h)
        for node, weight in zip(NODES, WEIGHTS, strict=True):
            station = x + half * (1.0 + node)
            radius, _, speed = self.meridional(station, h)
            total = total + weight * np.tan(self.blade_angle(station, h)) / radius * speed
        return np.asarray(half * total)

    def camber(self, x: Numbers, h: Numbers) -> Numbers:
        """Camber surface, shape (..., 3)."""
        radius, z, _ = self.meridional(x, h)
        angle = self.wrap(x, h)
        return np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=-1)

    def radius(self, x: Numbers, h: Numbers) -> Numbers:
        """Half thickness of the blade about its camber surface, shape (...)."""
        full = self.thickness[0] + (self.thickness[1] - self.thickness[0]) * h
        return np.asarray(0.5 * full * (1.0 - (1.0 - self.edge_ratio) * (1.0 - x) ** 4))
