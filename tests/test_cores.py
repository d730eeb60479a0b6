"""Work spread over cores."""

from __future__ import annotations

import threading

import pytest
from hypothesis import given
from hypothesis import strategies as st

from conflank_cli import cores


@given(st.integers(0, 500), st.integers(1, 70))
def test_every_number_comes_once(count: int, least: int) -> None:
    parts: list[slice] = []
    cores.spread(parts.append, count, least)
    numbers = [k for part in parts for k in range(part.start, part.stop)]
    assert sorted(numbers) == list(range(count))
    assert sum(part.stop - part.start < least for part in parts) <= 1


def test_work_is_done_side_by_side(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cores, "cores", lambda: 2)
    both = threading.Barrier(2, timeout=10.0)
    cores.spread(lambda part: (both.wait(), None)[1], 2)


def test_little_work_stays_in_the_caller() -> None:
    seen: list[threading.Thread] = []
    cores.spread(lambda part: seen.append(threading.current_thread()), 5, least=5)
    assert seen == [threading.current_thread()]


def test_errors_are_raised(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(part: slice) -> None:
        raise ValueError(f"at {part.start}")

    monkeypatch.setattr(cores, "cores", lambda: 2)
    with pytest.raises(ValueError, match="at 0"):
        cores.spread(fail, 10)


@pytest.mark.parametrize("workers", [1, 3])
def test_tasks_beside_each_other_answer_in_their_order(monkeypatch: pytest.MonkeyPatch, workers: int) -> None:
    monkeypatch.setattr(cores, "cores", lambda: workers)
    assert cores.beside([lambda k=k: k * k for k in range(9)]) == [k * k for k in range(9)]
    with pytest.raises(ZeroDivisionError):
        cores.beside([lambda: 1, lambda: 1 // 0])
