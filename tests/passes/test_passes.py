"""Passes over faces with closed forms, judged by the verification of what is posted."""

from dataclasses import replace
from math import sin

import msgspec
import numpy as np
import pytest

from conflank_cli.geometry.face import CheckMesh, DesignFace
from conflank_cli.geometry.workface import WorkFace
from conflank_cli.job import BallPasses, Selection, Tolerance
from conflank_cli.passes import ball_passes, distance_to_polyline
from conflank_cli.passes.axes import CONE_OFF, DEAD_CENTRE
from conflank_cli.passes.region import Grid
from conflank_cli.posting import post_program
from conflank_cli.progress import SilentProgress
from conflank_cli.scene import Scene
from conflank_cli.sweep import Sweep
from conflank_cli.tool import Tool
from conflank_cli.verification.judge import verify_program
from conflank_cli.verification.result import Verification
from tests.faces import design, interpolated, round_face, stacked
from tests.posting.test_program import motion_of
from tests.verification.scenes import NOTHING, T1, lying_on_plane, plane_face, triangles_of
from tests.verification.scenes import scene_of as plain_scene

POINTS = 6000
SILENT = SilentProgress()


def scene_of(
    face: DesignFace,
    check: CheckMesh = NOTHING,
    tolerance: Tolerance | None = None,
    scallop: float = 0.005,
    tool: Tool = T1,
) -> Scene:
    scene = plain_scene(face, check=check, tolerance=tolerance or Tolerance(), tools=(tool,))
    selection = Selection(coverage=1.0, ball_passes=BallPasses(enabled=True, scallop=scallop))
    return replace(scene, job=msgspec.structs.replace(scene.job, selection=selection))


def judged(scene: Scene, sweeps: tuple[Sweep, ...] = ()) -> tuple[Verification, dict[str, object]]:
    passes, summary = ball_passes(scene, sweeps, SILENT)
    text, _ = post_program(scene, sweeps, passes)
    return verify_program(text, scene, "", POINTS), summary["passes_by_face"][0]


