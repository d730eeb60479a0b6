"""Refinement and tracing of lines on faces that a tool cuts exactly, and the kernels against NumPy and SciPy."""

from __future__ import annotations

from dataclasses import replace
from math import cos, sin

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import eigh

from conflank_cli.detection.clustering import represent
from conflank_cli.detection.line_field import SeedLines, seed_lines
from conflank_cli.detection.settling import settle
from conflank_cli.detection.tracing import SPHERES, STEP, WAVE, Sequence, Traced, sphere_heights, trace
from conflank_cli.geometry.footpoint import CLAMPED, FAILED
from conflank_cli.geometry.kernels.axis import SETTLED, axis_errors, refine_line, sweep_direction
from conflank_cli.geometry.kernels.cells import mark_cells
from conflank_cli.geometry.screening import Screen
from conflank_cli.geometry.surface import BSplineSurface
from conflank_cli.geometry.workface import WorkFace
from conflank_cli.limits import Limits
from conflank_cli.once import Once
from conflank_cli.tool import CATALOGUE, Tool
from tests.detection.test_line_field import distance_to, helicoid
from tests.faces import design, interpolated, round_face, work
from tests.verification.scenes import scene_of

TAPER, RADIUS = 0.15, 25.0
CYLINDER = Tool("cylinder", 3.0, 3.0, 22.0)
# A tool, and the cone (or cylinder) it cuts with its whole flute along every ruling.
EXACT = {"cylinder": (CYLINDER, 0.0), "cone": (CATALOGUE["T3"], TAPER)}


class Line:
    """A line with the arrays that the kernels fill."""

    def __init__(self, tool: Tool, p: np.ndarray, d: np.ndarray, uv: tuple[float, float]) -> None:
        self.tool, self.p, self.d = tool, p.copy(), d / np.linalg.norm(d)
        self.heights = sphere_heights(tool)
        self.radii = tool.sphere_radius(self.heights)
        self.u, self.v = np.full(SPHERES, uv[0]), np.full(SPHERES, uv[1])
        self.error, self.on = np.empty(SPHERES), np.empty(SPHERES)
        self.normal = np.empty((SPHERES, 3))
        self.start = SPHERES // 2

    def _arguments(self, face: WorkFace) -> tuple:
        return (
            *face.projector.spans, face.sense, face.raster, self.p, self.d, self.heights, self.radii, self.start,
            self.u, self.v, self.error, self.normal, self.on,
        )  # fmt: skip

    def measure(self, face: WorkFace) -> None:
        axis_errors(*self._arguments(face))

    def refine(self, face: WorkFace, iterations: int = 10) -> bool:
        return bool(refine_line(*self._arguments(face), 0.2, 0.015, iterations, 1e-3))


def touching(tool: Tool, taper: float, angle: float, z: float, radius: float = RADIUS) -> tuple[np.ndarray, np.ndarray]:
    """The axis that touches the cone of `round_face` along the ruling at `angle`, its r_min circle at height z."""
    out = np.array([cos(angle), sin(angle), 0.0])
    normal = cos(taper) * out - np.array([0.0, 0.0, sin(taper)])
    ruling = sin(taper) * out + np.array([0.0, 0.0, cos(taper)])
    d = sin(tool.half_angle) * normal + cos(tool.half_angle) * ruling
    foot = (radius + z * np.tan(taper)) * out + np.array([0.0, 0.0, z])
    # The contact at height 0 on the generator is r_min off the axis, square to it.
    square = cos(tool.half_angle) * normal - sin(tool.half_angle) * ruling
    return foot + tool.r_min * square, d


@pytest.fixture(scope="module", params=EXACT, ids=list(EXACT))
def exact(request: pytest.FixtureRequest) -> tuple[Tool, float, WorkFace]:
    tool, taper = EXACT[request.param]
    return tool, taper, work(round_face(RADIUS, taper, 36.0), 1, 8.0)


def test_a_generator_of_its_own_cone_has_no_axis_error(exact: tuple[Tool, float, WorkFace]) -> None:
    tool, taper, face = exact
    line = Line(tool, *touching(tool, taper, 0.2, 4.0), (0.2, 15.0))
    line.measure(face)
    # The cone is interpolated to 1e-9 mm; the error says what this program would otherwise be blamed for.
    np.testing.assert_allclose(line.error, 0.0, atol=2e-8)
    np.testing.assert_array_equal(line.on, 1.0)


