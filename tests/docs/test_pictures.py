"""The pictures' files and the small decisions behind them."""

from math import cos, sin
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from conflank_cli.tool import CATALOGUE
from docs import pictures
from docs.pictures import cutter_mesh, evenly, save, spheres_picture


def test_equal_figures_give_equal_bytes(tmp_path: Path) -> None:
    for name in ("a.png", "b.png"):
        save(spheres_picture(), tmp_path / name)
    first = (tmp_path / "a.png").read_bytes()
    assert first == (tmp_path / "b.png").read_bytes()
    assert b"matplotlib" not in first.lower()
    assert (pictures.PICTURES / "spheres.png").is_file()


def test_a_file_that_stays_too_large_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pictures, "LARGEST_BYTES", 10)
    with pytest.raises(ValueError, match=r"a\.png has \d+ bytes, more than 10"):
        save(Figure(figsize=(1.0, 1.0)), tmp_path / "a.png")
    assert not (tmp_path / "a.png").exists()


def test_evenly_goes_by_travel() -> None:
    x = np.array([0.0, 0.1, 0.2, 0.3, 5.0, 9.9, 10.0])
    assert evenly(np.stack([x, 0 * x, 0 * x], axis=1), 3) == [0, 4, 6]


def test_the_drawn_cutter_is_the_tool() -> None:
    """Tip, tangent ball and cone, radii at both ends."""
    tool = CATALOGUE["T3"]
    tip, axis = np.array([3.0, -2.0, 1.0]), np.array([0.0, 0.6, 0.8])
    flute, shank = cutter_mesh(tool, tip, axis)
    height = (flute.vertices - tip) @ axis
    radius = np.linalg.norm(flute.vertices - tip - height[:, None] * axis, axis=1)
    assert height.min() == pytest.approx(0.0, abs=1e-12)
    ball = height <= tool.ball_radius * (1.0 - sin(tool.half_angle)) + 1e-9
    assert np.hypot(radius, height - tool.ball_radius)[ball] == pytest.approx(tool.ball_radius)
    # The ball ends where the cone begins: at r_min, in the plane of r_min.
    joint = height[ball].max()
    assert (joint, radius[ball].max()) == pytest.approx((-tool.tip_height, tool.ball_radius * cos(tool.half_angle)))
    assert radius.max() == pytest.approx(tool.r_max)
    assert height.max() == pytest.approx(tool.length - tool.tip_height)
    assert ((shank.vertices - tip) @ axis).min() == pytest.approx(height.max())
