"""The polish on the swept gap: exact envelopes, and an arc of which the best norms are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from benchmarks.detection import scene as free_scene
from benchmarks.envelopes import swept_gap as by_brute_force
from conflank_cli.geometry.screening import Screen
from conflank_cli.geometry.workface import WorkFace
from conflank_cli.job import Tolerance
from conflank_cli.limits import Limits
from conflank_cli.motion import Motion
from conflank_cli.optimization.envelope_polish import Points, for_area, for_norm, within
from conflank_cli.optimization.minimax import Aim, least_worst
from conflank_cli.optimization.task import NORM_STEPS, Norm, Task
from conflank_cli.optimization.terms import Weights
from conflank_cli.tool import CATALOGUE, Tool
from tests.faces import design, envelope, envelope_scene, known
from tests.optimization.arcs import CYLINDER, HALF_WIDTH, RADIUS, SAG, arc_points, arc_surface, level

LIMITS = Limits(0.010, 0.010)
WEIGHTS = Weights(mu3=1e-4)


def shaken(motion: Motion, by: float, seed: int) -> Motion:
    """Every coordinate of every control point moved by up to `by` mm."""
    p, q = np.random.default_rng(seed).uniform(-by, by, (2, *motion.p.shape))
    return Motion(motion.knots, motion.p + p, motion.q + q)


def gap_of(tool: Tool, motion: Motion, points: np.ndarray) -> np.ndarray:
    """The swept gap by brute force, which shares nothing with the package."""

    def axis(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        p, q = motion.ends(t)
        return p, (q - p) / np.linalg.norm(q - p, axis=1)[:, None]

    return by_brute_force(tool, axis, points)[0]


def test_a_disturbed_exact_motion_finds_back_to_its_envelope() -> None:
    case = envelope(CATALOGUE["T1"])
    face = WorkFace.of(design(case.surface, case.sense), 0.0)
    exact = known(case)
    rng = np.random.default_rng(5)
    motion = Motion(
        exact.knots,
        exact.p + rng.uniform(-0.01, 0.01, exact.p.shape),
        exact.q + rng.uniform(-0.01, 0.01, exact.q.shape),
    )
    points = Points.of(face, face.spacing(2500))
    assert np.abs(gap_of(case.tool, motion, points.x)).max() > 0.003
    polished = for_area(case.tool, motion, points, LIMITS, WEIGHTS, (3.0,) * 3 + (1.0,) * 6)
    assert polished is not None
    # Points between those it was polished on, and a swept gap from elsewhere.
    gap = gap_of(case.tool, polished, face.samples(0.37).points)
    assert np.abs(gap).mean() < 5e-5
    assert np.abs(gap).max() < 5e-4
    p, q = polished.ends(np.linspace(0.0, 1.0, 300))
    assert np.abs(np.linalg.norm(q - p, axis=1) - case.tool.length).max() < 1e-3


@pytest.mark.parametrize("norm", [2, 8, 32])
def test_norms_of_an_arc_are_those_of_the_best_height(norm: int) -> None:
    """A level motion over an arc leaves c - z(x): the best c for each norm is a minimum in one variable.

    A motion may do a little better by tilting at its ends, never worse.
    """
    points = Points(arc_points(), np.ones(len(arc_points())))
    norms = tuple(p for p, steps in NORM_STEPS.items() if p <= norm for _ in range(2 * steps))
    wide = Limits(0.2, 0.2)
    motion = for_norm(CYLINDER, level(-0.01), points, wide, Weights(mu3=1e-6), norms)
    depth = np.sqrt(RADIUS**2 - points.x[:, 0] ** 2) - RADIUS
    best = minimize_scalar(lambda c: np.sum(np.abs(c - depth) ** norm), bounds=(-SAG, 0.0), method="bounded").fun
    gap = gap_of(CYLINDER, motion, points.x)
    reached = float(np.sum(np.abs(gap) ** norm))
    assert 0.97 < (reached / best) ** (1.0 / norm) < 1.005


def test_one_sided_tolerances_are_kept() -> None:
    """With no overcut allowed the polish settles above the arc, and what it covers is within the band."""
    points = Points(arc_points(), np.ones(len(arc_points())))
    limits = Limits.of(Tolerance(0.0, 1.5 * SAG))
    motion = for_area(CYLINDER, level(0.02), points, limits, WEIGHTS, (3.0,) * 3 + (1.0,) * 8)
    assert motion is not None
    gap = gap_of(CYLINDER, motion, points.x)
    assert gap.min() > -1e-4
    assert within(gap - limits.allowance, limits).mean() > 0.9


def test_nothing_near_is_nothing_to_polish() -> None:
    points = Points(arc_points(), np.ones(len(arc_points())))
    far = level(30.0)
    assert len(points.near(far, CYLINDER, LIMITS, 3.0).x) == 0
    assert for_area(CYLINDER, far, points.near(far, CYLINDER, LIMITS, 3.0), LIMITS, WEIGHTS, (1.0,)) is None
    assert for_norm(CYLINDER, far, points.near(far, CYLINDER, LIMITS, 3.0), LIMITS, WEIGHTS, (2,)) is far


def test_a_task_never_loses_area_by_polishing() -> None:
    case = envelope(CATALOGUE["T3"])
    face = WorkFace.of(design(case.surface, case.sense), 0.7 * case.tool.length)
    samples = face.samples(face.spacing(800))
    points = Points.of(face, face.spacing(1500))
    screen = Screen.of(envelope_scene(case), 1.0)
    task = Task(face, case.tool, samples, points, screen, LIMITS, Weights(), (60, 16), True, 2, True)
    exact = known(case)
    off = task.first(Motion(exact.knots, exact.p + 0.003, exact.q - 0.003))
    before = samples.areas[task.covered(task.gaps(off.motion))].sum()
    for norm in (2, 8, "max"):
        flat = replace(task, norm=norm)
        after = flat.grown(flat.refined(off, off.motion), off.motion)
        covered = task.covered(task.gaps(after.motion))
        assert samples.areas[covered].sum() >= 0.998 * before
        assert np.abs(task.gaps(after.motion)[covered]).max() < 1e-3
    assert after.end.distance < off.end.distance + 1e-9


@pytest.mark.parametrize("norm", [32, "max"])
def test_the_worst_gap_is_even_about_the_middle_of_unequal_tolerances(norm: Norm) -> None:
    """Over an arc of sag s the gap fills s / 2 to either side of it, though one side has less room than s / 2."""
    arc = design(arc_surface(), 1)
    face = WorkFace.of(arc, 0.7 * CYLINDER.length)
    limits = Limits(0.4 * SAG, 0.8 * SAG)
    screen = Screen.of(free_scene(arc, (CYLINDER,), "quick", free=True), 1.0)
    samples, points = face.samples(1.0), Points.of(face, 1.0)
    task = Task(face, CYLINDER, samples, points, screen, limits, Weights(), (40, 16), True, norm, False)
    first = task.first(level(-0.2 * SAG, 12))
    gap = task.gaps(task.grown(task.refined(first, first.motion), first.motion).motion)
    assert np.abs(gap - limits.middle).max() < 0.51 * SAG


def test_the_least_maximum_over_an_arc() -> None:
    """A level motion misses an arc of sag s by s / 2 at best, by s with no overcut, whatever it starts from."""
    points = arc_points()
    served = np.ones(len(points), dtype=np.bool_)
    rng = np.random.default_rng(3)
    start = level(0.01)
    start = Motion(
        start.knots,
        start.p + rng.uniform(-0.02, 0.02, start.p.shape),
        start.q + rng.uniform(-0.02, 0.02, start.q.shape),
    )
    motion, worst = least_worst(start, CYLINDER, Aim(points, served))
    assert worst == pytest.approx(SAG / 2.0, rel=0.01)
    gap = gap_of(CYLINDER, motion, points)
    assert np.abs(gap).max() == pytest.approx(worst, abs=1e-6)
    motion, _ = least_worst(start, CYLINDER, Aim(points, served, overcut=0.0))
    gap = gap_of(CYLINDER, motion, points)
    assert gap.min() > -2e-5
    assert gap.max() == pytest.approx(SAG, rel=0.01)


def test_the_trade_between_overcut_and_stock_is_a_line_over_an_arc() -> None:
    points = arc_points()
    served = np.ones(len(points), dtype=np.bool_)
    for overcut in (0.25 * SAG, 0.75 * SAG):
        motion, _ = least_worst(level(0.0), CYLINDER, Aim(points, served, overcut=overcut))
        gap = gap_of(CYLINDER, motion, points)
        assert -gap.min() <= overcut + 2e-5
        assert gap.max() == pytest.approx(SAG - overcut, rel=0.01)


def test_stock_that_is_not_served_does_not_count() -> None:
    """With only the low edges of the arc served the motion goes down to them, where overcut is free."""
    points = arc_points()
    served = np.abs(points[:, 0]) > 0.9 * HALF_WIDTH
    motion, _ = least_worst(level(0.0), CYLINDER, Aim(points, served, overcut=2.0 * SAG))
    gap = gap_of(CYLINDER, motion, points)
    assert gap[served].max() < 1e-4
