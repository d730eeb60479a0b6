"""Whole judgements against closed forms: planes, cylinders, grooves, walls."""

from __future__ import annotations

import ast
import hashlib
from dataclasses import replace
from itertools import pairwise
from math import cos, hypot, pi, radians, sin
from pathlib import Path

import msgspec
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import conflank_cli.verification
from conflank_cli.geometry.face import DesignFace
from conflank_cli.job import Foreign, Setup, Tolerance
from conflank_cli.job import Program as JobProgram
from conflank_cli.tool import Section, Tool
from conflank_cli.verification.findings import CODES
from conflank_cli.verification.judge import verify_program
from conflank_cli.verification.result import Verification, from_json
from conflank_cli.verification.sampling import sample_face
from conflank_cli.verification.surroundings import Surroundings
from tests.verification.scenes import (
    ROTARY_TOLERANCE,
    T1,
    TCPM,
    cylinder_face,
    header,
    lying_on_plane,
    plane_face,
    program,
    scene_of,
    triangles_of,
)

POINTS = 3000
"""Enough for closed forms on small faces, and quick."""

FLANK = plane_face((10.0, 30.0), (1.0, 20.0))
"""Within reach of a T1 that lies along y with the low end of its axis at y = 0."""


def flank_program(height: float = 0.0, x: tuple[float, float] = (0.0, 40.0), label: str = "SWEEP 1") -> str:
    """One straight sweep over the plane, the cone lying on it along its generator."""
    tilt, tip, _ = lying_on_plane(T1, height)
    words = f"A{tilt:+.9f} C+0"
    place = f"Y{tip[1]:+.9f} Z{tip[2]:+.9f}"
    return program(
        [
            f"L {words} R0 FMAX M3",
            TCPM,
            f"L X{x[0] - 10:+.4f} Y{tip[1] + 40:+.9f} Z{tip[2] + 30:+.9f} {words} FMAX",
            f"L X{x[0] - 10:+.4f} Y{tip[1]:+.9f} Z{tip[2] + 30:+.9f} FMAX",
            f"L X{x[0]:+.4f} {place} {words} F500",
            f"; {label}",
            f"L X{x[1]:+.4f} F1000",
            "; RETRACT 1",
            f"L Z{tip[2] + 30:+.9f} F2000",
            "FUNCTION RESET TCPM",
            "L M140 MB MAX",
        ]
    )


def codes(result: Verification) -> list[str]:
    return [finding.code for finding in result.findings]


def test_a_cone_rolled_along_a_plane_cuts_it_exactly() -> None:
    text = flank_program()
    result = verify_program(text, scene_of(FLANK), "PLANE.H", POINTS)
    assert result.findings == ()
    assert result.coverage == pytest.approx(1.0)
    assert result.coverage_flank == pytest.approx(1.0)
    # Angles of nine decimals: 1e-9 degrees over 25 mm.
    assert result.gap_um.mean_abs is not None and result.gap_um.mean_abs < 1e-3
    assert abs(result.overcut_max_um) < 1e-3
    assert result.stock_max_um is not None and result.stock_max_um < 1e-3
    (sweep,) = result.sweeps
    assert (sweep.number, sweep.tool) == (1, "T1")
    assert sweep.covered_mm2 == pytest.approx(20.0 * 19.0, rel=1e-6)
    assert sweep.time_s == pytest.approx(40.0 / 1000.0 * 60.0)
    assert sweep.length_mm == pytest.approx(40.0)
    assert result.faces[0].area_mm2 == pytest.approx(380.0)
    assert result.program_sha256 == hashlib.sha256(text.encode()).hexdigest()
    # T + h TA: 2 um, and TA over 24 mm of cone and the ball below it.
    height = 24.0 - T1.tip_height
    assert result.control_tolerance_um == pytest.approx(2.0 + 1000.0 * height * radians(ROTARY_TOLERANCE), abs=1e-3)
    assert from_json(result.to_json()) == result


def test_the_length_of_a_cut_that_is_left_on_the_way_is_that_of_its_pieces() -> None:
    """Retract and approach between two pieces of a sweep are no part of it."""
    low, high = flank_program(0.0, (0.0, 20.0)), flank_program(0.0, (20.0, 40.0))
    body = [line.split(" ", 1)[1] for line in low.splitlines()]
    more = [line.split(" ", 1)[1] for line in high.splitlines()]
    text = "\n".join([*body[: body.index("M30")], *more[more.index("L M140 MB MAX") + 1 :]])
    (found,) = verify_program(text, scene_of(FLANK), "", POINTS).sweeps
    assert found.length_mm == pytest.approx(40.0)


