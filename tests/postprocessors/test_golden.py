"""Whole programs, reviewed by hand, line by line; to change one, change the file by hand too."""

from dataclasses import replace
from pathlib import Path

import msgspec
import pytest

from postprocessors.apt import write_apt
from postprocessors.heidenhain.conversational import write_conversational
from postprocessors.heidenhain.iso import write_iso
from postprocessors.machines.machine import Machine, load_machine
from postprocessors.post import ProgramOptions, Write
from tests.postprocessors.heidenhain.test_conversational import OPTIONS, small_path

GOLDEN = Path(__file__).parent / "golden"
SHIFTED = replace(OPTIONS, style="m128", datum=(100.0, -50.5, 20.0), own={"decimal": "comma"})
SPLIT = replace(OPTIONS, split="sweep")


def machine_for(name: str) -> Machine:
    """The table-table A/C machine, or it with another pair of axes or another retract."""
    machine = load_machine("ac-table")
    c, a = machine.rotary
    if name == "two_tools_m128.H":
        return msgspec.structs.replace(machine, retract="M91", retract_z_mm=-1.0)
    if name == "head_table.H":
        head = msgspec.structs.replace(
            a, letter="B", vector=(0.0, 1.0, 0.0), carried_by="head", range_deg=(-110.0, 110.0), output="continuous"
        )
        counted = msgspec.structs.replace(c, output="continuous")
        return msgspec.structs.replace(machine, name="head-table", rotary=(counted, head))
    if name == "nutating_head.H":
        head = msgspec.structs.replace(
            a, letter="B", vector=(0.0, 1.0, 1.0), carried_by="head", range_deg=(-180.0, 180.0)
        )
        return msgspec.structs.replace(machine, name="nutating-head", rotary=(c, head))
    return machine


@pytest.mark.parametrize(
    ("name", "write", "options", "number"),
    [
        ("two_tools_tcpm.H", write_conversational, OPTIONS, 0),
        ("two_tools_m128.H", write_conversational, SHIFTED, 0),
        ("head_table.H", write_conversational, OPTIONS, 0),
        ("nutating_head.H", write_conversational, OPTIONS, 0),
        ("two_tools_ln.H", write_conversational, replace(OPTIONS, style="ln"), 0),
        ("calling.H", write_conversational, SPLIT, 0),
        ("called.H", write_conversational, SPLIT, 3),
        ("two_tools.I", write_iso, replace(OPTIONS, style="m128"), 0),
        ("two_tools.APT", write_apt, replace(OPTIONS, style="multax"), 0),
    ],
)
def test_golden_program(name: str, write: Write, options: ProgramOptions, number: int) -> None:
    text = write(small_path(), machine_for(name), options)[number].text
    assert text.replace("\r\n", "\n") == (GOLDEN / name).read_text("ascii")
    assert "\n" not in text.replace("\r\n", "")
