"""Mutants of posted programs: what changes what the machine does is found, what does not is not.

A mutant that moves otherwise may pass where the judgement is of that other motion: an approach in free air, say, that
begins a millimetre further up. Each is asked whether its poses did change and nothing else that counts in the cut.
"""

from __future__ import annotations

from collections.abc import Iterable

import pytest

from conflank_cli.verification.judge import verify_program
from conflank_cli.verification.posed import pose_program
from tests.verification.edits import (
    EDITS,
    JUDGED,
    Edit,
    alike,
    blocks_of,
    found,
    line_edits,
    number_edits,
    numbered,
    only_moved,
    other_poses,
    same_reading,
    trace,
)
from tests.verification.posted import MACHINES, POINTS, STYLES, Posted, posted


def named(edits: Iterable[Edit]) -> list[object]:
    """Edits as parameters of a test."""
    return [pytest.param(edit, id=f"{edit.kind} {edit.name}".encode("ascii", "replace").decode()) for edit in edits]


def clean(program: Posted) -> bool:
    """Whether a program as posted has no finding and covers the faces."""
    result = verify_program(program.text, program.scene, "", POINTS, program.called)
    return not result.findings and result.coverage == 1.0


def test_what_is_posted_is_clean() -> None:
    assert clean(posted())


@pytest.mark.slow
@pytest.mark.parametrize("machine", MACHINES)
@pytest.mark.parametrize("style", STYLES, ids=" ".join)
def test_what_is_posted_in_any_style_for_any_machine_is_clean(style: tuple[str, str, str], machine: str) -> None:
    assert clean(posted(*style, machine))


def test_blocks_and_numbers_are_those_of_the_post() -> None:
    for kind, style, split in STYLES:
        program = posted(kind, style, split)
        assert numbered(blocks_of(program.text, kind), kind) == program.text


def test_the_list_is_long_and_its_names_are_its_own() -> None:
    assert sum(edit.expect == "finding" for edit in EDITS) >= 350
    assert len({(edit.kind, edit.style, edit.name) for edit in EDITS}) == len(EDITS)
    assert all(bool(edit.why) == (edit.expect == "either") for edit in EDITS)


@pytest.mark.parametrize("edit", named(edit for edit in EDITS if edit.expect == "finding"))
def test_an_edit_that_changes_what_the_machine_does_is_found(edit: Edit) -> None:
    program = posted(edit.kind, edit.style)
    text = edit.text(program)
    assert text != program.text
    assert found(program, text)


@pytest.mark.parametrize("edit", named(edit for edit in EDITS if edit.expect == "none"))
def test_a_harmless_edit_is_not_found(edit: Edit) -> None:
    program = posted(edit.kind, edit.style)
    text = edit.text(program)
    assert text != program.text
    posed = pose_program(text, program.scene, program.called)
    assert same_reading(program, posed) or not found(program, text)


@pytest.mark.parametrize("edit", named(edit for edit in EDITS if edit.why == JUDGED))
def test_an_edit_whose_motion_is_judged_is_found_or_is_other_motion(edit: Edit) -> None:
    program = posted(edit.kind, edit.style)
    text = edit.text(program)
    posed = pose_program(text, program.scene, program.called)
    assert posed.findings or same_reading(program, posed) or other_poses(program, posed)


def unfound(program: Posted, kind: str, edits: Iterable[Edit]) -> list[str]:
    """Names of mutants that do something else, in which nothing is found, and whose motion is not what differs."""
    names = []
    own = trace(program.text, kind)
    for edit in edits:
        text = edit.text(program)
        other = trace(text, kind)
        if alike(own, other) or found(program, text):
            continue
        posed = pose_program(text, program.scene, program.called)
        if not (only_moved(own, other) and other_poses(program, posed)):
            names.append(edit.name)
    return names


def test_no_control_line_can_be_left_out_doubled_or_moved() -> None:
    program = posted()
    assert unfound(program, "h", line_edits(program, "h", "tcpm", poses=False)) == []


def test_no_number_of_a_control_line_can_be_another() -> None:
    program = posted()
    assert unfound(program, "h", number_edits(program, "h", "tcpm")) == []


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "style"), [("h", "tcpm"), ("h", "m128"), ("h", "ln"), ("i", "m128"), ("apt", "multax")]
)
@pytest.mark.parametrize("machine", ["ac-table", "head-head"])
def test_no_line_and_no_number_of_any_style_can_be_another(kind: str, style: str, machine: str) -> None:
    """The first and last pose of every stretch as well, and the numbers of every fortieth line."""
    program = posted(kind, style, "none", machine)
    mutants = [*line_edits(program, kind, style, poses=True), *number_edits(program, kind, style, every=40)]
    assert unfound(program, kind, mutants) == []


def test_the_trace_tells_what_mutants_do() -> None:
    """The authority itself: it sees what it is there for, and nothing in what changes nothing."""
    program = posted()
    own = trace(program.text, "h")
    for old, new in (
        ("M8\r\n", "M9\r\n"),
        (" M3\r\n", "\r\n"),
        ("T0.002", "T0.2"),
        ("Q339=+1", "Q339=+2"),
        ("S3000", "S1"),
    ):
        assert old in program.text
        assert not alike(own, trace(program.text.replace(old, new, 1), "h"))
    assert alike(own, trace(program.text.replace("; SWEEP 1", "; HELLO"), "h"))
    assert alike(own, trace(program.text.replace("M30", "M30\r\n999 M30"), "h"))