def test_refinement_brings_a_displaced_line_back(exact: tuple[Tool, float, WorkFace]) -> None:
    """0.2 mm and 0.6 degrees off; along the contact and along the sweep the line may stay where it is."""
    tool, taper, face = exact
    p, d = touching(tool, taper, 0.2, 4.0)
    line = Line(tool, p + np.array([0.1, -0.15, 0.1]), d + np.array([0.01, -0.004, 0.0]), (0.2, 15.0))
    line.measure(face)
    assert np.abs(line.error).max() > 0.05
    assert line.refine(face)
    # The tilt along the face counts only in second order, so it dies away slowly; 0.1 µm is left of 90.
    assert np.abs(line.error).max() < 1e-4
    assert np.linalg.norm(line.p - p) < 0.5
    assert np.linalg.norm(line.d) == pytest.approx(1.0, abs=1e-14)


def test_a_line_far_off_the_face_is_lost() -> None:
    face = work(round_face(RADIUS, 0.0, 36.0), 1)
    line = Line(CYLINDER, np.array([30.0, 0.0, 80.0]), np.array([0.0, 0.0, 1.0]), (0.0, 36.0))
    assert not line.refine(face)


def test_axis_errors_against_scipy() -> None:
    """On a helicoid given by formula, at an arbitrary line, one sphere after the other."""
    face = work(interpolated(helicoid, (-0.6, 0.6), (-0.6, 0.6)), -1)
    frame = face.projector.evaluate([0.1], [0.1])[0]
    normal = -np.cross(frame[1], frame[2]) / np.linalg.norm(np.cross(frame[1], frame[2]))
    tool = CATALOGUE["T1"]
    d = frame[2] / np.linalg.norm(frame[2]) + 0.1 * normal + 0.05 * frame[1] / np.linalg.norm(frame[1])
    line = Line(tool, frame[0] + 2.0 * normal - 8.0 * d, d, (0.1, 0.1))
    line.measure(face)
    there = line.on > -0.5
    assert 8 < there.sum() < SPHERES  # the others hang over the end
    for j in np.flatnonzero(there):
        centre = line.p + line.heights[j] * line.d
        distance = distance_to(helicoid, centre, np.array([0.1, 0.1]))
        side = np.sign((centre - helicoid(line.u[j], line.v[j])) @ line.normal[j])
        radius = tool.r_min * cos(tool.half_angle) + line.heights[j] * sin(tool.half_angle)
        assert line.error[j] == pytest.approx(side * distance - radius, abs=1e-6)
        expected = side * (centre - helicoid(line.u[j], line.v[j])) / distance
        np.testing.assert_allclose(line.normal[j], expected, atol=1e-6)
    over = np.flatnonzero(~there)
    found = face.projector.project(line.p + line.heights[over, None] * line.d)
    assert np.all((found.flag == CLAMPED) | (found.flag == FAILED))


