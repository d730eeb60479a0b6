"""The record of figures takes what benchmarks write, and each release once."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks import history
from benchmarks.history import Release, figures_of, markdown_table, read, with_release, write
from benchmarks.tables import result

RESULTS = {
    "bench.json": {
        "rows": [
            {"case": "rotor", "tool": "T1", "coverage": 0.931234, "sweeps": 3, "gap_mean_abs_um": 1.7, "seconds": 12.5},
            {"case": "broken", "tool": "T1", "coverage": None, "sweeps": None, "gap_mean_abs_um": None, "seconds": 2.0},
        ]
    },
    "other.json": {
        "verdicts": {"poses a second": ["2479", True], "faces": ["all", True], "lift, um": ["-0.36", False]}
    },
}


def test_figures_come_from_benches_and_from_verdicts() -> None:
    assert figures_of(RESULTS) == {
        "bench: rotor T1, covered %": 93.12,
        "bench: rotor T1, sweeps": 3.0,
        "bench: rotor T1, mean |g| um": 1.7,
        "bench: rotor T1, wall s": 12.5,
        "bench: broken T1, wall s": 2.0,
        "other: poses a second": 2479.0,
        "other: lift, um": -0.36,
    }


def test_the_committed_results_have_figures() -> None:
    found = figures_of({name: result(name) for name in ("bench.json", history.SAMPLE, "optimization.json")})
    assert found["sample: covered by sweeps %"] == pytest.approx(
        100.0 * result(history.SAMPLE)["coverage_flank"], abs=0.01
    )
    assert any(name.startswith("optimization: ") for name in found)


def test_a_release_is_added_once_and_replaced_by_its_own() -> None:
    first = Release("1.0", "aaa", {"x": 1.0})
    assert with_release([], first) == [first]
    assert with_release([first], first) == [first]
    again = Release("1.0", "aaa", {"x": 2.0})
    assert with_release([first], again) == [again]
    # Another commit with the same figures says nothing new; another version does.
    assert with_release([first], Release("1.0", "bbb", {"x": 1.0})) == [first]
    assert len(with_release([first], Release("1.1", "bbb", {"x": 1.0}))) == 2
    assert len(with_release([first], Release("1.0", "bbb", {"x": 3.0}))) == 2


def test_a_history_is_read_as_it_was_written(tmp_path: Path) -> None:
    lines = [Release("1.0", "aaa", {"sample: x um": 1.25}), Release("1.1", "bbb", {"sample: x um": 1.0})]
    assert read(tmp_path / "none.jsonl") == []
    write(lines, tmp_path / "history.jsonl")
    assert read(tmp_path / "history.jsonl") == lines
    assert "| sample: x um | 1.25 | 1 |" in markdown_table(lines)


def test_the_picture_is_drawn_for_one_release_and_for_many(tmp_path: Path) -> None:
    for count in (1, 3):
        lines = [Release("1.0", str(k), figures_of(RESULTS)) for k in range(count)]
        history.draw(lines, tmp_path / "history.png")
        assert (tmp_path / "history.png").read_bytes()[:4] == b"\x89PNG"
