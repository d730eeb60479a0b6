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
