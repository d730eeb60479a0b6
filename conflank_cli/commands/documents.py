"""What --json prints: one JSON object with what a command found, and nothing else on standard output."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import click
import msgspec

from conflank_cli.errors import UsageError
from conflank_cli.output import STANDARD

if TYPE_CHECKING:
    from conflank_cli.posting.summary import PostSummary
    from conflank_cli.scene import Scene
    from conflank_cli.sweep import Sweep


def print_document(content: Mapping[str, Any]) -> None:
    """Print a document, indented and in UTF-8 on any terminal, as the last thing that a command does."""
    click.echo(msgspec.json.format(msgspec.json.encode(content)))


def refuse_both(as_json: bool, output: str, what: str) -> None:
    """Refuse --json where the result itself goes to standard output.

    Raises
    ------
    UsageError: both would be there.
    """
    if as_json and output == STANDARD:
        raise UsageError("--json", f"{what} on standard output too", "one of them there", "Name a file with -o.")


def of_stage(scene: Scene, sweeps: Sequence[Sweep], summary: Mapping[str, Any], files: Sequence[str]) -> dict[str, Any]:
    """What detect, optimize or select found: its summary, and what is known of each sweep."""
    entries = [
        {"face": scene.faces[sweep.face].number, "tool": sweep.tool, "facts": dict(sweep.facts)} for sweep in sweeps
    ]
    return {"files": list(files), "units": {"length": "mm"}, "summary": dict(summary), "sweeps": entries}


def of_posting(summary: PostSummary) -> dict[str, Any]:
    """What is known of a program before it runs."""
    travel = summary.travel
    return {
        "machine": summary.machine.name,
        "machine_verified": summary.machine.verified,
        "time_s": summary.seconds,
        "posting_um": 1e3 * summary.posting_mm,
        "control_um": 1e3 * summary.control_mm,
        "travel_margin_mm": float(travel.margin),
        "travel_known": travel.complete,
        "cuts": [
            {
                "cut": cut.cut,
                "tool": cut.tool,
                "blocks": cut.blocks,
                "length_mm": cut.length_mm,
                "time_s": cut.seconds,
                "time_with_links_s": cut.with_links,
            }
            for cut in summary.cuts
        ],
    }
