"""The reader against programs written by hand, in our own and in foreign styles."""

from __future__ import annotations

from math import cos, pi, radians, sin, sqrt

import numpy as np
import pytest

from conflank_cli.verification.conversational import split_conversational
from conflank_cli.verification.kinematics import axis_of
from conflank_cli.verification.program import CutLabel, Interpolation, StatedTool
from conflank_cli.verification.reader import read_program
from tests.verification.scenes import ROTARY_TOLERANCE, TCPM, program


def codes(text: str) -> set[str]:
    return {finding.code for finding in read_program(text).findings}


def test_our_own_style() -> None:
    text = program(
        [
            "L A-30 C+10 R0 FMAX M3",
            TCPM,
            "; APPROACH 1",
            "L X+1 Y+2 Z+30 A-30 C+10 R0 FMAX",
            "M8",
            "L X+1 Y+2 Z+3 F500",
            "; SWEEP 1",
            "L X+2 A-31 C+11 F800",
            "L X+3",
            "; RETRACT 1",
            "L Z+30 FMAX",
            "FUNCTION RESET TCPM",
            "L M140 MB MAX",
        ]
    )
    read = read_program(text)
    assert read.findings == ()
    assert read.name == "TEST"
    assert read.header.tools == (StatedTool(1, "T1", 1.5, 3.0, 24.0),)
    assert read.header.faces == (0,)
    assert read.tolerance == (0.002, ROTARY_TOLERANCE)
    assert read.cuts == (CutLabel("sweep", 1),)
    assert read.letters == "AC"
    assert read.unknown_moves == 1
    moves = read.moves
    assert moves.point.tolist()[:5] == [[1, 2, 30], [1, 2, 3], [2, 2, 3], [3, 2, 3], [3, 2, 30]]
    assert np.degrees(moves.rotary[3]) == pytest.approx([-31.0, 11.0])
    assert moves.cut.tolist() == [-1, -1, 0, 0, -1, -1]
    assert moves.joined.tolist() == [False, True, True, True, True, True]
    assert moves.rapid.tolist() == [True, False, False, False, True, True]
    assert moves.feed[1:4].tolist() == [500.0, 800.0, 800.0]
    assert set(moves.interpolation.tolist()[:5]) == {Interpolation.VECTOR}
    # The retract to the limit leads along the axis from where the tool stood.
    axis = axis_of("AC", moves.rotary[-1:])[0]
    assert np.cross(moves.point[-1] - moves.point[-2], axis) == pytest.approx(np.zeros(3), abs=1e-9)


FOREIGN = """BEGIN PGM FOREIGN MM
; posted elsewhere
TOOL CALL "BALL" Z S12000 F1500
CYCL DEF 7.0 DATUM SHIFT
CYCL DEF 7.1 X+100
CYCL DEF 7.2 IY-1
L M140 MB MAX
L B+10 C+350 R0 FMAX
M128 F2000
L X+1,5 Y-2,25 Z+,5 B+10 C+350 F1000
L IX+1 IC+20 F AUTO
M126
L C+340
L M140 MB50 F300
M129
END PGM FOREIGN MM
"""


def test_a_foreign_style_without_numbers_with_commas_increments_and_a_datum_shift() -> None:
    read = read_program(FOREIGN)
    assert read.findings == ()
    assert read.letters == "BC"
    assert read.moves.point[0] == pytest.approx([101.5, -3.25, 0.5])
    assert read.moves.point[1] == pytest.approx([102.5, -3.25, 0.5])
    # C went to 370; with M126 the way to 340 is -30, not -390 of a full turn or +330.
    assert np.degrees(read.moves.rotary[:3, 1]) == pytest.approx([350.0, 370.0, 340.0])
    assert read.moves.block.tolist() == [10, 11, 13, 14]
    # F AUTO is the feed of the tool call.
    assert read.moves.feed.tolist() == [1000.0, 1500.0, 1500.0, 300.0]
    assert np.linalg.norm(read.moves.point[3] - read.moves.point[2]) == pytest.approx(50.0)


def test_the_way_of_a_rotary_axis_without_m126_is_as_written() -> None:
    read = read_program(FOREIGN.replace("M126\n", "").replace("C+340", "C+10"))
    assert np.degrees(read.moves.rotary[:3, 1]) == pytest.approx([350.0, 370.0, 10.0])


def test_m126_takes_the_shorter_way() -> None:
    read = read_program(FOREIGN.replace("C+340", "C+15"))
    assert np.degrees(read.moves.rotary[2, 1]) == pytest.approx(375.0)


