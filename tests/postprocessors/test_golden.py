"""Whole programs, reviewed by hand, line by line; to change one, change the file by hand too."""

from dataclasses import replace
from pathlib import Path

import msgspec
import pytest

from postprocessors.apt import write_apt
from postprocessors.heidenhain.conversational import write_conversational
from postprocessors.heidenhain.iso import write_iso
from postprocessors.machines.machine import load_machine
from postprocessors.post import ProgramOptions, Write
from tests.postprocessors.heidenhain.test_conversational import OPTIONS, small_path

GOLDEN = Path(__file__).parent / "golden"
SHIFTED = replace(OPTIONS, style="m128", datum=(100.0, -50.5, 20.0), own={"decimal": "comma"})
SPLIT = replace(OPTIONS, split="sweep")


@pytest.mark.parametrize(
    ("name", "write", "options", "number"),
    [
        ("two_tools_tcpm.H", write_conversational, OPTIONS, 0),
        ("two_tools_m128.H", write_conversational, SHIFTED, 0),
        ("two_tools_ln.H", write_conversational, replace(OPTIONS, style="ln"), 0),
        ("calling.H", write_conversational, SPLIT, 0),
        ("called.H", write_conversational, SPLIT, 3),
        ("two_tools.I", write_iso, replace(OPTIONS, style="m128"), 0),
        ("two_tools.APT", write_apt, replace(OPTIONS, style="multax"), 0),
    ],
)
def test_golden_program(name: str, write: Write, options: ProgramOptions, number: int) -> None:
    machine = load_machine("ac-table")
    if options is SHIFTED:
        machine = msgspec.structs.replace(machine, retract="M91", retract_z_mm=-1.0)
    text = write(small_path(), machine, options)[number].text
    assert text.replace("\r\n", "\n") == (GOLDEN / name).read_text("ascii")
    assert "\n" not in text.replace("\r\n", "")