def test_sweep_direction_is_the_least_eigenvector() -> None:
    """Against scipy.linalg.eigh in all six velocities of the two ends, square to the axis by projection."""
    rng = np.random.default_rng(5)
    heights = np.linspace(0.3, 24.0, SPHERES)
    s = (heights - heights[0]) / (heights[-1] - heights[0])
    for stiffness in (0.0, 0.02):
        for _ in range(6):
            d = rng.normal(size=3)
            d /= np.linalg.norm(d)
            normal = rng.normal(size=3) + 0.3 * rng.normal(size=(SPHERES, 3))
            normal /= np.linalg.norm(normal, axis=1)[:, None]
            error, on = rng.normal(size=SPHERES) * 0.01, rng.choice([1.0, 1.0, 0.0, -1.0], SPHERES)
            ratio = np.maximum(error, 0.0) / 0.015
            weight = (1.0 + ratio**2) ** -2.0 * np.where(on > 0.5, 1.0, np.where(on > -0.5, 0.01, 0.0))
            # A velocity field v(s) = (1 - s) v0 + s v1 in an orthonormal basis of the plane across the axis.
            plane = np.linalg.svd(d[None])[2][1:]
            lift = np.kron(np.eye(2), plane.T)
            rows = np.concatenate([(1.0 - s)[:, None] * normal, s[:, None] * normal], axis=1) @ lift
            matrix = rows.T @ (weight[:, None] * rows) / weight.sum()
            matrix += stiffness * np.kron([[1.0, -1.0], [-1.0, 1.0]], np.eye(2))
            # Mean of |v|² over the flute by quadrature.
            x, w = np.polynomial.legendre.leggauss(3)
            x, w = 0.5 * (x + 1.0), 0.5 * w
            mass = sum(b * np.kron(np.outer([1.0 - a, a], [1.0 - a, a]), np.eye(2)) for a, b in zip(x, w, strict=True))
            values, vectors = eigh(matrix, mass)
            out = np.empty((2, 3))
            value = sweep_direction(np.zeros(3), d, heights, normal, error, on, 0.015, stiffness, out)
            assert value == pytest.approx(values[0], abs=1e-12)
            expected = (lift @ vectors[:, 0]).reshape(2, 3)
            expected *= np.sign(np.sum(expected * out))
            np.testing.assert_allclose(out, expected, atol=1e-7)
            # By brute force: of many velocities none does better.
            tried = rng.normal(size=(2000, 4))
            quotient = np.sum(tried @ matrix * tried, axis=1) / np.sum(tried @ mass * tried, axis=1)
            assert quotient.min() >= value - 1e-12
            assert quotient.min() <= value + 0.2


def test_tracing_covers_a_face_that_the_tool_cuts_exactly(exact: tuple[Tool, float, WorkFace]) -> None:
    """From one seed in the middle round the whole face: 30 mm of travel in steps, hardly a cell missed.

    On the cylinder the axis only has to move parallel to itself, which is exact. On the cone it has to turn, a mode
    that costs next to nothing at first order: what is left is for the optimisation, but within 20 µm once settled.
    """
    tool, taper, _ = exact
    flute = tool.length * cos(tool.half_angle)
    surface = round_face(RADIUS, taper, 0.9 * flute * cos(taper))
    face = work(surface, 1, 8.0)
    p, d = touching(tool, taper, 0.05, -0.03 * tool.length)
    seeds = SeedLines(p[None], d[None], np.array([[0.05, 8.0]]), np.array([10.0]), np.zeros(1, np.int64), np.zeros(1))
    screen = Screen.of(scene_of(design(surface, 1), tools=(tool,)))
    traced = trace(face, tool, seeds, face.samples(0.3), Once(lambda: screen), Limits(0.01, 0.01))
    (sequence,) = traced.sequences
    contact = settle(face, tool, sequence.p, sequence.d, Limits(0.01, 0.01))
    assert np.abs(contact.error[contact.on > 0.5]).max() < (0.020 if taper else SETTLED)
    assert traced.cell_areas.sum() == pytest.approx(face.samples(0.3).areas.sum(), rel=1e-9)
    covered = traced.cell_areas[traced.cells[0]].sum() / traced.cell_areas.sum()
    assert covered > (0.96 if taper else 0.985)
    middle = sequence.p + 0.5 * tool.length * sequence.d
    way = np.linalg.norm(np.diff(middle, axis=0), axis=1)
    # Steps are STEP in the mean over the flute; on a cone the middle of the flute moves at about that.
    np.testing.assert_allclose(way[1:-1], STEP, rtol=0.2)
    # In order: the angle round the face grows or falls steadily, from border to border.
    angle = np.unwrap(np.arctan2(middle[:, 1], middle[:, 0]))
    assert np.all(np.diff(angle) > 0.0) or np.all(np.diff(angle) < 0.0)
    assert angle.min() < -0.55 and angle.max() > 0.55