def test_ln_gives_the_axis_itself() -> None:
    text = program(
        [
            "M128",
            "LN X+1 Y+2 Z+3 TX+0.6 TY+0 TZ+0.8 R0 F500",
            "LN X+2 Y+2 Z+3 NX+0 NY+0 NZ+1 TX+0 TY+0 TZ+1",
            "M129",
            "L M140 MB MAX",
        ]
    )
    read = read_program(text)
    assert read.findings == ()
    assert read.moves.vector[:2].tolist() == [[0.6, 0.0, 0.8], [0.0, 0.0, 1.0]]
    assert np.isnan(read.moves.rotary).all()


def test_three_axes_need_no_tool_centre_point_control() -> None:
    read = read_program(program(["L X+0 Y+0 Z+5 R0 FMAX", "L Z+0 F200", "L X+10", "L M140 MB MAX"]))
    assert read.findings == ()
    assert read.moves.vector.tolist() == [[0.0, 0.0, 1.0]] * 4


def test_inches() -> None:
    text = program(["L X+1 Y+0 Z+0 R0 FMAX", "L X+2 F100", "L M140 MB MAX"]).replace(" MM\r\n", " INCH\r\n")
    moves = read_program(text).moves
    assert moves.point[:2, 0].tolist() == [25.4, 50.8]
    assert moves.feed[1] == pytest.approx(254.0)  # tenths of an inch a minute


def test_continued_and_skippable_blocks() -> None:
    blocks, _ = split_conversational(
        "0 BEGIN PGM A MM\n1 CYCL DEF 247 DATUM SETTING ~\n    Q339=+2 ;DATUM NUMBER\n/2 L X+1 ; go\n"
    )
    assert [block.number for block in blocks] == [0, 1, 3 - 1]
    assert blocks[1].text == "CYCL DEF 247 DATUM SETTING Q339=+2"
    assert blocks[1].comments == ("DATUM NUMBER",)
    assert blocks[2].skippable and blocks[2].text == "L X+1" and blocks[2].comments == ("go",)


KNOWN = ["L A-30 C+0 R0 FMAX", TCPM, "L X+0 Y+0 Z+0 A-30 C+0 R0 FMAX"]


@pytest.mark.parametrize(
    ("body", "code"),
    [
        ([*KNOWN, "L X+Q1 F100"], "CF102"),
        ([*KNOWN, "CALL LBL 1 REP 3"], "CF109"),
        ([*KNOWN, "CALL LBL 1 REP 3", "LBL 1"], "CF109"),
        ([*KNOWN, "LBL 1", "CALL LBL Q1"], "CF102"),
        ([*KNOWN, "CALL LBL 1", "M30", "LBL 1", "L X+1 F100"], "CF109"),
        ([*KNOWN, "CALL LBL 1", "M30", "LBL 1", "CALL LBL 1", "LBL 0"], "CF102"),
        ([*KNOWN, "FN 9: IF +Q1 EQU +2 GOTO LBL 1"], "CF102"),
        ([*KNOWN, "CALL PGM OTHER"], "CF102"),
        ([*KNOWN, "L A+1 B+1 C+1 F100"], "CF108"),
        ([*KNOWN, "Q1 = +5 +"], "CF102"),
        ([*KNOWN, "FN 18: SYSREAD Q1 = ID210 NR1"], "CF102"),
        ([*KNOWN, "CC Z+0"], "CF102"),
        ([*KNOWN, "C X+0 Y+1 DR+"], "CF102"),
        ([*KNOWN, "/ L X+1 F100"], "CF102"),
        ([*KNOWN, "L X+1 F100 M118 Z1"], "CF102"),
        ([*KNOWN, "L X+1 F100 RL", "FUNCTION RESET TCPM", "L X+1 RL"], "CF102"),
        (["PLANE SPATIAL SPA+10 SPB+0 SPC+0 STAY", *KNOWN], "CF105"),
        (["CYCL DEF 19.0 WORKING PLANE", "CYCL DEF 19.1 A+10 C+0", *KNOWN], "CF105"),
        (["CYCL DEF 10.0 ROTATION", "CYCL DEF 10.1 ROT+10", *KNOWN], "CF105"),
        (["CYCL DEF 200 DRILLING ~", "    Q200=+2 ;CLEARANCE", *KNOWN], "CF102"),
        ([*KNOWN, "L X+1 F100 HELLO"], "CF101"),
        ([*KNOWN, "WOBBLE 3"], "CF101"),
        ([*KNOWN, "LN X+1 Y+0 Z+0 TX+1 TY+0 F100"], "CF101"),
        ([*KNOWN, "FUNCTION RESET TCPM", "L X+1 Y+0 Z+0 F100"], "CF105"),
        (["L X+0 Y+0 Z+0 A+0 C+0 R0 FMAX", TCPM, "L IB+1"], "CF108"),
        ([*KNOWN, "L X+1"], "CF112"),
        ([*KNOWN, "TOOL CALL 2 Z S1000"], "CF113"),
        ([*KNOWN, "L Z+0 R0 FMAX M91"], "CF113"),
        (["LN X+1 Y+0 Z+0 TX+0 TY+0 TZ+1 F100"], "CF113"),
        (["L A+0 C+0 FMAX", TCPM, "LN X+1 Y+0 Z+0 TX+0 TY+0 TZ+2 F100"], "CF109"),
        (["L A+10 C+0 FMAX", TCPM.replace("POS", "SPAT"), "L X+0 Y+0 Z+0 A+10 C+0 FMAX"], "CF108"),
    ],
)
def test_what_is_not_followed_is_a_finding(body: list[str], code: str) -> None:
    assert code in codes(program(body))


