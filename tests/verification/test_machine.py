"""The verification's own kinematics: by closed forms of the usual machines, by SciPy, and against the posts' own."""

from __future__ import annotations

from math import cos, inf, pi, radians, sin

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from conflank_cli import job as job_keys
from conflank_cli.errors import InputError
from conflank_cli.verification.machine import MachineModel, machine_of, read_machine
from postprocessors.errors import PostError
from postprocessors.kinematics.linear_axes import nose_positions
from postprocessors.machines.machine import load_machine, parse_machine, read_machine_file

SHIPPED = ("ac-table", "bc-table", "head-table", "head-head", "nutating-head")
Z = np.array([0.0, 0.0, 1.0])


def shipped(name: str) -> MachineModel:
    return machine_of(job_keys.Machine(name=name))


def text_of(name: str) -> str:
    return read_machine_file(name)[0]


def with_pivots(name: str, *pivots: tuple[float, float, float]) -> MachineModel:
    """A shipped machine with other pivots: tables in machine coordinates, heads as seen from the nose."""
    head, *tables = text_of(name).split("[[rotary]]")
    tables = ["".join(line for line in table.splitlines(True) if "pivot_mm" not in line) for table in tables]
    return read_machine(
        head
        + "".join(f"[[rotary]]\npivot_mm = {[float(x) for x in p]}\n{t}" for p, t in zip(pivots, tables, strict=True)),
        "test",
    )


def places(count: int = 40) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(5)
    return rng.uniform(-80.0, 80.0, (count, 3)), rng.uniform(-2.0, 2.0, (count, 2))


def test_two_tables_by_the_closed_form() -> None:
    """M = P_A + Rx(-A) [(P_C - P_A) + Rz(-C) (p - P_C)] is where the tip is, and the nose L above it."""
    p_c, p_a = np.array([5.0, -7.0, 20.0]), np.array([-3.0, 11.0, 40.0])
    machine = with_pivots("ac-table", tuple(p_c), tuple(p_a))
    tip, rotary = places()
    zero, length = np.array([12.0, -3.5, 85.0]), 172.4
    nose = machine.nose(tip, rotary, zero, length)
    for k, (c, a) in enumerate(rotary):
        turn_c, turn_a = Rotation.from_euler("z", -c), Rotation.from_euler("x", -a)
        expected = p_a + turn_a.apply((p_c - p_a) + turn_c.apply(tip[k] + zero - p_c)) + length * Z
        np.testing.assert_allclose(nose[k], expected, atol=1e-10)
    np.testing.assert_allclose(
        machine.tool_axis(rotary),
        [[sin(c) * sin(a), -cos(c) * sin(a), cos(a)] for c, a in rotary],
        atol=1e-14,
    )
    np.testing.assert_allclose(machine.up(rotary), machine.tool_axis(rotary), atol=1e-14)
    assert machine.upright(rotary).all()


def test_a_head_over_a_table_by_the_closed_form() -> None:
    """M = P_C + Rz(-C) (p - P_C) + H (Ry(B) z - z), H from pivot to tip."""
    p_c, pivot, length = np.array([5.0, -7.0, 20.0]), 150.0, 172.4
    machine = with_pivots("head-table", tuple(p_c), (0.0, 0.0, pivot))
    tip, rotary = places()
    zero = np.array([12.0, -3.5, 85.0])
    nose = machine.nose(tip, rotary, zero, length)
    for k, (c, b) in enumerate(rotary):
        spindle = np.array([sin(b), 0.0, cos(b)])
        moved = p_c + Rotation.from_euler("z", -c).apply(tip[k] + zero - p_c) + (pivot + length) * (spindle - Z)
        np.testing.assert_allclose(nose[k], moved + length * Z, atol=1e-10)
        np.testing.assert_allclose(machine.spindle(rotary[k : k + 1])[0], spindle, atol=1e-14)
    # The table turns about Z: up stays up; and the tool is upright where B is zero.
    np.testing.assert_allclose(machine.up(rotary), np.tile(Z, (len(rotary), 1)), atol=1e-14)
    assert machine.upright(np.array([[1.0, 0.0], [1.0, 1e-3]])).tolist() == [True, False]


