"""The exact envelopes are exact: by their definition, by brute force, and as a job on disk."""

from __future__ import annotations

from dataclasses import replace
from math import cos, tan
from pathlib import Path

import numpy as np
import pytest
from OCP.BRepAdaptor import BRepAdaptor_Surface
from OCP.gp import gp_Pnt
from OCP.STEPControl import STEPControl_Reader
from OCP.TopAbs import TopAbs_FACE, TopAbs_FORWARD
from OCP.TopExp import TopExp_Explorer
from OCP.TopoDS import TopoDS
from scipy.optimize import minimize_scalar

from benchmarks.envelopes import (
    MARGIN,
    PATCH,
    EnvelopeCase,
    contact,
    cutter_distance,
    cylinder,
    random_envelopes,
    swept_gap,
    write_job,
)
from conflank_cli.geometry.footpoint import INTERIOR, Projector
from conflank_cli.job import load_job
from conflank_cli.tool import CATALOGUE, Tool

TOOLS = [*CATALOGUE.values(), cylinder()]
CASES = [case for tool in TOOLS for case in random_envelopes(tool, 2, 11)]
NAMES = [f"{case.tool.name}-{k % 2}" for k, case in enumerate(CASES)]


def contact_grid(case: EnvelopeCase) -> tuple[np.ndarray, np.ndarray]:
    """Times and heights (as fractions of the flute) over the face, a little inside its border."""
    t, fraction = np.meshgrid(np.linspace(0.055, 0.945, 30), np.linspace(0.04, 0.96, 12), indexing="ij")
    return t.ravel(), fraction.ravel()


@pytest.mark.parametrize("case", CASES, ids=NAMES)
def test_axis_points_are_a_sphere_radius_off_the_face(case: EnvelopeCase) -> None:
    """The condition that detection and optimisation aim at, with the sign that `sense` gives."""
    t, fraction = contact_grid(case)
    alpha = case.tool.half_angle
    height = fraction * case.tool.length / cos(alpha) ** 2 + case.tool.r_min * tan(alpha)
    low, high = case.tool.centre_range
    assert low < height.min() and height.max() < high
    p, d = case.motion.axis(t)
    found = Projector.of(case.surface).project(p + height[:, None] * d, t, fraction)
    np.testing.assert_array_equal(found.flag, INTERIOR)
    np.testing.assert_allclose(case.sense * found.distance, case.tool.sphere_radius(height), rtol=0.0, atol=2e-5)
    # The foot is the contact of that very sphere at that very time.
    np.testing.assert_allclose(found.u, t, rtol=0.0, atol=1e-4)
    np.testing.assert_allclose(found.v, fraction, rtol=0.0, atol=1e-3)


@pytest.mark.parametrize("case", CASES, ids=NAMES)
def test_known_motion_cuts_the_face_and_nothing_below_it(case: EnvelopeCase) -> None:
    """Swept gap by brute force on the whole face, borders included."""
    u, v = np.meshgrid(np.linspace(*PATCH, 40), np.linspace(MARGIN, 1.0 - MARGIN, 15), indexing="ij")
    gap, at = swept_gap(case.tool, case.motion.axis, Projector.of(case.surface).evaluate(u, v)[:, 0], 161)
    assert np.abs(gap).max() <= 5e-5
    np.testing.assert_allclose(at, u.ravel(), atol=2e-3)


@pytest.mark.parametrize("case", CASES, ids=NAMES)
def test_motions_are_as_on_blades(case: EnvelopeCase) -> None:
    p, q = case.p, case.q
    np.testing.assert_allclose(np.linalg.norm(q - p, axis=1), case.tool.length, atol=1e-12)  # rigid
    way = np.linalg.norm(np.diff(0.5 * (p + q), axis=0), axis=1).sum()
    assert 25.0 < way < 80.0
    directions = (q - p) / case.tool.length
    turning = np.degrees(np.arccos(np.clip(directions @ directions.T, -1.0, 1.0)).max())
    assert 3.0 < turning < 60.0


