"""Pose to text to pose for any pair of rotary axes, and the light version of the bench."""

from __future__ import annotations

import msgspec
import numpy as np
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from benchmarks.posts import STYLES, machines, poses_of, random_path, round_trip, rs274_blocks, write
from postprocessors.heidenhain.rides import rides_of
from postprocessors.machines.machine import Machine, load_machine
from postprocessors.toolpath import Cutter, Operation, Purpose, Stretch, ToolPath
from tests.postprocessors.heidenhain.test_conversational import OPTIONS, small_path

COUNT = 12
component = st.floats(-1.0, 1.0)
vector = st.tuples(component, component, component)


def pair(first: tuple[float, ...], second: tuple[float, ...], signs: tuple[int, int], letters: str) -> Machine:
    """A machine with two axes in any directions, both endless, pivots anywhere."""
    shipped = load_machine("ac-table")
    rotary = tuple(
        msgspec.structs.replace(
            shipped.rotary[0], letter=letter, vector=direction, sign=sign, pivot_mm=(7.0, -3.0, 11.0), output=output
        )
        for letter, direction, sign, output in zip(
            letters, (first, second), signs, ("modulo", "continuous"), strict=True
        )
    )
    return msgspec.structs.replace(shipped, name="any", rotary=rotary)


@settings(max_examples=25, deadline=None)
@given(
    vector,
    vector,
    st.sampled_from([(1, 1), (-1, 1), (1, -1), (-1, -1)]),
    st.sampled_from(["CA", "CB", "AB", "BC", "BA"]),
    st.integers(0, 2**32 - 1),
)
def test_any_pair_of_axes_comes_back(
    first: tuple[float, ...], second: tuple[float, ...], signs: tuple[int, int], letters: str, seed: int
) -> None:
    a, b = np.array(first), np.array(second)
    assume(np.linalg.norm(a) > 0.1 and np.linalg.norm(b) > 0.1)
    a, b = a / np.linalg.norm(a), b / np.linalg.norm(b)
    assume(np.linalg.norm(np.cross(a, b)) > 0.1 and np.hypot(b[0], b[1]) > 0.1)
    rng = np.random.default_rng(seed)
    angles = rng.uniform(-np.pi, np.pi, (2, COUNT))
    turn = Rotation.from_rotvec(angles[0][:, None] * a) * Rotation.from_rotvec(angles[1][:, None] * b)
    axis = turn.apply(np.tile([0.0, 0.0, 1.0], (COUNT, 1)))
    tip = rng.uniform(-900.0, 900.0, (COUNT, 3))
    # Each pose by itself: nothing says that they follow each other.
    stretches = [
        Stretch(purpose, number + 1, tip[number, None], axis[number, None], np.array([500.0]))
        for number in range(COUNT)
        for purpose in (Purpose.SWEEP, Purpose.RETRACT)
    ]
    cutter = Cutter(1, "T1", 1.5, 3.0, 24.0, 3000.0)
    path = ToolPath("ANY", "part", (0,), "CAD", (0.0,) * 3, (9.0,) * 3, (Operation(cutter, tuple(stretches)),))
    machine = pair(first, second, signs, letters)
    for kind, style in STYLES:
        count, off, far = round_trip(path, poses_of(write(path, machine, kind, style)))
        assert count == COUNT
        assert off <= 0.1 and far <= 0.2


def test_the_bench_in_little() -> None:
    rng = np.random.default_rng(3)
    for machine in machines().values():
        path = random_path(machine, 300, rng)
        for kind, style in STYLES:
            count, off, far = round_trip(path, poses_of(write(path, machine, kind, style)))
            assert count == 300
            assert 0.0 < off <= 0.1 and far <= 0.2


def test_a_pose_written_wrongly_shows() -> None:
    path = random_path(load_machine("ac-table"), 50, np.random.default_rng(3))
    text = write(path, load_machine("ac-table"), "h", "tcpm")
    block = next(line for line in text.split("\r\n") if line.endswith("F900"))
    x = block.split()[2]
    _, off, _ = round_trip(path, poses_of(text.replace(x, f"X{float(x[1:]) + 0.0003:+.4f}")))
    assert off > 0.2


def test_inverse_time_is_one_over_the_minutes_of_a_block() -> None:
    (first, *_), *_ = rides_of(small_path(), load_machine("ac-table"), OPTIONS)
    blocks = list(rs274_blocks([first]))
    assert blocks[0] == "G21 G90 G93" and blocks[-1] == "M2"
    # 2 mm at 800 mm/min.
    assert blocks[3] == "G1 X2.0000 Y0.0000 Z0.0000 A-30.5000 C0.0000 F400.000000000"