def test_two_head_axes_leave_the_part_alone() -> None:
    """M = p + H (t - z): both axes through one point."""
    machine = with_pivots("head-head", (0.0, 0.0, 150.0), (0.0, 0.0, 150.0))
    tip, rotary = places()
    axis = machine.tool_axis(rotary)
    nose = machine.nose(tip, rotary, np.zeros(3), 172.4)
    np.testing.assert_allclose(nose, tip + (150.0 + 172.4) * (axis - Z) + 172.4 * Z, atol=1e-10)
    np.testing.assert_allclose(machine.up(rotary), np.tile(Z, (len(rotary), 1)), atol=1e-14)
    np.testing.assert_allclose(machine.spindle(rotary), axis, atol=1e-14)


@pytest.mark.parametrize("name", SHIPPED)
def test_against_the_kinematics_of_the_posts(name: str) -> None:
    """Both are read from the same file, with pivots put off, and share no code."""
    own = with_pivots(name, (3.0, -8.0, 120.0), (-6.0, 2.5, 90.0))
    head, *tables = text_of(name).split("[[rotary]]")
    tables = ["".join(line for line in table.splitlines(True) if "pivot_mm" not in line) for table in tables]
    pivots = ("[3.0, -8.0, 120.0]", "[-6.0, 2.5, 90.0]")
    posts = parse_machine(
        head + "".join(f"[[rotary]]\npivot_mm = {p}\n{t}" for p, t in zip(pivots, tables, strict=True)), "test"
    )
    tip, rotary = places()
    zero = np.array([-20.0, 31.0, 44.0])
    other = nose_positions(posts, tip, np.degrees(rotary)).at(zero, 99.0)
    np.testing.assert_allclose(own.nose(tip, rotary, zero, 99.0), other, atol=1e-10)
    limits = posts.limits
    np.testing.assert_allclose(own.limits.speed, [*limits.speed[:3], *np.radians(limits.speed[3:])])
    np.testing.assert_allclose(
        own.limits.acceleration, [*limits.acceleration[:3], *np.radians(limits.acceleration[3:])]
    )
    np.testing.assert_allclose(own.limits.jerk, [*limits.jerk[:3], *np.radians(limits.jerk[3:])])
    assert own.max_feed == posts.max_feed_mm_min
    assert own.travel == tuple(line.travel_mm for line in posts.linear.each)


@pytest.mark.parametrize("name", SHIPPED)
def test_nose_to_tip_and_back(name: str) -> None:
    machine = with_pivots(name, (3.0, -8.0, 120.0), (-6.0, 2.5, 90.0))
    tip, rotary = places()
    lengths = np.linspace(50.0, 200.0, len(tip))
    nose = machine.nose(tip, rotary, np.array([1.0, 2.0, 3.0]), lengths)
    np.testing.assert_allclose(machine.tip(nose, rotary, np.array([1.0, 2.0, 3.0]), lengths), tip, atol=1e-10)


@pytest.mark.parametrize("name", SHIPPED)
def test_both_positions_point_the_tool_the_same_way_and_one_is_it(name: str) -> None:
    machine = shipped(name)
    rotary = places(200)[1]
    axis = machine.tool_axis(rotary)
    both = machine.positions(axis)
    for one in both:
        np.testing.assert_allclose(machine.tool_axis(one), axis, atol=1e-9)
    off = np.abs((both - rotary + pi) % (2.0 * pi) - pi).max(axis=2).min(axis=0)
    assert off.max() < 1e-7


def test_axes_out_of_reach_and_along_the_first_axis() -> None:
    """A head at 45 degrees tilts the tool by 90 degrees at most; along the first axis its position is open."""
    nutating = shipped("nutating-head")
    assert np.isnan(nutating.positions(-Z[None])).all()
    both = shipped("ac-table").positions(Z[None])
    assert np.isnan(both[:, 0, 0]).all() and np.abs(both[:, 0, 1]).max() == 0.0


@pytest.mark.parametrize("name", SHIPPED)
def test_vectors_are_followed_by_the_nearer_solution(name: str) -> None:
    machine = shipped(name)
    share = np.linspace(0.0, 1.0, 300)[:, None]
    rotary = np.array([0.3, 0.2]) + share * np.array([5.0, 0.3])
    np.testing.assert_allclose(machine.followed_positions(machine.tool_axis(rotary), rotary[0]), rotary, atol=1e-9)
    # From the other solution the other is nearer.
    (one, other) = machine.positions(machine.tool_axis(rotary[:1]))[:, 0]
    far = other if np.abs(one - rotary[0]).max() < 1e-6 else one
    inside = [axis.low <= position <= axis.high for axis, position in zip(machine.rotary, far, strict=True)]
    if all(inside):
        np.testing.assert_allclose(machine.followed_positions(machine.tool_axis(rotary[:1]), far)[0], far, atol=1e-9)


