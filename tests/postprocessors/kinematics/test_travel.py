from __future__ import annotations

import msgspec
import numpy as np
import pytest

from postprocessors.errors import PostError
from postprocessors.kinematics.linear_axes import nose_positions
from postprocessors.kinematics.travel import Mounting, check_travel
from postprocessors.kinematics.visits import VisitWords
from postprocessors.machines.machine import Machine, load_machine

AC = load_machine("ac-table")


def visit(tip: np.ndarray, words: np.ndarray, tool: str = "T1", cut: int = 3) -> VisitWords:
    return VisitWords(f"sweep {cut}", tool, cut, (), tip, words)


def along_x(length: float, c_deg: float = 0.0) -> VisitWords:
    tip = np.stack([np.linspace(0.0, length, 11), np.zeros(11), np.zeros(11)], axis=1)
    return visit(tip, np.tile([c_deg, 0.0], (11, 1)))


def test_a_known_datum_is_checked_pose_by_pose() -> None:
    # Travel X is -400 .. 400; 10 poses of 10 mm each from 320 reach 420.
    with pytest.raises(PostError) as caught:
        check_travel(AC, (along_x(100.0),), Mounting((320.0, 0.0, 0.0), {"T1": 150.0}))
    assert caught.value.where == "sweep 3, pose 11"
    assert caught.value.found == "X+420.000 in machine coordinates"
    assert caught.value.expected == "X -400 .. 400"
    found = check_travel(AC, (along_x(100.0),), Mounting((250.0, 0.0, 0.0), {"T1": 150.0}))
    assert found.complete
    np.testing.assert_allclose([found.low, found.high], [[250.0, 0.0, 150.0], [350.0, 0.0, 150.0]], atol=1e-9)
    assert found.margin == pytest.approx(50.0)
    # With the table turned by half a turn, the same way leads from -320 to -420.
    with pytest.raises(PostError, match=r"pose 11.*X-420\.000"):
        check_travel(AC, (along_x(100.0, 180.0),), Mounting((320.0, 0.0, 0.0), {"T1": 150.0}))


def test_the_length_of_the_tool_counts() -> None:
    with pytest.raises(PostError, match=r"Z\+520\.000"):
        check_travel(AC, (along_x(1.0),), Mounting((0.0, 0.0, 300.0), {"T1": 220.0}))


def test_without_a_datum_only_what_fits_nowhere_is_refused() -> None:
    found = check_travel(AC, (along_x(790.0),), Mounting())
    assert not found.complete
    assert found.margin == pytest.approx(5.0, abs=1e-6)
    assert found.zero[0] == pytest.approx(-395.0, abs=1e-6)
    assert set(found.supposed) == {"T1"}
    with pytest.raises(PostError) as caught:
        check_travel(AC, (along_x(810.0),), Mounting())
    assert "X needs 810.0 mm (from sweep 3, pose 1 to sweep 3, pose 11)" in caught.value.found
    assert caught.value.expected == "at most 800 mm of X"


def brute_force_margin(machine: Machine, visits: tuple[VisitWords, ...], zeros: np.ndarray, length: float) -> float:
    limits = np.array([line.travel_mm for line in machine.linear.each])
    best = -np.inf
    for zero in zeros:
        nose = np.concatenate([nose_positions(machine, v.tip, v.words).at(zero, length) for v in visits])
        best = max(best, float(np.minimum(nose - limits[:, 0], limits[:, 1] - nose).min()))
    return best


def test_the_roomiest_datum_beats_every_other() -> None:
    rng = np.random.default_rng(6)
    tip = rng.uniform(-60.0, 60.0, (40, 3))
    words = np.stack([rng.uniform(0.0, 300.0, 40), rng.uniform(-90.0, 20.0, 40)], axis=1)
    visits = (visit(tip, words),)
    found = check_travel(AC, visits, Mounting(None, {"T1": 150.0}))
    around = np.array(found.zero) + rng.uniform(-30.0, 30.0, (400, 3))
    assert brute_force_margin(AC, visits, around, 150.0) <= found.margin + 1e-6
    assert brute_force_margin(AC, visits, np.array([found.zero]), 150.0) == pytest.approx(found.margin, abs=1e-6)


HEAD_TABLE = load_machine("head-table")


def turning_upright(x: float) -> VisitWords:
    """The tip at rest while B goes from 100 degrees to 0: the carriage swings out to 150 + L and back a little."""
    return visit(np.array([[x, 0.0, 100.0]] * 2), np.array([[0.0, 100.0], [0.0, 0.0]]))


def test_what_an_axis_does_between_two_poses_is_within_travel_too() -> None:
    """With a tool of 170 mm the spindle is 320 sin 100 deg = 315.1 mm out at the start, and 320 mm at 90 degrees."""
    mounting = Mounting((0.0, 0.0, 300.0), {"T1": 170.0})
    found = check_travel(HEAD_TABLE, (turning_upright(279.5),), mounting)
    # The nearest place to 90 degrees is within half of the 5 degrees that are checked.
    assert found.high[0] == pytest.approx(279.5 + 320.0, abs=320.0 * (1.0 - np.cos(np.radians(2.5))))
    with pytest.raises(PostError, match=r"pose 2: found X\+602\.500 in machine coordinates"):
        check_travel(HEAD_TABLE, (turning_upright(282.5),), mounting)


@pytest.mark.parametrize("pose", [0, 5, 10])
def test_a_retract_to_a_height_of_the_machine_does_not_go_down(pose: int) -> None:
    """Only the first and the last pose of a visit have to be below it."""
    low = msgspec.structs.replace(AC, retract="M91", retract_z_mm=300.0)
    tip = np.zeros((11, 3))
    tip[pose, 2] = 160.0
    way = (visit(tip, np.zeros((11, 2))),)
    mounting = Mounting((0.0, 0.0, 0.0), {"T1": 150.0})
    assert check_travel(AC, way, mounting).high[2] == pytest.approx(310.0)
    if pose == 5:
        check_travel(low, way, mounting)
        return
    with pytest.raises(PostError, match=rf"pose {pose + 1}: found Z\+310\.000.*Z -100 \.\. 300, the retract"):
        check_travel(low, way, mounting)
    # Without a datum the part is put lower.
    assert check_travel(low, way, Mounting(None, {"T1": 150.0})).zero[2] < -9.9
