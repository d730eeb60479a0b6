"""Selection on a plane that a cylinder cuts in strips, where coverage and gaps can be told beforehand."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import msgspec
import numpy as np
import pytest

from benchmarks.envelopes import swept_gap
from conflank_cli.geometry.workface import WorkFace
from conflank_cli.motion import Motion, uniform_knots
from conflank_cli.progress import SilentProgress
from conflank_cli.scene import Scene
from conflank_cli.selection import select
from conflank_cli.sweep import Sweep
from conflank_cli.tool import Section, Tool
from tests.verification.scenes import plane_face, scene_of

FLUTE = 20.0
# The shank is slimmer than the flute, so that strips may lie side by side.
TOOL = Tool("C", 3.0, 3.0, FLUTE, (Section(4.0, 4.0, 60.0),), ())
WIDTH, HEIGHT = 50.0, 40.0
PLATE = plane_face((0.0, WIDTH), (0.0, HEIGHT))


def strip(low: float, x: tuple[float, float] = (-3.0, WIDTH + 3.0), off: float = 0.0, turn: float = 0.0) -> Sweep:
    """The tool lies along y from `low` on and moves along x, `off` mm above the plane; `turn` lifts it on the way."""
    knots = uniform_knots(6)
    greville = np.array([knots[k + 1 : k + 4].mean() for k in range(6)])
    p = np.stack([x[0] + greville * (x[1] - x[0]), np.full(6, low), 3.0 + off + turn * greville], axis=1)
    return Sweep(0, "C", Motion(knots, p, p + np.array([0.0, FLUTE, 0.0])), {"lines": 7.0})


def plate_scene(coverage: float = 1.0, allowance: float = 0.0) -> Scene:
    scene = scene_of(PLATE, tools=(TOOL,))
    job = msgspec.structs.replace(
        scene.job,
        selection=msgspec.structs.replace(scene.job.selection, coverage=coverage),
        tolerance=msgspec.structs.replace(scene.job.tolerance, allowance=allowance),
    )
    return replace(scene, job=job)


def selected(scene: Scene, sweeps: list[Sweep], progress: SilentProgress) -> tuple[list[Sweep], dict[str, Any]]:
    choice = select(scene, sweeps, progress)
    return choice.plan, choice.summary


def test_two_strips_cover_the_plate_and_a_third_between_them_is_not_taken() -> None:
    sweeps = [strip(10.0), strip(0.0), strip(20.0)]
    plan, summary = selected(plate_scene(), sweeps, SilentProgress())
    assert sorted(float(sweep.motion.p[0, 1]) for sweep in plan) == [0.0, 20.0]
    assert summary["coverage"] == pytest.approx(1.0, abs=1e-12)
    assert summary["sweeps"] == 2 and summary["screened"] == 3 and summary["rejected"] == 0
    assert summary["gap_mean_abs_um"] == pytest.approx(0.0, abs=1e-6)
    (face,) = summary["faces"]
    assert (face["face"], face["sweeps"], face["coverage"]) == (0, 2, pytest.approx(1.0))
    assert (face["price"], face["greedy"], face["bound"], face["gap"]) == (2.0, 2.0, 2.0, 0.0)
    assert face["left_mm2"] == face["in_the_way_mm2"] == {}
    for sweep in plan:
        assert sweep.facts["lines"] == 7.0  # what stages before have measured stays
        assert sweep.facts["length_mm"] == pytest.approx(WIDTH + 6.0, abs=1e-6)
        assert sweep.facts["covered_area_mm2"] == pytest.approx(WIDTH * FLUTE, rel=0.02)
        # All of the strip but its borders is certain, and below the flute what the ball leaves less than 9.5 µm on.
        ball = WIDTH * np.sqrt(2.0 * 3.0 * 0.0095)
        assert WIDTH * FLUTE - 5.0 < sweep.facts["certified_area_mm2"] < WIDTH * FLUTE + ball
        assert 0.0 <= sweep.facts["certified_overcut_um"] < 0.8
        assert sweep.facts["certified_gap_um"] < 9.5 + 1e-9


def test_coverage_and_mean_gap_are_those_of_the_plan() -> None:
    """A strip that is lifted from 0 to 20 µm on its way covers half of its length, with 5 µm on average."""
    plan, summary = selected(plate_scene(), [strip(0.0, (0.0, WIDTH), turn=0.020)], SilentProgress())
    (sweep,) = plan
    # The tool stands square to the plane along its contact, so that g(x) is the lift at x.
    half = 0.5 * WIDTH * FLUTE
    assert sweep.facts["covered_area_mm2"] == pytest.approx(half, rel=0.07)
    assert summary["coverage"] == pytest.approx(half / (WIDTH * HEIGHT), rel=0.07)
    assert summary["gap_mean_abs_um"] == pytest.approx(5.0, rel=0.07)
    # And by brute force on the points that selection itself judges.
    face = WorkFace.of(PLATE, 0.0)
    samples = face.samples(face.spacing(6000))
    some = np.arange(0, len(samples.areas), 7)

    def axis(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        p, q = sweep.motion.ends(t)
        return p, (q - p) / np.linalg.norm(q - p, axis=1)[:, None]

    gap, _ = swept_gap(TOOL, axis, samples.points[some], 201)
    expected = samples.areas[some][np.abs(gap) <= 0.0095].sum() / samples.areas[some].sum()
    assert summary["coverage"] == pytest.approx(expected, abs=0.02)


@pytest.mark.parametrize("allowance", [0.0, 0.5])
def test_overcut_beyond_the_tolerance_is_rejected(allowance: float) -> None:
    """20 µm too deep from end to end; an allowance raises what counts as too deep."""
    deep, good = strip(0.0, off=allowance - 0.020), strip(20.0, off=allowance)
    plan, summary = selected(plate_scene(allowance=allowance), [deep, good], SilentProgress())
    assert [float(sweep.motion.p[0, 1]) for sweep in plan] == [20.0]
    assert summary["rejected"] == 1
    assert summary["coverage"] == pytest.approx(0.5, abs=0.02)


def test_large_allowance_is_judged_as_finely_as_none() -> None:
    """With stock of 0.5 mm to leave, g is near 0.5 where it counts, and between poses it must be refined there as well.

    A tool that stands upright on its ball: halfway between poses 1 mm apart the ball is 40 µm further away.
    """
    knots = uniform_knots(6)
    greville = np.array([knots[k + 1 : k + 4].mean() for k in range(6)])
    results = []
    for allowance in (0.0, 0.5):
        p = np.stack([greville * WIDTH, np.full(6, 20.1), np.full(6, 3.0 + allowance)], axis=1)
        sweep = Sweep(0, "C", Motion(knots, p, p + np.array([0.0, 0.0, FLUTE])), {})
        plan, _ = selected(plate_scene(0.01, allowance), [sweep], SilentProgress())
        results.append(sum(chosen.facts["covered_area_mm2"] for chosen in plan))
    # 9.5 µm is left up to 0.24 mm from the middle: one row of samples.
    assert results[0] > 20.0
    assert results[1] == pytest.approx(results[0], rel=1e-6)


def test_more_accurate_of_equal_sweeps() -> None:
    plan, summary = selected(plate_scene(), [strip(0.0, off=0.004), strip(0.0)], SilentProgress())
    assert len(plan) == 1
    assert summary["gap_mean_abs_um"] == pytest.approx(0.0, abs=1e-6)


def test_enough_is_enough() -> None:
    plan, summary = selected(plate_scene(0.45), [strip(0.0), strip(20.0)], SilentProgress())
    assert len(plan) == 1
    assert summary["coverage"] == pytest.approx(0.5, abs=0.02)


def test_nothing_to_select_from() -> None:
    plan, summary = selected(plate_scene(), [], SilentProgress())
    assert plan == []
    assert summary["coverage"] == 0.0
    assert summary["gap_mean_abs_um"] is None
    (face,) = summary["faces"]
    assert (face["face"], face["coverage"], face["sweeps"]) == (0, 0.0, 0)
    # Lines of a cylinder fit a plane everywhere.
    assert face["left_mm2"] == {"no_sweep": pytest.approx(WIDTH * HEIGHT)}


def test_nothing_fits() -> None:
    plan, summary = selected(plate_scene(), [strip(0.0, off=-1.0)], SilentProgress())
    assert plan == []
    assert summary["rejected"] == summary["screened"] == 1
    assert summary["coverage"] == 0.0
