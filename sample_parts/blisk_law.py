"""The blisk blade: circular-arc camber lines on cylinders, twisted like a free-vortex rotor, tapered and leaned.

Wheel axis along Z, flow along +Z, blade stacked along +X. Sections lie on the cylinders of radius r about Z:
z = axial coordinate, r theta = tangential coordinate.

Laws over the height h = (r - hub radius) / height:

- chord, camber angle and thickness ratio: linear between hub and tip;
- stagger psi: tan psi = A r - B / r, the direction of a flow with uniform axial speed and free-vortex whirl seen from
  the wheel (Dixon and Hall, Fluid Mechanics and Thermodynamics of Turbomachinery, 7th ed. 2014, ch. 6);
  A and B follow from the two given staggers;
- lean: tangential shift of the section, growing with the square of the height;
- camber line: circular arc; thickness: parabola between round edges, the thin-blade limit of the double circular arc
  (NASA SP-36, Johnsen and Bullock (eds.), 1965).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import radians, tan

import numpy as np
from blade_surfaces import Numbers


@dataclass(frozen=True, slots=True)
class BliskLaw:
    """Dimensions of the blisk blade; pairs are (hub, tip)."""

    blades: int = 24
    hub_radius: float = 60.0
    height: float = 45.0
    chord: tuple[float, float] = (34.0, 28.0)
    stagger_deg: tuple[float, float] = (20.0, 55.0)
    camber_deg: tuple[float, float] = (45.0, 20.0)
    thickness_ratio: tuple[float, float] = (0.09, 0.04)
    edge_ratio: float = 0.25
    """Thickness at the edges over the greatest thickness."""
    lean: float = 4.0
    fillet: float = 2.0
    stacking: float = 0.8
    """Stacking point over camber height: the centroid of a section with parabolic camber and thickness."""

    @property
    def tip_radius(self) -> float:
        """Outer radius of the blades, mm."""
        return self.hub_radius + self.height

    def stagger(self, radius: Numbers) -> Numbers:
        """Angle between chord and axis at a radius, in radians."""
        hub, tip = self.hub_radius, self.tip_radius
        tan_hub, tan_tip = (tan(radians(angle)) for angle in self.stagger_deg)
        wheel = (tan_tip * tip - tan_hub * hub) / (tip**2 - hub**2)
        whirl = hub * (wheel * hub - tan_hub)
        return np.asarray(np.arctan(wheel * radius - whirl / radius))

    def camber(self, x: Numbers, h: Numbers) -> Numbers:
        """Camber surface, shape (..., 3)."""
        radius = self.hub_radius + self.height * h
        chord = self.chord[0] + (self.chord[1] - self.chord[0]) * h
        turning = np.radians(self.camber_deg[0]) + np.radians(self.camber_deg[1] - self.camber_deg[0]) * h
        arc_radius = chord / (2.0 * np.sin(turning / 2.0))
        along = arc_radius * np.sin(turning * (x - 0.5))
        sagitta = arc_radius * (1.0 - np.cos(turning / 2.0))
        across = arc_radius * (np.cos(turning * (x - 0.5)) - np.cos(turning / 2.0)) - self.stacking * sagitta
        stagger = self.stagger(radius)
        axial = along * np.cos(stagger) - across * np.sin(stagger)
        tangential = along * np.sin(stagger) + across * np.cos(stagger) + self.lean * h**2
        angle = tangential / radius
        return np.stack([radius * np.cos(angle), radius * np.sin(angle), axial], axis=-1)

    def radius(self, x: Numbers, h: Numbers) -> Numbers:
        """Half thickness of the blade about its camber surface, shape (...)."""
        chord = self.chord[0] + (self.chord[1] - self.chord[0]) * h
        ratio = self.thickness_ratio[0] + (self.thickness_ratio[1] - self.thickness_ratio[0]) * h
        return np.asarray(0.5 * chord * ratio * (self.edge_ratio + (1.0 - self.edge_ratio) * 4.0 * x * (1.0 - x)))
