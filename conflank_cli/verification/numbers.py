"""Numbers as a control writes and takes them."""

from __future__ import annotations

NUMBER = r"[+-]?(?:\d+(?:[.,]\d*)?|[.,]\d+)"
"""A number with decimal point or comma, as a regular expression."""

MOST = 99_999.9999
"""Largest coordinate or angle that the control takes."""

MOST_SPINDLE = 99_999.999
"""Largest speed of the spindle that the control takes, 1/min."""

MOST_FEED = 99_999.999
"""Largest feed that the control takes."""

MOST_TOOL = 32_767
"""Largest number of a tool."""

MOST_COMPONENT = 9.99999999
"""Largest component of a vector that the control takes."""


def number(text: str) -> float:
    """A number with decimal point or comma."""
    return float(text.replace(",", "."))
