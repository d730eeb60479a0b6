"""The reader of APT data against data written by hand, in the manner of CAD systems."""

from __future__ import annotations

import numpy as np
import pytest

from conflank_cli.verification.program import CutLabel
from conflank_cli.verification.reader import read_program

DATA = """$$ -----------------------------------------------------------------
$$     Generated on Sunday
$$*CATIA0
PARTNO PART TO BE MACHINED
COOLNT/ON
CUTTER/ 6.000000, 3.000000, 0.000000
UNITS/MM
MULTAX
LOADTL/3,1
SPINDL/ 3000.0000,RPM,CLW
PPRINT/TOOL 3 T3 R_MIN 2 R_MAX 5 LENGTH 30
PPRINT SWEEP 1
RAPID
GOTO  /   10.00000,   20.00000,   30.00000,  0.600000,  0.000000, $
          0.800000
FEDRAT/  500.0000,MMPM
GOTO  /   11.00000,   20.00000,   30.00000
TLAXIS/ 0,0,1
GODLTA/ 0, 1, -1
RAPID
GOTO/ 1.2E1, 21, 29, 0, 0, 1
RETRCT
FINI
"""


def test_data_as_cad_systems_write_them() -> None:
    read = read_program(DATA)
    assert read.findings == ()
    assert read.name == "PART TO BE MACHINED"
    assert read.tool_calls[0].number == 3 and read.header.tools[0].name == "T3"
    assert read.cuts == (CutLabel("sweep", 1),)
    moves = read.moves
    assert moves.point[:4].tolist() == [[10, 20, 30], [11, 20, 30], [11, 21, 29], [12, 21, 29]]
    assert moves.vector[:4] == pytest.approx(np.array([[0.6, 0, 0.8]] * 2 + [[0, 0, 1]] * 2))
    assert moves.rapid[:4].tolist() == [True, False, False, True]
    assert moves.feed[1:3].tolist() == [500.0, 500.0]
    assert moves.joined[:4].tolist() == [False, True, True, True]
    # The line a statement begins in.
    assert moves.block[:2].tolist() == [14, 17]
    assert moves.point[4] == pytest.approx([12, 21, 229])


def test_inches() -> None:
    read = read_program("PARTNO/A\nUNITS/INCHES\nLOADTL/1\nRAPID\nGOTO/1,0,0,0,0,1\nFEDRAT/10,IPM\nGOTO/2,0,0\nFINI\n")
    assert read.findings == ()
    assert read.moves.point[:, 0].tolist() == [25.4, 50.8]
    assert read.moves.feed[1] == pytest.approx(254.0)


@pytest.mark.parametrize(
    ("statement", "code"),
    [
        ("CIRCLE/0,0,0,0,0,1,5", "CF102"),
        ("CYCLE/DRILL,5", "CF102"),
        ("CUTCOM/LEFT", "CF102"),
        ("MODE/INCR", "CF102"),
        ("TRACUT/MATRIX1", "CF102"),
        ("FEDRAT/0.1,MMPR", "CF102"),
        ("GOTO/1,2", "CF101"),
        ("GOTO/1,2,X", "CF101"),
        ("GOTO/nan,2,3", "CF101"),
        ("GOTO/1,2,3,0,0,2", "CF109"),
    ],
)
def test_what_is_not_followed_is_a_finding(statement: str, code: str) -> None:
    text = DATA.replace("TLAXIS/ 0,0,1", statement)
    assert code in {finding.code for finding in read_program(text).findings}


def test_what_is_not_followed_moves_the_tool_to_nowhere_known() -> None:
    moves = read_program(DATA.replace("TLAXIS/ 0,0,1", "CIRCLE/0,0,0,0,0,1,5")).moves
    assert moves.joined.tolist()[:3] == [False, True, False]


def test_data_without_units_are_a_finding() -> None:
    read = read_program(DATA.replace("UNITS/MM\n", ""))
    assert [finding.code for finding in read.findings] == ["CF102"]
    assert read.moves.point[0].tolist() == [10.0, 20.0, 30.0]


def test_data_cut_off_are_a_finding() -> None:
    assert {finding.code for finding in read_program(DATA.replace("FINI\n", "")).findings} == {"CF101"}


CLSF = """TOOL PATH/FINISH_1,TOOL,BALL_TAPER
TLDATA/TANTOOF,3.0000,1.5000,24.0000,0.0000,3.5763
MSYS/0.0000,0.0000,0.0000,1.0000000,0.0000000,0.0000000,0.0000000,1.0000000,0.0000000
$$ centerline data
PAINT/PATH
PAINT/SPEED,10
UNITS/MM
LOAD/TOOL,2
SPINDL/RPM,3000,CLW
COOLNT/FLOOD
RAPID
GOTO/1.0000,2.0000,30.0000,0.6000000,0.0000000,0.8000000
FEDRAT/MMPM,500.0000
GOTO/1.0000,2.0000,3.0000
PAINT/COLOR,37
GOTO/4.0000,2.0000,3.0000,0.0000000,0.0000000,1.0000000
RAPID
GOTO/4.0000,2.0000,30.0000
COOLNT/OFF
SPINDL/OFF
PAINT/TOOL,NOMORE
END-OF-PATH
"""


