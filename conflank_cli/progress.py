"""Progress of the stages: a bar each on a terminal, nothing where nobody watches."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    import rich.progress


class Stage(Protocol):
    """A stage that is under way."""

    def advance(self, n: int = 1) -> None:
        """Count `n` more of the total as done."""


class Progress(Protocol):
    """Who is told how far the stages are."""

    def stage(self, title: str, total: int) -> AbstractContextManager[Stage]:
        """Open a stage of `total` steps (one: nobody knows how far it is); leaving the context closes it."""


class _SilentStage:
    def advance(self, n: int = 1) -> None:
        pass


class SilentProgress:
    """Tells nobody."""

    @contextmanager
    def stage(self, title: str, total: int) -> Iterator[Stage]:
        """Open a stage that shows nothing."""
        yield _SilentStage()


class _BarStage:
    def __init__(self, bars: rich.progress.Progress, task: rich.progress.TaskID) -> None:
        self._bars = bars
        self._task = task

    def advance(self, n: int = 1) -> None:
        self._bars.advance(self._task, n)


class BarProgress:
    """One bar per stage on stderr; a stage may be opened inside another."""

    def __init__(self) -> None:
        self._bars: rich.progress.Progress | None = None

    @contextmanager
    def stage(self, title: str, total: int) -> Iterator[Stage]:
        """Open a stage with a bar of its own."""
        outermost = self._bars is None
        bars = self._bars = self._bars or _make_bars()
        if outermost:
            bars.start()
        # A stage of one step would stand at nothing and then be done: its bar runs to and fro instead.
        task = bars.add_task(title, total=total if total > 1 else None)
        try:
            yield _BarStage(bars, task)
            # A stage that stopped early because it was done is done.
            bars.update(task, total=max(total, 1), completed=max(total, 1))
        finally:
            bars.stop_task(task)
            if outermost:
                bars.stop()
                self._bars = None


def _make_bars() -> rich.progress.Progress:
    # rich costs a tenth of a second to import, and help needs no bars.
    from rich.console import Console
    from rich.progress import BarColumn, Progress, ProgressColumn, Task, TextColumn
    from rich.text import Text

    class Steps(ProgressColumn):
        """Steps that are done of all, where it is known how many there are."""

        def render(self, task: Task) -> Text:
            total = round(task.total or 0)
            done = f"{round(task.completed):>{len(str(total))}}/{total}" if total > 1 else ""
            return Text(done, style="progress.download")

    class Times(ProgressColumn):
        """Time that has gone; before the end also the time left, once there is a rate to tell it from."""

        def render(self, task: Task) -> Text:
            left = None if task.finished or not task.total else task.time_remaining
            gone = _clock((task.finished_time if task.finished else task.elapsed) or 0.0)
            return Text(gone if left is None else f"{gone}, {_clock(left)} left", style="progress.remaining")

    columns = (TextColumn("{task.description:<28}"), BarColumn(), Steps(), Times())
    return Progress(*columns, console=Console(stderr=True))


def _clock(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes}:{rest:02}"


def make_progress(quiet: bool) -> Progress:
    """Bars where stderr is a terminal and not `quiet`, silence otherwise."""
    if quiet or not sys.stderr.isatty():
        return SilentProgress()
    return BarProgress()
