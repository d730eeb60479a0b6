"""Faces beside the design faces, judged on their surfaces, and what regions leave of design faces: closed forms."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import cos, hypot, pi, sin

import numpy as np
import pytest

from conflank_cli.geometry.face import CheckMesh, DesignFace
from conflank_cli.geometry.surface import BSplineSurface
from conflank_cli.job import Margin, Tolerance
from conflank_cli.once import Once
from conflank_cli.scene import Scene
from conflank_cli.tool import Section, Tool
from conflank_cli.verification.judge import verify_program
from conflank_cli.verification.result import Verification
from conflank_cli.verification.surroundings import Surroundings
from conflank_cli.verification.triangles import triangles_over
from tests.verification.scenes import (
    NOTHING,
    T1,
    TCPM,
    cylinder_face,
    header,
    lying_on_plane,
    plane_face,
    program,
    rectangle,
    scene_of,
    triangles_of,
)

WITHIN = 5e-5
"""What a least distance may be off, mm: it is found to far less, and written with six decimals."""

RADIUS = 4.0
GROOVE_AT = 60.0
"""Where the groove lies in x: far from the design face."""


def groove(radius: float, y: tuple[float, float], number: int = 6) -> DesignFace:
    """The lower quarter of a pipe along y, concave seen from above; its lowest line is z = -radius at x = GROOVE_AT."""
    half = radius * np.sqrt(0.5)
    corner = [[GROOVE_AT - half, -half], [GROOVE_AT, -2.0 * half], [GROOVE_AT + half, -half]]
    poles = np.array([[[a, b, c] for b in y] for a, c in corner])
    weights = np.repeat([[1.0], [np.sqrt(0.5)], [1.0]], 2, axis=1)
    surface = BSplineSurface(2, 1, np.array([0.0, 0, 0, 1, 1, 1]), np.array([y[0], *y, y[1]]), poles, weights)
    return DesignFace(number, "groove", surface, (rectangle(0.0, 1.0, *y),), 1)


def chords(radius: float, y: tuple[float, float], number: int = 6, count: int = 7) -> CheckMesh:
    """The same groove in chords, none of whose corners is on its lowest line."""
    angle = -0.75 * pi + 0.5 * pi * np.arange(count + 1) / count
    x, z = GROOVE_AT + radius * np.cos(angle), radius * np.sin(angle)
    quads = [
        [(x[k], y[0], z[k]), (x[k + 1], y[0], z[k + 1]), (x[k + 1], y[1], z[k + 1]), (x[k], y[1], z[k])]
        for k in range(count)
    ]
    return triangles_of(*quads, face=number)


def with_surfaces(scene: Scene, *faces: DesignFace) -> Scene:
    return replace(scene, surfaces=Once(lambda: faces))


def groove_scene(known: bool = True, tool: Tool = T1) -> Scene:
    scene = scene_of(plane_face((0.0, 4.0), (0.0, 4.0)), tools=[tool], check=chords(RADIUS, (0.0, 20.0)))
    return with_surfaces(scene, groove(RADIUS, (0.0, 20.0))) if known else scene


def along_groove(depth: float, beside: float = 0.0) -> str:
    """The ball, upright, along the lowest line of the groove, or `beside` it, and so much below it."""
    z, y = -RADIUS - depth, (3.0, 17.0)
    body = [
        f"L X{GROOVE_AT + beside:+.4f} Y{y[0]:+.4f} Z+40 R0 FMAX", f"L Z{z:+.6f} F500",
        "; PASS 1", f"L Y{y[1]:+.4f} F800", "; RETRACT 1", "L Z+40 FMAX", "L M140 MB MAX",
    ]  # fmt: skip
    return program(body)


def codes(result: Verification) -> set[str]:
    return {finding.code for finding in result.findings}


@pytest.mark.parametrize(("depth", "found"), [(0.0099, False), (0.0101, True), (0.012, True)])
def test_a_cut_into_a_concave_neighbour_is_as_deep_as_in_its_surface(depth: float, found: bool) -> None:
    """Chords of 13 degrees lie 25 um above the groove's bottom: less their sag they hid what is cut there."""
    result = verify_program(along_groove(depth), groove_scene(), "", 500)
    assert result.clearance_mm.ball.least == pytest.approx(-depth, abs=WITHIN)
    assert result.overcut_max_um == pytest.approx(1000.0 * depth, abs=0.05)
    assert ("CF203" in codes(result)) is found
    at = result.clearance_mm.ball.at
    assert at is not None and at.face == 6
    assert (at.point[0], at.point[2]) == (pytest.approx(GROOVE_AT, abs=0.02), pytest.approx(-RADIUS, abs=1e-4))


