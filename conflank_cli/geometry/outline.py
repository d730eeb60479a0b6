"""The outline of a tool assembly with the distances it keeps: how near to the axis a point may be, by its height."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from conflank_cli.tool import Section, Tool

Array = npt.NDArray[np.float64]

# Squares of radii in a millimetre of height. Between them they are taken as linear, which they are but for the square
# of the height: a ball of radius 1 comes out 0.1 µm too small, a cone exact to a hundredth of that.
FINE = 32
# Spheres are held against the largest radius within so many of these steps: a quarter of a millimetre.
COARSE = 8
# What stands for no radius at all, mm2.
NOTHING = -1.0


@dataclass(frozen=True, slots=True)
class Margins:
    """Distances to keep, mm, by component; negative: so much may be cut into."""

    cutter: float
    shank: float
    holder: float

    def less(self, slack: float) -> Margins:
        """All of them less so much."""
        return Margins(self.cutter - slack, self.shank - slack, self.holder - slack)


@dataclass(frozen=True, slots=True)
class Outline:
    """Radii within which something is too near to a tool.

    Attributes
    ----------
    lowest: height on the axis at which all tables begin, mm.
    squares: (H,) square of the radius within which a point is, every 1 / FINE mm of height; below 0 where no point is.
    widest: (2, W) largest radius that matters to a sphere whose centre has a height in a piece of COARSE / FINE mm; of
        small spheres, then of large ones.
    """

    lowest: float
    squares: Array
    widest: Array

    @classmethod
    @lru_cache(maxsize=64)
    def of(cls, tool: Tool, margins: Margins, small: float, large: float) -> Outline:
        """The outline of a tool, for points and for spheres of two sizes about them, of at most these radii, mm."""
        sections, component = assembly(tool)
        limits = [getattr(margins, name) for name in component]
        beyond = large + max(*limits, margins.cutter, 0.0) + 1.0 / FINE
        lowest = tool.ball_centre_height - tool.ball_radius - beyond
        pieces = int(np.ceil((float(sections[:, 1].max()) + beyond - lowest) * FINE / COARSE))
        z = lowest + np.arange(pieces * COARSE + 1) / FINE
        squares = (tool.ball_radius + margins.cutter) ** 2 - (z - tool.ball_centre_height) ** 2
        for section, name, limit in zip(sections, component, limits, strict=True):
            # Shank and holder end in steps: there a height between two of the table counts as on the wider side.
            near = z if name == "cutter" else np.clip(z, section[0] - limit, section[1] + limit)
            radii = offset_radius(near, section, limit)
            there = (np.abs(near - z) <= 1.0 / FINE) & (radii > 0.0)
            squares = np.maximum(squares, np.where(there, radii * radii, NOTHING))
        squares = np.maximum(squares, NOTHING)
        return cls(lowest, squares, np.stack([_widest(squares, small), _widest(squares, large)]))


def _widest(squares: Array, radius: float) -> Array:
    """Largest radius of an outline within so many mm of height of each of its coarse pieces."""
    around = int(np.ceil(radius * FINE))
    padded = np.pad(np.maximum(squares, 0.0), around)
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * around + 1 + COARSE)[::COARSE]
    return np.asarray(np.sqrt(windows.max(axis=1)))


def offset_radius(z: Array, section: Array, margin: float) -> Array:
    """Radius at heights z (N,), mm, within which a point is nearer than `margin` to a truncated cone; < 0 for none.

    section: heights of both ends and radii there. A negative margin asks which points are so deep inside.
    """
    low, high, r_low, r_high = section
    dz, dr = high - low, r_high - r_low
    length = np.hypot(dz, dr)
    side = r_low + (z - low) / dz * dr + margin * length / dz
    if margin <= 0.0:
        return np.where((z >= low - margin) & (z <= high + margin), side, -1.0)
    # Off the flank, as far as it goes, then around the edges of both ends; before an end all within its edge.
    radius = np.where((z >= low - margin * dr / length) & (z <= high - margin * dr / length), side, -1.0)
    for end, r_end in ((low, r_low), (high, r_high)):
        square = margin * margin - (z - end) ** 2
        radius = np.maximum(radius, np.where(square >= 0.0, r_end + np.sqrt(np.maximum(square, 0.0)), -1.0))
    return radius


def assembly(tool: Tool) -> tuple[Array, tuple[str, ...]]:
    """Cone, shank and holder as truncated cones (S, 4): heights of both ends, radii there; and each one's component."""
    rows = [(0.0, tool.length, tool.r_min, tool.r_max)]
    names = ["cutter"]
    top = tool.length

    def stack(sections: tuple[Section, ...], name: str) -> None:
        nonlocal top
        for section in sections:
            rows.append((top, top + section.length, 0.5 * section.diameter_low, 0.5 * section.diameter_high))
            names.append(name)
            top += section.length

    stack(tool.shank, "shank")
    stack(tool.holder, "holder")
    return np.array(rows), tuple(names)
