"""What a program sets, held against its job: each edit of a sound program is found, and by its own code."""

from __future__ import annotations

import msgspec
import pytest

from conflank_cli.job import Cycle32, Foreign, Job, Part, Program, Tools
from conflank_cli.job import Design as DesignKeys
from conflank_cli.tool import CATALOGUE
from conflank_cli.verification.agreement import disagreements
from conflank_cli.verification.reader import read_program
from tests.verification.scenes import TCPM, program

T1 = CATALOGUE["T1"]
JOB = Job(part=Part("part.step", (DesignKeys(0),)), tools=Tools(("T1",)))
TEXT = program(
    [
        "L A-30 C+10 R0 FMAX",
        TCPM,
        "L X+1 Y+2 Z+30 A-30 C+10 R0 FMAX",
        "; SWEEP 1",
        "L X+1 Y+2 Z+3 F500",
        "L X+2",
        "; RETRACT 1",
        "L Z+30 FMAX",
        "FUNCTION RESET TCPM",
        "L M140 MB MAX",
    ]
)


def found(text: str, job: Job = JOB) -> dict[str, str]:
    read = read_program(text)
    return {finding.code: finding.text for finding in disagreements(read, job, [T1] * len(read.tool_calls))}


def with_program(**keys: object) -> Job:
    return msgspec.structs.replace(JOB, program=Program(**keys))  # type: ignore[arg-type]


def test_a_sound_program_agrees() -> None:
    assert found(TEXT) == {}


@pytest.mark.parametrize(
    ("old", "new", "code", "words"),
    [
        ("M13", "M8", "CF114", "the spindle stands"),
        ("M13", "M14", "CF114", "wrong way"),
        ("S3000", "S3100", "CF114", "S3100 where the job has 3000"),
        (" S3000", "", "CF114", "not known"),
        ("L X+2\r", "L X+2 M5\r", "", ""),
        ("F500", "F500 M5", "CF114", "the spindle stands"),
        ("M13", "M3", "CF121", "coolant"),
        ("F500", "F500 M9", "CF121", "coolant"),
        ("Q339=+1", "Q339=+2", "CF118", "preset 2 where the job has number 1"),
        ("CYCL DEF 247 DATUM SETTING Q339=+1", "M8", "CF118", "no preset is set"),
        ("PLANE RESET STAY", "M8", "CF118", "neither reset nor tilted"),
        ("T0.002", "T5", "CF117", "T5 where the job has 0.002"),
        ("TA0.003", "TA10", "CF117", "TA10"),
        ("F500", "F500 RL", "CF110", "radius compensation RL"),
    ],
)
def test_an_edit_is_found(old: str, new: str, code: str, words: str) -> None:
    assert old in TEXT
    result = found(TEXT.replace(old, new))
    assert set(result) == ({code} if code else set())
    assert words in result.get(code, "")


@pytest.mark.parametrize("line", ["T0.002", "HSC-MODE"])
def test_a_tolerance_cycle_that_is_not_whole(line: str) -> None:
    kept = [block for block in TEXT.splitlines(keepends=True) if line not in block]
    read = read_program("".join(kept))
    codes = {finding.code for finding in (*read.findings, *disagreements(read, JOB, [T1]))}
    assert codes & {"CF101", "CF117"}


def test_a_tolerance_reset_in_the_cut() -> None:
    text = TEXT.replace(" L X+2\r", " CYCL DEF 32.0 TOLERANCE\r\n 99 CYCL DEF 32.1\r\n 99 L X+2\r")
    assert set(found(text)) == {"CF117"}


def test_the_job_says_what_is_asked() -> None:
    assert set(found(TEXT, with_program(datum=3))) == {"CF118"}
    assert set(found(TEXT, with_program(datum=(1.0, 2.0, 3.0)))) == {"CF118"}
    assert set(found(TEXT, with_program(coolant="M7"))) == {"CF121"}
    assert found(TEXT, with_program(coolant="none")) == {}
    assert set(found(TEXT, with_program(cycle32=Cycle32(t=0.001)))) == {"CF117"}
    assert set(found(TEXT, with_program(cycle32=Cycle32(t=0.002, ta=0.001)))) == {"CF117"}


def test_the_job_of_a_foreign_program_answers_for_what_it_does_not_set() -> None:
    silent = "".join(
        line for line in TEXT.splitlines(keepends=True) if "CYCL DEF" not in line and "PLANE" not in line
    ).replace("M13", "M3")
    assert set(found(silent)) == {"CF117", "CF118", "CF121"}
    foreign = with_program(foreign=Foreign())
    assert found(silent, foreign) == {}
    # What it does set must agree all the same.
    assert set(found(TEXT.replace("Q339=+1", "Q339=+2"), foreign)) == {"CF118"}
    assert set(found(TEXT.replace("T0.002", "T5"), foreign)) == {"CF117"}
    assert set(found(silent.replace("M3", "M8"), foreign)) == {"CF114"}