def test_triangles_of_an_unknown_surface_count_against_the_cutter() -> None:
    """What is not known to be harmless is a finding: the groove may be as deep as the chords, or as their arcs."""
    # Beside the middle of the lowest chord, which is where halving begins.
    result = verify_program(along_groove(0.0, 0.0337), groove_scene(known=False), "", 500)
    # Half the angle of a chord; across a chord w, over which the normal turns by an angle, an arc rises by w angle / 8.
    half = 0.25 * pi / 7.0
    chord, sag = RADIUS * (1.0 - cos(half)), 2.0 * RADIUS * sin(half) * 2.0 * half / 8.0
    assert result.clearance_mm.ball.least == pytest.approx(-chord - sag, abs=WITHIN)
    assert "CF203" in codes(result)


def passing(tool: Tool, axis_x: float) -> str:
    """An upright tool along y at x, its tip at z = 0."""
    body = [
        f"L X{axis_x:+.6f} Y-20 Z+0 R0 FMAX", "; SWEEP 1", "L Y+20 F500", "; RETRACT 1", "L M140 MB MAX",
    ]  # fmt: skip
    return program(body, header(tool), tool)


@pytest.mark.parametrize("component", ["shank", "holder"])
@pytest.mark.parametrize("known", [True, False])
def test_a_convex_neighbour_is_as_near_to_shank_and_holder_as_its_surface(component: str, known: bool) -> None:
    """A pipe R 20 about the y axis beside the tool: chords of 15 degrees lie 171 um further away than its arc."""
    tool = Tool("S", 1.0, 1.0, 10.0, (Section(4.0, 4.0, 20.0),), (Section(12.0, 12.0, 30.0),), number=3)
    low, high = (15.0, 25.0) if component == "shank" else (38.0, 52.0)
    radius, pipe, off = (2.0 if component == "shank" else 6.0), 20.0, 0.45
    middle = 0.5 * (low + high) - 1.0
    # The pipe's nearest line is x = 20 at height `middle`; five chords to either side of the middle of one.
    angle = np.radians(np.array([-22.5, -7.5, 7.5, 22.5]))
    x, z = pipe * np.cos(angle), middle + pipe * np.sin(angle)
    quads = [
        [(x[k], -30.0, z[k]), (x[k + 1], -30.0, z[k + 1]), (x[k + 1], 30.0, z[k + 1]), (x[k], 30.0, z[k])]
        for k in range(3)
    ]
    scene = scene_of(
        plane_face((-60.0, -50.0), (0.0, 5.0)), tools=[tool], check=triangles_of(*quads, face=5),
        margin=Margin(0.2, 0.5, 0.5),
    )  # fmt: skip
    if known:
        corner = [[x[0], z[0]], [pipe / cos(angle[0]), middle], [x[3], z[3]]]
        poles = np.array([[[a, b, c] for b in (-30.0, 30.0)] for a, c in corner])
        weights = np.repeat([[1.0], [cos(angle[0])], [1.0]], 2, axis=1)
        surface = BSplineSurface(2, 1, np.array([0.0, 0, 0, 1, 1, 1]), np.array([-30.0, -30, 30, 30]), poles, weights)
        scene = with_surfaces(scene, DesignFace(5, "pipe", surface, (rectangle(0.0, 1.0, -30.0, 30.0),), 1))
    result = verify_program(passing(tool, pipe + off + radius), scene, "", 500)
    figures = getattr(result.clearance_mm, component)
    # The sag is told from the angle between triangles, within 1 %.
    assert figures.least == pytest.approx(off, abs=WITHIN if known else 0.003)
    code = {"shank": "CF303", "holder": "CF304"}[component]
    assert [item.amount for item in result.findings if item.code == code] == [figures.least]