def test_a_gouge_has_depth_place_block_and_pose() -> None:
    result = verify_program(flank_program(-0.025), scene_of(FLANK), "", POINTS)
    assert result.overcut_max_um == pytest.approx(25.0, abs=1e-3)
    assert codes(result) == ["CF201", "CF202"]
    gouge = result.findings[0]
    assert (gouge.amount, gouge.limit, gouge.unit) == (pytest.approx(25.0, abs=1e-3), 10.0, "um")
    assert gouge.title == "CF201 gouge"
    at = result.overcut_max_at
    assert at is not None and at.pose is not None and at.face == 0
    assert at.block == gouge.block
    assert flank_program(-0.025).splitlines()[at.block].endswith("L X+40.0000 F1000")
    # The pose touches the place: the contact lies on the generator below the axis.
    assert at.pose.tip[0] == pytest.approx(at.point[0], abs=1e-3)
    assert result.coverage == 0.0


def test_an_allowance_moves_what_counts() -> None:
    scene = scene_of(FLANK, tolerance=Tolerance(allowance=0.3))
    result = verify_program(flank_program(0.3), scene, "", POINTS)
    assert result.findings == ()
    assert result.coverage == pytest.approx(1.0)
    assert "CF201" in codes(verify_program(flank_program(0.0), scene, "", POINTS))


def test_stock_beyond_the_reach_of_all_cuts_is_exact() -> None:
    result = verify_program(flank_program(7.0), scene_of(FLANK), "", POINTS)
    assert result.stock_max_um == pytest.approx(7000.0, abs=1e-2)
    assert codes(result) == ["CF202"]
    assert result.findings[0].amount == 0.0


def test_a_face_half_covered() -> None:
    result = verify_program(flank_program(x=(0.0, 20.0)), scene_of(FLANK), "", POINTS)
    # The retract leads straight up; the cone's last line of contact is at x = 20, and a little more within 10 um.
    rim, spacing = np.sqrt(2.0 * 3.0 * 0.010), np.sqrt(20.0 * 19.0 / POINTS)
    assert 0.5 <= result.coverage <= 0.5 + (rim + spacing) / 20.0
    (finding,) = result.findings
    assert finding.code == "CF202" and finding.limit == 0.9


def test_chords_between_blocks_count() -> None:
    """A cylinder on a cylinder: between blocks the straight tip cuts (R + r)(1 - cos(step / 2)) too deep."""
    radius, tool = 30.0, Tool("D8", 4.0, 4.0, 30.0, number=7)
    count = 46
    angles = np.linspace(-0.2, pi / 2 + 0.2, count)
    reach = radius + tool.r_min
    path = [f"L X{reach * cos(a):+.9f} Y+0 Z{reach * sin(a):+.9f} A-90 C+0 F500" for a in angles]
    above = path[0].replace("Y+0", "Y+40").replace("F500", "FMAX")
    body = ["L A-90 C+0 R0 FMAX", TCPM, above, "; SWEEP 1", *path, "; RETRACT 1", "L M140 MB MAX"]
    text = program(body, header(tool, face=4), tool)
    scene = scene_of(cylinder_face(radius, (5.0, 25.0)), tools=[tool], tolerance=Tolerance(0.05, 0.05))
    result = verify_program(text, scene, "", POINTS)
    step = angles[1] - angles[0]
    assert result.overcut_max_um == pytest.approx(1000.0 * reach * (1.0 - cos(step / 2.0)), rel=1e-3)
    assert result.faces[0].area_mm2 == pytest.approx(20.0 * pi / 2 * radius, rel=1e-4)
    assert result.faces[0].face == 4
    assert result.coverage == pytest.approx(1.0)
    assert result.findings == ()