def test_a_line_met_on_the_way_of_another_is_not_followed_again() -> None:
    """Generators of a cylinder side by side, twice as many as are traced together; one sweep runs through all."""
    surface = round_face(RADIUS, 0.0, 20.0)
    face = work(surface, 1, 8.0)
    angles = np.linspace(-0.5, 0.5, 2 * WAVE)
    lines = [touching(CYLINDER, 0.0, angle, -1.0) for angle in angles]
    p, d = (np.array([line[k] for line in lines]) for k in range(2))
    uv = np.stack([angles, np.full(len(angles), 9.0)], axis=1)
    count = len(angles)
    seeds = SeedLines(p, d, uv, np.full(count, 10.0), np.arange(count), np.zeros(count))
    screen = Screen.of(scene_of(design(surface, 1), tools=(CYLINDER,)))
    traced = trace(face, CYLINDER, seeds, face.samples(1.0), Once(lambda: screen), Limits(0.01, 0.01))
    assert len(traced.sequences) == WAVE
    # A line that stands a millimetre higher is another sweep.
    higher = replace(seeds, p=np.where(np.arange(count)[:, None] % 2 == 0, p, p + np.array([0.0, 0.0, 1.0])))
    both = trace(face, CYLINDER, higher, face.samples(1.0), Once(lambda: screen), Limits(0.01, 0.01))
    assert {round(float(s.p[0, 2])) for s in both.sequences} == {-1, 0}


def test_allowance_keeps_the_sequence_that_far_off() -> None:
    face = work(round_face(RADIUS, 0.0, 20.0), 1, 8.0)
    seeds = seed_lines(face, CYLINDER, np.array([[0.0, 10.0]]), np.array([10.0]), 0.4)
    screen = Screen.of(scene_of(face.face, tools=(CYLINDER,)))
    traced = trace(face, CYLINDER, seeds, face.samples(1.0), Once(lambda: screen), Limits(0.01, 0.01, 0.4))
    assert traced.sequences
    for sequence in traced.sequences:
        radial = np.hypot(*(sequence.p + 10.0 * sequence.d)[:, :2].T)
        np.testing.assert_allclose(radial, RADIUS + 3.4, atol=0.012)


def test_no_line_fits_a_bore_narrower_than_the_tool() -> None:
    """Radius 2.9 mm for a tool of 3 mm; also a seed that is forced upon it leaves no sequence."""
    surface: BSplineSurface = round_face(2.9, 0.0, 20.0)
    face = work(surface, -1, 8.0)
    assert len(seed_lines(face, CYLINDER, np.array([[0.0, 10.0]]), np.array([10.0])).p) == 0
    p, d, uv = np.array([[-0.1, 0.0, 0.0]]), np.array([[0.0, 0.0, 1.0]]), np.array([[0.0, 10.0]])
    seeds = SeedLines(p, d, uv, np.array([10.0]), np.zeros(1, np.int64), np.zeros(1))
    screen = Screen.of(scene_of(design(surface, -1), tools=(CYLINDER,)))
    assert trace(face, CYLINDER, seeds, face.samples(0.5), Once(lambda: screen), Limits(0.01, 0.01)).sequences == ()


def test_cells_between_lines_are_marked_by_interpolated_error() -> None:
    """Two lines, two spheres: along the mesh the error runs from -0.02 to 0.04; tolerance keeps the stretch between."""
    on = np.ones((1, 2, 2))
    u = np.array([[[0.1, 0.1], [0.9, 0.9]]])
    v = np.array([[[0.2, 0.8], [0.2, 0.8]]])
    error = np.array([[[-0.02, -0.02], [0.04, 0.04]]])
    marks = np.zeros((1, 8, 8), dtype=np.bool_)
    spans = np.array([[0, 2]])
    mark_cells(np.array([0.0, 1.0]), np.array([0.0, 1.0]), error, u, v, on, spans, 0.01, 0.02, marks)
    # Probes at x = 1/8, 3/8, 5/8, 7/8 have errors -0.0125, 0.0025, 0.0175, 0.0325 and sit at u = 0.2, 0.4, 0.6, 0.8,
    # at three places across, v = 0.3, 0.5, 0.7.
    expected = np.zeros((8, 8), dtype=np.bool_)
    expected[np.ix_([3, 4], [2, 4, 5])] = True
    np.testing.assert_array_equal(marks[0], expected)
    on[0, 1, 1] = -1.0
    again = np.zeros_like(marks)
    mark_cells(np.array([0.0, 1.0]), np.array([0.0, 1.0]), error, u, v, on, spans, 0.01, 0.02, again)
    assert not again.any()


