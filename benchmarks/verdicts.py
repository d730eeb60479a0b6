"""What the benchmarks that ask for figures share: requirements, tables, and going through the parts of one."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from rich.console import Console
from rich.table import Table

from benchmarks.run import TABLE_WIDTH


@dataclass(frozen=True, slots=True)
class Verdict:
    """One requirement: what was asked (empty: nothing, for comparison), what came out, whether it is reached."""

    what: str
    asked: str
    found: str
    reached: bool


Part = Callable[[], tuple[list[Verdict], dict[str, Any]]]
"""A part of a benchmark: it prints its tables, and returns what was asked and the figures to keep."""


def table(title: str, *headings: str) -> Table:
    """A table whose first column, and one of explanations, is text and the others figures."""
    made = Table(title=title)
    for k, heading in enumerate(headings):
        made.add_column(heading, justify="left" if k == 0 or heading == "explanation" else "right", no_wrap=True)
    return made


def table_console() -> Console:
    """A console that is wide enough for the tables in a log file too."""
    console = Console()
    return console if console.is_terminal else Console(width=TABLE_WIDTH)


def measured(
    console: Console, title: str, parts: Mapping[str, Part], only: str | None
) -> tuple[list[Verdict], dict[str, Any]]:
    """Go through the parts, or only one, and print what was asked; returns that and the figures by part."""
    verdicts: list[Verdict] = []
    figures: dict[str, Any] = {}
    for name, part in parts.items():
        if only in (None, name):
            start = time.perf_counter()
            asked, figures[name] = part()
            verdicts += asked
            console.print(f"{name}: {time.perf_counter() - start:.0f} s")
    printed = table(title, "figure", "asked", "found", "result")
    for verdict in verdicts:
        printed.add_row(
            verdict.what, verdict.asked, verdict.found, ("pass" if verdict.reached else "MISS") if verdict.asked else ""
        )
    console.print(printed)
    return verdicts, figures


def kept(verdicts: Sequence[Verdict]) -> dict[str, list[Any]]:
    """Verdicts as they are kept in JSON."""
    return {verdict.what: [verdict.found, verdict.reached] for verdict in verdicts}