def test_ball_passes_leave_the_scallop_of_the_closed_form() -> None:
    """Straight passes s apart with a ball R leave sqrt(R^2 + s^2 / 4) - R at most, on a plane."""
    spacing, radius = 0.4, T1.ball_radius
    body = []
    for k in range(12):
        y = spacing * k
        body += [f"L X-5 Y{y:+.4f} Z+9 R0 FMAX", "L Z+0 F500", f"; PASS {k + 1}", "L X+15 F800", f"; RETRACT {k + 1}"]
        body += ["L Z+9 FMAX"]
    text = program([*body, "L M140 MB MAX"])
    face = plane_face((0.0, 10.0), (0.4, 4.0))
    result = verify_program(text, scene_of(face, tolerance=Tolerance(0.01, 0.02)), "", 12000)
    scallop = hypot(radius, spacing / 2.0) - radius
    # The grid need not have a point on the crest; 0.05 mm beside it the scallop is lower by 0.05 s / (2 R).
    assert result.stock_max_um is not None
    assert result.stock_max_um <= 1000.0 * scallop + 1e-3
    assert result.stock_max_um == pytest.approx(1000.0 * scallop, rel=0.05)
    assert result.overcut_max_um == pytest.approx(0.0, abs=1e-6)
    assert (len(result.sweeps), len(result.passes)) == (0, 12)
    assert result.coverage == pytest.approx(1.0)
    assert result.coverage_flank < result.coverage
    # Every pass covers its strip.
    assert result.passes[5].covered_mm2 > 10.0 * spacing
    assert result.findings == ()


def test_the_step_between_two_patches() -> None:
    """Two sweeps side by side, one 6 um higher: the gap jumps by that where one ends and the other takes over."""
    low, high = flank_program(0.0, (0.0, 20.0)), flank_program(0.006, (20.0, 40.0), "SWEEP 2")
    body = [line.split(" ", 1)[1] for line in low.splitlines()]
    more = [line.split(" ", 1)[1] for line in high.splitlines()]
    start = more.index("L M140 MB MAX") + 1
    text = "\n".join([*body[: body.index("M30")], *more[start:]])
    result = verify_program(text, scene_of(FLANK), "", 12000)
    assert [sweep.number for sweep in result.sweeps] == [1, 2]
    assert result.findings == ()
    assert result.sweeps[1].gap_mean_abs_um == pytest.approx(6.0, abs=0.2)
    # Past its end the first patch rises as the tool's flank does, and meets the second where both are 6 um high.
    assert result.step_max_um is not None and 0.0 < result.step_max_um <= 6.01


def test_a_frame_on_the_table_changes_nothing() -> None:
    rotate, shift = (90.0, 20.0, -35.0), (12.0, -7.0, 30.0)
    turn = Rotation.from_euler("XYZ", rotate, degrees=True)
    _, tip, axis = lying_on_plane(T1)
    tips = turn.apply(np.array([[0.0, 40.0, 30.0], [0.0, 0.0, 0.0], [40.0, 0.0, 0.0]]) + tip) + shift
    toward = turn.apply(axis)
    # Of the two solutions the one with A below zero: the machine's A goes to 30 degrees only.
    a, c = -np.degrees(np.arccos(toward[2])), np.degrees(np.arctan2(-toward[0], toward[1]))
    places = [f"L X{p[0]:+.9f} Y{p[1]:+.9f} Z{p[2]:+.9f} A{a:+.9f} C{c:+.9f} F500" for p in tips]
    frame = "ROTATE 90 20 -35 TRANSLATE 12 -7 30"
    body = [f"L A{a:+.9f} C{c:+.9f} FMAX", TCPM, places[0], places[1], "; SWEEP 1", places[2], "; RETRACT 1"]
    text = program([*body, "L M140 MB MAX"], header(frame=frame))
    result = verify_program(text, scene_of(FLANK, setup=Setup(rotate, shift)), "", POINTS)
    assert result.findings == ()
    assert result.coverage == pytest.approx(1.0)
    assert result.gap_um.mean_abs is not None and result.gap_um.mean_abs < 1e-3
    # A job that has the part elsewhere is a contradiction.
    assert "CF110" in codes(verify_program(text, scene_of(FLANK), "", POINTS))


def test_the_sphere_centre_as_reference() -> None:
    _, tip, axis = lying_on_plane(T1)
    centre = tip + T1.ball_radius * axis
    tilt = lying_on_plane(T1)[0]
    where = f"Y{centre[1]:+.9f} Z{centre[2]:+.9f} A{tilt:+.9f} C+0"
    above = where.replace(f"Y{centre[1]:+.9f}", f"Y{centre[1] + 40.0:+.9f}")
    body = [f"L A{tilt:+.9f} C+0 FMAX", TCPM, f"L X+0 {above} FMAX", f"L X+0 {where} FMAX"]
    body += ["; SWEEP 1", f"L X+40 {where} F500", "; RETRACT 1", "L M140 MB MAX"]
    text = program(body, header(reference="SPHERE CENTRE"))
    result = verify_program(text, scene_of(FLANK), "", POINTS)
    assert result.findings == ()
    assert result.gap_um.mean_abs is not None and result.gap_um.mean_abs < 1e-3
    # A program that states nothing, and a job that states it instead, are the same.
    scene = scene_of(FLANK)
    job = msgspec.structs.replace(scene.job, program=JobProgram(foreign=Foreign(reference="sphere centre")))
    silent = verify_program(program(body, ["; POSTED ELSEWHERE"]), replace(scene, job=job), "", POINTS)
    assert silent.findings == ()
    assert silent.judged["reference"] == result.judged["reference"] == "SPHERE CENTRE"
    assert silent.gap_um == result.gap_um