def test_contact_satisfies_both_conditions_against_finite_differences() -> None:
    tool, motion = CATALOGUE["T3"], CASES[0].motion
    t, fraction = np.full(9, 0.4), np.linspace(0.1, 0.9, 9)
    for side in (-1, 1):
        points, normal = contact(tool, motion, t, fraction, side)
        p, d = motion.axis(t)
        np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0, atol=1e-14)
        np.testing.assert_allclose(np.sum(normal * d, axis=1), np.sin(tool.half_angle), atol=1e-14)
        # The contact is on the cone, at the height asked for, and the normal points to the axis.
        np.testing.assert_allclose(cutter_distance(tool, p, d, points), 0.0, atol=1e-12)
        np.testing.assert_allclose(np.sum((points - p) * d, axis=1), fraction * tool.length, atol=1e-12)
        np.testing.assert_array_less(0.0, cutter_distance(tool, p, d, points - 0.1 * normal))
        # A point of the envelope stays on the cutter's skin to first order while the cutter moves.
        step = 1e-4
        before, after = (cutter_distance(tool, *motion.axis(t + s), points) for s in (-step, step))
        np.testing.assert_allclose((after - before) / (2.0 * step), 0.0, atol=1e-3)


@pytest.mark.parametrize("tool", TOOLS, ids=lambda tool: tool.name)
def test_cutter_distance_is_the_distance_to_the_spheres(tool: Tool) -> None:
    """Ball and cone are the union of the spheres inscribed in the cone: the least distance to one of them."""
    rng = np.random.default_rng(2)
    p, d = np.array([1.0, 2.0, 3.0]), np.array([2.0, -1.0, 2.0]) / 3.0
    low, high = tool.centre_range
    for point in p + rng.uniform(-8.0, 8.0, (40, 3)) + 0.4 * tool.length * d:
        best = minimize_scalar(
            lambda h, point=point: float(np.linalg.norm(point - p - h * d) - tool.sphere_radius(h)),
            bounds=(low, high),
            method="bounded",
            options={"xatol": 1e-10},
        )
        if low + 0.01 < best.x < high - 0.01:
            assert cutter_distance(tool, p, d, point) == pytest.approx(best.fun, abs=1e-9)
    tip = p + tool.tip_height * d
    assert cutter_distance(tool, p, d, tip) == pytest.approx(0.0, abs=1e-12)
    assert cutter_distance(tool, p, d, tip - 2.0 * d) == pytest.approx(2.0, abs=1e-12)


def test_motions_that_fold_or_cross_themselves_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """The draw goes on until a motion is sound."""
    tool, sound = CASES[0].tool, CASES[0].motion
    fold, cross = np.zeros((4, 3)), np.zeros((4, 3))
    fold[0], fold[2] = [30.0, 0.0, 0.0], [12.0, 0.0, 0.0]  # forwards, backwards, forwards
    cross[0], cross[2], cross[3] = [40.0, 0.0, 0.0], [-5.0, 14.0, 0.0], [14.0, 0.0, 0.0]  # a loop
    refused = [replace(sound, path=fold), replace(sound, path=cross)]
    offered = iter([*refused, sound])
    monkeypatch.setattr("benchmarks.envelopes.random_motion", lambda tool, rng: next(offered))
    (case,) = random_envelopes(tool, 1, 11)
    assert case.motion is sound
    assert next(offered, None) is None


def test_equal_seeds_give_equal_cases() -> None:
    tool = CATALOGUE["T2"]
    again = random_envelopes(tool, 1, 11)[0]
    first = next(case for case in CASES if case.tool.name == "T2")
    np.testing.assert_array_equal(again.surface.poles, first.surface.poles)
    np.testing.assert_array_equal(again.p, first.p)
    assert again.sense == first.sense


@pytest.mark.parametrize("case", [CASES[0], CASES[-1]], ids=[NAMES[0], NAMES[-1]])
def test_job_on_disk(case: EnvelopeCase, tmp_path: Path) -> None:
    """The STEP file holds the same surface with the same orientation; the job file is one that the program accepts."""
    path = write_job(case, tmp_path / "case", "face")
    job = load_job(path)
    (tool,) = job.resolved_tools()
    assert (tool.r_min, tool.r_max, tool.length) == (case.tool.r_min, case.tool.r_max, case.tool.length)
    assert job.part.design[0].side == ("outside" if case.sense > 0 else "inside")
    reader = STEPControl_Reader()
    reader.ReadFile(str(path.with_suffix(".step")))
    reader.TransferRoots()
    explorer = TopExp_Explorer(reader.OneShape(), TopAbs_FACE)
    face = TopoDS.Face(explorer.Current())
    assert face.Orientation() == TopAbs_FORWARD
    adaptor, point = BRepAdaptor_Surface(face), gp_Pnt()
    u, v = contact_grid(case)
    expected = Projector.of(case.surface).evaluate(u, v)[:, 0]
    found = []
    for a, b in zip(u, v, strict=True):
        adaptor.D0(a, b, point)
        found.append([point.X(), point.Y(), point.Z()])
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-9)
    explorer.Next()
    assert not explorer.More()
