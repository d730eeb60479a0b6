"""Detection on faces that one motion of the tool cuts exactly."""

from __future__ import annotations

from dataclasses import replace

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from benchmarks.detection import scene as free_scene
from benchmarks.envelopes import cylinder
from benchmarks.shapes import moved
from conflank_cli.detection import DENSITIES, SPREAD, detect
from conflank_cli.detection.ruled_fit import FEWEST, MOST, RIGID, SHARE, fit_motion
from conflank_cli.detection.settling import Contact, settle
from conflank_cli.errors import NumericalError
from conflank_cli.geometry.gap import motion_gap
from conflank_cli.geometry.workface import WorkFace
from conflank_cli.job import Setup, Tolerance
from conflank_cli.limits import Limits
from conflank_cli.optimization.gauss_newton import error_field
from conflank_cli.progress import SilentProgress
from conflank_cli.scene import Scene
from conflank_cli.sweep import Sweep
from conflank_cli.tool import CATALOGUE, Tool
from tests.faces import design, envelope, envelope_scene, interpolated, round_face, stacked, work
from tests.verification.scenes import scene_of

TOOLS = [*CATALOGUE.values(), cylinder()]


def covered(scene: Scene, tool: Tool, sweep: Sweep, tolerance: float) -> float:
    """Share of the face within tolerance of the fitted motion, by its swept gap."""
    samples = WorkFace.of(scene.faces[0], 0.0).samples(1.0)
    gap, _ = motion_gap(sweep.motion, tool, samples.points)
    return float(samples.areas[np.abs(gap) <= tolerance].sum() / samples.areas.sum())


@pytest.mark.parametrize("tool", TOOLS, ids=lambda tool: tool.name)
def test_some_candidate_nearly_cuts_an_exact_envelope(tool: Tool) -> None:
    """Before any optimisation: 90 % of the patch in one sweep, its axis error within 20 µm over the whole face."""
    case = envelope(tool)
    scene = envelope_scene(case)
    sweeps = detect(scene, SilentProgress())
    areas = [sweep.facts["area_mm2"] for sweep in sweeps]
    assert areas == sorted(areas, reverse=True)
    assert 0 < len(sweeps) <= DENSITIES["quick"].families + SPREAD
    face = WorkFace.of(scene.faces[0], 0.7 * tool.length)
    found = False
    for sweep in sweeps[:4]:
        field, _, _ = error_field(face, tool, sweep.motion, 0.0, (80, 24))
        # The first and last lines lie beside the face and are not held by it.
        error = np.abs(field.error[field.on > 0.5])
        found |= covered(scene, tool, sweep, 0.020) >= 0.9 and float(np.quantile(error, 0.99)) <= 0.020
    assert found
    whole = WorkFace.of(scene.faces[0], 0.0).samples(1.0).areas.sum()
    assert areas[0] >= 0.9 * whole
    assert areas[0] <= 1.001 * whole


@settings(max_examples=3, deadline=None, derandomize=True)
@given(st.integers(0, 2**32 - 1))
def test_moving_the_part_moves_what_is_found(seed: int) -> None:
    """A part turned and shifted in its CAD frame and turned back on the machine's table.

    Refinement amplifies rounding a little, and a soft mode may settle elsewhere: 1 µm, against 30 mm of travel.
    """
    rotation = Rotation.random(random_state=np.random.RandomState(seed % 2**31))
    shift = np.random.default_rng(seed).uniform(-100.0, 100.0, 3)
    case = envelope(CATALOGUE["T3"])
    scene = envelope_scene(case)
    surface = moved(case.surface, rotation.as_matrix(), shift)
    turned = replace(scene, faces=(design(surface, case.sense),))
    back = tuple(float(x) for x in rotation.inv().as_euler("XYZ", degrees=True))
    turned = replace(turned, job=msgspec.structs.replace(scene.job, setup=Setup(rotate_deg=back)))
    here, there = detect(scene, SilentProgress()), detect(turned, SilentProgress())
    assert there[0].facts["area_mm2"] == pytest.approx(here[0].facts["area_mm2"], rel=0.02)
    assert len(there) == pytest.approx(len(here), abs=3)
    t = np.linspace(0.0, 1.0, 40)
    for a, b in zip(here[0].motion.ends(t), there[0].motion.ends(t), strict=True):
        expected = rotation.apply(a) + shift
        # A sequence may be followed from either end.
        assert min(np.abs(b - expected).max(), np.abs(b - expected[::-1]).max()) < 1e-3


def test_no_line_fits_is_an_error_that_says_so() -> None:
    """A bore of radius 4 mm for a tool of up to 5."""
    scene = scene_of(design(round_face(4.0), -1), tools=(CATALOGUE["T2"],))
    with pytest.raises(NumericalError, match="no line of T2"):
        detect(scene, SilentProgress())


@settings(max_examples=2, deadline=None, derandomize=True)
@given(st.floats(0.7, 1.5))
def test_scaling_part_tool_and_tolerance_scales_what_is_found(scale: float) -> None:
    """Steps and rasters are in mm, so lines fall elsewhere; the patches must be the same all the same."""
    case = envelope(CATALOGUE["T1"])
    surface = case.surface
    larger = replace(surface, poles=np.ascontiguousarray(scale * surface.poles))
    tool = Tool("T1", scale * case.tool.r_min, scale * case.tool.r_max, scale * case.tool.length)
    areas = []
    for face, cutter, factor in ((surface, replace(case.tool, shank=(), holder=()), 1.0), (larger, tool, scale)):
        scene = free_scene(design(face, case.sense), (cutter,), "quick", free=True)
        tolerance = Tolerance(0.020 * factor, 0.020 * factor)
        scene = replace(scene, job=msgspec.structs.replace(scene.job, tolerance=tolerance))
        sweeps = detect(scene, SilentProgress())
        areas.append(sweeps[0].facts["area_mm2"] / factor**2)
        assert max(covered(scene, cutter, sweep, 0.020 * factor) for sweep in sweeps[:4]) >= 0.9
    assert areas[1] == pytest.approx(areas[0], rel=0.02)


