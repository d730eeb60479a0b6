import re
import time
from dataclasses import replace
from math import degrees
from pathlib import Path

import msgspec
import numpy as np
import pytest

from conflank_cli.verification.conversational import read_conversational
from postprocessors.errors import PostError
from postprocessors.heidenhain.control import rotary_tolerance
from postprocessors.heidenhain.conversational import write_conversational
from postprocessors.machines.machine import Machine, load_machine
from postprocessors.post import ProgramOptions
from postprocessors.toolpath import Cutter, Operation, Purpose, Stretch, ToolPath


def write_program(path: ToolPath, machine: Machine, options: ProgramOptions) -> str:
    (program,) = write_conversational(path, machine, options)
    assert program.name == path.name
    return program.text


GOLDEN = Path(__file__).parent.parent / "golden"
OPTIONS = ProgramOptions(version="0.1.0")
T1 = Cutter(1, "T1", 1.5, 3.0, 24.0, 3000.0)
T3 = Cutter(3, "T3", 2.0, 5.0, 30.0, 2500.0)


def axis_at(a_deg: float, c_deg: float) -> list[float]:
    a, c = np.radians([a_deg, c_deg])
    return [np.sin(c) * np.sin(a), -np.cos(c) * np.sin(a), np.cos(a)]


def cut(number: int, a: list[float], c: list[float], start: tuple[float, float, float]) -> tuple[Stretch, ...]:
    """A cut along x with the tool at the given angles, linked from 50 mm above."""
    axis = np.array([axis_at(*pair) for pair in zip(a, c, strict=True)])
    tip = np.array(start) + np.outer(np.arange(len(a)), [2.0, 0.0, 0.0])
    up = [tip[0] + 50.0 * axis[0], tip[0]], [tip[-1], tip[-1] + 50.0 * axis[-1]]
    still = np.repeat(axis[:1], 2, axis=0), np.repeat(axis[-1:], 2, axis=0)
    feed = np.full(len(a), 800.0)
    feed[-1] = 640.4
    return (
        Stretch(Purpose.APPROACH, number, np.array(up[0]), still[0], np.array([0.0, 500.0])),
        Stretch(Purpose.SWEEP, number, tip, axis, feed),
        Stretch(Purpose.RETRACT, number, np.array(up[1]), still[1], np.array([500.0, 0.0])),
    )


def path_of(*operations: Operation) -> ToolPath:
    return ToolPath("GOLDEN", "two_cuts", (0, 3), "CAD", (-10.0, -10.0, -20.0), (30.0, 10.0, 0.0), operations)


def small_path() -> ToolPath:
    first = cut(1, [-30.0, -30.5, -31.0], [359.5, 0.0, 0.5], (0.0, 0.0, -0.00001))
    second = cut(2, [-20.0, -20.0], [90.0, 91.0], (1.0, -2.5, -12.34567))
    third = cut(3, [10.0, 12.0], [200.0, 200.0], (5.0, 5.0, -5.0))
    return path_of(Operation(T1, first + second), Operation(T3, third))


def test_text_is_ascii_with_crlf_and_counted_blocks() -> None:
    lines = write_program(small_path(), load_machine("ac-table"), OPTIONS).split("\r\n")
    assert lines[-1] == ""
    assert all("\n" not in line and line.isascii() and len(line) <= 120 for line in lines)
    numbered = [line for line in lines[:-1] if not line.startswith("    ")]
    assert [int(line.split()[0]) for line in numbered] == list(range(len(numbered)))
    assert numbered[0] == "0 BEGIN PGM GOLDEN MM"
    assert numbered[-1].endswith(" END PGM GOLDEN MM")


def test_header_states_one_fact_a_line() -> None:
    path = replace(small_path(), part="my blade ä", faces=tuple(range(100, 160)), frame="ROTATE 90 0 0 TRANSLATE 0 0 5")
    text = write_program(path, load_machine("ac-table"), OPTIONS)
    comments = re.findall(r"^\d+ (;.*)\r$", text, re.MULTILINE)
    assert comments[0] == "; CONFLANK 0.1.0"
    faces = [line for line in comments if line.startswith("; PART ")]
    assert ",".join(line.split(" FACE ")[1] for line in faces) == ",".join(map(str, range(100, 160)))
    assert {line.split(" FACE ")[0] for line in faces} == {"; PART my_blade__"}
    rest = comments[1 + len(faces) :]
    assert rest[:6] == [
        "; TOOL 1 T1 R_MIN 1.5 R_MAX 3 LENGTH 24",
        "; TOOL 3 T3 R_MIN 2 R_MAX 5 LENGTH 30",
        "; REFERENCE TIP",
        "; MACHINE ac-table",
        "; STYLE tcpm",
        "; FRAME ROTATE 90 0 0 TRANSLATE 0 0 5",
    ]
    assert [line for line in rest if line.startswith("; SWEEP")] == ["; SWEEP 1", "; SWEEP 2", "; SWEEP 3"]