def test_shank_over_a_design_face_is_measured_between_the_samples() -> None:
    """A shank along a tangent of a cylinder R 30, 45 degrees up, passes it at a distance known beforehand."""
    radius, off, shank = 30.0, 0.0123, 2.0
    tool = Tool("S", 1.5, 1.5, 10.0, (Section(2.0 * shank, 2.0 * shank, 60.0),), (), number=3)
    axis = np.array([-sin(0.25 * pi), 0.0, cos(0.25 * pi)])
    nearest = (radius + shank + off) * np.array([cos(0.25 * pi), 0.0, sin(0.25 * pi)])
    tip = nearest - 40.0 * axis
    words = "A-45 C+90"
    place = f"X{tip[0]:+.9f} Z{tip[2]:+.9f} {words}"
    body = [f"L {words} R0 FMAX", TCPM, f"L Y+5.03 {place} F1000", "; SWEEP 1", f"L Y+14.97 {place} F1000"]
    text = program([*body, "; RETRACT 1", "L M140 MB MAX"], header(tool), tool)
    result = verify_program(text, scene_of(cylinder_face(radius, (0.0, 20.0)), tools=[tool]), "", 500)
    assert result.clearance_mm.shank.least == pytest.approx(off, abs=WITHIN)


def test_the_edge_of_the_cone_is_found_between_the_points() -> None:
    """A cutter without a shank: the rim of its top disc pokes 4 um into a wall that leans towards it."""
    tool = Tool("N", 2.0, 3.0, 20.0, (), (), number=4)
    top = tool.length - tool.tip_height
    lean = np.array([sin(0.8), cos(0.8)])
    # The wall's plane: x sin + z cos >= const is metal; the rim's corner (3, top) is 4 um within.
    level = 3.0 * lean[0] + top * lean[1] - 0.004

    def at(along: float, y: float) -> tuple[float, float, float]:
        foot = level * lean + (3.0 * lean[1] - top * lean[0] + along) * np.array([lean[1], -lean[0]])
        return float(foot[0]), y, float(foot[1])

    # Where halving leaves it between points: as what is smooth it would be found 5 um off the wall.
    low, high = -1.7 + 4.0 / 7.0, 3.1 + 4.0 / 7.0
    wall = triangles_of([at(low, -31.0), at(high, -31.0), at(high, 33.0), at(low, 33.0)])
    scene = scene_of(plane_face((-60.0, -50.0), (0.0, 5.0)), tools=[tool], check=wall)
    text = program(["L X+0 Y+0.37 Z+0 R0 FMAX", "; SWEEP 1", "L Y+0.38 F500"], header(tool), tool)
    result = verify_program(text, scene, "", 500)
    # In the plane of the axis: on the wall's line the deepest point is as far from the top as from the side.
    along = np.linspace(-0.03, 0.03, 600_001)
    x, z = np.array([3.0, top])[:, None] - 0.004 * lean[:, None] + along * np.array([[lean[1]], [-lean[0]]])
    alpha = tool.half_angle
    deepest = float(np.maximum(z - top, (x - 3.0) * cos(alpha) - (z - top) * sin(alpha)).min())
    assert -0.004 < deepest < -0.002
    assert result.clearance_mm.cone.least == pytest.approx(deepest, abs=WITHIN)


REST = plane_face((30.0, 36.0), (1.0, 20.0))
REGION = plane_face((10.0, 30.0), (1.0, 20.0))


def over_the_border(depth: float, height: float = 0.0) -> str:
    """One sweep over region and rest, the cone lying on the plane; beyond x = 31 it goes `depth` deeper."""
    tilt, tip, _ = lying_on_plane(T1, height)
    words = f"A{tilt:+.9f} C+0"
    place = f"Y{tip[1]:+.9f}"
    z = float(tip[2])
    return program(
        [
            f"L {words} R0 FMAX", TCPM, f"L X+0 {place} Z{z + 30:+.9f} {words} FMAX", f"L X+0 Z{z:+.9f} F500",
            "; SWEEP 1", "L X+31 F1000", f"L X+33 Z{z - depth:+.9f}", f"L X+40 Z{z - depth:+.9f}",
            "; RETRACT 1", f"L Z{z + 30:+.9f} FMAX", "FUNCTION RESET TCPM", "L M140 MB MAX",
        ]
    )  # fmt: skip