def test_both_families_of_lines_are_followed_with_the_tip_either_way() -> None:
    """z = x y / 120 is ruled along x and along y; a cylinder follows either, from either end."""
    surface = interpolated(lambda u, v: stacked(u, v, u * v / 120.0), (-12.0, 12.0), (-12.0, 12.0), 8)
    tool = Tool("cylinder", 3.0, 3.0, 20.0)
    sweeps = detect(free_scene(design(surface, 1), (tool,), "quick", free=True), SilentProgress())
    axes = np.array([np.subtract(*sweep.motion.ends(0.5)) for sweep in sweeps]) / -tool.length
    for ruling in ([1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, -1.0, 0.0]):
        assert (axes @ ruling).max() > np.cos(0.1)


def circular(radius: float, step: float, jump: float = 0.0) -> Contact:
    """Lines `step` mm apart on a circle, along z, all of them in contact with the cylinder inside of it.

    jump: every other line is moved so far along itself and turned by a thousandth of that about the normal, which the
    contact does not feel.
    """
    angle = np.arange(0.0, 1.5, step / radius)
    out = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)
    side = jump * (-1.0) ** np.arange(len(angle))[:, None]
    d = np.array([0.0, 0.0, 1.0]) + 1e-3 * side * np.cross([0.0, 0.0, 1.0], out)
    heights = np.linspace(0.0, 25.0, 12)
    shape = (len(angle), len(heights))
    normal = np.repeat(out[:, None], len(heights), axis=1)
    d /= np.linalg.norm(d, axis=1)[:, None]
    return Contact(radius * out + side * d, d, heights, np.zeros(shape), np.ones(shape), normal, np.ones(shape))


@pytest.mark.parametrize("jump", [0.0, 0.3])
@pytest.mark.parametrize("tolerance", [0.020, 0.001])
def test_fit_is_as_close_as_asked_and_rigid(jump: float, tolerance: float) -> None:
    """A circle of radius 30 mm, whether or not the lines jump along it; 25 mm long to 1 µm throughout."""
    contact = circular(30.0, 1.5, jump)
    motion = fit_motion(contact, 25.0, Limits(tolerance, tolerance))
    t = np.linspace(0.0, 1.0, 400)
    p, q = motion.ends(t)
    inside = (t > 0.02) & (t < 0.98)
    # Twice what the fit asks of itself at the lines: between them nothing holds it but its smoothness.
    assert np.abs(np.hypot(p[inside, 0], p[inside, 1]) - 30.0).max() < 2.0 * SHARE * tolerance
    assert np.abs(np.hypot(q[inside, 0], q[inside, 1]) - 30.0).max() < 2.0 * SHARE * tolerance
    assert np.abs(np.linalg.norm(q - p, axis=1) - 25.0).max() < 1.05 * RIGID
    # Steady: t runs with the travel, but where few control points do, along the face they may cut corners.
    speed = np.linalg.norm(motion.ends(t, 1)[0][:, :2], axis=1)
    np.testing.assert_allclose(speed, speed.mean(), rtol=0.1)
    assert FEWEST <= len(motion.p) <= MOST


def test_fit_has_no_more_control_points_than_the_tolerance_needs() -> None:
    contact = circular(30.0, 1.5)
    coarse, fine = (len(fit_motion(contact, 25.0, Limits(x, x)).p) for x in (0.020, 0.00005))
    assert coarse == FEWEST < fine


@pytest.mark.parametrize("count", [4, 5, 300])
def test_fit_has_no_more_control_points_than_lines(count: int) -> None:
    x = 1.5 * np.arange(count)
    p = np.stack([x, 0.0 * x, 0.0 * x], axis=1)
    shape = (count, 3)
    contact = Contact(
        p, np.tile([0.0, 0.0, 1.0], (count, 1)), np.array([0.0, 5.0, 10.0]), np.zeros(shape), np.ones(shape),
        np.tile([0.0, 1.0, 0.0], (*shape, 1)), np.ones(shape),
    )  # fmt: skip
    motion = fit_motion(contact, 10.0, Limits(0.01, 0.01))
    assert 4 <= len(motion.p) <= min(max(count - 1, 4), MOST)
    np.testing.assert_allclose(motion.ends([0.0, 1.0])[0], p[[0, -1]], atol=1e-6)


def test_settled_lines_are_in_contact() -> None:
    """Lines along a cylinder that hang 30 µm off and lean: refined, they touch, and the normals say where."""
    face = work(round_face(25.0, 0.0, 36.0), 1, 8.0)
    tool = Tool("cylinder", 3.0, 3.0, 20.0)
    angle = np.linspace(-0.3, 0.3, 9)
    out = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)
    d = np.array([0.0, 0.0, 1.0]) + 0.004 * out
    p = 28.03 * out + np.array([0.0, 0.0, 8.0])
    contact = settle(face, tool, p, d / np.linalg.norm(d, axis=1)[:, None], Limits(0.02, 0.02))
    assert np.abs(contact.error).max() < 2e-4
    np.testing.assert_array_equal(contact.on, 1.0)
    np.testing.assert_allclose(contact.weight, 1.0, atol=1e-3)
    np.testing.assert_allclose(contact.normal, np.repeat(out[:, None], len(contact.heights), axis=1), atol=1e-3)
    np.testing.assert_allclose(p[:, 2], 8.0)  # what was given is left alone
