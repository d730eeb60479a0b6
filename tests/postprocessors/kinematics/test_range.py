"""Which orientations a machine reaches: against a table of all words within its ranges."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from postprocessors.kinematics.two_rotary import forward, within_range
from postprocessors.machines.machine import load_machine
from tests.postprocessors.kinematics.test_two_rotary import make, units

STEP = 1.0


@pytest.mark.parametrize(
    ("first", "second"),
    [
        ({"vector": (0, 0, 1)}, {"vector": (1, 0, 0), "range_deg": (-120.0, 30.0)}),
        ({"vector": (0, 0, 1), "range_deg": (-90.0, 200.0)}, {"vector": (1, 0, 0), "range_deg": (-20.0, 95.0)}),
        ({"vector": (0, 0, 1), "sign": -1, "range_deg": (300.0, 420.0)}, {"vector": (0, 1, 0), "sign": -1,
          "range_deg": (-100.0, 10.0)}),
        ({"vector": (0, 1, 0), "range_deg": (-50.0, 50.0)}, {"vector": (1, 0, 0), "range_deg": (-40.0, 40.0)}),
        ({"vector": (0, 0, 1)}, {"vector": (0.0, 1.0, 1.0), "range_deg": (-180.0, 180.0)}),
    ],
)  # fmt: skip
def test_reach_against_all_words(first: dict, second: dict) -> None:
    machine = make(first, second)
    words = [
        np.arange(rotary.range_deg[0], rotary.range_deg[1] + 0.5 * STEP, STEP)
        if rotary.range_deg is not None
        else np.arange(0.0, 360.0, STEP)
        for rotary in machine.rotary
    ]
    table = forward(machine, np.stack(np.meshgrid(*words, indexing="ij"), axis=-1).reshape(-1, 2))
    rng = np.random.default_rng(8)
    axis = units(rng, 3000)
    distance, _ = cKDTree(table).query(axis)
    # A word is at most half a step from one in the table in each axis.
    near = distance < np.radians(STEP)
    found = within_range(machine, axis)
    assert not np.any(found & ~near)
    # Whatever the machine reaches, it reaches exactly.
    assert np.all(within_range(machine, table[:: max(len(table) // 4000, 1)]))
    inside = forward(
        machine, np.stack([rng.uniform(*(r.range_deg or (-180.0, 180.0)), 500) for r in machine.rotary], 1)
    )
    assert np.all(within_range(machine, inside))


def test_axis_at_the_limit_is_within_range() -> None:
    """Rounding must not decide: posting takes a word that is past its limit by 1e-9 rad."""
    machine = make({"vector": (0, 0, 1)}, {"vector": (1, 0, 0), "range_deg": (-90.0, 30.0)})
    tilt = np.radians(-90.0) - 3e-16 * np.arange(8)
    turn = np.linspace(0.0, 6.0, 8)
    axis = np.stack([np.sin(turn) * np.sin(tilt), -np.cos(turn) * np.sin(tilt), np.cos(tilt) - 1e-12], axis=1)
    assert np.all(within_range(machine, axis))


def test_upright_tool_needs_no_particular_first_angle() -> None:
    """With the tool along the first axis any of its angles will do, also where 0 is out of its range."""
    machine = make(
        {"vector": (0, 0, 1), "range_deg": (90.0, 270.0)}, {"vector": (1, 0, 0), "range_deg": (-120.0, 30.0)}
    )
    assert within_range(machine, np.array([[0.0, 0.0, 1.0]]))[0]
    assert not within_range(machine, np.array([[0.0, 0.0, -1.0]]))[0]


def test_shipped_machine_tilts_by_its_range() -> None:
    machine = load_machine("ac-table")
    tilt = np.radians([0.0, 60.0, 119.9, 120.1, 180.0])
    axis = np.stack([np.sin(tilt) * np.cos(1.0), np.sin(tilt) * np.sin(1.0), np.cos(tilt)], axis=1)
    np.testing.assert_array_equal(within_range(machine, axis), [True, True, True, False, False])
