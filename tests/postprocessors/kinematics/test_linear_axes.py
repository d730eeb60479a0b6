"""X, Y, Z and rotary words put the tool where it should be: by SciPy's rotations, with offsets, for any two axes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from benchmarks.simulated_machine import on_the_part
from postprocessors.errors import PostError
from postprocessors.kinematics.linear_axes import has_head, nose_positions, up_in_part, upright_words
from postprocessors.kinematics.two_rotary import forward, inverse
from postprocessors.machines.machine import Machine, load_machine
from tests.postprocessors.kinematics.test_two_rotary import directions, make, units

POINTS = st.tuples(*[st.floats(-300.0, 300.0)] * 3)


def assert_round_trip(machine: Machine, tip: np.ndarray, axis: np.ndarray, zero: np.ndarray, length: float) -> None:
    solutions = inverse(machine, axis)
    signs = np.array([rotary.sign for rotary in machine.rotary])
    for angles in solutions.angles:
        words = (np.degrees(angles) * signs)[solutions.reachable]
        nose = nose_positions(machine, tip[solutions.reachable], words).at(zero, length)
        there, along = on_the_part(machine, nose, words, zero, length)
        np.testing.assert_allclose(there, tip[solutions.reachable], atol=1e-9)
        # At the border of reach the square root halves the digits: 3e-8 rad.
        np.testing.assert_allclose(along, axis[solutions.reachable], atol=3e-8)


@settings(max_examples=60, deadline=None)
@given(
    directions, directions, st.sampled_from([-1, 1]), st.sampled_from([-1, 1]), POINTS, POINTS, POINTS,
    st.sampled_from([("table", "table"), ("table", "head"), ("head", "head")]), st.integers(0, 2**32 - 1),
)  # fmt: skip
def test_any_two_axes_with_offsets(a, b, sign_a, sign_b, pivot_a, pivot_b, zero, carried_by, seed) -> None:
    machine = make(
        {"vector": a, "sign": sign_a, "pivot_mm": pivot_a, "carried_by": carried_by[0]},
        {"vector": b, "sign": sign_b, "pivot_mm": pivot_b, "carried_by": carried_by[1]},
    )
    first, second = (axis.direction for axis in machine.rotary)
    assume(np.linalg.norm(np.cross(first, second)) > 0.1 and np.hypot(*second[:2]) > 0.1)
    rng = np.random.default_rng(seed)
    assert_round_trip(machine, rng.uniform(-200.0, 200.0, (50, 3)), units(rng, 50), np.array(zero), 170.0)


@pytest.mark.parametrize("name", ["ac-table", "bc-table", "head-table", "head-head", "nutating-head"])
def test_shipped_machines(name: str) -> None:
    rng = np.random.default_rng(4)
    tip = rng.uniform(-200.0, 200.0, (1000, 3))
    assert_round_trip(load_machine(name), tip, units(rng, 1000), np.array([10.0, -20.0, 30.0]), 150.0)


def test_table_table_follows_the_formula_of_the_manuals() -> None:
    """M = P_A + Rx(-A)[(P_C - P_A) + Rz(-C)(p - P_C)], with the tool's length on top for the nose."""
    pivot_c, pivot_a = np.array([3.0, -4.0, 50.0]), np.array([0.0, 7.0, 20.0])
    machine = make({"vector": (0, 0, 1), "pivot_mm": tuple(pivot_c)}, {"vector": (1, 0, 0), "pivot_mm": tuple(pivot_a)})
    rng = np.random.default_rng(5)
    words, tip = rng.uniform(-180.0, 180.0, (200, 2)), rng.uniform(-100.0, 100.0, (200, 3))
    back_c = Rotation.from_euler("z", -words[:, [0]], degrees=True)
    back_a = Rotation.from_euler("x", -words[:, [1]], degrees=True)
    expected = pivot_a + back_a.apply((pivot_c - pivot_a) + back_c.apply(tip - pivot_c)) + [0.0, 0.0, 130.0]
    np.testing.assert_allclose(nose_positions(machine, tip, words).at(np.zeros(3), 130.0), expected, atol=1e-10)


def test_upright_head_stands_above_the_tip() -> None:
    nose = nose_positions(load_machine("head-head"), np.array([[1.0, 2.0, 3.0]]), np.array([[77.0, 0.0]]))
    np.testing.assert_allclose(nose.at(np.zeros(3), 100.0), [[1.0, 2.0, 103.0]], atol=1e-10)


def test_up_is_the_spindle_direction_of_a_head_at_zero() -> None:
    """C and A by SciPy: under a table they carry the part, in a head they leave it where it is."""
    words = np.array([[30.0, -50.0], [200.0, 20.0]])
    turn = Rotation.from_euler("z", words[:, [0]], degrees=True) * Rotation.from_euler("x", words[:, [1]], degrees=True)
    np.testing.assert_allclose(up_in_part(load_machine("ac-table"), words), turn.apply([0.0, 0.0, 1.0]), atol=1e-12)
    np.testing.assert_allclose(up_in_part(load_machine("head-head"), words), [[0.0, 0.0, 1.0]] * 2, atol=1e-12)
    # A table under a B head tilts the part.
    mixed = make({"vector": (1, 0, 0), "carried_by": "table"}, {"vector": (0, 1, 0), "carried_by": "head"})
    lean = Rotation.from_euler("x", words[:, [0]], degrees=True).apply([0.0, 0.0, 1.0])
    np.testing.assert_allclose(up_in_part(mixed, words), lean, atol=1e-12)


@pytest.mark.parametrize("name", ["ac-table", "bc-table", "head-table", "head-head", "nutating-head"])
def test_upright_the_tool_axis_is_the_machines_z(name: str) -> None:
    machine = load_machine(name)
    words = np.array([[30.0, -50.0], [200.0, 20.0]])
    upright = upright_words(machine, words)
    np.testing.assert_allclose(forward(machine, upright), up_in_part(machine, upright), atol=1e-12)
    np.testing.assert_allclose(up_in_part(machine, upright), up_in_part(machine, words), atol=1e-12)
    assert has_head(machine) == ("head" in name) == bool((upright != words).any())
    # C turns the head about Z; it need not move.
    np.testing.assert_array_equal(upright[:, 0], words[:, 0])


def test_a_head_that_never_stands_upright_is_refused() -> None:
    head = {"vector": (0, 1, 0), "carried_by": "head", "range_deg": (10.0, 100.0)}
    machine = make({"vector": (0, 0, 1), "carried_by": "table"}, head)
    with pytest.raises(PostError, match="0 within the range of a head axis"):
        upright_words(machine, np.array([[0.0, 40.0]]))
