"""Bars as a terminal shows them."""

import io
import time

import pytest
from rich.console import Console

from conflank_cli.progress import BarProgress, SilentProgress, make_progress


def test_bars_tell_how_far_they_are_and_the_time_left(monkeypatch: pytest.MonkeyPatch) -> None:
    """Steps of equal length: after three of four a third of the time that has gone is left."""
    shown = io.StringIO()
    now = [100.0]
    terminal = Console(file=shown, force_terminal=True, width=100, get_time=lambda: now[0])
    monkeypatch.setattr("rich.console.Console", lambda **options: terminal)
    with BarProgress().stage("optimize", 4) as stage:
        for _ in range(3):
            now[0] += 30.0
            stage.advance()
        # Bars are drawn ten times a second.
        time.sleep(0.3)
    text = shown.getvalue()
    assert "optimize" in text and "3/4" in text and "4/4" in text
    assert "1:30, 0:30 left" in text
    # At the end nothing is left to wait for.
    assert "left" not in text.rsplit("4/4", 1)[1]


def test_a_stage_of_one_step_runs_to_and_fro(monkeypatch: pytest.MonkeyPatch) -> None:
    shown = io.StringIO()
    terminal = Console(file=shown, force_terminal=True, width=100)
    monkeypatch.setattr("rich.console.Console", lambda **options: terminal)
    with BarProgress().stage("verify", 1):
        time.sleep(0.15)
    assert "verify" in shown.getvalue() and "/" not in shown.getvalue()


def test_nobody_who_does_not_watch_gets_bars() -> None:
    assert isinstance(make_progress(quiet=True), SilentProgress)
    with make_progress(quiet=True).stage("detect", 3) as stage:
        stage.advance()
