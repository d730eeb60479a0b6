"""Selection on a plane that a cylinder cuts in strips, where coverage and gaps can be told beforehand."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import msgspec
import numpy as np
import pytest

from benchmarks.envelopes import swept_gap
from conflank_cli.coverage import Reason
from conflank_cli.geometry.face import CheckMesh
from conflank_cli.geometry.gap import motion_gap
from conflank_cli.geometry.workface import WorkFace
from conflank_cli.motion import Motion, uniform_knots
from conflank_cli.progress import SilentProgress
from conflank_cli.scene import Scene
from conflank_cli.selection import select
from conflank_cli.selection.choice import LINK_SECONDS, TOOL_CHANGE_SECONDS
from conflank_cli.selection.judging import Face
from conflank_cli.sweep import Sweep
from conflank_cli.tool import Section, Tool
from tests.verification.scenes import cylinder_face, plane_face, scene_of, triangles_of

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


def with_check(scene: Scene, *quads: list[list[float]], face: int = 9) -> Scene:
    return scene.checking(triangles_of(*quads, face=face))


def test_what_is_in_the_way_is_named_and_the_rest_is_left_for_its_reason() -> None:
    """A wall across the lower strip at x = 20: its shorter part is lost to the wall, the longer one is not needed."""
    wall = [[20.0, 5.0, 1.0], [20.0, 15.0, 1.0], [20.0, 15.0, 30.0], [20.0, 5.0, 30.0]]
    scene = with_check(plate_scene(0.45), wall)
    choice = select(scene, [strip(0.0), strip(20.0)], SilentProgress())
    (face,) = choice.summary["faces"]
    # The upper strip alone does; of the lower one the cylinder of radius 3 comes up to 3 mm before or after the wall.
    assert face["sweeps"] == 1 and choice.summary["rejected"] == 0
    lost = face["left_mm2"]
    assert set(lost) <= {"not_chosen", "collision", "small"}
    assert face["in_the_way_mm2"] == {"cone too near to face 9": pytest.approx(lost["collision"], rel=0.2)}
    assert lost["collision"] == pytest.approx((20.0 + 3.0) * FLUTE, rel=0.1)
    (points,) = choice.coverage
    assert points.areas.sum() == pytest.approx(WIDTH * HEIGHT)
    assert points.area(Reason.COLLISION) == pytest.approx(lost["collision"])
    forbidden = points.uv[points.reason == Reason.COLLISION]
    assert forbidden[:, 0].max() < 24.0 and forbidden[:, 1].max() < 21.0
    assert set(points.sweep[points.reason == Reason.COVERED]) == {0}
    assert set(points.sweep[points.reason != Reason.COVERED]) == {-1}


def test_nothing_can_be_cut_under_a_lid() -> None:
    """The plan is empty, and says what forbids every sweep."""
    lid = [[-10.0, -10.0, 4.0], [60.0, -10.0, 4.0], [60.0, 50.0, 4.0], [-10.0, 50.0, 4.0]]
    choice = select(with_check(plate_scene(), lid), [strip(0.0), strip(20.0)], SilentProgress())
    assert choice.plan == [] and choice.summary["coverage"] == 0.0
    (face,) = choice.summary["faces"]
    assert face["left_mm2"] == {"collision": pytest.approx(WIDTH * HEIGHT)}
    assert any(what.endswith("face 9") for what in face["in_the_way_mm2"])


def test_where_no_line_fits() -> None:
    """A cylinder of radius 3 within a trough of radius 2."""
    trough = replace(cylinder_face(2.0, (0.0, 30.0)), sense=1)
    scene = scene_of(trough, tools=(TOOL,))
    (face,) = select(scene, [], SilentProgress()).summary["faces"]
    assert face["left_mm2"] == {"no_line": pytest.approx(np.pi * 30.0, rel=1e-3)}


def test_a_sweep_a_little_too_deep_is_moved_off_the_face() -> None:
    """11 µm too deep all along: cutting it short would leave nothing, and moving it off by 2 µm all of it."""
    plan, summary = selected(plate_scene(0.4), [strip(0.0, off=-0.011)], SilentProgress())
    assert summary["coverage"] == pytest.approx(0.5, abs=0.02)
    assert -9.5 - 1e-6 < plan[0].facts["gap_min_um"] < -9.0


def test_the_least_time_is_not_the_fewest_sweeps() -> None:
    """One slow tool over everything against two quick ones side by side."""
    slow = replace(TOOL, name="SLOW", length=41.0, number=2, feed_mm_min=200.0)
    wide = replace(strip(0.0), tool="SLOW")
    wide = replace(wide, motion=replace(wide.motion, q=wide.motion.p + np.array([0.0, 41.0, 0.0])))
    sweeps = [wide, strip(0.0), strip(20.0)]
    found = {}
    for objective in ("sweeps", "time"):
        scene = replace(plate_scene(0.95), tools=(TOOL, slow))
        selection = msgspec.structs.replace(scene.job.selection, objective=objective)
        scene = replace(scene, job=msgspec.structs.replace(scene.job, selection=selection))
        choice = select(scene, sweeps, SilentProgress())
        found[objective] = sorted(sweep.tool for sweep in choice.plan), choice.summary["faces"][0]["price"]
    assert found["sweeps"] == (["SLOW"], 1.0)
    assert found["time"][0] == ["C", "C"]
    # 56 mm and the clearance twice at 1000 mm/min, a way to and from each, one tool.
    assert found["time"][1] == pytest.approx(2 * (60.0 * 66.0 / 1000.0 + LINK_SECONDS) + TOOL_CHANGE_SECONDS, rel=1e-3)


def test_of_as_few_sweeps_those_of_one_tool() -> None:
    other = replace(TOOL, name="D", number=2)
    scene = replace(plate_scene(0.95), tools=(TOOL, other))
    sweeps = [replace(strip(0.0), tool="D"), strip(20.0), strip(0.0, off=0.0005)]
    plan, summary = selected(scene, sweeps, SilentProgress())
    assert [sweep.tool for sweep in plan] == ["C", "C"]
    assert summary["tool_changes"] == 0


def test_what_the_screen_misses_between_its_poses_is_not_chosen() -> None:
    """A spike that hangs over the way, its tip 15 um too low: the screen's poses stand 0.4 and 0.6 mm beside it."""
    tip = np.array([10.4, 10.0, 5.985])
    spike = CheckMesh(
        tip + np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 9.0], [-0.1, 0.0, 9.0]]),
        np.array([[0, 1, 2]], dtype=np.int32), np.array([9], dtype=np.int32),
    )  # fmt: skip
    plan, _ = selected(plate_scene(0.3).checking(spike), [strip(0.0)], SilentProgress())
    (sweep,) = plan
    p, _ = sweep.motion.ends(np.linspace(0.0, 1.0, 2001))
    # No pose within sqrt(6 * 0.005) mm of the tip's x is left: there the tip is more than 10 um within the flute.
    assert np.abs(p[:, 0] - tip[0]).min() > 0.17
    assert plan[0].facts["covered_area_mm2"] < 0.9 * WIDTH * FLUTE