def test_moves_in_machine_coordinates_are_noted_for_who_knows_the_machine() -> None:
    read = read_program(program(["L Z-1 R0 FMAX M91", *KNOWN, "FUNCTION RESET TCPM", "L Z-1 R0 FMAX M92"]))
    assert read.findings == ()
    assert [(move.kind, move.words) for move in read.unknown if move.kind[:3] == "mac"] == [
        ("machine", {"Z": -1.0}),
        ("machine 2", {"Z": -1.0}),
    ]


def test_rotary_moves_are_noted_for_who_knows_the_machine() -> None:
    read = read_program(program([*KNOWN, "FUNCTION RESET TCPM", "L A+0 C+90 R0 FMAX"]))
    assert read.findings == ()
    assert [(move.kind, move.words) for move in read.unknown][-1] == ("turn", {"A": 0.0, "C": pytest.approx(pi / 2)})


def test_a_program_cut_off_is_a_finding() -> None:
    text = program(KNOWN)
    assert "CF101" in codes(text[: text.index("M30")])


def test_the_same_finding_again_only_counts() -> None:
    (finding,) = read_program(program([*KNOWN, "WOBBLE", "WOBBLE"])).findings
    assert (finding.count, finding.block) == (2, 19)


@pytest.mark.parametrize(
    ("letters", "words", "axis"),
    [
        ("AC", (-90.0, 0.0), (0.0, 1.0, 0.0)),
        ("AC", (-90.0, 270.0), (1.0, 0.0, 0.0)),
        ("AC", (30.0, 90.0), (0.5, 0.0, sqrt(0.75))),
        ("BC", (90.0, 0.0), (1.0, 0.0, 0.0)),
        ("BC", (30.0, 90.0), (0.0, 0.5, sqrt(0.75))),
        ("AB", (90.0, 0.0), (0.0, -1.0, 0.0)),
        ("AB", (0.0, 90.0), (1.0, 0.0, 0.0)),
        ("AB", (20.0, 30.0), (0.5, -sin(radians(20)) * sqrt(0.75), cos(radians(20)) * sqrt(0.75))),
    ],
)
def test_rotary_axes(letters: str, words: tuple[float, float], axis: tuple[float, float, float]) -> None:
    assert axis_of(letters, np.radians([words]))[0] == pytest.approx(axis, abs=1e-12)


# --- labels and called programs -------------------------------------------------------------------------------------


def test_a_program_section_is_repeated() -> None:
    """With incremental steps and a repetition within a repetition, as facing programs have them."""
    body = [*KNOWN, "LBL 1", "LBL 2", "L IX+1 F100", "CALL LBL 2 REP 2/2", "L IY+5", "CALL LBL 1 REP 1", "L Z+9"]
    read = read_program(program(body))
    assert read.findings == ()
    points = read.moves.point.tolist()
    assert points == [
        [0, 0, 0],
        *([k, 0, 0] for k in (1, 2, 3)),
        [3, 5, 0],
        *([k, 5, 0] for k in (4, 5, 6)),
        [6, 10, 0],
        [6, 10, 9],
    ]


def test_subprograms_after_the_end_are_run_where_they_are_called() -> None:
    body = [*KNOWN, "CALL LBL 5", 'CALL LBL "UP"', "CALL LBL 05", "L Z+9 F100 M30"]
    body += ["LBL 5", "L IX+1 F100", "LBL 0", 'LBL "UP"', "L IZ+1 F100", "LBL 0"]
    read = read_program(program(body))
    assert read.findings == ()
    assert read.moves.point.tolist() == [[0, 0, 0], [1, 0, 0], [1, 0, 1], [2, 0, 1], [2, 0, 9]]


