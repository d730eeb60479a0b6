import re
from dataclasses import replace

import pytest

from conflank_cli.verification.iso import read_iso
from postprocessors.errors import PostError
from postprocessors.heidenhain.conversational import write_conversational
from postprocessors.heidenhain.iso import LAST_BLOCK, write_iso
from postprocessors.machines.machine import load_machine
from postprocessors.post import ProgramOptions
from postprocessors.toolpath import Operation
from tests.postprocessors.heidenhain.test_conversational import OPTIONS, T1, cut, path_of, small_path

ISO = replace(OPTIONS, style="m128")


def write(options: ProgramOptions = ISO) -> str:
    (program,) = write_iso(small_path(), load_machine("ac-table"), options)
    return program.text


def test_every_block_is_numbered_and_ended() -> None:
    first, *inner, last, end = write().split("\r\n")
    assert (first, last, end) == ("%GOLDEN G71 *", f"N{LAST_BLOCK} %GOLDEN G71 *", "")
    numbers = [re.fullmatch(r"N(\d+) \S.* \*", line) for line in inner]
    assert all(numbers)
    assert [int(found[1]) for found in numbers if found] == [10 * k for k in range(1, len(inner) + 1)]


def test_the_poses_are_those_of_the_conversational_program() -> None:
    (conversational,) = write_conversational(small_path(), load_machine("ac-table"), ISO)
    words = r"X\S+ Y\S+ Z\S+ A\S+ C\S+"
    assert re.findall(words, write())[0:] == re.findall(words, conversational.text)


@pytest.mark.parametrize("style", ["tcpm", "ln"])
def test_styles_that_the_control_does_not_have_in_iso_are_refused(style: str) -> None:
    with pytest.raises(PostError) as caught:
        write(replace(OPTIONS, style=style))
    assert caught.value.where == "[program] style"
    assert "no LN and no FUNCTION TCPM" in caught.value.expected


@pytest.mark.parametrize(
    ("options", "where", "found"),
    [
        (replace(ISO, split="sweep"), "[program] split", "sweep"),
        (replace(ISO, own={"tolerance": "G62 T{tolerance}"}), "[program] options.tolerance", "{tolerance}"),
        (replace(ISO, own={"structure": "on"}), "[program] options", "structure"),
    ],
)
def test_what_this_post_does_not_have_is_refused(options: ProgramOptions, where: str, found: str) -> None:
    with pytest.raises(PostError) as caught:
        write(options)
    assert caught.value.where == where
    assert found in caught.value.found


def test_blocks_that_differ_between_controls_are_options() -> None:
    text = write(replace(ISO, own={"tolerance": "G62 T{t} P01 1 P02 {ta}", "tolerance_off": "", "datum": ""}))
    assert "N140 G62 T0.002 P01 1 P02 0.0044 *" in text
    assert "G247" not in text and "G62 *" not in text
    shifted = write(replace(ISO, datum=(1.0, 2.5, -3.0)))
    assert "N140 G54 X+1 Y+2.5 Z-3 *" in shifted and "G54 X+0 Y+0 Z+0 *" in shifted


def test_radius_compensation_is_g41_until_g40() -> None:
    approach, sweep, retract = cut(1, [-30.0, -30.5, -31.0], [359.5, 0.0, 0.5], (0.0, 0.0, 0.0))
    path = path_of(Operation(T1, (approach, replace(sweep, material="right"), retract)))
    (program,) = write_iso(path, load_machine("ac-table"), replace(ISO, own={"radius": "on"}))
    cuts = [line for line in program.text.splitlines() if " X" in line and "G3" not in line]
    assert ["G41" in line for line in cuts] == [False, True, False, False, False]
    assert "G00 G40 X" in cuts[-1]
    assert not read_iso(program.text).findings
