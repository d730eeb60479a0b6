"""The cutter: a truncated cone with a tangent ball tip, below a shank and a holder."""

from __future__ import annotations

from dataclasses import dataclass
from math import atan2, cos, sin, tan

import numpy as np
import numpy.typing as npt


@dataclass(frozen=True, slots=True)
class Section:
    """One cylinder or cone of shank or holder, from below: end diameters and axial length, all mm."""

    diameter_low: float
    diameter_high: float
    length: float


@dataclass(frozen=True, slots=True)
class Tool:
    """A conical tool T = (r_min, r_max, length), as the paper writes it; a cylinder has r_min = r_max.

    Heights are measured along the axis from the plane of r_min (point p) towards the spindle. Ball and cone cut; shank
    and holder only collide.

    Attributes
    ----------
    name: name in the catalogue.
    r_min, r_max: radius at the small and at the large end of the cone, mm.
    length: axial length of the cone, mm.
    shank, holder: sections above the cone, from below.
    number: tool number on the machine.
    spindle_rpm, feed_mm_min: cutting data.
    """

    name: str
    r_min: float
    r_max: float
    length: float
    shank: tuple[Section, ...] = ()
    holder: tuple[Section, ...] = ()
    number: int = 1
    spindle_rpm: float = 3000.0
    feed_mm_min: float = 1000.0

    @property
    def half_angle(self) -> float:
        """Half angle α of the cone in radians."""
        return atan2(self.r_max - self.r_min, self.length)

    @property
    def ball_radius(self) -> float:
        """Radius of the ball that is tangent to the cone at r_min, mm."""
        return self.r_min / cos(self.half_angle)

    @property
    def ball_centre_height(self) -> float:
        """Height of the ball's centre above the plane of r_min, mm."""
        return self.r_min * tan(self.half_angle)

    @property
    def tip_height(self) -> float:
        """Height of the tip point (negative: it lies below the plane of r_min), mm."""
        return self.ball_centre_height - self.ball_radius

    @property
    def top(self) -> float:
        """Height of the top of the holder above the plane of r_min, mm."""
        return self.length + sum(section.length for section in (*self.shank, *self.holder))

    @property
    def centre_range(self) -> tuple[float, float]:
        """Heights of the lowest and highest sphere centre whose contact lies on the cone, mm."""
        slope = tan(self.half_angle)
        return self.r_min * slope, self.length + self.r_max * slope

    def sphere_radius(self, height: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """Radius of the sphere inscribed in the cone and centred on the axis at `height`: r(height) cos α, mm."""
        alpha = self.half_angle
        return np.asarray(self.r_min * cos(alpha) + np.asarray(height, dtype=np.float64) * sin(alpha))


_SLIM_HOLDER = (Section(20.0, 27.0, 40.0), Section(40.0, 40.0, 40.0))


def _standard(name: str, r_min: float, r_max: float, length: float, number: int) -> Tool:
    """A built-in tool: a 40 mm shank of radius r_max above the cone, then a slim shrink-fit holder."""
    shank = (Section(2.0 * r_max, 2.0 * r_max, 40.0),)
    return Tool(name, r_min, r_max, length, shank, _SLIM_HOLDER, number)


CATALOGUE: dict[str, Tool] = {
    tool.name: tool
    for tool in (
        _standard("T1", 1.5, 3.0, 24.0, 1),
        _standard("T2", 3.0, 5.0, 31.0, 2),
        _standard("T3", 2.0, 5.0, 30.0, 3),
    )
}
"""The paper's tools (Calleja et al. 2018, section 5)."""
