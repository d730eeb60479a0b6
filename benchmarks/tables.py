"""Tables of Markdown from the JSON files in benchmarks/results."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

RESULTS = Path(__file__).resolve().parent / "results"


def result(name: str) -> Any:
    """A file of benchmarks/results."""
    return json.loads((RESULTS / name).read_text(encoding="utf-8"))


def markdown(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table; headings that start with "<" are for text, all others for numbers on the right."""
    names = [heading.removeprefix("<") for heading in headings]
    rules = [":--" if heading.startswith("<") else "--:" for heading in headings]
    lines = [names, rules, *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


def fixed(value: float | None, digits: int) -> str:
    """A number, or a dash for what is not known."""
    # Minus nothing is nothing.
    return "–" if value is None else f"{round(value, digits) + 0.0:.{digits}f}"
