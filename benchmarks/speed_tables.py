"""The tables of `benchmarks.speed` from its figures, for the terminal and for docs/speed.md alike."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from benchmarks.growth import fitted_exponent
from benchmarks.tables import markdown, result

Figures = Mapping[str, Any]
Cells = tuple[tuple[str, ...], list[list[str]]]
"""Headings and rows."""

PARTS_OF_JOB = ("start", "read", "detect", "optimize", "select", "post", "verify", "report", "rest")
"""Where a job's time goes: until the command begins and after it has ended, stage by stage, and what is in no stage."""


def rounded(value: float) -> str:
    """Three figures, in thousands or millions where it is large."""
    for limit, unit in ((1e6, " M"), (1e4, " k")):
        if value >= limit:
            value, suffix = value / (1e6 if unit == " M" else 1e3), unit
            break
    else:
        suffix = ""
    digits = 2 if value < 10 else 1 if value < 100 else 0
    return f"{value:.{digits}f}{suffix}"


def stage_rows(figures: Figures) -> Cells:
    """One row for each stage: throughput, scaling, cold start, memory."""
    rows = []
    for name, found in figures["stages"].items():
        units, wall = found["units"], found["wall_s"]
        rows.append(
            [
                name,
                found["unit"],
                rounded(units / found["cpu_s"]["one"]),
                rounded(units / wall["all"]),
                f"{wall['one'] / wall['all']:.2f}",
                f"{1e3 * found['cpu_s']['one']:.0f}",
                f"{1e3 * found['cold_cpu_s']:.0f}",
                f"{found['memory_mb']:.0f}",
                f"{found['load']:.1f}",
            ]
        )
    headings = (
        "stage", "counted in", "a second of one core", "a second on all", "all / one", "core ms warm", "cold", "MB",
        "load",
    )  # fmt: skip
    return headings, rows


def growth_rows(figures: Figures) -> Cells:
    """One row for each stage and what its work grows with: sizes, times, exponent."""
    rows = []
    for name, found in figures["stages"].items():
        for against, grown in found["growth"].items():
            sizes, seconds = grown["sizes"], grown["seconds"]
            rows.append(
                [
                    name,
                    against,
                    f"{rounded(sizes[0])} … {rounded(sizes[-1])}",
                    f"{1e3 * seconds[0]:.3g} … {1e3 * seconds[-1]:.3g}",
                    f"{fitted_exponent(sizes, seconds):.2f}",
                ]
            )
    return ("stage", "grows with", "from … to", "core ms", "exponent"), rows


def method_rows(figures: Figures) -> Cells:
    """One row for each way to find footpoints."""
    methods = figures["peers"]["methods"]
    rows = [
        [
            found["name"],
            rounded(found["per_second"]),
            f"{methods[0]['per_second'] / found['per_second']:.1f}",
            f"{found['error_mm']:.0e}",
        ]
        for found in methods
    ]
    return ("method", "points a second of one core", "conflank warm is times faster", "largest error mm"), rows


def job_rows(figures: Figures) -> Cells:
    """One row for each whole job."""
    rows = []
    for found in figures["jobs"]:
        rows.append(
            [
                found["name"],
                f"{found['wall_s']:.1f}",
                f"{found['cpu_s']:.1f}",
                f"{found['memory_mb']:.0f}",
                *(f"{found['parts_s'].get(part, 0.0):.1f}" for part in PARTS_OF_JOB),
                f"{found['load']:.1f}",
            ]
        )
    return ("job", "wall s", "core s", "MB", *PARTS_OF_JOB, "load"), rows


def asked_rows(figures: Figures) -> Cells:
    """What is asked and what was found."""
    rows = [
        [what, figures["asked"][what], found, "reached" if reached else "missed"]
        for what, (found, reached) in figures["verdicts"].items()
        if figures["asked"][what]
    ]
    return ("figure", "asked", "found", "result"), rows


TABLES: dict[str, Callable[[Figures], Cells]] = {
    "asked": asked_rows,
    "jobs": job_rows,
    "peers": method_rows,
    "stages": stage_rows,
    "growth": growth_rows,
}


def _block(rows: Callable[[Figures], Cells]) -> Callable[[], str]:
    def text() -> str:
        headings, cells = rows(result("speed.json"))
        return markdown([f"<{headings[0]}", *headings[1:]], cells)

    return text


BLOCKS = {f"speed-{name}": _block(rows) for name, rows in TABLES.items()}
