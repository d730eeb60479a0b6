"""Figures of a small program: they are drawn, equal inputs give equal bytes, and their numbers are right."""

from collections.abc import Callable

import numpy as np
import pytest
from matplotlib.figure import Figure

from conflank_cli.report import figures
from conflank_cli.sweep import Sweep
from conflank_cli.verification.posed import pose_program
from tests.report.test_document import scene
from tests.report.test_gap_map import FACE, lying_cone
from tests.report.test_models import lying
from tests.verification.scenes import scene_of

POSED = pose_program(lying_cone(0.003), scene())
DRAWN: dict[str, Callable[[], Figure]] = {
    "coverage": lambda: figures.coverage_figure(scene(), POSED),
    "gap": lambda: figures.gap_figure(scene(), POSED),
    "sweeps": lambda: figures.sweeps_figure(scene(), POSED),
    "axes": lambda: figures.axes_figure(scene(), POSED),
    "lines": lambda: figures.lines_figure(scene(), [Sweep(0, "T1", lying())]),
}
MAGIC = {".png": b"\x89PNG", ".svg": b"<?xml", ".pdf": b"%PDF"}


@pytest.mark.parametrize("name", DRAWN)
def test_equal_inputs_give_equal_figures(name: str) -> None:
    kind = {"axes": ".svg", "sweeps": ".pdf"}.get(name, ".png")
    data = figures.encoded(DRAWN[name](), kind)
    assert data.startswith(MAGIC[kind])
    assert data == figures.encoded(DRAWN[name](), kind)


def test_the_range_of_the_gap_is_in_its_title() -> None:
    title = figures.gap_figure(scene_of(FACE), POSED).axes[0].get_title()
    assert "mean |g| 3." in title and ".. 10.0 µm" in title


def test_what_one_sweep_covers() -> None:
    """20 mm by the length of the generator, of 30 by 28 mm."""
    panel, other = figures.sweeps_figure(scene(), POSED).axes
    # Beside the sweep the cone is round, and above its end the ball is: both stay within 10 um for a little.
    covered = panel.lines[0].get_ydata()[0]
    assert covered == pytest.approx(100.0 * 20.0 * 22.0 / (30.0 * 28.0), abs=4.0)
    assert other.lines[0].get_ydata()[0] == pytest.approx(3.0, abs=0.3)


def test_what_stands_before_a_face_is_cut_away_and_what_is_behind_it_stays() -> None:
    from conflank_cli.report.gap_map import face_grid

    grid = face_grid(FACE, (20, 20))
    camera = figures._camera(grid, 0.4)
    points = np.array([[15.0, 16.0, 5.0], [15.0, 16.0, -5.0], [15.0, 16.0, 0.0]])
    assert (figures._in_front(camera, points, grid.points[grid.inside]) > 0.0).tolist() == [True, False, False]