def test_clsf_as_nx_writes_it() -> None:
    read = read_program(CLSF)
    assert read.findings == ()
    assert read.tool_calls[0].number == 2
    moves = read.moves
    assert moves.point.tolist() == [[1, 2, 30], [1, 2, 3], [4, 2, 3], [4, 2, 30]]
    assert moves.vector == pytest.approx(np.array([[0.6, 0, 0.8]] * 2 + [[0, 0, 1]] * 2))
    assert moves.rapid.tolist() == [True, False, False, True]
    assert moves.feed[1:3].tolist() == [500.0, 500.0]
    assert moves.spindle.tolist() == [3000.0] * 4
    assert moves.coolant.tolist() == [8] * 4


def test_several_operations_in_one_file() -> None:
    read = read_program(CLSF + CLSF.replace("LOAD/TOOL,2", "LOAD/TOOL,3"))
    assert read.findings == ()
    assert [call.number for call in read.tool_calls] == [2, 3]
    assert len(read.moves.block) == 8


@pytest.mark.parametrize(
    ("old", "new", "code"),
    [
        ("MSYS/0.0000", "MSYS/10.0000", "CF102"),
        ("MSYS/0.0000,", "MSYS/", "CF101"),
        ("LOAD/TOOL,2", "LOAD/WIRE,2", "CF101"),
        ("LOAD/TOOL,2", "LOAD/TOOL,2,ZOFF,5.0", "CF102"),
        ("LOAD/TOOL,2", "LOAD/TOOL,2,ADJUST,3", "CF102"),
        ("RPM,3000,CLW", "RPM,3000", "CF114"),
        ("RPM,3000,CLW", "CLW", "CF114"),
        ("RPM,3000,CLW", "SMM,120,CLW", "CF114"),
        ("RPM,3000,CLW", "RPM,0,CLW", "CF114"),
        ("COOLNT/FLOOD", "COOLNT/TAP", "CF121"),
        ("UNITS/MM", "UNITS/FURLONG", "CF101"),
        ("PAINT/COLOR,37", "UNITS/INCHES", "CF109"),
        ("PAINT/COLOR,37", "LINTOL/ON", "CF102"),
        ("PAINT/COLOR,37", "GOHOME", "CF105"),
        ("PAINT/COLOR,37", "CIRCLE/4,2,5,0,0,1,2", "CF102"),
        ("PAINT/COLOR,37", "RAPID\nFEDRAT/100,MMPM", "CF115"),
        ("MMPM,500.0000", "MMPM,0.0000", "CF115"),
        ("MMPM,500.0000", "MMPM,500000.0000", "CF115"),
        ("FEDRAT/MMPM,500.0000\n", "", "CF112"),
        ("GOTO/1.0000,2.0000,3.0000", "GOTO/1.0000,2.0000,3.0e8", "CF109"),
        ("GOTO/1.0000,2.0000,3.0000", "GOTO/1.0000,2.0000,1_000", "CF101"),
        ("END-OF-PATH\n", "", "CF101"),
        ("END-OF-PATH\n", "END-OF-PATH\nGOTO/0,0,0\n", "CF101"),
        ("END-OF-PATH\n", "FINI\nGOTO/0,0,0\nFINI\n", "CF119"),
    ],
)
def test_statements_of_clsf_that_are_not_followed_are_findings(old: str, new: str, code: str) -> None:
    assert old in CLSF
    assert code in {finding.code for finding in read_program(CLSF.replace(old, new, 1)).findings}


def test_another_coordinate_system_makes_poses_unknown() -> None:
    moves = read_program(CLSF.replace("MSYS/0.0000", "MSYS/10.0000")).moves
    assert len(moves.block) == 0


def test_the_spindle_as_it_is_told() -> None:
    stopped = CLSF.replace("PAINT/COLOR,37", "SPINDL/OFF")
    read = read_program(stopped)
    assert read.moves.spindle.tolist() == [3000.0, 3000.0, 0.0, 0.0]
    assert (read.events[0].what, read.events[0].before) == ("SPINDL/OFF", 2)
    turned = read_program(CLSF.replace("PAINT/COLOR,37", "SPINDL/CCLW"))
    assert turned.moves.spindle.tolist() == [3000.0, 3000.0, -3000.0, -3000.0]
    assert [event.before for event in turned.events if "turns round" in event.what] == [2]
    again = read_program(CLSF.replace("PAINT/COLOR,37", "SPINDL/OFF\nSPINDL/ON"))
    assert again.moves.spindle.tolist() == [3000.0] * 4
    for word in ("STOP", "OPSTOP", "DELAY/2"):
        assert 2 in [event.before for event in read_program(CLSF.replace("PAINT/COLOR,37", word)).events]
