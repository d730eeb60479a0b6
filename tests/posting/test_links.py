"""Ways between neighbouring cuts: beside the part where that is free, by full retracts where it is not."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from conflank_cli.ball_pass import Pass
from conflank_cli.geometry.face import CheckMesh
from conflank_cli.geometry.footpoint import Projector
from conflank_cli.posting import plan_to_toolpath, post_program, summarize
from conflank_cli.posting.links import Link, hull_points
from conflank_cli.posting.program import _by_rotary_axes
from conflank_cli.tool import CATALOGUE
from conflank_cli.verification.kinematics import CAD_FRAME
from conflank_cli.verification.poses import build_cells, poses_on_part
from conflank_cli.verification.program import Interpolation
from conflank_cli.verification.reader import read_program
from postprocessors.kinematics.two_rotary import SWING_LIMIT, Run, swing
from postprocessors.kinematics.visits import visits_with_words
from postprocessors.toolpath import Purpose
from tests.posting.test_passes import pass_of
from tests.posting.test_program import AC, scene_of, stretches_of, upright

T1 = CATALOGUE["T1"]
BOX = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=np.float64)
SIDES = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4],
         [1, 5, 7], [1, 7, 3]]  # fmt: skip


def shifted(item: Pass, along: float) -> Pass:
    """The same pass somewhere else along the wall."""
    return replace(item, tip=item.tip + np.array([0.0, along, 0.0]))


def deepest(tip: np.ndarray, axis: np.ndarray) -> float:
    """How far the cutter of T1 reaches beyond x = 0 in poses (N, 3), in closed form."""
    ball = tip[:, 0] + T1.ball_radius * axis[:, 0] + T1.ball_radius
    p = tip - T1.tip_height * axis
    across = np.sqrt(1.0 - axis[:, 0] ** 2)
    low = p[:, 0] + T1.r_min * across
    high = p[:, 0] + T1.length * axis[:, 0] + T1.r_max * across
    return float(np.maximum(ball, np.maximum(low, high)).max())


def test_a_link_keeps_the_cutter_off_the_face() -> None:
    """Numbers from the text, in between by SciPy's Slerp, against the half space behind the face."""
    text, path = post_program(scene_of(), [], [pass_of(), shifted(pass_of(), 20.0)])
    assert re.findall(r"; (\w+ \d)\r", text)[2:5] == ["RETRACT 1", "LINK 2", "APPROACH 2"]
    # To the limit once before and once after both.
    assert text.count("M140 MB MAX") == 2 and text.count("FUNCTION TCPM") == 1
    (link,) = stretches_of(path, Purpose.LINK)
    assert (link.feed == 0.0).all()
    number = np.arange(len(link.tip))
    fine = np.linspace(0.0, number[-1], 2001)
    tip = np.stack([np.interp(fine, number, column) for column in link.tip.T], axis=1)
    # The least turn from z to each axis; Slerp between turns of z is near enough to one of the axis within 2 degrees.
    turns = Rotation.concatenate([Rotation.align_vectors([axis], [[0.0, 0.0, 1.0]])[0] for axis in link.axis])
    axis = Slerp(number, turns)(fine).apply([0.0, 0.0, 1.0])
    assert deepest(tip, axis) < -0.4
    assert np.degrees(np.arccos(np.clip((link.axis[1:] * link.axis[:-1]).sum(axis=1), -1.0, 1.0))).max() < 2.000001
    for visit in visits_with_words(AC, path):
        assert swing(AC, np.vstack([s.axis for s in visit.stretches]), visit.words).max() <= SWING_LIMIT


def test_verification_finds_the_same_link_free_both_ways() -> None:
    text, _ = post_program(scene_of(), [], [pass_of(), shifted(pass_of(), 20.0)])
    program = read_program(text)
    assert not program.findings
    moves = program.moves
    poses = poses_on_part(moves, program.letters, CAD_FRAME, np.zeros(len(moves.block)))
    between = np.flatnonzero(moves.cut < 0)
    inner = between[(between > np.flatnonzero(moves.cut == 0)[-1]) & (between < np.flatnonzero(moves.cut == 1)[0])]
    # Retract, link and approach of both: joined from end to end, and by rapid only between the arcs.
    assert moves.joined[inner].all() and moves.rapid[inner].any() and not moves.rapid[inner[[0, -1]]].any()
    for mode in Interpolation:
        cells = build_cells(poses, inner[moves.rapid[inner]], mode).cells
        middle = cells[:, 6:9] + 0.5 * cells[:, 9:12] + cells[:, 12:15]
        middle /= np.linalg.norm(middle, axis=1, keepdims=True)
        assert deepest(cells[:, 0:3] + 0.5 * cells[:, 3:6], middle) < -0.4