def test_tcpm_is_off_wherever_the_control_forbids_it() -> None:
    lines = write_program(small_path(), load_machine("ac-table"), OPTIONS).split("\r\n")
    active = False
    for line in lines:
        block = line.partition(" ")[2]
        if block.startswith("FUNCTION TCPM"):
            assert not active
            active = True
        elif block == "FUNCTION RESET TCPM":
            active = False
        elif block.startswith(("TOOL CALL", "L M140", "M30", "CYCL", "PLANE")) or re.match(r"L [AC][+-]", block):
            assert not active, block
        elif re.match("L X", block):
            assert active, block


def test_numbers_carry_signs_and_no_minus_zero() -> None:
    text = write_program(small_path(), load_machine("ac-table"), OPTIONS)
    assert "-0.0000" not in text
    for block in re.findall(r"L X.*", text):
        assert re.match(r"L X[+-]\d+\.\d{4} Y[+-]\d+\.\d{4} Z[+-]\d+\.\d{4} A[+-]\d+\.\d{4} C\+\d+\.\d{4}( |\r)", block)


def test_a_word_that_rounds_to_a_full_turn_is_zero() -> None:
    operation = Operation(T1, cut(1, [-30.0, -30.0], [359.99998, 0.1], (0.0, 0.0, 0.0)))
    text = write_program(path_of(operation), load_machine("ac-table"), OPTIONS)
    assert "C+360" not in text
    assert "A-30.0000 C+0.0000 R0 FMAX M3" in text


def test_the_printed_pose_is_the_pose() -> None:
    rng = np.random.default_rng(11)
    tilt, azimuth = np.linspace(-70.0, -10.0, 400), np.linspace(0.0, 900.0, 400)
    axis = np.array([axis_at(*pair) for pair in zip(tilt, azimuth, strict=True)])
    tip = np.cumsum(rng.uniform(-1.0, 1.0, (400, 3)), axis=0)
    sweep = Stretch(Purpose.SWEEP, 1, tip, axis, np.full(400, 1000.0))
    text = write_program(path_of(Operation(T1, (sweep,))), load_machine("ac-table"), OPTIONS)
    found = re.findall(r"L X(\S+) Y(\S+) Z(\S+) A(\S+) C(\S+)", text)
    x, y, z, a, c = np.array(found, dtype=np.float64).T
    np.testing.assert_allclose(np.stack([x, y, z], axis=1), tip, atol=0.5001e-4)
    a, c = np.radians([a, c])
    printed = np.stack([np.sin(c) * np.sin(a), -np.cos(c) * np.sin(a), np.cos(a)], axis=1)
    # Half a digit in each angle: 0.87e-6 rad each.
    assert np.linalg.norm(printed - axis, axis=1).max() < 1.3e-6


def test_counted_turns_go_without_the_shorter_way() -> None:
    machine = load_machine("ac-table")
    c, a = machine.rotary
    counted = msgspec.structs.replace(machine, rotary=(msgspec.structs.replace(c, output="continuous"), a))
    azimuth = np.linspace(0.0, 720.0, 200)
    axis = np.array([axis_at(-30.0, angle) for angle in azimuth])
    tip = np.outer(np.arange(200.0), [1.0, 0.0, 0.0])
    path = path_of(Operation(T1, (Stretch(Purpose.SWEEP, 1, tip, axis, np.full(200, 1000.0)),)))
    text = write_program(path, counted, OPTIONS)
    assert "M126" not in text and "C+720.0000" in text
    text = write_program(path, machine, OPTIONS)
    assert "M126" in text and "C+720" not in text


def test_retract_in_machine_coordinates() -> None:
    machine = msgspec.structs.replace(load_machine("ac-table"), retract="M91", retract_z_mm=-1.0)
    text = write_program(small_path(), machine, OPTIONS)
    assert text.count("L Z-1 R0 FMAX M91") == 5
    assert "M140" not in text