@pytest.mark.parametrize("allowance", [0.0, 0.3])
@pytest.mark.parametrize(("depth", "found"), [(0.008, False), (0.025, True)])
def test_the_rest_of_a_face_may_be_cut_no_deeper_than_its_region(depth: float, found: bool, allowance: float) -> None:
    scene = scene_of(REGION, tolerance=Tolerance(allowance=allowance))
    text = over_the_border(depth, allowance)
    assert "CF203" not in codes(verify_program(text, scene, "", 1000))
    result = verify_program(text, replace(scene, rest=(REST,)), "", 1000)
    assert ("CF203" in codes(result)) is found
    assert result.overcut_max_um == pytest.approx(1000.0 * depth, abs=0.05)
    if found:
        assert result.overcut_max_at is not None and result.overcut_max_at.face == REST.number
        cut = next(finding for finding in result.findings if finding.code == "CF203")
        assert cut.limit == pytest.approx(allowance - 0.010)


def test_points_that_are_halved_stay_on_their_surface() -> None:
    faces = (groove(RADIUS, (0.0, 20.0)),)
    sample = Surroundings.of(NOTHING, faces).near(np.full(3, -99.0), np.full(3, 99.0))
    first = len(sample.points)
    while (long := sample.longest > 0.5).any():
        sample = sample.halved(long)
    off = np.abs(np.hypot(sample.points[:, 0] - GROOVE_AT, sample.points[:, 2]) - RADIUS)
    assert len(sample.points) > first + 500
    assert off.max() < 1e-12
    # A side of half a millimetre is 8 um off its arc at most, and a piece off the surface by no more than it says.
    middle = sample.points[sample.pieces].mean(axis=1)
    sag = RADIUS - np.hypot(middle[:, 0] - GROOVE_AT, middle[:, 2])
    assert (sag <= sample.piece_sag + 1e-9).all() and sample.piece_sag.max() < 0.020


def star(points: int, low: float, high: float) -> np.ndarray:
    angle = pi * np.arange(2 * points) / points
    radius = np.where(np.arange(2 * points) % 2 == 0, high, low)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)


@pytest.mark.parametrize(
    "loops",
    [
        (star(9, 1.0, 9.0),),
        (rectangle(-9.0, 9.0, -9.0, 9.0), star(5, 2.0, 8.0)),
        (rectangle(-9.0, 9.0, -0.001, 0.001),),
        (rectangle(-9.0, -1.0, -9.0, 9.0), rectangle(1.0, 9.0, -9.0, 9.0)),
    ],
    ids=["star", "hole", "sliver", "two"],
)
def test_triangles_fill_a_trim_and_nothing_else(loops: Sequence[np.ndarray]) -> None:
    surface = plane_face((-10.0, 10.0), (-10.0, 10.0)).surface
    uv, triangles = triangles_over(DesignFace(0, "", surface, tuple(loops), 1))

    def area(loop: np.ndarray) -> float:
        ahead = np.roll(loop, -1, axis=0)
        return abs(float((loop[:, 0] * ahead[:, 1] - loop[:, 1] * ahead[:, 0]).sum())) / 2.0

    one, other = uv[triangles[:, 1]] - uv[triangles[:, 0]], uv[triangles[:, 2]] - uv[triangles[:, 0]]
    sizes = np.abs(one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]) / 2.0
    whole = area(loops[0]) + sum(area(loop) * (-1.0 if len(loop) > 4 else 1.0) for loop in loops[1:])
    assert sizes.sum() == pytest.approx(whole, rel=1e-9)


def test_stock_and_overcut_are_found_between_the_samples() -> None:
    """Passes over a plane 0.7 mm apart, with points 0.3 mm apart: the crests lie between them, and a dip as well."""
    spacing, radius, dip = 0.7, T1.ball_radius, 0.0031
    body = []
    for k in range(8):
        y = spacing * k
        x = ["L X+3.83 F800", f"L X+4.33 Z{-dip if k == 4 else 0.0:+.6f}", "L X+4.83 Z+0"]
        body += [f"L X-5 Y{y:+.4f} Z+9 R0 FMAX", "L Z+0 F500", f"; PASS {k + 1}", *x, "L X+15", f"; RETRACT {k + 1}"]
        body += ["L Z+9 FMAX"]
    scene = scene_of(plane_face((0.0, 10.0), (0.4, 4.3)), tolerance=Tolerance(0.02, 0.1))
    result = verify_program(program([*body, "L M140 MB MAX"]), scene, "", 400)
    scallop = hypot(radius, spacing / 2.0) - radius
    assert result.stock_max_um == pytest.approx(1000.0 * scallop, abs=0.05)
    assert result.overcut_max_um == pytest.approx(1000.0 * dip, abs=0.05)
    assert result.faces[0].stock_max_um == result.stock_max_um
