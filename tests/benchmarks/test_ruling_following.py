"""The ruling-following default touches where it says, and is exact where following rulings is."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pytest

from benchmarks.ruling_following import Band, band_errors, ruling_following
from conflank_cli.geometry.face import DesignFace
from conflank_cli.geometry.gap import motion_gap
from conflank_cli.geometry.surface import BSplineSurface
from conflank_cli.geometry.workface import WorkFace
from conflank_cli.tool import CATALOGUE, Tool

CLAMPED = np.array([0.0, 0.0, 0.0, 1.0, 1.0, 1.0])
BOX = (0.1, 0.9, 0.2, 0.8)


def quadric(bend_u: float, bend_v: float, sense: int = 1) -> DesignFace:
    """z = bend_u x² + bend_v y² over x in [-15, 15], y in [-10, 10], exactly; u along x, v along y."""
    x, y = np.array([-15.0, 0.0, 15.0]), np.array([-10.0, 0.0, 10.0])
    poles = np.zeros((3, 3, 3))
    poles[..., 0], poles[..., 1] = np.meshgrid(x, y, indexing="ij")
    # Poles of s² over [-a, a] are a², -a², a².
    poles[..., 2] += bend_u * np.array([225.0, -225.0, 225.0])[:, None]
    poles[..., 2] += bend_v * np.array([100.0, -100.0, 100.0])[None, :]
    border = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    return DesignFace(0, "", BSplineSurface(2, 2, CLAMPED, CLAMPED, poles), (border,), sense)


@pytest.mark.parametrize("tool", CATALOGUE.values(), ids=CATALOGUE)
@pytest.mark.parametrize(("across", "bends"), [("u", (-0.01, 0.0)), ("v", (0.0, -0.01))])
@pytest.mark.parametrize("up", [True, False])
def test_a_parabolic_cylinder_is_cut_exactly_along_its_rulings(
    tool: Tool, across: Literal["u", "v"], bends: tuple[float, float], up: bool
) -> None:
    """Tool and face touch along the whole generator, for whatever way the tip points."""
    face = WorkFace.under(quadric(*bends), tool)
    motion = ruling_following(face, tool, Band(BOX, across, up))
    errors = band_errors(face, tool, motion, BOX, (60, 20))
    # What is left is the fit of the motion, below 0.1 um.
    assert len(errors) > 100 and np.abs(errors).max() < 1e-4
    u, v = (grid.ravel() for grid in np.meshgrid(np.linspace(0.15, 0.85, 9), np.linspace(0.3, 0.7, 9)))
    points = face.projector.evaluate(u, v)[:, 0]
    assert np.abs(motion_gap(motion, tool, points)[0]).max() < 1e-4


@pytest.mark.parametrize("sense", [1, -1])
def test_on_a_saddle_it_is_tangent_in_the_middle_and_off_by_the_curvature_at_the_ends(sense: int) -> None:
    """Across the axis the generator is tangent at y = 0, so the error grows as bend y² towards both ends."""
    tool, bend = CATALOGUE["T1"], 0.002
    face = WorkFace.under(quadric(-0.002 * sense, bend * sense, sense), tool)
    motion = ruling_following(face, tool, Band((0.3, 0.7, 0.0, 1.0), "u", True))
    middle = face.projector.evaluate(np.linspace(0.35, 0.65, 7), np.full(7, 0.5))[:, 0]
    assert np.abs(motion_gap(motion, tool, middle)[0]).max() < 1e-4
    for fraction in (0.25, 0.75):
        points = face.projector.evaluate([0.5], [fraction])[:, 0]
        gap = motion_gap(motion, tool, points)[0][0]
        # A face that bends towards the cutter is cut into. Tilt and travel change the figure a little.
        assert gap == pytest.approx(-bend * 25.0, rel=0.1)


def test_the_axis_is_tilted_by_the_half_angle() -> None:
    """Against the surface normal in the middle of its height, and a rigid motion but for its fit."""
    tool = CATALOGUE["T3"]
    face = WorkFace.under(quadric(-0.004, 0.004), tool)
    motion = ruling_following(face, tool, Band(BOX, "u", True))
    t = np.linspace(0.0, 1.0, 31)
    p, q = motion.ends(t)
    np.testing.assert_allclose(np.linalg.norm(q - p, axis=1), tool.length, atol=1e-5)
    u = BOX[0] + t * (BOX[1] - BOX[0])
    frame = face.projector.evaluate(u, np.full(31, 0.5 * (BOX[2] + BOX[3])))
    normal = np.cross(frame[:, 1], frame[:, 2])
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    np.testing.assert_allclose(np.einsum("ni,ni->n", (q - p) / tool.length, normal), np.sin(tool.half_angle), atol=1e-5)
