"""The ruled flanks are what their formulas say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.ruled_gallery import GALLERY, RuledFlank, along_rulings, cone
from conflank_cli.geometry.footpoint import Projector
from conflank_cli.geometry.gap import motion_gap

BY_NAME = [flank.name for flank in GALLERY]


def test_rails_at_a_worked_example() -> None:
    """Every term of the formulas at u = 1/2, worked by hand."""
    flank = RuledFlank(
        "", (10.0, 20.0), (30.0, 50.0), 8.0, 3.0, 1.0, 1.0, 0.0,
        wrap=0.4, warp=0.1, twist=0.6, backsweep=0.8, lean=0.25, rc=0.5,
    )  # fmt: skip
    hub, shroud = flank.rails(np.array([0.5]))
    # r = r0 + (r1 - r0) (0.5 + 4 0.5 0.25) = r1; sin 2πu = 0, sin πu = 1.
    theta, theta_shroud = 0.2, 0.2 + 0.3 + 0.2
    np.testing.assert_allclose(hub[0], [20.0 * np.cos(theta), 20.0 * np.sin(theta), 4.0], atol=1e-12)
    np.testing.assert_allclose(
        shroud[0], [50.0 * np.cos(theta_shroud), 50.0 * np.sin(theta_shroud), 3.0 + 4.0 + 2.0], atol=1e-12
    )


@pytest.mark.parametrize("flank", GALLERY, ids=BY_NAME)
def test_the_surface_is_the_ruled_surface_between_the_rails(flank: RuledFlank) -> None:
    """Within 1e-8 mm, a hundredth of what is promised of it, between the nodes of the interpolation."""
    u, v = (grid.ravel() for grid in np.meshgrid(np.linspace(0.0, 1.0, 777), np.linspace(0.0, 1.0, 5), indexing="ij"))
    hub, shroud = flank.rails(u)
    points = Projector.of(flank.surface()).evaluate(u, v)[:, 0]
    np.testing.assert_allclose(points, (1.0 - v)[:, None] * hub + v[:, None] * shroud, rtol=0.0, atol=1e-8)


@pytest.mark.parametrize("flank", GALLERY, ids=BY_NAME)
@pytest.mark.parametrize("side", [1, -1])
def test_a_thin_cylinder_starts_along_the_rulings(flank: RuledFlank, side: int) -> None:
    """Its flute reaches past both rails, in touch with the middle of every ruling, on the side that is asked for."""
    tool = replace(flank.tool, r_min=0.1, r_max=0.1)
    motion = along_rulings(flank, side, 0.1)
    u = np.linspace(0.05, 0.95, 19)
    hub, shroud = flank.rails(u)
    # The fit of few control points is coarse where rulings turn fast, some tenths of a millimetre.
    for share in (0.01, 0.5, 0.99):
        gap = motion_gap(motion, tool, (1.0 - share) * hub + share * shroud, reach=2.0, step=0.05)[0]
        assert np.abs(gap).max() < 0.6
    p, q = motion.ends(np.linspace(0.0, 1.0, 50))
    np.testing.assert_allclose(np.linalg.norm(q - p, axis=1), flank.flute, atol=0.2)
    # On the first ruling, the normal in its middle says which side the axis is on.
    frame = Projector.of(flank.surface()).evaluate([0.0], [0.5])[0]
    t = np.linspace(0.0, 0.2, 500)
    p, q = motion.ends(t)
    d = (q - p) / np.linalg.norm(q - p, axis=1)[:, None]
    away = p - frame[0] - np.einsum("ni,ni->n", p - frame[0], d)[:, None] * d
    nearest = away[np.linalg.norm(away, axis=1).argmin()]
    assert side * (nearest @ np.cross(frame[1], frame[2])) > 0.0


def test_the_cone_has_the_cylinders_radius_in_the_middle_of_its_flute() -> None:
    """And the half angle asked for."""
    flank = GALLERY[0]
    tool = cone(flank, 0.03)
    assert tool.half_angle == pytest.approx(0.03)
    assert 0.5 * (tool.r_min + tool.r_max) == pytest.approx(flank.radius)
    assert tool.length == flank.flute