def test_a_link_hops_over_what_stands_in_between_or_is_left_out() -> None:
    def with_box(high: float) -> list[str]:
        box = np.array([-40.0, 24.0, 0.0]) + BOX * [40.0, 4.0, high]
        triangles = np.array(SIDES, dtype=np.int32)
        mesh = CheckMesh(box, triangles, np.zeros(len(triangles), dtype=np.int32))
        scene = scene_of().checking(mesh)
        path = plan_to_toolpath(scene, [], AC, [pass_of(turn=0.0), shifted(pass_of(turn=0.0), 24.0)])
        return [len(link.tip) for link in stretches_of(path, Purpose.LINK)]

    straight = len(stretches_of(plan_to_toolpath(scene_of(), [], AC,
        [pass_of(turn=0.0), shifted(pass_of(turn=0.0), 24.0)]), Purpose.LINK)[0].tip)  # fmt: skip
    (hop,) = with_box(14.0)
    assert hop > straight
    assert with_box(200.0) == []


@pytest.mark.parametrize("extra", ['safe = {links = "retract"}', 'split = "sweep"'])
def test_links_are_left_out_where_the_job_says_so(extra: str) -> None:
    path = plan_to_toolpath(scene_of(f"[program]\n{extra}\n"), [], AC, [pass_of(), shifted(pass_of(), 20.0)])
    assert stretches_of(path, Purpose.LINK) == []


def test_links_save_time_and_leave_the_cuts_as_they_are() -> None:
    jobs = [scene_of(), scene_of('[program]\nsafe = {links = "retract"}\n')]
    cuts = [pass_of(), shifted(pass_of(), 20.0)]
    near, far = (plan_to_toolpath(scene, [upright()], AC, cuts) for scene in jobs)
    for one, other in zip(stretches_of(near, Purpose.PASS), stretches_of(far, Purpose.PASS), strict=True):
        np.testing.assert_array_equal(one.tip, other.tip)
        np.testing.assert_array_equal(one.axis, other.axis)
    assert summarize(jobs[0].job, near).seconds < summarize(jobs[1].job, far).seconds


@pytest.mark.parametrize(("most", "through"), [(119.0, True), (121.0, False)])
def test_a_link_that_swings_out_of_range_is_none(most: float, through: bool) -> None:
    """Cuts at 100 degrees of A, where 120 are the most, with a link whose axis swings on between them."""
    tilt = np.radians([100.0, 110.0, most, 110.0, 100.0])
    axis = np.stack([0.0 * tilt, np.sin(tilt), np.cos(tilt)], axis=1)
    link = Link(np.arange(5.0)[:, None] * np.array([1.0, 0.0, 0.0]), axis)
    run = Run("sweep 2", np.vstack([axis[:1], link.axis, axis[-1:]]))
    assert (_by_rotary_axes(AC, run, link, 1) is not None) == through


def test_the_size_of_everything_counts_all_copies_and_obstacles_where_they_stand() -> None:
    """Of three copies of a wall only one is cut; a post stays where it is, however the part is turned."""
    scene = scene_of("[setup]\ncopies = {axis = [0, 0, 1], count = 3, only = [1]}\n")
    post = np.array([[200.0, 0.0, 0.0], [200.0, 0.0, 90.0], [201.0, 0.0, 0.0]])
    mesh = CheckMesh(post, np.array([[0, 1, 2]], dtype=np.int32), np.array([-1], dtype=np.int32))
    found = hull_points(scene.checking(mesh), [Projector.of(face.surface) for face in scene.faces])
    wall = np.array([[0.0, y, z] for y in (0.0, 60.0) for z in (0.0, 30.0)])
    turned = [Rotation.from_euler("z", angle, degrees=True).apply(wall) for angle in (0.0, 120.0, 240.0)]
    wanted = np.vstack([*turned, post])
    for direction in np.random.default_rng(3).normal(size=(200, 3)):
        assert (found @ direction).max() == pytest.approx((wanted @ direction).max(), abs=1e-9)