def sphere_face(radius: float, sense: int) -> DesignFace:
    def shape(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        return radius * stacked(np.cos(u) * np.cos(v), np.sin(u) * np.cos(v), np.sin(v))

    return design(interpolated(shape, (-0.1, 0.1), (0.8, 1.0)), sense)


FACES = {
    "plane": plane_face((0.0, 6.0), (0.0, 4.0)),
    "cylinder": design(round_face(8.0, height=6.0, turn=0.6), 1),
    "hollow": design(round_face(8.0, height=6.0, turn=0.6), -1),
    "ball": sphere_face(25.0, 1),
}


@pytest.mark.parametrize("name", FACES)
@pytest.mark.parametrize("scallop", [0.003, 0.008])
def test_a_whole_face_by_ball_alone_has_the_scallop_asked_for(name: str, scallop: float) -> None:
    result, report = judged(scene_of(FACES[name], scallop=scallop))
    assert result.findings == ()
    assert result.coverage == pytest.approx(1.0)
    assert result.coverage_flank < 0.5
    assert report["coverage"] == pytest.approx(1.0)
    # No higher than asked, and not much lower either: that would be time for nothing. 0.5 um is what posting may cost.
    assert result.stock_max_um is not None
    assert 0.75 * 1e3 * scallop <= result.stock_max_um <= 1e3 * scallop + 0.5
    assert result.overcut_max_um <= 0.5
    assert not result.sweeps and all(item.number == k for k, item in enumerate(result.passes, start=1))


@pytest.mark.parametrize(("over", "under"), [(0.0, 0.02), (0.02, 0.002)])
def test_a_tolerance_to_one_side_is_kept(over: float, under: float) -> None:
    result, _ = judged(scene_of(FACES["plane"], tolerance=Tolerance(over, under)))
    assert result.findings == ()
    assert result.coverage == pytest.approx(1.0)
    assert result.overcut_max_um <= 1e3 * over


def test_an_allowance_is_left() -> None:
    result, _ = judged(scene_of(FACES["cylinder"], tolerance=Tolerance(allowance=0.2)))
    assert result.findings == ()
    assert result.coverage == pytest.approx(1.0)
    assert result.stock_max_um is not None and result.stock_max_um <= 5.5


def test_contacts_are_on_the_ball_and_off_its_dead_centre() -> None:
    (item,) = ball_passes(scene_of(FACES["plane"]), (), SILENT)[0]
    angle = np.arccos(item.axis[:, 2])
    assert angle.min() >= DEAD_CENTRE - 1e-9
    assert angle.max() <= 0.5 * np.pi - T1.half_angle - 0.5 * CONE_OFF
    assert item.tip[:, 2] + T1.ball_radius * item.axis[:, 2] == pytest.approx(T1.ball_radius, abs=1e-9)
    assert np.linalg.norm(item.axis, axis=1) == pytest.approx(1.0)


def test_a_hollow_smaller_than_the_ball_is_left_and_the_summary_says_why() -> None:
    passes, summary = ball_passes(scene_of(design(round_face(1.2, height=4.0, turn=1.0), -1)), (), SILENT)
    (report,) = summary["passes_by_face"]
    assert passes == []
    assert report["left_mm2"] == {"the ball does not fit": pytest.approx(4.8, rel=1e-3), "no axis is free": 0.0}


def test_under_a_lid_no_axis_is_free() -> None:
    """A plate 2 mm above the face as far as x = 3: the ball, its centre 1.5 mm up, goes until it touches its edge."""
    lid = triangles_of([[-9, -9, 2], [3, -9, 2], [3, 9, 2], [-9, 9, 2]])
    result, report = judged(scene_of(plane_face((0.0, 8.0), (0.0, 3.0)), check=lid))
    assert {finding.code for finding in result.findings} == {"CF202"}
    last = 3.0 + np.sqrt(T1.ball_radius**2 - (2.0 - T1.ball_radius) ** 2)
    # Beside its last contact a ball leaves 10 um as far as sqrt(2 R 10 um).
    beside = np.sqrt(2.0 * T1.ball_radius * 0.01)
    assert (8.0 - last) / 8.0 - 0.01 < result.coverage < (8.0 - last + beside) / 8.0 + 0.01
    assert report["left_mm2"]["no axis is free"] == pytest.approx(24.0 * (1.0 - result.coverage), rel=0.05)


def half_cut(depth: float) -> Sweep:
    """T1 lying on the plane z = 0, sunk by `depth`, driven along x over the strip y >= 3 of a face 0 .. 8."""
    _, tip, axis = lying_on_plane(T1, -depth)
    # The first contact on the cone is r_min sin(half angle) beside the p end.
    start = tip + np.array([0.0, 3.0 + T1.r_min * sin(T1.half_angle), 0.0])
    tips = start + np.linspace(-2.0, 10.0, 60)[:, None] * [1.0, 0.0, 0.0]
    return Sweep(0, "T1", motion_of(tips, np.tile(axis, (60, 1)), "T1"))


@pytest.mark.parametrize("depth", [0.0, 0.0075])
def test_passes_finish_what_a_sweep_leaves_without_a_step(depth: float) -> None:
    scene = scene_of(plane_face((0.0, 8.0), (0.0, 8.0)))
    result, report = judged(scene, (half_cut(depth),))
    assert result.findings == ()
    assert result.coverage == pytest.approx(1.0)
    assert result.coverage_flank == pytest.approx(5.0 / 8.0, abs=0.05)
    assert report["coverage_flank"] == pytest.approx(result.coverage_flank, abs=0.02)
    assert [item.number for item in result.passes] == list(range(2, 2 + len(result.passes)))
    # The strip and a little beside it, not the whole face.
    length, spacing = sum(item.length_mm for item in result.passes), 0.245
    assert length < 1.6 * 8.0 * 3.0 / spacing
    assert result.step_max_um is not None and result.step_max_um <= 10.0


def test_where_the_sweeps_do_it_all_there_is_no_pass() -> None:
    sweep = half_cut(0.0)
    passes, summary = ball_passes(scene_of(plane_face((0.0, 8.0), (3.5, 8.0))), (sweep,), SILENT)
    assert passes == [] and summary["passes"] == 0
    assert summary["passes_by_face"][0]["coverage"] == pytest.approx(1.0)


def test_equal_inputs_give_equal_passes() -> None:
    one, other = (ball_passes(scene_of(FACES["hollow"]), (), SILENT)[0] for _ in range(2))
    assert len(one) == len(other)
    assert all(np.array_equal(a.tip, b.tip) and np.array_equal(a.axis, b.axis) for a, b in zip(one, other, strict=True))


def test_the_sink_takes_off_what_a_step_has_too_much() -> None:
    grid = Grid.of(WorkFace.of(plane_face((0.0, 10.0), (0.0, 10.0)), 0.0))
    across = grid.points[..., 0]
    gap = np.where(across < 5.0, -0.007, np.inf)
    cut = across > 4.7
    sink = grid.sink(gap, cut, 0.005, 0.010, 0.009)
    assert sink[(across >= 4.7) & (across < 5.3)] == pytest.approx(0.002, abs=1e-12)
    assert sink[across > 7.0] == pytest.approx(0.0, abs=1e-12)
    assert np.abs(np.diff(sink, axis=0)).max() <= 0.002 * grid.pitch[0] / 0.4 + 1e-12
    assert grid.sink(gap, cut, 0.005, 0.010, 0.001).max() == pytest.approx(0.001)
    # Stock of 10 um that no pass takes off keeps them from going deeper beside it.
    stock = np.where(across < 4.4, 0.010, gap)
    assert grid.sink(stock, cut, 0.005, 0.010, 0.009)[across < 4.4] == pytest.approx(0.0, abs=1e-12)


def test_distance_to_a_polyline() -> None:
    corners = np.array([[0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [3.0, 2.0, 0.0]])
    points = np.array([[1.234, 0.5, 0.0], [3.0, 1.111, -0.25], [3.3, -0.4, 0.0], [0.0, 9.0, 0.0]])
    found = distance_to_polyline(points, corners, 2.0)
    assert found[:3] == pytest.approx([0.5, 0.25, 0.5], abs=1e-12)
    assert found[3] == np.inf


def test_area_and_curvature_of_the_grid() -> None:
    """On a cylinder: its area, 1/r across and 0 along, seen from either side."""
    for sense, largest in ((1, 0.0), (-1, 1.0 / 8.0)):
        grid = Grid.of(WorkFace.of(design(round_face(8.0, height=6.0, turn=0.6), sense), 0.0))
        assert grid.area.sum() == pytest.approx(8.0 * 0.6 * 6.0, rel=1e-6)
        assert grid.curvature == pytest.approx(largest, abs=1e-6)
        outwards = np.stack([grid.points[..., 0], grid.points[..., 1]], axis=-1) / 8.0
        assert np.einsum("uvk,uvk->uv", grid.normals[..., :2], outwards) == pytest.approx(float(sense), abs=1e-6)
