"""What axes have to do, from the text: closed forms, a machine simulated in small steps, mutants of posted programs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import msgspec
import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks import simulated_machine
from conflank_cli.job import Machine
from conflank_cli.scene import Scene
from conflank_cli.verification import axes
from conflank_cli.verification.axes import Driven, contact_feeds, drive, labelled_cuts
from conflank_cli.verification.findings import Finding
from conflank_cli.verification.posed import PosedProgram, pose_program
from postprocessors.machines.machine import load_machine
from tests.verification.scenes import T1, TCPM, plane_face, program, scene_of

Array = npt.NDArray[np.float64]
SCENE = scene_of(plane_face((10.0, 30.0), (1.0, 20.0)))
AC = load_machine("ac-table")


def cutting(blocks: Sequence[str], start: str = "X+0 Y+0 Z+50 C+0 A+0", label: str = "") -> str:
    """Blocks under TCPM after a rapid to their start."""
    inner = [f"; {label}"] if label else []
    return program(["L C+0 A+0 R0 FMAX M3", TCPM, f"L {start} FMAX", *inner, *blocks, "FUNCTION RESET TCPM"])


def posed_of(blocks: Sequence[str], scene: Scene = SCENE, label: str = "") -> PosedProgram:
    return pose_program(cutting(blocks, label=label), scene)


def driven(blocks: Sequence[str], scene: Scene = SCENE) -> Driven:
    return drive(posed_of(blocks, scene), scene)


def by_code(found: Driven) -> dict[str, list[Finding]]:
    result: dict[str, list[Finding]] = {}
    for finding in found.findings:
        result.setdefault(finding.code, []).append(finding)
    return result


def path_blocks(points: Array, feeds: Array) -> list[str]:
    """Blocks to points (N, 5) after the first, X Y Z C A, at feeds (N - 1,)."""
    return [
        "L " + " ".join(f"{letter}{value:+.4f}" for letter, value in zip("XYZCA", row, strict=True)) + f" F{feed:.0f}"
        for row, feed in zip(points[1:], feeds, strict=True)
    ]


def circle(radius: float, count: int) -> Array:
    angle = np.linspace(0.0, 2.0 * np.pi, count + 1)
    points = np.zeros((count + 1, 5))
    points[:, 0], points[:, 1], points[:, 2] = radius * np.sin(angle), radius * (1.0 - np.cos(angle)), 50.0
    return points


def test_a_straight_line_asks_for_its_speed_alone() -> None:
    found = driven([f"L X+{x} F6000" for x in range(1, 60)])
    assert found.findings == ()
    # 100 of 500 mm/s; X alone, from the third block on; whole feeds make next to nothing of it.
    assert found.load.max() == pytest.approx(0.36, abs=0.01), "a block of 1 mm takes 10 ms, the control 3.6"


def test_a_line_takes_the_time_of_the_s_curve() -> None:
    """s / v + v / a + a / j; where the way to its start is not known, it takes no time."""
    found = driven(["L X+100 F3000"])
    assert found.seconds.sum() == pytest.approx(100.0 / 50.0 + 50.0 / 3000.0 + 3000.0 / 60000.0, rel=1e-9)
    # A rapid takes what its slowest axis needs: 500 mm/s.
    there = driven(["L X+100 FMAX"])
    assert there.seconds.sum() == pytest.approx(100.0 / 500.0 + 500.0 / 3000.0 + 3000.0 / 60000.0, rel=1e-9)


def test_a_circle_asks_for_the_square_of_its_speed_over_the_radius() -> None:
    """100 mm/s on 1 mm: 10,000 mm/s2 and 1,000,000 mm/s3, on 24 mm 417 mm/s2 and 17,361 mm/s3."""
    found = by_code(driven(path_blocks(circle(1.0, 24), np.full(24, 6000.0))))
    assert sorted(found) == ["CF404", "CF405"]
    for code, amount, limit, unit in (("CF404", 1e4, 3000.0, "mm/s2"), ("CF405", 1e6, 60000.0, "mm/s3")):
        assert [finding.text[0] for finding in found[code]] == ["X", "Y"]
        for finding in found[code]:
            # Chords of 15 degrees; what rounding coordinates of four decimals can make is subtracted.
            assert finding.amount == pytest.approx(amount, rel=0.02 if code == "CF404" else 0.08)
            assert (finding.limit, finding.unit) == (limit, unit)
            assert finding.block is not None and finding.count > 10
    assert driven(path_blocks(circle(24.0, 90), np.full(90, 6000.0))).findings == ()


def test_jerk_of_a_cubic_is_exact_on_uneven_blocks() -> None:
    """x = 10,000 t^3 in blocks of times that alternate: 60,000 mm/s3 is just allowed, 1 % more is not."""
    times = np.concatenate([[0.0], np.cumsum(np.tile([0.02, 0.03, 0.045], 6))])
    for factor, expected in ((0.99, []), (1.02, ["CF405"])):
        points = np.zeros((len(times), 5))
        points[:, 0], points[:, 2] = factor * 1e4 * times**3, 50.0
        # Y is long enough that feeds of whole numbers are exact enough.
        points[:, 1] = 400.0 * times
        feeds = 60.0 * np.linalg.norm(np.diff(points[:, :3], axis=0), axis=1) / np.diff(times)
        small = [
            f"{block.rsplit(' F', 1)[0]} F{feed:.3f}"
            for block, feed in zip(path_blocks(points, feeds), feeds, strict=True)
        ]
        found = by_code(driven(small))
        assert [code for code in found if code == "CF405"] == expected


def test_a_swing_is_too_fast_for_its_axis() -> None:
    """C by 10 degrees in 0.02 s: 500 of 300 degrees a second."""
    found = by_code(driven([f"L X+{k} C+{10 * k} F3000" for k in range(1, 6)]))
    (speed,) = found["CF403"]
    assert (speed.amount, speed.limit, speed.unit) == (pytest.approx(500.0, rel=5e-3), pytest.approx(300.0), "deg/s")
    assert speed.text.startswith("C would need") and speed.count == 5


def test_an_endless_axis_goes_the_shorter_way() -> None:
    program_ = [f"L X+{k} C{c:+d} F3000" for k, c in ((1, 358), (2, 0), (3, 2))]
    start = "X+0 Y+0 Z+50 C+356 A+0"
    posed = pose_program(cutting(["M126", *program_], start), SCENE)
    assert drive(posed, SCENE).findings == ()


@pytest.mark.parametrize("between", ["L Z+60 FMAX", "L M140 MB MAX"])
def test_rapids_and_unknown_ways_break_a_run(between: str) -> None:
    there = [f"L X+{0.5 * k:.1f} F6000" for k in range(1, 9)]
    back = [f"L X+{0.5 * k:.1f} F6000" for k in range(7, -1, -1)]
    assert sorted(by_code(driven([*there, *back]))) == ["CF404", "CF405"]
    assert by_code(driven([*there, between, "L X+4 Y+0 Z+50 C+0 A+0 FMAX", *back])) == {}


def test_a_block_without_motion_breaks_nothing() -> None:
    there = [f"L X+{0.5 * k:.1f} F6000" for k in range(1, 9)]
    back = [f"L X+{0.5 * k:.1f} F6000" for k in range(7, -1, -1)]
    assert sorted(by_code(driven([*there, "L X+4", *back]))) == ["CF404", "CF405"]


def test_digits_alone_are_no_finding(monkeypatch: pytest.MonkeyPatch) -> None:
    """Blocks of some digits along a smooth line: what rounding makes of them is the text's, not the motion's."""
    points = np.zeros((60, 5))
    points[:, 0], points[:, 1], points[:, 2] = 0.0077 * np.arange(60), 0.00313 * np.arange(60), 50.0
    points[:, 3] = 0.05374 * np.arange(60)
    blocks = path_blocks(points, np.full(59, 300.0))
    assert driven(blocks).findings == ()
    # The same words, were they exact, would ask for more than C can.
    monkeypatch.setattr(axes, "DIGITS", (1e-9,))
    assert "CF405" in by_code(driven(blocks))


def test_more_than_the_machine_has() -> None:
    (finding,) = driven(["L X+50 F10001", "L X+90", "L X+120 F10000"]).findings
    assert (finding.code, finding.amount, finding.limit, finding.count) == ("CF115", 10001.0, 10000.0, 2)


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(2, 40), st.floats(5.0, 90.0))
def test_times_against_a_simulated_machine(seed: int, blocks: int, feed: float) -> None:
    """Steps of a tenth of a millisecond, backwards in short pieces, beside closed forms for whole blocks."""
    rng = np.random.default_rng(seed)
    moves = np.vstack([np.zeros(5), np.cumsum(rng.normal(0.0, 1.0, (blocks, 5)), axis=0)])
    steps = np.diff(moves, axis=0)
    way = np.linalg.norm(steps[:, :3], axis=1)
    model = pose_program(cutting([]), SCENE).machine
    limits = load_machine("ac-table").limits
    least = np.maximum((np.abs(steps) / limits.speed).max(axis=1), 0.0036)
    nominal = np.maximum(way / feed, least)
    radians = np.vstack([np.zeros(5), steps])
    radians[:, 3:] = np.radians(radians[:, 3:])
    known = np.append(False, np.ones(blocks, dtype=np.bool_))
    found = axes._times(model, radians, np.append(0.0, nominal), known, np.zeros(blocks + 1, dtype=np.bool_)).sum()
    assert found == pytest.approx(simulated_machine.drive(moves, nominal, limits).seconds, rel=0.02, abs=0.002)


def contact(blocks: Sequence[str], label: str = "SWEEP 1", control: bool = True) -> list[Finding]:
    posed = posed_of(blocks, label=label)
    posed = replace(posed, program=replace(posed.program, control=control))
    ran = drive(posed, SCENE)
    none = np.zeros(len(ran.load), dtype=np.bool_)
    return contact_feeds(posed.poses, posed.program, posed.tools, SCENE, none, labelled_cuts(posed.program), ran.load)


def straight(feed: int, count: int = 40) -> list[str]:
    return [f"L X+{k} F{feed}" for k in range(1, count + 1)]


@pytest.mark.parametrize(("feed", "found"), [(1000, 0), (1050, 0), (1060, 1), (5000, 1), (510, 0), (490, 1), (100, 1)])
def test_the_feed_in_contact_is_the_tools(feed: int, found: int) -> None:
    """T1 has 1000 mm/min; 5 % above it is a finding, and so is less than half of it without a reason."""
    findings = contact(straight(feed))
    assert [finding.code for finding in findings] == ["CF115"] * found
    if found:
        assert findings[0].amount == pytest.approx(feed) and findings[0].limit == 1000.0 and findings[0].count == 40


def test_the_fastest_point_in_contact_counts() -> None:
    """A swings by 1 degree while the tip goes 0.5 mm: the end of the cone is faster or slower, by the sign."""
    height = T1.length - T1.tip_height
    (finding,) = contact([f"L Y+{0.5 * k:.1f} A-{k} F1000" for k in range(1, 20)])
    assert finding.amount == pytest.approx(1000.0 * (0.5 + height * np.radians(1.0)) / 0.5, rel=1e-3)
    assert contact([f"L Y+{0.5 * k:.1f} A+{k} F1000" for k in range(1, 20)]) == []
    # Of a pass only the ball cuts.
    assert contact([f"L Y+{0.5 * k:.1f} A+{0.2 * k:.1f} F900" for k in range(1, 20)], "PASS 1") == []


def test_a_slow_corner_has_a_reason() -> None:
    """Braked for a right angle as hard as the axes can, F drops below half; far from it nothing may."""
    slow = [1000, 1000, 700, 450, 300, 300, 450, 700, 1000, 1000]
    points = np.zeros((11, 5))
    points[:6, 0], points[6:, 0] = 0.1 * np.arange(6), 0.5
    points[6:, 1], points[:, 2] = 0.1 * np.arange(1, 6), 50.0
    corner = path_blocks(points, np.array(slow, dtype=np.float64))
    assert contact(corner) == []
    assert len(contact([*straight(1000, 10), "L X+11 F400", "L X+12 F1000"])) == 1


def test_where_no_machine_is_known_a_slow_feed_may_have_its_reason() -> None:
    assert contact(straight(490), control=False) == []
    assert len(contact(straight(1060), control=False)) == 1


def test_an_unlabelled_cut_is_checked_where_it_cuts() -> None:
    posed = posed_of(straight(3000))
    ran = drive(posed, SCENE)
    none = np.zeros(len(ran.load), dtype=np.bool_)
    assert (
        contact_feeds(posed.poses, posed.program, posed.tools, SCENE, none, labelled_cuts(posed.program), ran.load)
        == []
    )
    (finding,) = contact_feeds(posed.poses, posed.program, posed.tools, SCENE, ~none, none, ran.load)
    assert finding.amount == pytest.approx(3000.0)


def test_where_all_is_mounted_the_axes_of_the_machine_count() -> None:
    """A turns by 5 degrees a block, 400 mm from its axis: Y and Z of the machine go 35 mm while the tip goes 1 mm."""
    blocks = [f"L X+{k} A-{5 * k} F1500" for k in range(1, 10)]
    assert driven(blocks).findings == ()
    known = Machine(name="ac-table", zero=(0.0, 0.0, 350.0), gauge_length={"T1": 150.0})
    mounted = replace(SCENE, job=msgspec.structs.replace(SCENE.job, machine=known))
    found = by_code(driven(blocks, mounted))
    assert any(finding.text[0] in "YZ" for finding in found["CF403"])


def test_doubling_a_feed_is_found() -> None:
    """Of each block of a circle near its limits, F doubled or halved: an axis would have to jump."""
    blocks = path_blocks(circle(10.0, 60), np.full(60, 5000.0))
    assert driven(blocks).findings == ()
    for k in (10, 30, 45):
        for feed in ("F10000", "F2500"):
            changed = [*blocks]
            changed[k] = changed[k].replace("F5000", feed)
            assert {"CF404", "CF405"} & by_code(driven(changed)).keys()