def test_an_overcut_between_all_points_is_not_chosen() -> None:
    """A dip so narrow that the cylinder leaves an arc of its own radius, midway between two columns of points."""
    face = Face.of(PLATE)
    fine, coarse = (np.unique(np.round(samples.points[:, 0], 9)) for samples in (face.fine, face.coarse))
    between = 0.5 * (fine[1:] + fine[:-1])
    between = between[(between > 20.0) & (between < 30.0)]
    x0 = float(between[np.argmax([np.abs(coarse - x).min() for x in between])])
    count, depth = 401, 0.0105
    knots = uniform_knots(count)
    greville = np.array([knots[k + 1 : k + 4].mean() for k in range(count)])
    x = -3.0 + greville * (WIDTH + 6.0)
    # A cubic takes two thirds of what a single control point is lowered by; this one is moved to the middle.
    dip = int(np.argmin(np.abs(x - x0)))
    x += x0 - x[dip]
    z = np.full(count, 3.0)
    z[dip] -= 1.5 * depth
    p = np.stack([x, np.zeros(count), z], axis=1)
    sweep = Sweep(0, "C", Motion(knots, p, p + np.array([0.0, FLUTE, 0.0])), {})
    around = np.stack([x0 + np.linspace(-0.4, 0.4, 801), np.full(801, 10.0), np.zeros(801)], axis=1)

    def deepest(points: np.ndarray, cut: Sweep) -> float:
        return float(motion_gap(cut.motion, TOOL, points, 0.0)[0].min())

    tolerance = 0.010 - 0.0005
    assert deepest(around, sweep) == pytest.approx(-depth, abs=1e-5)
    assert min(deepest(face.fine.points, sweep), deepest(face.coarse.points, sweep)) > -tolerance
    plan, summary = selected(plate_scene(0.45), [sweep], SilentProgress())
    assert summary["coverage"] > 0.45
    for chosen in plan:
        assert deepest(around, chosen) >= -tolerance - 1e-6
        assert chosen.facts["certified_overcut_um"] <= 9.5


def test_the_rest_of_a_face_is_kept_by_what_is_chosen() -> None:
    """A strip that rises out of its region as deep as it may, and one that goes 20 um deeper beside it."""
    scene = replace(plate_scene(0.3), rest=(plane_face((WIDTH, WIDTH + 20.0), (0.0, HEIGHT)),))
    for turn, whole in ((0.0, True), (-0.030, False)):
        lower = strip(0.0, (-3.0, WIDTH + 15.0), off=-0.4 * turn, turn=turn)
        plan, _ = selected(scene, [lower], SilentProgress())
        end = max(float(cut.motion.ends([0.0, 1.0])[0][:, 0].max()) for cut in plan)
        assert (end > WIDTH + 14.9) is whole
