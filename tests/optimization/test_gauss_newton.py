"""Gauss-Newton against dense algebra, finite differences and motions that are known to be exact."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import BSpline
from scipy.linalg import solveh_banded

from benchmarks.envelopes import cylinder
from benchmarks.envelopes import swept_gap as by_brute_force
from conflank_cli.geometry.kernels.banded import add_errors, add_rows, solve
from conflank_cli.geometry.kernels.gauss_newton import BARRIER_FROM, BARRIER_GAIN, OFF_FACE, sample_weights
from conflank_cli.geometry.normal_equations import NormalEquations, basis_at
from conflank_cli.geometry.workface import WorkFace
from conflank_cli.motion import Motion, uniform_knots
from conflank_cli.optimization.gauss_newton import (
    STATUS,
    Limits,
    Step,
    error_field,
    minimise,
)
from conflank_cli.optimization.terms import AxisPath, Weights
from conflank_cli.tool import CATALOGUE, Tool
from tests.faces import design, envelope, known, work
from tests.verification.scenes import plane_face

LIMITS = Limits(0.010, 0.010)
GRID = (60, 16)
# The paper's weights first; then fairness and orthogonality fade while rigidity gains, as `Task` does it.
SCHEDULE = (Step(1.0, 1.0, 0.03, False),) * 3 + tuple(
    Step(10.0**-k, min(10.0 ** (k / 2), 1e3), 0.03, False) for k in range(1, 9)
)


@pytest.fixture(scope="module")
def exact() -> tuple[WorkFace, Tool, Motion]:
    case = envelope(CATALOGUE["T1"])
    return WorkFace.of(design(case.surface, case.sense), 0.7 * case.tool.length), case.tool, known(case, 14)


def test_basis_is_that_of_the_knots() -> None:
    count, samples = 9, 25
    t = np.linspace(0.0, 1.0, samples)
    basis = basis_at(uniform_knots(count), t)
    spline = BSpline(uniform_knots(count), np.eye(count), 3)
    for order, rows in enumerate((basis.value, basis.slope, basis.bend)):
        dense = np.zeros((samples, count))
        for i in range(samples):
            dense[i, basis.first[i] : basis.first[i] + 4] = rows[i]
        np.testing.assert_allclose(dense, spline(t, nu=order), atol=1e-9)


def test_banded_normal_equations_against_dense_ones() -> None:
    rng = np.random.default_rng(4)
    count, m, k = 7, 30, 3
    basis = basis_at(uniform_knots(count), np.linspace(0.0, 1.0, m))
    rows, residuals, weights = rng.normal(size=(m, k, 6)), rng.normal(size=(m, k)), rng.uniform(0.0, 2.0, (m, k))
    weights[rng.random((m, k)) < 0.2] = 0.0
    band, right = np.zeros((24, 6 * count)), np.zeros(6 * count)
    add_rows(band, right, basis.first, basis.value, rows, residuals, weights)
    jacobian = np.zeros((m, k, count, 6))
    for i in range(m):
        for c in range(4):
            jacobian[i, :, basis.first[i] + c] = basis.value[i, c] * rows[i]
    jacobian = jacobian.reshape(m * k, 6 * count)
    matrix = jacobian.T @ (weights.reshape(-1, 1) * jacobian)
    np.testing.assert_allclose(right, -jacobian.T @ (weights * residuals).ravel(), atol=1e-12)
    for r in range(24):
        np.testing.assert_allclose(band[r, : 6 * count - r], np.diagonal(matrix, -r), atol=1e-12)
        np.testing.assert_array_equal(band[r, 6 * count - r :], 0.0)
    assert np.abs(np.tril(matrix, -24)).max() == 0.0
    # Adding is adding, and the solver reads the band as it was meant.
    add_rows(band, right, basis.first, basis.value, rows, residuals, weights)
    band[0] += 1.0
    expected = np.linalg.solve(2.0 * matrix + np.eye(6 * count), right)
    np.testing.assert_allclose(solveh_banded(band, right, lower=True), expected, atol=1e-9)
    found = np.empty(6 * count)
    assert solve(band, right, found)
    np.testing.assert_allclose(found, expected, atol=1e-9)
    band[0, 9] = -1.0
    assert not solve(band, right, found)


def test_axis_errors_add_what_their_rows_add() -> None:
    rng = np.random.default_rng(7)
    count, m, n = 8, 20, 5
    basis = basis_at(uniform_knots(count), np.linspace(0.0, 1.0, m))
    s, normals, errors = rng.uniform(-0.2, 1.0, n), rng.normal(size=(m, n, 3)), rng.normal(size=(m, n))
    weights = rng.uniform(0.0, 2.0, (m, n)) * (rng.random((m, n)) < 0.8)
    rows = np.concatenate([(1.0 - s)[None, :, None] * normals, s[None, :, None] * normals], axis=2)
    expected, found = NormalEquations.of(count), NormalEquations.of(count)
    expected.add(basis.first, basis.value, rows, errors, weights)
    add_errors(found.band, found.right, basis.first, basis.value, s, normals, errors, weights)
    np.testing.assert_allclose(found.band, expected.band, atol=1e-12)
    np.testing.assert_allclose(found.right, expected.right, atol=1e-12)


def test_terms_of_a_motion_add_the_rows_of_their_residuals(exact: tuple[WorkFace, Tool, Motion]) -> None:
    """Rigidity, proximity, fairness and orthogonality as residuals with their gradients, written out."""
    _, tool, motion = exact
    motion = Motion(motion.knots, motion.p + np.random.default_rng(8).normal(0.0, 0.3, motion.p.shape), motion.q)
    t = np.linspace(0.0, 1.0, 40)
    basis = basis_at(motion.knots, t)
    path = AxisPath.of(motion, tool, basis)
    (p, q), (slope_p, slope_q) = motion.ends(t), motion.ends(t, 1)
    d = (q - p) / np.linalg.norm(q - p, axis=1)[:, None]
    velocity = 0.5 * (slope_p + slope_q)
    speed = np.linalg.norm(velocity, axis=1)
    cosine = np.sum(velocity * d, axis=1) / speed
    bend = np.hstack(motion.ends(t, 2))
    np.testing.assert_allclose(path.d, d, atol=1e-12)
    np.testing.assert_allclose(path.excess, np.linalg.norm(q - p, axis=1) - tool.length, atol=1e-10)
    np.testing.assert_allclose(path.velocity, velocity, atol=1e-10)
    np.testing.assert_allclose(path.cosine, cosine, atol=1e-12)
    np.testing.assert_allclose(path.bend, bend, atol=1e-7)

    fade, stiff, m = 0.3, 7.0, len(t)
    weights = Weights(1.0, 0.2, 0.03, 0.4, 0.5)
    expected, found = NormalEquations.of(len(motion.p)), NormalEquations.of(len(motion.p))
    unit = np.broadcast_to(np.eye(6), (m, 6, 6))
    rigid, across = np.hstack([-d, d])[:, None], (0.5 * np.hstack([d, d]) / speed[:, None])[:, None]
    for rows, own, residuals, weight in (
        (basis.value, rigid, path.excess[:, None], stiff * weights.mu4 / m),
        (basis.value, unit, np.zeros((m, 6)), weights.mu3 / (2 * m)),
        (basis.bend, unit, bend, fade * weights.mu2 / (2 * m * speed.mean() ** 4)),
        (basis.slope, across, cosine[:, None], fade * weights.mu5 / m),
    ):
        expected.add(basis.first, rows, own, residuals, np.full(residuals.shape, weight))
    path.add(found, weights, fade, stiff)
    np.testing.assert_allclose(found.band, expected.band, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(found.right, expected.right, rtol=1e-9, atol=1e-9)


def test_gradient_of_the_axis_error_is_the_normal(exact: tuple[WorkFace, Tool, Motion]) -> None:
    """Moving p and q of a motion: the error changes by (1 - s) n and s n, by central differences."""
    face, tool, motion = exact
    rng = np.random.default_rng(6)
    moved = Motion(motion.knots, motion.p + 0.05 * rng.normal(size=motion.p.shape), motion.q)
    field, normal, fractions = error_field(face, tool, moved, 0.0, GRID)
    inner = field.on > 0.5
    step = 1e-4
    for _ in range(3):
        a, b = rng.normal(size=(2, 3))
        after, before = (
            error_field(face, tool, Motion(motion.knots, moved.p + s * a, moved.q + s * b), 0.0, GRID, field)[0].error
            for s in (step, -step)
        )
        slope = normal @ a * (1.0 - fractions) + normal @ b * fractions
        np.testing.assert_allclose(((after - before) / (2.0 * step))[inner], slope[inner], atol=1e-6)


def objective(face: WorkFace, tool: Tool, motion: Motion, weights: Weights, m: int, travel: float) -> float:
    """The functional without its distance term, written down again: half the weighted mean squares."""
    t = np.linspace(0.0, 1.0, m)
    p, q = motion.ends(t)
    bend = np.hstack(motion.ends(t, 2)) / travel**2
    rigid = np.linalg.norm(q - p, axis=1) - tool.length
    return 0.5 * (weights.mu4 * float(np.mean(rigid**2)) + weights.mu2 * float(np.mean(bend**2)) * 3.0)


@pytest.mark.parametrize("term", ["mu2", "mu4"])
def test_first_step_goes_down_the_gradient_of_each_term(exact: tuple[WorkFace, Tool, Motion], term: str) -> None:
    """With a very large mu3 the step is minus the gradient over mu3 / (count weights): against finite differences."""
    face, tool, motion = exact
    rng = np.random.default_rng(8)
    start = Motion(motion.knots, motion.p + 0.02 * rng.normal(size=motion.p.shape), motion.q)
    m = 60
    heavy = 1e7
    weights = replace(Weights(0.0, 0.0, heavy, 0.0, 0.0), **{term: 1.0})
    solution = minimise(face, tool, start, LIMITS, weights, (m, 8), (Step(1.0, 1.0, 0.03, False),))
    step = np.hstack([solution.motion.p - start.p, solution.motion.q - start.q])
    t = np.linspace(0.0, 1.0, m)
    values = BSpline(start.knots, np.eye(len(start.p)), 3)(t)
    proximity = heavy / (2 * m) * values.T @ values
    p1, q1 = start.ends(t, 1)
    travel = float(np.linalg.norm(0.5 * (p1 + q1), axis=1).mean())

    def value(control: np.ndarray) -> float:
        return objective(face, tool, Motion(start.knots, control[:, :3], control[:, 3:]), weights, m, travel)

    control = np.hstack([start.p, start.q])
    gradient = np.zeros_like(control)
    for index in np.ndindex(control.shape):
        move = np.zeros_like(control)
        move[index] = 1e-4
        gradient[index] = (value(control + move) - value(control - move)) / 2e-4
    # What mu3 does not outweigh of the term's own curvature is a few millionths of it.
    np.testing.assert_allclose(proximity @ step, -gradient, atol=1e-5 * np.abs(gradient).max())


def test_orthogonality_turns_the_velocity_across_the_axis() -> None:
    """A cylinder that screws along itself: with mu5 the speed along the axis dies, without it stays."""
    tool = cylinder()
    knots = uniform_knots(8)
    x = np.array([knots[k + 1 : k + 4].mean() for k in range(8)])
    p = np.stack([30.0 * x, 10.0 * x, np.full(8, 3.0)], axis=1)
    motion = Motion(knots, p, p + np.array([0.0, tool.length, 0.0]))
    face = WorkFace.of(plane_face((-10.0, 40.0), (-10.0, 50.0)), 5.0)
    cosine = {}
    for mu5 in (0.0, 10.0):
        weights = Weights(mu2=0.0, mu3=1e-3, mu5=mu5)
        solution = minimise(face, tool, motion, LIMITS, weights, GRID, (Step(1.0, 1.0, 0.03, False),) * 20)
        p1, q1 = solution.motion.ends(np.linspace(0.0, 1.0, 30), 1)
        p0, q0 = solution.motion.ends(np.linspace(0.0, 1.0, 30))
        d, v = (q0 - p0) / tool.length, 0.5 * (p1 + q1)
        cosine[mu5] = np.abs(np.sum(d * v, axis=1) / np.linalg.norm(v, axis=1)).mean()
        assert np.abs(solution.field.error).max() < 1e-3  # it slides on the plane meanwhile
    assert cosine[0.0] == pytest.approx(1.0 / np.sqrt(10.0), abs=1e-3)
    assert cosine[10.0] < 0.3 * cosine[0.0]


@pytest.mark.parametrize("tool", [*CATALOGUE.values(), cylinder()], ids=lambda tool: tool.name)
def test_exact_envelope_is_found_from_two_tenths_off(tool: Tool) -> None:
    """Mean |g| within 0.1 µm and |pq| = L within 1 µm; g by brute force, not by the package."""
    case = envelope(tool)
    face = WorkFace.of(design(case.surface, case.sense), 0.7 * tool.length)
    motion = known(case, 20)
    rng = np.random.default_rng(1)
    t = np.linspace(0.0, 1.0, 20)[:, None]
    wave = 0.2 * np.sin(2.0 * np.pi * t + rng.uniform(0.0, 6.0, 3))
    start = Motion(motion.knots, motion.p + wave, motion.q + 0.2 * np.cos(3.0 * t + rng.uniform(0.0, 6.0, 3)))
    schedule = SCHEDULE + (Step(1e-8, 1e3, 0.008, True),) * 8
    solution = minimise(face, tool, start, LIMITS, Weights(mu3=1e-4), GRID, schedule)
    assert not solution.failed
    p, q = solution.motion.ends(np.linspace(0.0, 1.0, 200))
    span = np.linalg.norm(q - p, axis=1)
    np.testing.assert_allclose(span, tool.length, atol=1e-3)
    points = face.samples(face.spacing(500)).points

    def axis(times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        a, b = solution.motion.ends(times)
        return a, (b - a) / np.linalg.norm(b - a, axis=1)[:, None]

    gap, _ = by_brute_force(tool, axis, points, 201)
    # The last rows may lie past the end of the motion or of the flute, which have slid a little.
    best = np.sort(np.abs(gap))[: int(0.95 * len(gap))]
    assert best.mean() < 1e-4


def test_converged_means_that_nothing_moves_any_more(exact: tuple[WorkFace, Tool, Motion]) -> None:
    face, tool, motion = exact
    schedule = (Step(0.0, 1e3, 0.01, False),)
    # So much hold on the soft modes that nothing creeps, however slowly.
    weights = Weights(mu3=1e3)
    solution = minimise(face, tool, motion, LIMITS, weights, GRID, schedule * 40)
    assert solution.status == "converged"
    again = minimise(face, tool, solution.motion, LIMITS, weights, GRID, schedule)
    np.testing.assert_allclose(again.motion.p, solution.motion.p, atol=2e-6)
    one = minimise(face, tool, Motion(motion.knots, motion.p + 0.1, motion.q + 0.1), LIMITS, Weights(), GRID, schedule)
    assert one.status == "iterations" and not one.failed
    assert one.iterations == 1


def test_a_motion_off_the_face_is_lost(exact: tuple[WorkFace, Tool, Motion]) -> None:
    face, tool, motion = exact
    away = np.array([300.0, 200.0, -400.0])
    solution = minimise(face, tool, Motion(motion.knots, motion.p + away, motion.q + away), LIMITS, Weights(), GRID,
                        SCHEDULE)  # fmt: skip
    assert solution.status == "lost" and solution.failed
    assert solution.status in STATUS


def test_without_any_hold_the_equations_are_singular(exact: tuple[WorkFace, Tool, Motion]) -> None:
    face, tool, motion = exact
    solution = minimise(face, tool, motion, LIMITS, Weights(1.0, 0.0, 0.0, 0.0, 0.0), (14, 4), SCHEDULE[:1])
    assert solution.status == "singular" and solution.failed


def test_no_step_is_longer_than_a_millimetre(exact: tuple[WorkFace, Tool, Motion]) -> None:
    face, tool, motion = exact
    start = Motion(motion.knots, motion.p, motion.p + 1.3 * (motion.q - motion.p))
    solution = minimise(face, tool, start, LIMITS, Weights(), GRID, SCHEDULE[:1])
    moved = np.hstack([solution.motion.p - start.p, solution.motion.q - start.q])
    assert np.abs(moved).max() == pytest.approx(1.0, abs=1e-12)


def test_weights_of_samples() -> None:
    error = np.array([[0.0, 0.02, -0.02, 0.08], [-0.004, -0.005, -0.01, -0.02], [0.0, 0.02, -0.02, 0.0]])
    on = np.ones((3, 4))
    on[2] = [0.0, 0.0, 0.0, -1.0]
    plain, steep = np.empty((3, 4)), np.empty((3, 4))
    sample_weights(error, on, LIMITS.over, 0.02, False, plain)
    # Stock left: Geman and McClure's influence x / (1 + x²)² gives the weight 1 / (1 + x²)², a quarter at the scale.
    np.testing.assert_allclose(plain[0], [1.0, 0.25, 1.0, 1.0 / 17.0**2], rtol=1e-12)
    np.testing.assert_array_equal(plain[1], 1.0)
    np.testing.assert_allclose(plain[2], [OFF_FACE, 0.25 * OFF_FACE, OFF_FACE, 0.0], rtol=1e-12)
    sample_weights(error, on, LIMITS.over, 0.02, True, steep)
    np.testing.assert_allclose(steep[0, [0, 1]], plain[0, [0, 1]], rtol=1e-12)
    excess = np.maximum(np.array([0.4, 0.5, 1.0, 2.0]) - BARRIER_FROM, 0.0)
    np.testing.assert_allclose(steep[1], 1.0 + BARRIER_GAIN * excess**2, rtol=1e-12)


def test_error_field_of_a_cold_and_of_a_warm_start_agree(exact: tuple[WorkFace, Tool, Motion]) -> None:
    face, tool, motion = exact
    cold, normal, fractions = error_field(face, tool, motion, 0.0, GRID)
    warm, again, _ = error_field(face, tool, motion, 0.0, GRID, cold)
    inner = cold.on > -0.5
    np.testing.assert_array_equal(cold.on, warm.on)
    np.testing.assert_allclose(warm.error[inner], cold.error[inner], atol=1e-9)
    np.testing.assert_allclose(again[inner], normal[inner], atol=1e-7)
    assert np.abs(cold.error[cold.on > 0.5]).max() < 5e-4  # the envelope is exact, 14 control points nearly so
    # And against a cold projection of every sphere centre.
    p, q = motion.ends(np.linspace(0.0, 1.0, GRID[0]))
    centres = p[:, None] + fractions[None, :, None] * (q - p)[:, None]
    found = face.projector.project(centres.reshape(-1, 3))
    expected = face.sense * found.distance - np.tile(tool.sphere_radius(fractions * tool.length), GRID[0])
    np.testing.assert_allclose(cold.error[cold.on > 0.5], expected.reshape(GRID)[cold.on > 0.5], atol=1e-9)


def test_allowance_shifts_the_error(exact: tuple[WorkFace, Tool, Motion]) -> None:
    face, tool, motion = exact
    plain, _, _ = error_field(face, tool, motion, 0.0, GRID)
    shifted, _, _ = error_field(face, tool, motion, 0.3, GRID)
    np.testing.assert_allclose(shifted.error, plain.error - 0.3, atol=1e-12)


def test_a_face_turned_inside_out_sees_the_tool_on_the_other_side(exact: tuple[WorkFace, Tool, Motion]) -> None:
    face, tool, motion = exact
    other = work(face.face.surface, -face.face.sense, 5.0)
    here, _, fractions = error_field(face, tool, motion, 0.0, GRID)
    there, _, _ = error_field(other, tool, motion, 0.0, GRID)
    both = (here.on > 0.5) & (there.on > 0.5)
    twice = -2.0 * np.broadcast_to(tool.sphere_radius(fractions * tool.length), GRID)
    np.testing.assert_allclose(there.error[both], twice[both] - here.error[both], atol=1e-9)
