"""Places worth a look in what a verification says: its findings, and the extremes of a program without any."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from conflank_cli.verification.result import Place, Triple, Verification


@dataclass(frozen=True, slots=True)
class Spot:
    """Something to go to.

    Attributes
    ----------
    title, text: what is there, in a few words and in a sentence.
    finding: whether it is a finding.
    point: on the part or an obstacle, mm, CAD frame; None where it has no place.
    face: CAD face number, None where it is not known.
    block: block of the program; None where none is near.
    """

    title: str
    text: str
    finding: bool
    point: Triple | None
    face: int | None
    block: int | None


def spots(verification: Verification) -> list[Spot]:
    """The findings in their order, then the extremes."""
    found = [
        Spot(finding.title, finding.text, True, finding.place, None, finding.block) for finding in verification.findings
    ]
    return found + [
        Spot(title, text, False, place.point, place.face if place.face >= 0 else None, place.block)
        for title, text, place in _extremes(verification)
        if place is not None
    ]


def _extremes(verification: Verification) -> Iterator[tuple[str, str, Place | None]]:
    yield "deepest overcut", f"{verification.overcut_max_um:.1f} µm", verification.overcut_max_at
    if verification.stock_max_um is not None:
        yield "most stock left", f"{verification.stock_max_um:.0f} µm", verification.stock_max_at
    for name in ("ball", "cone", "shank", "holder"):
        figures = getattr(verification.clearance_mm, name)
        if figures.least is not None:
            yield f"nearest the {name} comes", f"{figures.least:.3f} mm", figures.at