MAIN = program(["CALL PGM TNC:\\BLADES\\ONE.H", "CALL PGM TWO"])
PARTS = {
    "ONE.H": program(["M129", *KNOWN, "; SWEEP 1", "L X+5 F100", "; RETRACT 1", "M129", "L M140 MB MAX"]),
    "TWO.H": program(["M129", *KNOWN, "; SWEEP 2", "L X-5 F100", "; RETRACT 2", "M129", "L M140 MB MAX"]),
}
PARTS = {name: text.replace("M30", "M9") for name, text in PARTS.items()}


def test_called_programs_are_followed() -> None:
    read = read_program(MAIN, PARTS.get)
    assert read.findings == ()
    assert [cut.number for cut in read.cuts] == [1, 2]
    assert read.header.faces == (0,) and len(read.header.tools) == 1
    assert {part.name: part.text for part in read.called} == PARTS
    cut = read.moves.cut.tolist()
    assert read.moves.program(cut.index(0)) == "ONE.H" and read.moves.program(cut.index(1)) == "TWO.H"
    assert len(read.moves.cut) == 6
    # Block numbers are those of the called program.
    assert read.moves.block[cut.index(1)] == read.moves.block[cut.index(0)]


@pytest.mark.parametrize(
    ("parts", "code", "words"),
    [
        ({"ONE.H": PARTS["ONE.H"]}, "CF102", "no TWO.H beside"),
        ({"ONE.H": PARTS["ONE.H"].replace("M9", "M30"), "TWO.H": PARTS["TWO.H"]}, "CF109", "called program, in ONE.H"),
        ({"ONE.H": PARTS["ONE.H"].replace("M9", "CALL PGM ONE"), "TWO.H": PARTS["TWO.H"]}, "CF102", "in a circle"),
    ],
)
def test_calls_that_do_not_work_are_findings(parts: dict[str, str], code: str, words: str) -> None:
    finding = read_program(MAIN, parts.get).findings[0]
    assert finding.code == code and words in finding.text


def test_what_follows_a_call_that_is_not_followed_is_not_taken_for_known() -> None:
    read = read_program(program([*KNOWN, "CALL PGM ELSEWHERE", "L X+1 F100"]))
    assert len(read.moves.block) == 1


# --- speed and equality ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("feed", ["", " F250", " FMAX", " R0 FMAX"])
@pytest.mark.parametrize("words", ["X+1.5 Y-2 Z+.25 A-30 C+10", "Y+7", "C+370", "X1,5 A-,5", "Z-0.0001"])
def test_usual_blocks_are_read_as_any_other(words: str, feed: str) -> None:
    """A harmless M function at the end takes a block off the quick way; both must lead to the same pose."""
    first = ["L A-30 C+0 R0 FMAX", TCPM, "L X+0 Y+0 Z+0 A-30 C+0 R0 FMAX"]
    quick, slow = (read_program(program([*first, f"L {words}{feed}{end}"])) for end in ("", " M8"))
    for name in ("point", "rotary", "feed", "rapid", "block", "joined"):
        np.testing.assert_array_equal(getattr(quick.moves, name), getattr(slow.moves, name))
    assert quick.findings == slow.findings


def test_described_axes() -> None:
    """A nutating head: t = R(C about z) R(B about (0, 1, 1)) z; B180 lays the spindle down."""
    head = ["; REFERENCE TIP", "; ROTARY C 0 0 1", "; ROTARY B 0 0.5 0.5", "; MACHINE m", "; FRAME CAD"]
    body = ["L B+180 C+90 R0 FMAX", TCPM, "L X+0 Y+0 Z+0 B+180 C+90 R0 FMAX"]
    read = read_program(program(body, head))
    assert axis_of(read.letters, read.moves.rotary)[0] == pytest.approx([-1.0, 0.0, 0.0], abs=1e-12)
    assert "CF108" in codes(program([*body, "L A+1"], head))


def test_letters_of_another_code_are_quoted_and_not_a_failure() -> None:
    """A comment of an old editor in Latin-1 has bytes that are no UTF-8; the text with them keeps its hash."""
    text = "0 BEGIN PGM X MM\r\n1 L X\u00c4 Y5\r\n2 END PGM X MM\r\n".encode("latin-1")
    found = read_program(text.decode("utf-8", "surrogateescape")).findings
    assert any("\u00c4" in finding.text for finding in found)
    assert all(finding.text.encode("utf-8") for finding in found)
