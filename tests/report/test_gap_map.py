"""The gap in the pictures against closed forms and against the verification of the same text."""

import numpy as np
import pytest

from conflank_cli.job import Setup, Tolerance
from conflank_cli.posting import post_program
from conflank_cli.report.gap_map import gap_map
from conflank_cli.verification.judge import verify_program
from conflank_cli.verification.posed import pose_program
from tests.verification.scenes import T1, TCPM, header, lying_on_plane, plane_face, program, scene_of
from tests.verification.test_pattern import PLATE, pattern_scene, sweep

FACE = plane_face((0.0, 30.0), (2.0, 30.0))


def lying_cone(height: float, frame: str = "CAD", shift: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> str:
    """A sweep of a T1 that lies on the plane z = height and moves along x from 5 to 25."""
    tilt, tip, _ = lying_on_plane(T1, height)
    x, y, z = np.array([0.0, tip[1], tip[2]]) + shift
    words = f"A{tilt:+.9f} C+0"
    return program(
        [
            f"L {words} R0 FMAX M3",
            TCPM,
            f"L X{x + 5:+.4f} Y{y:+.9f} Z{z:+.9f} {words} F500",
            "; SWEEP 1",
            f"L X{x + 25:+.4f} F1000",
            "; RETRACT 1",
            f"L Z{z + 30:+.9f} FMAX",
            "FUNCTION RESET TCPM",
            "L M140 MB MAX",
        ],
        header(T1, frame),
    )


@pytest.mark.parametrize("height", [-0.004, 0.0, 0.006])
def test_the_gap_under_a_lying_cone_is_its_height(height: float) -> None:
    shown = gap_map(pose_program(lying_cone(height), scene_of(FACE)), FACE, (31, 29))
    cone_end = T1.length / np.cos(T1.half_angle)
    under = (shown.points[..., 0] >= 5) & (shown.points[..., 0] <= 25) & (shown.points[..., 1] <= cone_end)
    assert under.sum() > 400
    assert shown.gap[under] == pytest.approx(height, abs=1e-7)
    assert shown.by_cut.shape == (1, 31, 29)
    assert shown.inside.all()
    # Beyond the flute and beside the sweep there is stock.
    assert shown.gap[shown.points[..., 1] > cone_end + 1.0].min() > 0.1
    assert not shown.covered(0.01, 0.01)[:4].any()
    assert shown.covered(0.01, 0.01)[under].all()


def test_the_map_agrees_with_the_verification_of_the_text() -> None:
    """Coverage and deepest overcut, as two sets of points see them."""
    scene = scene_of(FACE, tolerance=Tolerance(0.01, 0.01))
    text = lying_cone(-0.005)
    judged = verify_program(text, scene, points_per_face=3000)
    shown = gap_map(pose_program(text, scene), FACE, (201, 201))
    assert shown.covered(0.01, 0.01).mean() == pytest.approx(judged.coverage, abs=0.01)
    assert -1e3 * shown.gap.min() == pytest.approx(judged.overcut_max_um, abs=0.05)


def test_poses_are_in_the_frame_of_the_part() -> None:
    setup = Setup(translate=(7.0, -3.0, 11.0))
    text = lying_cone(0.0, "ROTATE 0 0 0 TRANSLATE 7 -3 11", setup.translate)
    posed = pose_program(text, scene_of(FACE, setup=setup))
    cutting = posed.poses.moves.cut == 0
    _, expected, direction = lying_on_plane(T1)
    assert posed.tools[0] == T1
    assert posed.poses.tip[cutting][-1] == pytest.approx(np.add(expected, (25.0, 0.0, 0.0)), abs=1e-6)
    axis = posed.poses.axis[cutting]
    assert axis == pytest.approx(np.broadcast_to(direction, axis.shape), abs=1e-9)


def test_what_is_to_stay_is_no_gap() -> None:
    """A cutter 0.3 mm above the face leaves an allowance of 0.3 mm, and nothing else."""
    shown = gap_map(pose_program(lying_cone(0.3), scene_of(FACE)), FACE, (31, 29), allowance=0.3)
    under = (shown.points[..., 0] >= 5) & (shown.points[..., 0] <= 25) & (shown.points[..., 1] <= 20)
    assert shown.gap[under] == pytest.approx(0.0, abs=1e-7)


def test_of_copies_the_worst_counts() -> None:
    """Three plates about z; on the second the cutter goes 20 um deeper."""
    scene = pattern_scene()
    text, _ = post_program(scene, [sweep()])
    start, end = text.index("; APPROACH 2"), text.index("; APPROACH 3")
    z = float(text[text.index("; SWEEP 2") :].split(" Z")[1].split()[0])
    deeper = text[:start] + text[start:end].replace(f"Z{z:+.4f}", f"Z{z - 0.02:+.4f}") + text[end:]
    posed = pose_program(deeper, scene)
    assert len(posed.by_copy) == 3
    shown = gap_map(posed, PLATE, (20, 20))
    assert shown.gap == pytest.approx(-0.02, abs=1e-3)
    # Each cut is seen from the copy that it is for.
    assert shown.by_cut[0] == pytest.approx(0.0, abs=1e-3) and shown.by_cut[1] == pytest.approx(-0.02, abs=1e-3)