def test_rotary_tolerance_keeps_the_top_of_the_flute_within_t() -> None:
    angle = rotary_tolerance(OPTIONS, T1)
    height = 24.0 + 1.5
    assert 0.9 * 0.002 < np.radians(angle) * height <= 0.002
    assert rotary_tolerance(replace(OPTIONS, tolerance_deg=0.05), T1) == 0.05
    assert angle < degrees(0.002 / 24.0)


def test_feed_is_whole_modal_and_within_the_machine() -> None:
    machine = msgspec.structs.replace(load_machine("ac-table"), max_feed_mm_min=700.0)
    text = write_program(small_path(), machine, OPTIONS)
    assert set(re.findall(r" F(\d+)", text)) == {"500", "700", "640"}


def broken(**changes: object) -> ToolPath:
    return replace(small_path(), **changes)


def with_sweep(**changes: object) -> ToolPath:
    stretches = list(cut(5, [-30.0, -31.0], [0.0, 0.5], (0.0, 0.0, 0.0)))
    stretches[1] = replace(stretches[1], **changes)
    return path_of(Operation(T1, tuple(stretches)))


FLAT = cut(1, [0.0, 0.0], [0.0, 0.0], (0.0, 0.0, 0.0))


@pytest.mark.parametrize(
    ("path", "options", "where", "found"),
    [
        (broken(name="BLADE 1"), OPTIONS, "[program] name", "BLADE 1"),
        (broken(name="blade1"), OPTIONS, "[program] name", "blade1"),
        (broken(name="A" * 17), OPTIONS, "[program] name", "A" * 17),
        (small_path(), replace(OPTIONS, style="spline"), "[program] style", "spline"),
        (small_path(), replace(OPTIONS, split="cut"), "[program] split", "cut"),
        (small_path(), replace(OPTIONS, datum=-1), "[program] datum", "-1"),
        (small_path(), replace(OPTIONS, datum=(0.0, 0.0, 1e5)), "[program] datum", "100000"),
        (small_path(), replace(OPTIONS, datum=(0.0, np.nan, 0.0)), "[program] datum", "nan"),
        (small_path(), replace(OPTIONS, own={"decimals": "3"}), "[program] options", "decimals"),
        (small_path(), replace(OPTIONS, own={"decimal": "dot"}), "[program] options.decimal", "dot"),
        (broken(name="A" * 15), replace(OPTIONS, split="sweep"), "[program] name", "A" * 15 + "_1"),
        (small_path(), replace(OPTIONS, tolerance_mm=0.00001), "cycle32.t", "1e-05"),
        (small_path(), replace(OPTIONS, coolant="M13"), "coolant", "M13"),
        (broken(operations=()), OPTIONS, "tool path", "no cut"),
        (broken(blank_high=(30.0, 10.0, -19.9)), OPTIONS, "blank", "sides"),
        (path_of(Operation(replace(T1, number=40000), FLAT)), OPTIONS, "T1", "40000"),
        (path_of(Operation(T1, FLAT), Operation(replace(T3, number=1), FLAT)), OPTIONS, "[tools]", "T1 and T3"),
        (with_sweep(tip=np.array([[0.0, 0.0, 0.0], [np.nan, 0.0, 0.0]])), OPTIONS, "sweep 5, pose 2", "nan"),
        (with_sweep(tip=np.array([[0.0, 0.0, 0.0], [1e5, 0.0, 0.0]])), OPTIONS, "sweep 5, pose 2", "100000"),
        (with_sweep(axis=np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 2.0]])), OPTIONS, "sweep 5, pose 2", "axis"),
        (with_sweep(feed=np.array([1.0, -1.0])), OPTIONS, "sweep 5, pose 2", "feed -1"),
        (with_sweep(axis=np.array([axis_at(-30.0, 0.0), axis_at(-30.0, 90.0)])), OPTIONS, "sweep 5", "degrees off"),
        (with_sweep(axis=np.array([axis_at(-130.0, 0.0)] * 2)), OPTIONS, "sweep 5", "A-130"),
    ],
)
def test_what_the_control_cannot_run_is_not_written(path, options, where, found) -> None:
    with pytest.raises(PostError) as caught:
        write_program(path, load_machine("ac-table"), options)
    assert where in caught.value.where
    assert found in caught.value.found


