"""A cylinder that moves level over an arc: what it leaves is known in closed form."""

from __future__ import annotations

import numpy as np

from conflank_cli.geometry.surface import BSplineSurface
from conflank_cli.motion import Motion, uniform_knots
from conflank_cli.tool import CATALOGUE, Tool
from tests.faces import interpolated, stacked

CYLINDER = Tool("CYL", 4.0, 4.0, 30.0, CATALOGUE["T1"].shank, CATALOGUE["T1"].holder)
# The face is z = sqrt(RADIUS² - x²) - RADIUS over |x| <= HALF_WIDTH and 0 <= y <= LENGTH; the axis lies along x.
RADIUS, HALF_WIDTH, LENGTH = 800.0, 10.0, 20.0
SAG = float(RADIUS - np.sqrt(RADIUS**2 - HALF_WIDTH**2))


def arc_points(spacing: float = 0.8) -> np.ndarray:
    """Points of the face, border included, (N, 3)."""
    x = np.linspace(-HALF_WIDTH, HALF_WIDTH, round(2.0 * HALF_WIDTH / spacing) + 1)
    y = np.linspace(0.0, LENGTH, round(LENGTH / spacing) + 1)
    x, y = (grid.ravel() for grid in np.meshgrid(x, y))
    return np.stack([x, y, np.sqrt(RADIUS**2 - x**2) - RADIUS], axis=1)


def arc_surface() -> BSplineSurface:
    """The face, u along x and v along y."""

    def shape(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return stacked(x, y, np.sqrt(RADIUS**2 - x**2) - RADIUS)

    return interpolated(shape, (-HALF_WIDTH, HALF_WIDTH), (0.0, LENGTH), 8)


def level(height: float, count: int = 8) -> Motion:
    """A motion along y whose envelope is the plane z = height."""
    y = np.array([uniform_knots(count)[k + 1 : k + 4].mean() for k in range(count)])
    p = np.stack([np.full(count, -15.0), -2.0 + (LENGTH + 4.0) * y, np.full(count, height + CYLINDER.r_min)], axis=1)
    return Motion(uniform_knots(count), p, p + np.array([CYLINDER.length, 0.0, 0.0]))