def test_one_sequence_stands_for_a_family() -> None:
    def sequence(d: tuple[float, float, float]) -> Sequence:
        axis = np.tile(np.array(d) / np.linalg.norm(d), (4, 1))
        return Sequence(np.zeros((4, 3)), axis, np.zeros((4, 1)), np.ones((4, 1)))

    cells = np.zeros((5, 10), dtype=np.bool_)
    cells[0, :5] = True
    cells[1, :6] = True  # shares 5 of 6 with the first
    cells[2, :6] = True  # the same cells, the other way round
    cells[3, 4:] = True  # shares 2 of 10 with the second
    cells[4, 9] = True  # small
    up, down = (0.0, 0.1, 1.0), (0.0, 0.1, -1.0)
    traced = Traced(tuple(sequence(d) for d in (up, up, down, up, up)), cells, np.full(10, 2.0))
    assert represent(traced, 0.75, 3.0, 9) == [1, 2, 3]
    assert represent(traced, 0.9, 3.0, 9) == [1, 2, 3, 0]
    assert represent(traced, 0.75, 0.0, 9) == [1, 2, 3, 4]
    assert represent(Traced((), np.zeros((0, 10), dtype=np.bool_), np.full(10, 2.0)), 0.75, 3.0, 9) == []
    # One more than asked for: nothing else covers the last cells, where they are worth a sweep.
    assert represent(traced, 0.75, 0.0, 2) == [1, 2, 3]
    assert represent(traced, 0.75, 8.5, 2) == [1, 2]


@given(st.integers(0, 2**32 - 1), st.sampled_from([0.5, 0.75, 0.9]))
def test_no_family_is_lost(seed: int, alike: float) -> None:
    """Every sequence that is large enough is alike to one that stands for it, in area and in direction."""
    rng = np.random.default_rng(seed)
    count, size = int(rng.integers(1, 60)), 24
    start, length = rng.integers(0, size, count), rng.integers(1, size, count)
    place = np.arange(size)
    cells = (place >= start[:, None]) & (place < (start + length)[:, None])
    areas = rng.uniform(0.5, 2.0, size)
    axes = rng.choice([-1.0, 1.0], (count, 1)) * [0.0, 0.0, 1.0] + rng.normal(0.0, 0.3, (count, 3))
    axes /= np.linalg.norm(axes, axis=1)[:, None]
    sequences = tuple(Sequence(np.zeros((4, 3)), np.tile(d, (4, 1)), np.zeros((4, 1)), np.ones((4, 1))) for d in axes)
    chosen = represent(Traced(sequences, cells, areas), alike, 2.0, count)
    assert len(set(chosen)) == len(chosen)

    def same(a: int, b: int) -> bool:
        overlap = areas[cells[a] & cells[b]].sum() / areas[cells[a] | cells[b]].sum()
        return bool(overlap > alike - 1e-6 and axes[a] @ axes[b] > np.cos(np.radians(25.0)) - 1e-9)

    for k in range(count):
        if areas[cells[k]].sum() >= 2.0:
            assert k in chosen or any(same(k, c) for c in chosen)


@given(st.integers(0, 2**32 - 1), st.integers(1, 5))
def test_no_part_of_a_face_is_lost(seed: int, most: int) -> None:
    """However few families are kept, no sequence covers much that is not covered by those that are."""
    rng = np.random.default_rng(seed)
    cells = rng.random((30, 40)) < rng.uniform(0.05, 0.4, (30, 1))
    areas = rng.uniform(0.5, 2.0, 40)
    one = Sequence(np.zeros((4, 3)), np.tile([0.0, 0.0, 1.0], (4, 1)), np.zeros((4, 1)), np.ones((4, 1)))
    chosen = represent(Traced((one,) * 30, cells, areas), 0.75, 3.0, most)
    assert len(set(chosen)) == len(chosen)
    left = areas * ~cells[chosen].any(axis=0)
    assert (cells @ left).max() < 3.0
    # What was added had to be.
    for count in range(most, len(chosen)):
        assert areas[cells[chosen[count]] & ~cells[chosen[:count]].any(axis=0)].sum() >= 3.0