def test_a_hundred_thousand_blocks_take_at_most_two_seconds() -> None:
    count = 100_000
    azimuth = np.linspace(0.0, 40.0, count)
    sine, cosine = np.sin(-0.5), np.cos(-0.5)
    axis = np.stack([np.sin(azimuth) * sine, -np.cos(azimuth) * sine, np.full(count, cosine)], axis=1)
    tip = np.stack([np.linspace(0.0, 500.0, count), 50.0 * np.sin(azimuth), np.full(count, -3.0)], axis=1)
    path = path_of(Operation(T1, (Stretch(Purpose.SWEEP, 1, tip, axis, np.full(count, 900.0)),)))
    began = time.process_time()
    text = write_program(path, load_machine("ac-table"), OPTIONS)
    assert time.process_time() - began < 2.0
    assert text.count("L X") == count


# --- styles ---------------------------------------------------------------------------------------------------------


def test_vectors_have_length_one_and_point_where_the_tool_does() -> None:
    rng = np.random.default_rng(5)
    axis = rng.normal(size=(300, 3))
    axis[:, 2] = np.abs(axis[:, 2]) + 0.2
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    operations = [
        Operation(T1, (Stretch(Purpose.SWEEP, k, np.zeros((1, 3)), pose[None], np.array([500.0])),))
        for k, pose in enumerate(axis, start=1)
    ]
    text = write_program(path_of(*operations), load_machine("ac-table"), replace(OPTIONS, style="ln"))
    found = np.array(re.findall(r"LN .* TX(\S+) TY(\S+) TZ(\S+)", text), dtype=np.float64)
    assert found.shape == axis.shape
    assert np.abs(found - axis).max() <= 1.5e-7
    # Half of the last digit of the largest component.
    assert np.abs(np.linalg.norm(found, axis=1) - 1.0).max() <= 0.5001e-7


@pytest.mark.parametrize("style", ["tcpm", "m128", "ln"])
def test_a_cut_left_and_entered_again_turns_the_axes_retracted(style: str) -> None:
    first, again = (
        cut(1, [-30.0, -31.0], [10.0, 11.0], (0.0, 0.0, 0.0)),
        cut(1, [-31.0, -30.0], [11.0, 12.0], (9.0,) * 3),
    )
    options = replace(OPTIONS, style=style)
    text = write_program(path_of(Operation(T1, first + again)), load_machine("ac-table"), options)
    blocks = [line.partition(" ")[2] for line in text.split("\r\n")]
    on, off = (
        ("M128", "M129") if style == "m128" else ("FUNCTION TCPM F TCP AXIS POS PATHCTRL VECTOR", "FUNCTION RESET TCPM")
    )
    place = blocks.index("L A-31.0000 C+11.0000 R0 FMAX")
    assert blocks[place - 2 : place] == [off, "L M140 MB MAX"]
    assert blocks[place + 1] == on
    assert blocks.count(on) == 2 and blocks.count("; APPROACH 1") == 2
    # Spindle and coolant run on.
    assert sum(" M3" in block for block in blocks) == 1 and blocks.count("M8") == 1


# --- split ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("split", "count"), [("sweep", 3), ("tool", 2)])
def test_the_calling_program_calls_every_part_once_and_in_order(split: str, count: int) -> None:
    main, *parts = write_conversational(small_path(), load_machine("ac-table"), replace(OPTIONS, split=split))
    assert re.findall(r"CALL PGM (\S+)", main.text) == [part.name for part in parts]
    assert [part.name for part in parts] == [f"GOLDEN_{k}" for k in range(1, count + 1)]
    assert "L X" not in main.text and "M30" in main.text
    whole = write_program(small_path(), load_machine("ac-table"), OPTIONS)
    moves = [re.findall(r"L X.*", part.text) for part in parts]
    assert [move for part in moves for move in part] == re.findall(r"L X.*", whole)
    for part in parts:
        # A called program must not end the one that calls it, and runs by itself as well.
        assert "M30" not in part.text
        assert part.text.startswith(f"0 BEGIN PGM {part.name} MM\r\n")
        assert part.text.count("TOOL CALL") == 1 and "CYCL DEF 247" in part.text


def test_a_datum_shift_moves_the_words_and_is_taken_back() -> None:
    shift = (100.0, -50.5, 20.0)
    options = replace(OPTIONS, datum=shift)
    text = write_program(small_path(), load_machine("ac-table"), options)
    plain = write_program(small_path(), load_machine("ac-table"), OPTIONS)
    pattern = r"L X(\S+) Y(\S+) Z(\S+)"
    words, unshifted = (np.array(re.findall(pattern, item), dtype=np.float64) for item in (text, plain))
    np.testing.assert_allclose(words + shift, unshifted, atol=1e-9)
    assert "CYCL DEF 247" not in text
    assert re.findall(r"CYCL DEF 7\.\d ([XYZ]\S+)", text) == ["X+100", "Y-50.5", "Z+20", "X+0", "Y+0", "Z+0"]


