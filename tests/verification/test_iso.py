"""The reader of ISO programs against programs written by hand, in our own and in foreign styles."""

from __future__ import annotations

import numpy as np
import pytest

from conflank_cli.verification.program import CutLabel, Interpolation
from conflank_cli.verification.reader import read_program
from tests.verification.scenes import header


def iso(*body: str) -> str:
    blocks = [*header(), "T1 G17 S3000", "G62 T0.002 P01 0 P02 0.01", "G00 G40 M140 MB MAX", *body, "M30"]
    lines = [f"N{10 * number} {block} *" for number, block in enumerate(blocks, start=1)]
    return "\r\n".join(["%TEST G71 *", *lines, "N99999999 %TEST G71 *", ""])


KNOWN = ["G00 G40 G90 A-30 C+0", "M128", "G00 G40 G90 X+0 Y+0 Z+0 A-30 C+0"]


def codes(*body: str) -> set[str]:
    return {finding.code for finding in read_program(iso(*body)).findings}


def test_our_own_style() -> None:
    read = read_program(
        iso(
            *KNOWN,
            "M8",
            "; SWEEP 1",
            "G01 X+2 A-31 C+11 F800",
            "X+3",
            "; RETRACT 1",
            "G00 Z+30",
            "M129",
            "G00 M140 MB MAX",
        )
    )
    assert read.findings == ()
    assert (read.name, read.letters, read.tolerance) == ("TEST", "AC", (0.002, 0.01))
    assert read.cuts == (CutLabel("sweep", 1),)
    assert read.header.machine == "ac-table" and read.header.tools[0].name == "T1"
    moves = read.moves
    assert moves.point.tolist()[:4] == [[0, 0, 0], [2, 0, 0], [3, 0, 0], [3, 0, 30]]
    assert np.degrees(moves.rotary[1]) == pytest.approx([-31.0, 11.0])
    assert moves.rapid.tolist() == [True, False, False, True, True]
    assert moves.feed[1:3].tolist() == [800.0, 800.0]
    assert moves.cut.tolist() == [-1, 0, 0, -1, -1]
    assert set(moves.interpolation.tolist()) == {Interpolation.AXIS}
    assert moves.block.tolist() == [130, 160, 170, 190, 210]


FOREIGN = """%SWARF G71*
N10G30G17X-50Y-50Z-40*
N20G31G90X+50Y+50Z+0*
; posted elsewhere
N30 G99 T5 L+0 R+6*
N40 T5 G17 S6000*
N50 G54 X+10 Y0 Z-5*
N60 G00 G40 G90 M140 MB MAX*
N70 B+30 C350*
N80 M128 F2000*
N90 G0 G90 X1,5 Y-2,5 Z,5 B30 C350 M3*
N100 G91 G1 X+1 C+20 F500*
N110 G90 Z-3*
N120 M129*
N130 G00 Z-1 M91*
N140 M2*
N99999 %SWARF G71*
"""


def test_a_foreign_style_without_spaces_with_commas_increments_and_a_shift() -> None:
    read = read_program(FOREIGN)
    assert read.findings == ()
    assert (read.name, read.letters) == ("SWARF", "BC")
    assert read.tool_calls[0].number == 5
    assert read.moves.point == pytest.approx(np.array([[11.5, -2.5, -4.5], [12.5, -2.5, -4.5], [12.5, -2.5, -8.0]]))
    assert np.degrees(read.moves.rotary[:, 1]) == pytest.approx([350.0, 370.0, 370.0])
    assert read.moves.feed[1:].tolist() == [500.0, 500.0]


def test_labels() -> None:
    read = read_program(
        iso(*KNOWN, "G98 L1", "G91 G01 X+1 F100", "L1,2", "L7,0", "G90 Z+5", "M30", "G98 L7", "Y+1", "G98 L0")
    )
    assert read.findings == ()
    assert read.moves.point.tolist() == [[0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0], [3, 1, 0], [3, 1, 5]]


@pytest.mark.parametrize(
    ("body", "code"),
    [
        ([*KNOWN, "G01 X+Q1 F100"], "CF102"),
        ([*KNOWN, "D18 Q1 P01 +5"], "CF102"),
        ([*KNOWN, "G02 X+5 Y+5 I+0 J+1 F100"], "CF102"),
        ([*KNOWN, "G01 X+1 F100", "G25 R5"], "CF102"),
        ([*KNOWN, "%OTHER"], "CF102"),
        ([*KNOWN, "L9,0"], "CF109"),
        ([*KNOWN, "G79"], "CF102"),
        ([*KNOWN, "G41 G01 X+1 F100", "M129", "X+1"], "CF102"),
        (["G73 G90 H+30", *KNOWN], "CF105"),
        (["G80 A+10 B+0 C+0", *KNOWN], "CF108"),
        (["PLANE SPATIAL SPA+10 SPB+0 SPC+0 STAY", *KNOWN], "CF102"),
        ([*KNOWN, "/ G01 X+1 F100"], "CF102"),
        ([*KNOWN, "G01 X+1 F100 HELLO"], "CF101"),
        ([*KNOWN, "G01 X+1"], "CF112"),
        ([*KNOWN, "T2 G17 S1000"], "CF113"),
        ([*KNOWN, "M129", "G01 X+1 Y+0 Z+0 F100"], "CF105"),
        ([*KNOWN, "G01 B+1 F100"], "CF108"),
    ],
)
def test_what_is_not_followed_is_a_finding(body: list[str], code: str) -> None:
    assert code in codes(*body)


def test_frames_that_change_nothing_are_none() -> None:
    assert codes("G73 G90 H+0", "G28", "G80", "G72 F1", *KNOWN) == set()


def test_a_program_cut_off_is_a_finding() -> None:
    text = iso(*KNOWN)
    assert {finding.code for finding in read_program(text[: text.index("N99999999")]).findings} == {"CF101"}


@pytest.mark.parametrize("words", ["G01 X+1.5 Y-2 Z+.25 A-30 C+10 F100", "G0 Y+7", "C+370 F20", "G1 X1,5 A-,5 F9"])
def test_usual_blocks_are_read_as_any_other(words: str) -> None:
    quick, slow = (read_program(iso(*KNOWN, words + end)) for end in ("", " M8"))
    for name in ("point", "rotary", "feed", "rapid", "block", "joined"):
        np.testing.assert_array_equal(getattr(quick.moves, name), getattr(slow.moves, name))
    assert quick.findings == slow.findings
