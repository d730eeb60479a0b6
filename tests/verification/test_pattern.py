"""A rotary pattern: what a program cuts on each copy, on planes that copies turn about an axis."""

from __future__ import annotations

from dataclasses import replace

import msgspec
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from conflank_cli.copies import over_copies, seen_from_first
from conflank_cli.geometry.collision import Collider
from conflank_cli.job import Copies
from conflank_cli.machine_frame import copy_rotation, machine_of, reachable_axes
from conflank_cli.motion import Motion, uniform_knots
from conflank_cli.posting import post_program
from conflank_cli.scene import Scene
from conflank_cli.sweep import Sweep
from conflank_cli.tool import CATALOGUE
from conflank_cli.verification.judge import verify_program
from conflank_cli.verification.kinematics import about
from tests.verification.scenes import NOTHING, lying_on_plane, plane_face, scene_of, triangles_of

T1 = CATALOGUE["T1"]
# Three plates around z, 30 mm from it: turned by a third of a whole turn they lie side by side.
PLATE = plane_face((30.0, 50.0), (0.0, 20.0))
THREE = Copies((0.0, 0.0, 2.0), 3)


def pattern_scene(copies: Copies = THREE, check=NOTHING) -> Scene:
    scene = scene_of(PLATE, check=check)
    setup = msgspec.structs.replace(scene.job.setup, copies=copies)
    return replace(scene, job=msgspec.structs.replace(scene.job, setup=setup))


def sweep(x: tuple[float, float] = (28.0, 52.0)) -> Sweep:
    """T1 lies on the plate along y and goes along x: one sweep covers it."""
    _, tip, axis = lying_on_plane(T1)
    low = tip - T1.tip_height * axis
    knots = uniform_knots(4)
    p = low + np.stack([np.linspace(*x, 4), np.full(4, -2.0), np.zeros(4)], axis=1)
    return Sweep(0, "T1", Motion(knots, p, p + T1.length * axis))


@pytest.mark.parametrize("number", [1, 2])
def test_both_rotations_are_that_of_scipy(number: int) -> None:
    copies = Copies((1.0, -2.0, 0.5), 3)
    axis = np.array(copies.axis) / np.linalg.norm(copies.axis)
    expected = Rotation.from_rotvec(number * 2.0 * np.pi / 3.0 * axis).as_matrix()
    np.testing.assert_allclose(copy_rotation(copies, number), expected, atol=1e-15)
    np.testing.assert_allclose(about(copies.axis, number * 2.0 * np.pi / 3.0), expected, atol=1e-15)


def test_every_copy_is_cut_and_judged() -> None:
    scene = pattern_scene()
    text, path = post_program(scene, [sweep()])
    found = verify_program(text, scene, points_per_face=2000)
    assert [cut.number for cut in found.sweeps] == [1, 2, 3]
    assert [face.copy for face in found.faces] == [0, 1, 2]
    assert found.findings == ()
    assert found.coverage == pytest.approx(1.0, abs=1e-9)
    assert found.overcut_max_um < 0.6
    # The cuts lie where the copies are: a third of a turn apart about z.
    ends = [stretch.tip[0] for stretch in path.operations[0].stretches if stretch.purpose.name == "SWEEP"]
    for k, end in enumerate(ends):
        np.testing.assert_allclose(end, copy_rotation(THREE, k) @ ends[0], atol=1e-9)


def test_a_copy_that_is_not_cut_is_missed_and_named() -> None:
    """A program for two copies, judged against a job that asks for all three."""
    text, _ = post_program(pattern_scene(Copies(THREE.axis, 3, (2, 0))), [sweep()])
    found = verify_program(text, pattern_scene(), points_per_face=500)
    assert [face.coverage for face in found.faces] == pytest.approx([1.0, 0.0, 1.0], abs=1e-9)
    assert found.coverage == pytest.approx(2.0 / 3.0, abs=1e-9)
    (missed,) = found.findings
    assert missed.code == "CF202" and missed.text.startswith("copy 1: 0.00 %")