@pytest.mark.parametrize(
    ("old", "new", "code"),
    [
        ("; FRAME CAD", "; nothing", "CF104"),
        ("; REFERENCE TIP", "; nothing", "CF107"),
        ("; TOOL 1 T1", "; TOIL 1 T1", "CF103"),
        ("R_MIN 1.5", "R_MIN 4.5", "CF109"),
        ("R_MIN 1.5", "R_MIN 1.6", "CF110"),
        ("; TOOL 1 T1", "; TOOL 1 T9", "CF110"),
        ("; FRAME CAD", "; FRAME ROTATE 0 0 0 TRANSLATE 0 0 1", "CF110"),
    ],
)
def test_what_the_header_does_not_say(old: str, new: str, code: str) -> None:
    text = flank_program()
    assert old in text
    assert code in codes(verify_program(text.replace(old, new), scene_of(FLANK), "", POINTS))


def test_an_empty_program_covers_nothing_and_says_so() -> None:
    result = verify_program("0 BEGIN PGM EMPTY MM\n1 END PGM EMPTY MM\n", scene_of(FLANK), "", POINTS)
    assert result.coverage == 0.0
    assert {"CF111", "CF202"} <= set(codes(result))
    assert from_json(result.to_json()) == result


def test_a_wall_beside_the_face_that_the_cutter_gouges() -> None:
    """A wall across the end of the sweep at x = 40.5, in which the cone, 1.9 to 3 mm thick there, cuts."""
    wall = triangles_of([(40.5, -5, -5), (40.5, 30, -5), (40.5, 30, 20), (40.5, -5, 20)])
    result = verify_program(flank_program(), scene_of(FLANK, check=wall), "", POINTS)
    assert set(codes(result)) >= {"CF203"}
    # Deepest where the cone's side and its top disc are equally far: (2.5 - depth tan a) cos a = depth.
    deepest = 2.5 * cos(T1.half_angle) / (1.0 + sin(T1.half_angle))
    assert result.overcut_max_um == pytest.approx(1000.0 * deepest, abs=100.0)
    assert result.overcut_max_at is not None and result.overcut_max_at.face == 9
    assert result.clearance_mm.cone.least == pytest.approx(-deepest, abs=0.1)


def test_touching_the_part_is_allowed_but_not_an_obstacle() -> None:
    """The plane goes on beside the face: the cone lies on it with gap zero."""
    beside = [(30.0, 1.0, 0.0), (36.0, 1.0, 0.0), (36.0, 20.0, 0.0), (30.0, 20.0, 0.0)]
    part = verify_program(flank_program(), scene_of(FLANK, check=triangles_of(beside)), "", POINTS)
    assert part.findings == ()
    assert part.clearance_mm.cone.least == pytest.approx(0.0, abs=1e-6)
    obstacle = verify_program(flank_program(), scene_of(FLANK, check=triangles_of(beside, face=-1)), "", POINTS)
    assert "CF302" in codes(obstacle)
    assert next(item.limit for item in obstacle.findings if item.code == "CF302") == 0.2


def test_clearance_of_shank_and_holder() -> None:
    """A plate over the path: tools stand upright, so distances to it are those to cylinders."""
    tool = Tool("S", 1.0, 1.0, 10.0, (Section(4.0, 4.0, 20.0),), (Section(20.0, 20.0, 30.0),), number=3)
    shank = triangles_of([(0, 2.4, 15), (20, 2.4, 15), (20, 2.4, 20), (0, 2.4, 20)])
    body = ["L X+0 Y+0 Z+60 R0 FMAX", "L Z+0 FMAX", "; SWEEP 1", "L X+20 F500", "; RETRACT 1", "L M140 MB50 FMAX"]
    scene = scene_of(plane_face((5.0, 15.0), (-0.05, 0.05)), tools=[tool], check=shank)
    result = verify_program(program(body, header(tool), tool), scene, "", POINTS)
    assert result.clearance_mm.shank.least == pytest.approx(0.4, abs=1e-6)
    assert result.clearance_mm.holder.least == pytest.approx(hypot(0.0, 31.0 - 20.0), abs=1e-6)
    assert codes(result) == ["CF303"]
    assert (result.findings[0].amount, result.findings[0].limit) == (pytest.approx(0.4), 0.5)
    # From the tip, the holder begins 10 + 20 above the plane of r_min, which is 1 above the tip.
    place = result.clearance_mm.holder.at
    assert place is not None and place.point[2] == pytest.approx(20.0)


