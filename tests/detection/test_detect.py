"""Detection on faces that one motion of the tool cuts exactly."""

from __future__ import annotations

from dataclasses import replace

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from benchmarks.envelopes import cylinder
from benchmarks.shapes import moved
from conflank_cli.detection import detect
from conflank_cli.detection.ruled_fit import FEWEST, MOST, fit_motion
from conflank_cli.errors import NumericalError
from conflank_cli.geometry.gap import motion_gap
from conflank_cli.geometry.workface import WorkFace
from conflank_cli.job import Setup
from conflank_cli.optimization.gauss_newton import error_field
from conflank_cli.progress import SilentProgress
from conflank_cli.scene import Scene
from conflank_cli.sweep import Sweep
from conflank_cli.tool import CATALOGUE, Tool
from tests.faces import design, envelope, envelope_scene, round_face
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
    assert 0 < len(sweeps) <= 40
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


def test_fit_goes_through_lines_of_a_circle() -> None:
    """Lines 1.5 mm apart on a circle of radius 30: between them the fit is linear interpolation, 10 µm off at most."""
    angle = np.arange(0.0, 1.5, 0.05)
    out = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)
    d = np.tile([0.0, 0.0, 1.0], (len(angle), 1))
    motion = fit_motion(30.0 * out, d, 25.0)
    t = np.linspace(0.0, 1.0, 100)
    p, q = motion.ends(t)
    assert np.abs(np.hypot(p[:, 0], p[:, 1]) - 30.0).max() < 0.012
    np.testing.assert_allclose(q - p, np.tile([0.0, 0.0, 25.0], (100, 1)), atol=1e-9)
    # Steady: t runs with the travel.
    speed = np.linalg.norm(motion.ends(t, 1)[0], axis=1)
    np.testing.assert_allclose(speed, speed.mean(), rtol=0.02)
    np.testing.assert_allclose(p[0], [30.0, 0.0, 0.0], atol=0.01)
    assert FEWEST <= len(motion.p) <= MOST


@pytest.mark.parametrize("count", [4, 5, 300])
def test_fit_has_no_more_control_points_than_lines(count: int) -> None:
    x = 1.5 * np.arange(count)
    p = np.stack([x, 0.0 * x, 0.0 * x], axis=1)
    motion = fit_motion(p, np.tile([0.0, 0.0, 1.0], (count, 1)), 10.0)
    assert 4 <= len(motion.p) <= min(max(count - 1, 4), MOST)
    np.testing.assert_allclose(motion.ends([0.0, 1.0])[0], p[[0, -1]], atol=1e-9)
