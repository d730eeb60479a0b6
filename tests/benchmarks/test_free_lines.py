"""What single poses reach beside a wall, where the ball's radius tells."""

from __future__ import annotations

from dataclasses import replace

import msgspec
import numpy as np

from benchmarks.blind_search import LEAST_RUN
from benchmarks.detection import NO_MACHINE
from benchmarks.free_lines import LENIENT, ball_reached, freely_reached, touched
from conflank_cli.geometry.workface import WorkFace
from conflank_cli.job import Machine
from conflank_cli.scene import Scene
from conflank_cli.tool import CATALOGUE
from tests.benchmarks.test_blind_search import some
from tests.verification.scenes import NOTHING, lying_on_plane, plane_face, scene_of, triangles_of

T1 = CATALOGUE["T1"]
FACE = plane_face((0.0, 14.0), (0.0, 20.0))
# A wall beside the face, 4 mm high and longer than the tool: what lies along it has to keep its shank away too.
WALL = triangles_of([(0.0, -60.0, 0.0), (0.0, 80.0, 0.0), (0.0, 80.0, 4.0), (0.0, -60.0, 4.0)])


def everywhere(scene: Scene) -> Scene:
    return replace(scene, job=msgspec.structs.replace(scene.job, machine=Machine("no-limits", None, NO_MACHINE)))


def test_beside_a_wall_the_ball_decides() -> None:
    face = WorkFace.of(FACE, 0.0)
    samples = face.samples(0.25)
    row = np.flatnonzero(np.abs(samples.points[:, 1] - 10.0) < 0.13)
    beside = some(samples, row[np.argsort(samples.points[row, 0])][:14])
    x = beside.points[:, 0]
    assert freely_reached(everywhere(scene_of(FACE, tools=(T1,), check=NOTHING)), 0, beside, LEAST_RUN).all()
    reached = freely_reached(everywhere(scene_of(FACE, tools=(T1,), check=WALL)), 0, beside, LEAST_RUN)
    # The lowest sphere of the cone is the ball, and may cut so deep into the wall; a chord of so much is within
    # tolerance on the other side of its contact.
    overcut = scene_of(FACE).job.tolerance.overcut + LENIENT
    chord = np.sqrt(2.0 * T1.ball_radius * scene_of(FACE).job.tolerance.undercut)
    assert not reached[x < T1.ball_radius - overcut - chord].any()
    assert reached[x > T1.ball_radius + 0.3].all()
    assert reached.any() and not reached.all()


def test_the_ball_touches_as_near_to_a_wall_as_its_radius() -> None:
    samples = WorkFace.of(FACE, 0.0).samples(0.25)
    row = np.flatnonzero(np.abs(samples.points[:, 1] - 10.0) < 0.13)
    beside = some(samples, row[np.argsort(samples.points[row, 0])][:14])
    scene = scene_of(FACE, tools=(T1,), check=WALL)
    least = T1.ball_radius - scene.job.tolerance.overcut - LENIENT
    assert np.array_equal(ball_reached(everywhere(scene), beside), beside.points[:, 0] > least)


def test_a_pose_touches_along_its_generator() -> None:
    _, tip, axis = lying_on_plane(T1)
    p = tip - T1.tip_height * axis
    along = np.linspace(-5.0, 30.0, 351)
    points = np.stack([0.0 * along, along, 0.0 * along], axis=1)
    inside = touched(points, p[None], axis[None], T1, 0.001)
    # From the ball's contact on, and as far as a chord below it; the generator as long as the flute.
    start = p[1] + T1.r_min * np.sin(T1.half_angle)
    end = start + T1.length / np.cos(T1.half_angle)
    assert inside[(along > start + 0.01) & (along < end - 0.01)].all()
    assert not inside[(along < start - 0.1) | (along > end + 0.01)].any()