def test_areas_of_trimmed_faces() -> None:
    angle = np.linspace(0.0, 2.0 * pi, 721)[:-1]
    ring = 5.0 + np.stack([4.0 * np.cos(angle), 4.0 * np.sin(angle)], axis=1)
    hole = 5.0 + np.stack([2.0 * np.cos(angle), 2.0 * np.sin(angle)], axis=1)
    whole = plane_face((0.0, 10.0), (0.0, 10.0))
    face = DesignFace(0, "ring", whole.surface, (ring, hole), 1)
    sample = sample_face(face, 20000)
    assert sample.area.sum() == pytest.approx(pi * (16.0 - 4.0), rel=2e-3)
    inside = np.linalg.norm(sample.points[:, :2] - 5.0, axis=1)
    assert inside.min() > 2.0 - 1e-4 and inside.max() < 4.0 + 1e-4
    np.testing.assert_allclose(sample.normals, np.tile([0.0, 0.0, 1.0], (len(inside), 1)), atol=1e-12)
    pair = sample.points[sample.neighbours[:, 0]] - sample.points[sample.neighbours[:, 1]]
    assert np.linalg.norm(pair, axis=1).max() < 0.1


def test_normals_of_a_rational_face_point_out_of_the_metal() -> None:
    sample = sample_face(cylinder_face(30.0, (0.0, 10.0)), 500)
    outward = sample.points * [1.0, 0.0, 1.0] / 30.0
    np.testing.assert_allclose(sample.normals, outward, atol=1e-12)


def test_points_on_a_curved_mesh_know_how_far_off_they_may_be() -> None:
    """A cylinder in chords of 5 degrees: the sagitta is R (1 - cos 2.5 deg)."""
    radius, angles = 20.0, np.radians(np.arange(0.0, 91.0, 5.0))
    quads = [
        [(radius * cos(t), y, radius * sin(t)) for t, y in ((a, 0.0), (b, 0.0), (b, 9.0), (a, 9.0))]
        for a, b in pairwise(angles)
    ]
    sample = Surroundings.of(triangles_of(*quads)).near(np.full(3, -99.0), np.full(3, 99.0))
    while (long := sample.sides.max(axis=1) > 1.0).any():
        sample = sample.halved(long)
    off = radius - np.hypot(sample.points[:, 0], sample.points[:, 2])
    assert off.max() == pytest.approx(radius * (1.0 - cos(radians(2.5))), rel=0.1)
    # The arc bulges by what the sag says, and by no more than 1 % more.
    assert (off <= 1.01 * sample.sag + 1e-12).all()
    spacing = np.unique(np.round(sample.points[:, 1], 6))
    assert np.diff(spacing).max() <= 1.0


def test_equal_programs_give_equal_bytes() -> None:
    first, second = (verify_program(flank_program(), scene_of(FLANK), "A.H", POINTS).to_json() for _ in range(2))
    assert first == second


def test_codes_are_stable() -> None:
    assert {"CF101", "CF102", "CF201", "CF202", "CF203", "CF301", "CF304"} <= set(CODES)


def test_nothing_of_what_is_judged_takes_part_in_the_judgement() -> None:
    folder = Path(conflank_cli.verification.__file__).parent
    stages = ("detection", "optimization", "selection", "posting", "geometry.footpoint", "sweep", "motion")
    forbidden = ("postprocessors", *(f"conflank_cli.{name}" for name in stages))
    files = [*folder.glob("*.py"), folder.parent / "geometry" / "kernels" / "verified_gap.py"]
    assert len(files) > 5
    for file in files:
        for node in ast.walk(ast.parse(file.read_text())):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom):
                names = [f"{node.module}", *(f"{node.module}.{alias.name}" for alias in node.names)]
            for name in names:
                assert not name.startswith(forbidden), f"{file.name} imports {name}"
                if "kernels" in name:
                    assert "verified_gap" in name or name.endswith("kernels"), f"{file.name} imports {name}"
