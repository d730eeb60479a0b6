"""The tables of docs/paper.md say what the results say."""

from __future__ import annotations

from typing import Any

import pytest

from benchmarks import paper_tables


def strips(*coverages: float) -> list[dict[str, Any]]:
    return [
        {"sweeps": count, "coverage": reached, "overcut_um": 3.0, "stock_um": 40.0, "cutting_seconds": 2.0 * count}
        for count, reached in zip((1, 2, 4, 20), coverages, strict=True)
    ]


SWEEP = {
    "share": 0.4,
    "epsilon_um": {"mean_abs": 1.0, "mean": -0.5, "min": -4.0, "max": 5.0},
    "gap_um": {"mean_abs": 2.0, "mean": 0.5, "min": -6.0, "max": 9.0},
    "rulings_epsilon_um": {"mean_abs": 50.0},
    "seconds": 3.0,
}
FACE = {
    "face": "impeller, suction",
    "tools": {"T1": {"coverage": [0.5, 0.8, 0.92], "cutting_seconds": [2.0, 3.0, 4.0], "largest": [SWEEP, SWEEP]}},
    "cylinder": {"coverage": [0.4, 0.6]},
    "together": {"coverage": [0.6, 0.91], "best": 0.89, "reachable": 0.953, "tools": ["T3", "T1"]},
    "methods": {"following the rulings": strips(0.1, 0.2, 0.3, 0.95), "two points": strips(0.2, 0.7, 0.6, 0.5)},
    "ball": {"cutting_seconds": 300.0, "coverage": 0.991},
}
DOCUMENT = {"verdicts": {"covered": ["91", True], "mean": ["3", False]}, "left_out": ["rotor.step"], "faces": [FACE]}


@pytest.fixture(autouse=True)
def _results(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(paper_tables, "result", lambda _: DOCUMENT)


def row(table: str) -> list[str]:
    return [cell.strip() for cell in table.splitlines()[2].strip("|").split("|")]


def test_sweeps_are_counted_and_their_errors_joined() -> None:
    assert row(paper_tables.sweeps_table()) == [
        "impeller, suction", "T1", "92.0", "92.0", "3", "1.00", "-0.50", "-4.0 … 5.0", "2.00", "+0.50", "-6.0 … 9.0",
        "3.0", "50",
    ]  # fmt: skip
    assert row(paper_tables.together_table())[-4:] == ["89.0", "95.3", "2", "1 T1, 1 T3"]
    assert row(paper_tables.impeller_table())[2:5] == ["1", "40.0", "1.00"]


def test_a_method_that_gets_there_has_its_time_and_another_its_best_coverage() -> None:
    cells = row(paper_tables.methods_table())
    assert cells[1:] == ["92.0", "3: 9 s", "20: 40 s", "not with 20: 70.0 %", "60.0 %", "300 s, 99.1 %"]
    assert row(paper_tables.rulings_table())[1] == "10.0 (3 / 40)"


def test_what_is_missed_or_left_out_is_said() -> None:
    assert paper_tables.verdict_table().splitlines()[-1] == "| mean | 3 | missed |"
    assert "rotor.step" in paper_tables.left_out()
