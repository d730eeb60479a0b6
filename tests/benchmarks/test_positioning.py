"""Two-point and triple tangent positions touch where they say, and are exact where the face is developable."""

from __future__ import annotations

from collections.abc import Callable
from math import cos, tan

import numpy as np
import numpy.typing as npt
import pytest
from scipy.interpolate import make_interp_spline

from benchmarks.detection import whole
from benchmarks.positioning import three_points, two_points
from benchmarks.ruling_following import Band, ruling_following
from conflank_cli.geometry.gap import motion_gap
from conflank_cli.geometry.surface import BSplineSurface
from conflank_cli.geometry.workface import WorkFace
from conflank_cli.motion import Motion
from conflank_cli.tool import CATALOGUE, Tool

Array = npt.NDArray[np.float64]
Method = Callable[[WorkFace, Tool, Band], Motion]

CYLINDER = Tool("CYLINDER", 3.0, 3.0, 24.0)
TOOLS = (CATALOGUE["T1"], CATALOGUE["T3"], CYLINDER)
BAND = Band((0.0, 1.0, 0.0, 1.0), "u", True)
HALF = 9.0  # mm, of the rulings


def ruled(twist: float, bend: float) -> BSplineSurface:
    """z = twist x y - bend x² between the rails y = -HALF and HALF, x in [-20, 20]: straight rulings along y."""
    x = np.linspace(-20.0, 20.0, 9)
    rails = [np.stack([x, np.full(9, y), twist * x * y - bend * x * x], axis=1) for y in (-HALF, HALF)]
    spline = make_interp_spline(np.linspace(0.0, 1.0, 9), np.hstack(rails), 3)
    poles = np.ascontiguousarray(spline.c.reshape(len(spline.c), 2, 3))
    return BSplineSurface(3, 1, spline.t, np.array([0.0, 0.0, 1.0, 1.0]), poles)


def gap(method: Method, tool: Tool, twist: float, bend: float, sense: int) -> Array:
    """Swept gap in µm, (rulings, heights): away from where the sweep begins and ends."""
    face = WorkFace.under(whole(ruled(twist, bend), sense), tool)
    u, v = np.meshgrid(np.linspace(0.15, 0.85, 41), np.linspace(0.0, 1.0, 31), indexing="ij")
    points = face.projector.evaluate(u.ravel(), v.ravel())[:, 0]
    found = motion_gap(method(face, tool, BAND), tool, points, reach=1.0, step=0.25)[0]
    return np.asarray(1e3 * found.reshape(u.shape))


@pytest.mark.parametrize("tool", TOOLS, ids=lambda tool: tool.name)
@pytest.mark.parametrize("method", [two_points, three_points])
@pytest.mark.parametrize("sense", [1, -1])
def test_a_parabolic_cylinder_is_cut_exactly(method: Method, tool: Tool, sense: int) -> None:
    """A tool that touches both ends of a ruling of a developable face touches all of it."""
    assert np.abs(gap(method, tool, 0.0, 0.01, sense)).max() < 0.05


@pytest.mark.parametrize("tool", TOOLS, ids=lambda tool: tool.name)
def test_two_points_touch_both_rails_of_a_twisted_face_and_gouge_between_them(tool: Tool) -> None:
    found = gap(two_points, tool, 0.01, 0.0, 1)
    assert np.abs(found[:, [0, -1]]).max() < 0.1
    # A cylinder on z = k x y turns by k y against the normal, and is 2 r (k y)² / 4 deep in the middle if level at ±y.
    assert found[:, 15].max() < -5.0
    if tool is CYLINDER:
        expected = -1e3 * tool.r_min * (0.01 * HALF) ** 2 / 2.0
        np.testing.assert_allclose(found[20, 15], expected, rtol=0.02)


def test_a_cylinder_in_three_tangents_follows_a_hyperbolic_paraboloid() -> None:
    """Its twist is shared out by sliding along the rails; what is left is of higher order, and small."""
    two, three = (np.abs(gap(method, CYLINDER, 0.01, 0.0, 1)).max() for method in (two_points, three_points))
    assert three < 0.1 and two > 10.0


@pytest.mark.parametrize("tool", TOOLS, ids=lambda tool: tool.name)
def test_each_method_leaves_less_than_the_one_before(tool: Tool) -> None:
    worst = [np.abs(gap(method, tool, 0.01, 0.0, -1)).max() for method in (ruling_following, two_points, three_points)]
    assert worst[2] < 0.5 * worst[1] and worst[1] < 1.01 * worst[0]


@pytest.mark.parametrize("tool", TOOLS, ids=lambda tool: tool.name)
def test_three_points_are_tangent_to_the_rails_and_touch_between_them(tool: Tool) -> None:
    """By the plain distance to the cone's surface, pose by pose: nothing of the package but the motion."""
    face = WorkFace.under(whole(ruled(0.01, 0.02), 1), tool)
    motion = three_points(face, tool, BAND)
    x = np.linspace(-20.0, 20.0, 4001)
    for time in (0.3, 0.5, 0.7):
        p, q = motion.ends([time])
        d = (q[0] - p[0]) / np.linalg.norm(q[0] - p[0])
        # The face y = const near the pose, from rail to rail: the least distance of each such line is a tangency.
        y = np.linspace(-HALF, HALF, 37)
        points = np.stack(
            np.broadcast_arrays(x[:, None], y[None, :], 0.01 * x[:, None] * y - 0.02 * x[:, None] ** 2), -1
        )
        along = (points - p[0]) @ d
        radial = np.linalg.norm(points - p[0] - along[..., None] * d, axis=-1)
        distance = (radial - tool.r_min - along * tan(tool.half_angle)) * cos(tool.half_angle)
        least = 1e3 * distance.min(axis=0)
        assert np.abs(least[[0, -1]]).max() < 0.2  # both rails; sampled every 10 µm along x
        # In between the tool lies in the face on one side of the third contact and off it on the other.
        assert least[1:-1].min() < 0.2 and np.abs(least[1:-1]).min() < 0.5