def test_commas_stand_in_words_only() -> None:
    text = write_program(small_path(), load_machine("ac-table"), replace(OPTIONS, own={"decimal": "comma"}))
    points = [block for block in text.split("\r\n") if "." in block and ";" not in block]
    assert all("CYCL DEF" in block or "BLK FORM" in block for block in points)
    assert "CYCL DEF 32.1 T0,002" in text
    assert text.replace(",", ".") == write_program(small_path(), load_machine("ac-table"), OPTIONS).replace(",", ".")


def test_structure_blocks_stand_before_each_cut() -> None:
    text = write_program(small_path(), load_machine("ac-table"), replace(OPTIONS, own={"structure": "on"}))
    blocks = [line.partition(" ")[2] for line in text.split("\r\n")]
    places = [k for k, block in enumerate(blocks) if block.startswith("* - ")]
    assert [blocks[k] for k in places] == ["* - SWEEP 1", "* - SWEEP 2", "* - SWEEP 3"]
    assert all(re.match(r"L A\S+ C\S+ R0 FMAX", blocks[k + 1]) for k in places)


def test_axes_whose_letters_do_not_tell_their_directions_are_described() -> None:
    machine = load_machine("ac-table")
    c, a = machine.rotary
    assert "ROTARY" not in write_program(small_path(), machine, OPTIONS)
    nutating = msgspec.structs.replace(a, letter="B", vector=(0.0, 1.0, 1.0), sign=-1, range_deg=None)
    path = path_of(Operation(T1, cut(1, [-30.0, -30.5], [10.0, 11.0], (0.0, 0.0, 0.0))))
    text = write_program(path, msgspec.structs.replace(machine, rotary=(c, nutating)), OPTIONS)
    assert re.findall(r"; (ROTARY .*)\r", text) == ["ROTARY C 0 0 1", "ROTARY B 0 -0.707106781187 -0.707106781187"]


@pytest.mark.parametrize(("material", "word"), [("right", "RL"), ("left", "RR")])
def test_radius_compensation_holds_from_the_approach_to_the_retract(material: str, word: str) -> None:
    """The tool is to the left of the contour (RL) where the material lies to the right of the feed."""
    approach, sweep, retract = cut(1, [-30.0, -30.5, -31.0], [359.5, 0.0, 0.5], (0.0, 0.0, 0.0))
    sided = replace(sweep, material=material)
    path = path_of(Operation(T1, (approach, sided, retract, *cut(2, [-20.0, -20.0], [90.0, 91.0], (1.0, 0.0, 0.0)))))
    plain = write_program(path, load_machine("ac-table"), OPTIONS)
    text = write_program(path, load_machine("ac-table"), replace(OPTIONS, own={"radius": "on"}))
    # Modal: once on the block that approaches, R0 once on the block that leaves; else the same program.
    assert re.findall(r" (R[LR])[ \r]", text) == [word]
    (on,) = (number for number, line in enumerate(text.splitlines()) if f" {word} F500" in line)
    (off,) = (n for n, line in enumerate(text.splitlines()) if line.endswith(" R0 FMAX") and "; RETRACT 1" in
              text.splitlines()[n - 1])  # fmt: skip
    assert "; SWEEP 1" in text.splitlines()[on + 1] and on < off
    assert text.replace(f" {word}", "").splitlines()[:off] == plain.splitlines()[:off]
    one, other = read_conversational(text), read_conversational(plain)
    assert not one.findings
    np.testing.assert_array_equal(one.moves.point, other.moves.point)
    # With a trim in the text the poses are not known any more, and the reader says so.
    trimmed = read_conversational(text.replace("TOOL CALL 1 Z S3000", "TOOL CALL 1 Z S3000 DR+0.02"))
    assert {finding.code for finding in trimmed.findings} == {"CF102"}


def test_radius_compensation_needs_a_way_out() -> None:
    approach, sweep, _ = cut(1, [-30.0, -30.5], [359.5, 0.0], (0.0, 0.0, 0.0))
    path = path_of(Operation(T1, (approach, replace(sweep, material="left"))))
    with pytest.raises(PostError, match="retract after each sweep"):
        write_program(path, load_machine("ac-table"), replace(OPTIONS, own={"radius": "on"}))
