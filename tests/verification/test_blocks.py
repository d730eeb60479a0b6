"""Where the control splits a text into lines, and what it may not take as it stands."""

from __future__ import annotations

import pytest

from conflank_cli.verification.blocks import lines_of
from conflank_cli.verification.reader import read_program
from tests.verification.scenes import program

TEXT = program(["L X+0 Y+0 Z+5 R0 FMAX", "; a comment", "L Z+0 F200", "L M140 MB MAX"])


def codes(text: str) -> set[str]:
    return {finding.code for finding in read_program(text).findings}


def test_lines_end_at_lf_and_cr_lf() -> None:
    assert lines_of("A\r\nB\nC") == (["A", "B", "C"], [])


@pytest.mark.parametrize(
    "letter", ["\x0b", "\x0c", "\r", "\x1c", "\x85", "\u2028", "\u2029", "\x00", "\t", "\x1b", "\u00e4"]
)
def test_other_characters_end_no_line_and_are_findings(letter: str) -> None:
    """A block behind one in a comment is a comment, whatever an editor shows."""
    text = TEXT.replace("a comment", f"a comment{letter}L Z-99 F200")
    read = read_program(text)
    assert "CF119" in {finding.code for finding in read.findings}
    assert read.moves.point[:, 2].min() == 0.0


@pytest.mark.parametrize("end", ["", "\x00\x00", "\x1a", "\x03", "\r\n\r\n"])
def test_what_a_transfer_leaves_at_the_end_is_harmless(end: str) -> None:
    assert codes(TEXT + end) == set()


@pytest.mark.parametrize(
    ("text", "code"),
    [
        (TEXT + "99 L X+100 FMAX\r\n", "CF119"),
        (TEXT + "; a note\r\n", "CF119"),
        (TEXT + TEXT, "CF119"),
        ("; a note\r\n" + TEXT, "CF119"),
        (TEXT.replace("END PGM TEST", "END PGM OTHER"), "CF119"),
        (TEXT.replace("END PGM TEST MM", "END PGM TEST INCH"), "CF119"),
        (TEXT[: TEXT.index("END PGM")].rpartition("\r\n")[0] + "\r\n", "CF101"),
        (TEXT.replace("0 BEGIN PGM TEST MM\r\n", ""), "CF101"),
    ],
)
def test_one_program_from_its_first_line_to_its_last(text: str, code: str) -> None:
    assert codes(TEXT) == set()
    assert code in codes(text)
