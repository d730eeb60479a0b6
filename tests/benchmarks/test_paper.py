"""What `make paper` works out from sweeps: strips, greedy order, coverage of a program, errors."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.detection import whole
from benchmarks.paper import CYLINDER, MOST, Posted, greedy_order, spread, verdicts, widest
from benchmarks.strips import METHODS, bands, by_strips, cutting_seconds, gap_of
from conflank_cli.geometry.surface import BSplineSurface
from conflank_cli.geometry.workface import WorkFace
from conflank_cli.motion import Motion, fitted
from conflank_cli.sweep import Sweep
from conflank_cli.tool import CATALOGUE

T1 = CATALOGUE["T1"]
BENT = np.array([0.0, 0.0, 0.0, 1.0, 1.0, 1.0])


def parabolic_cylinder(width: float) -> WorkFace:
    """z = -x² / 100 over x in [-10, 10] and y in [0, width], u along x; its rulings run along y."""
    poles = np.zeros((3, 2, 3))
    poles[..., 0] = np.array([-10.0, 0.0, 10.0])[:, None]
    poles[..., 1] = [0.0, width]
    poles[..., 2] = 0.01 * np.array([-100.0, 100.0, -100.0])[:, None]
    return WorkFace.under(whole(BSplineSurface(2, 1, BENT, np.array([0.0, 0.0, 1.0, 1.0]), poles), 1), T1)


@pytest.mark.parametrize("name", METHODS)
def test_strips_as_wide_as_the_flute_cover_a_developable_face(name: str) -> None:
    """The face is cut exactly along its rulings, so the method must find those, and two strips of 20 mm do."""
    face = parabolic_cylinder(40.0)
    samples = face.samples(1.0)
    found = by_strips(face, T1, METHODS[name], 2, samples, 0.010)
    assert found.way[0] == "u" and len(found.motions) == 2
    assert found.coverage(samples, 0.010) == 1.0
    # One strip is cut where the flute reaches, not beyond.
    one = by_strips(face, T1, METHODS[name], 1, samples, 0.010)
    assert one.coverage(samples, 0.010) == pytest.approx(T1.length / 40.0, abs=0.05)


def test_strips_cover_the_face_and_are_no_wider_than_the_flute() -> None:
    face = parabolic_cylinder(40.0)
    narrow = bands(face, T1, ("u", True), 4)
    np.testing.assert_allclose([band.box for band in narrow], [(0, 1, k / 4, (k + 1) / 4) for k in range(4)], atol=1e-9)
    (wide,) = bands(face, T1, ("u", True), 1)
    assert 40.0 * (wide.box[3] - wide.box[2]) == pytest.approx(0.95 * T1.length)
    assert 0.5 * (wide.box[2] + wide.box[3]) == pytest.approx(0.5)


def test_a_straight_sweep_takes_its_length_at_the_feed_of_the_faster_end() -> None:
    t = np.linspace(0.0, 1.0, 40)
    p = np.stack([20.0 * t, 0.0 * t, 0.0 * t], axis=1)
    q = p * [1.5, 1.0, 1.0] + [0.0, 0.0, T1.length]
    assert cutting_seconds(fitted(t, np.hstack([p, q]), 8), T1) == pytest.approx(30.0 / 1000.0 * 60.0, rel=1e-6)


def test_the_gap_of_several_sweeps_is_the_least() -> None:
    face = parabolic_cylinder(20.0)
    samples = face.samples(2.0)
    motion = by_strips(face, T1, METHODS["two points"], 1, samples, 0.010).motions[0]
    off_the_face = np.array([0.0, 0.0, 0.05])
    off = Motion(motion.knots, motion.p + off_the_face, motion.q + off_the_face)
    alone = gap_of([off], T1, samples)
    assert np.abs(gap_of([off, motion], T1, samples)).max() < 1e-3 < alone.min()


def posted(gaps: list[list[float]]) -> Posted:
    motion = fitted(np.linspace(0, 1, 20), np.random.default_rng(1).normal(size=(20, 6)), 6)
    sweeps = [Sweep(0, name, motion, {}) for name in ("T1", "T2", "T1")[: len(gaps)]]
    return Posted(sweeps, np.array(gaps), np.arange(1.0, len(gaps) + 1.0))


def test_sweeps_are_put_in_the_order_in_which_each_adds_most() -> None:
    areas = np.array([1.0, 2.0, 4.0, 8.0])
    covers = np.array([[1, 1, 1, 0], [0, 0, 1, 1], [1, 1, 0, 0]], dtype=np.bool_)
    assert greedy_order(covers, areas, MOST) == [1, 0]  # the third adds nothing any more
    assert greedy_order(covers, areas, 1) == [1]
    assert greedy_order(np.zeros((0, 4), dtype=np.bool_), areas, MOST) == []


def test_an_exchange_covers_more_than_the_largest_first() -> None:
    """The largest is in the middle; the two at its sides cover all."""
    areas = np.ones(10)
    covers = np.zeros((3, 10), dtype=np.bool_)
    covers[0, 2:8] = covers[1, :5] = covers[2, 5:] = True
    assert greedy_order(covers, areas, 2) == [0, 1]
    assert sorted(widest(covers, areas, 2)) == [1, 2]
    assert widest(covers[:0], areas, 2) == []


def test_what_a_later_sweep_gouges_is_not_covered() -> None:
    """Gaps in mm: the second sweep covers the second half, and cuts 20 µm too deep where the first was right."""
    found = posted([[0.001, 0.5], [-0.020, 0.002]])
    np.testing.assert_allclose(found.coverage(np.array([3.0, 1.0])), [0.75, 0.25])
    ordered = found.greedy(np.array([3.0, 1.0]))
    assert [sweep.tool for sweep in ordered.sweeps] == ["T1", "T2"]
    three = posted([[0.0, 0.1], [0.1, 0.0], [0.0, 0.0]])
    assert len(three.of_tools(["T1"]).sweeps) == 2
    one, others = three.first(1)
    assert [sweep.tool for sweep in one.sweeps] == ["T1"] and [sweep.tool for sweep in others.sweeps] == ["T2", "T1"]
    np.testing.assert_array_equal(others.gaps, three.gaps[1:])
    assert three.first(3)[1].gaps.shape == (0, 2)


def test_a_coverage_that_is_missed_stands_beside_what_is_in_reach() -> None:
    sweep = {"epsilon_um": {"mean_abs": 2.0}, "rulings_epsilon_um": {"mean_abs": 50.0}}
    tools = {"T1": {"largest": [sweep]}}
    rows = [
        {"face": "a", "sample": True, "tools": tools, "together": {"best": 0.934}},
        {"face": "b", "sample": True, "tools": tools, "together": {"best": 0.8, "reachable": 0.873}},
        {"face": "c", "sample": False, "tools": tools, "together": {"best": 0.1}},
    ]
    found = verdicts(rows)
    assert [(verdict.found, verdict.reached) for verdict in found[:2]] == [
        ("93.4", True),
        ("80.0 of 87.3 in reach", False),
    ]
    assert len(found) == 5


def test_errors_are_stated_by_area_with_their_sign() -> None:
    assert spread(np.array([0.001, -0.003]), np.array([3.0, 1.0])) == {
        "mean_abs": 1.5,
        "mean": 0.0,
        "min": -3.0,
        "max": 1.0,
    }


def test_the_cylinder_is_as_thick_as_the_cone_in_its_middle() -> None:
    assert CYLINDER.half_angle == 0.0 and CYLINDER.length == T1.length
    assert CYLINDER.r_min == 0.5 * (T1.r_min + T1.r_max) == 0.5 * CYLINDER.shank[0].diameter_low
    assert CYLINDER.number not in {tool.number for tool in CATALOGUE.values()}