def test_a_gouge_in_a_copy_is_found_where_it_is() -> None:
    """The same cut pressed 50 um deeper on copy 1 alone."""
    scene = pattern_scene()
    text, _ = post_program(scene, [sweep()])
    start, end = text.index("; APPROACH 2"), text.index("; APPROACH 3")
    z = float(text[text.index("; SWEEP 2") :].split(" Z")[1].split()[0])
    deeper = text[:start] + text[start:end].replace(f"Z{z:+.4f}", f"Z{z - 0.05:+.4f}") + text[end:]
    assert deeper != text
    found = verify_program(deeper, scene, points_per_face=2000)
    gouge = next(finding for finding in found.findings if finding.code == "CF201")
    assert gouge.text.startswith("copy 1: gouge of 50.")
    assert gouge.place is not None
    back = np.array(gouge.place) @ copy_rotation(THREE, 1)
    # Places are written with six decimals.
    assert 30.0 - 1e-6 <= back[0] <= 50.0 + 1e-6 and -1e-6 <= back[1] <= 20.0 + 1e-6
    assert back[2] == pytest.approx(0.0, abs=1e-6)
    assert {finding.text[:7] for finding in found.findings} == {"copy 1:"}


def test_what_stands_around_the_part_stands_around_every_copy_and_obstacles_do_not() -> None:
    """A wall 4 mm beside the flute: of the part it is in the way on each copy, a foreign one where it stands."""
    wall = triangles_of([[25.0, 24.5, 2.0], [55.0, 24.5, 2.0], [55.0, 24.5, 40.0], [25.0, 24.5, 40.0]])
    text, _ = post_program(pattern_scene(), [sweep()])
    of_part = verify_program(text, pattern_scene(check=wall), points_per_face=500)
    assert {finding.text[:7] for finding in of_part.findings} == {"copy 0:", "copy 1:", "copy 2:"}
    foreign = replace(wall, face=np.full(len(wall.face), -1, dtype=np.int32))
    beside = verify_program(text, pattern_scene(check=foreign), points_per_face=500)
    assert {finding.text[:7] for finding in beside.findings} == {"copy 0:"}


def test_selection_sees_obstacles_as_every_copy_does() -> None:
    """A fixture where copy 1 is cut hits the sweep of copy 0 seen from there, and not where only copy 0 is cut."""
    wall = triangles_of([[25.0, 10.0, -5.0], [55.0, 10.0, -5.0], [55.0, 10.0, 40.0], [25.0, 10.0, 40.0]], face=-1)
    at_first = replace(wall, vertices=wall.vertices @ copy_rotation(THREE, 1).T)
    scene = pattern_scene(check=at_first)
    assert not Collider.of(scene).motion(sweep().motion, T1).clear
    alone = pattern_scene(Copies(THREE.axis, 3, (0,)), check=at_first)
    assert Collider.of(alone).motion(sweep().motion, T1).clear
    assert seen_from_first(alone) is alone
    assert len(seen_from_first(scene).check.triangles) == 3 * len(wall.triangles)


def test_the_machine_has_to_reach_every_copy() -> None:
    """About x, across the table's axis, a half turn puts the tool below the table."""
    scene = pattern_scene(Copies((1.0, 0.0, 0.0), 2))
    up = np.array([[0.0, 0.0, 1.0]])
    assert machine_of(scene.job).name == "ac-table"
    assert not reachable_axes(scene.job, up).any()
    assert reachable_axes(pattern_scene(Copies((1.0, 0.0, 0.0), 2, (0,))).job, up).all()


def test_a_tool_goes_over_all_copies_before_it_is_changed() -> None:
    plan = [replace(sweep(), tool=tool, facts={"k": k}) for k, tool in enumerate(("T1", "T1", "T3"))]
    made = [
        (int(cut.facts["k"]), round(float(np.arctan2(turn[1, 0], turn[0, 0])), 3))
        for cut, turn in over_copies(Copies((0.0, 0.0, 1.0), 4, (1, 0)), plan)
    ]
    quarter = round(np.pi / 2, 3)
    assert made == [(0, quarter), (1, quarter), (0, 0.0), (1, 0.0), (2, quarter), (2, 0.0)]