def test_through_the_singular_pose_the_first_axis_stays() -> None:
    machine = shipped("ac-table")
    tilt = np.linspace(-0.4, 0.4, 9)
    axis = np.stack([np.zeros(9), np.sin(-tilt), np.cos(tilt)], axis=1)
    followed = machine.followed_positions(axis, np.array([0.0, -0.4]))
    np.testing.assert_allclose(followed, np.stack([np.zeros(9), tilt], axis=1), atol=1e-9)


def test_what_a_machine_file_says() -> None:
    machine = shipped("ac-table")
    assert (machine.name, machine.letters, machine.top, machine.harmless) == ("ac-table", "CA", 500.0, frozenset())
    c, a = machine.rotary
    assert (c.low, c.high, c.modulo, c.table) == (-inf, inf, True, True)
    assert (a.low, a.high, a.modulo) == (radians(-120.0), radians(30.0), False)
    text = text_of("ac-table")
    with_m91 = text.replace('retract = "M140"', 'retract = "M91"\nretract_z_mm = 480.0\nharmless_m = [10, 11]')
    assert read_machine(with_m91, "x").top == 480.0
    assert read_machine(with_m91, "x").harmless == {10, 11}
    assert parse_machine(with_m91, "x").harmless_m == (10, 11)


def test_the_sign_turns_the_direction() -> None:
    text = text_of("ac-table").replace("vector = [0.0, 0.0, 1.0]", "vector = [0.0, 0.0, 2.0]\nsign = -1")
    c = read_machine(text, "x").rotary[0]
    assert c.direction == (0.0, 0.0, -1.0)


@pytest.mark.parametrize(
    ("old", "new", "place"),
    [
        ("travel_mm = [-400.0, 400.0]", "travel_mm = [400.0, -400.0]", "linear.x travel_mm"),
        ("max_speed_deg_min = 18000.0", "max_speed_deg_min = 0.0", "rotary C max_speed_deg_min"),
        ("range_deg = [-120.0, 30.0]", "range_deg = [30.0, -120.0]", "rotary A range_deg"),
        ('letter = "A"', 'letter = "C"', "rotary"),
        ("vector = [1.0, 0.0, 0.0]", "vector = [0.0, 0.0, 1.0]", "rotary"),
        ("vector = [1.0, 0.0, 0.0]", "vector = [0.0, 0.0, 0.0]", "rotary A vector"),
        ('retract = "M140"', 'retract = "M91"', "retract_z_mm"),
        ("max_feed_mm_min = 10000.0", 'max_feed_mm_min = "?"', "x.toml"),
        ("verified = false", "verfied = false", "x.toml"),
        ("verified = false", "verified = maybe", "x.toml"),
    ],
)
def test_files_that_make_no_machine_are_refused(old: str, new: str, place: str) -> None:
    text = text_of("ac-table")
    assert old in text
    with pytest.raises(InputError, match=place.replace(".", r"\.")):
        read_machine(text.replace(old, new), "x.toml")


@pytest.mark.parametrize("function", [3, 91, 128, 140, -1, 1000])
def test_no_machine_file_calls_a_function_of_the_control_harmless(function: int) -> None:
    text = text_of("ac-table").replace('retract = "M140"', f'retract = "M140"\nharmless_m = [10, {function}]')
    with pytest.raises(InputError, match="harmless_m"):
        read_machine(text, "x.toml")
    with pytest.raises(PostError, match="harmless_m"):
        parse_machine(text, "x.toml")


@pytest.mark.parametrize("name", ["../ac-table", "no-such", "/etc/passwd", "a" * 100_000])
def test_machines_that_do_not_come_along(name: str) -> None:
    with pytest.raises(InputError, match="one of ac-table, bc-table"):
        shipped(name)


def test_a_template_is_no_machine() -> None:
    with pytest.raises(InputError, match="filled in"):
        shipped("kondia_hs1000")


def test_both_readers_take_every_shipped_machine() -> None:
    for name in SHIPPED:
        assert shipped(name).name == load_machine(name).name
