"""Edits of posted programs: how many the verification finds, by kind, style and machine.

Run with ``python -m benchmarks.edits``, one part of it with ``--only posted``, ``list``, ``lines`` or ``numbers``. The
programs are those of a small block (tests/verification/posted.py): every style for every shipped machine as posted, the
list of single edits (tests/verification/edits.py), then each line left out, doubled and moved, and numbers changed.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterable
from functools import partial
from typing import Any

import click
from rich.console import Console

from benchmarks.verdicts import Verdict, measured, table, table_console
from conflank_cli.verification.judge import verify_program
from conflank_cli.verification.posed import pose_program
from tests.verification.edits import (
    EDITS,
    Edit,
    alike,
    found,
    line_edits,
    number_edits,
    only_moved,
    other_poses,
    same_reading,
    trace,
)
from tests.verification.posted import MACHINES, POINTS, STYLES, Posted, posted

EVERY = 40
"""Numbers of every so many lines are changed."""
KINDS = tuple(dict.fromkeys((kind, style) for kind, style, _ in STYLES))


def as_posted(console: Console) -> tuple[list[Verdict], dict[str, Any]]:
    """Every style for every machine, unedited."""
    shown = table("as posted", "machine", "format", "style", "split", "blocks", "findings", "unknown moves")
    rows = []
    for machine in MACHINES:
        for kind, style, split in STYLES:
            program = posted(kind, style, split, machine)
            result = verify_program(program.text, program.scene, "", POINTS, program.called)
            blocks = sum(text.count("\n") for text in (program.text, *program.parts.values()))
            values = (machine, kind, style, split, blocks, len(result.findings), result.unknown_moves)
            shown.add_row(*map(str, values))
            rows.append(values)
    console.print(shown)
    wrong = sum(bool(row[5]) for row in rows)
    return [Verdict("posted programs with a finding", "0", str(wrong), wrong == 0)], {"rows": rows}


def single(console: Console) -> tuple[list[Verdict], dict[str, Any]]:
    """The list of single edits."""
    asked: Counter[tuple[str, str]] = Counter()
    answered: Counter[tuple[str, str]] = Counter()
    missed: list[str] = []
    for edit in EDITS:
        program = posted(edit.kind, edit.style)
        text = edit.text(program)
        same = edit.expect != "finding" and same_reading(program, pose_program(text, program.scene, program.called))
        codes = [] if same else found(program, text)
        asked[edit.kind, edit.expect] += 1
        right = edit.expect == "either" or bool(codes) == (edit.expect == "finding")
        answered[edit.kind, edit.expect] += right
        if not right:
            missed.append(f"{edit.kind} {edit.name}: {', '.join(codes) or 'no finding'}")
    shown = table("single edits", "format", "expected", "edits", "as expected")
    for key, count in sorted(asked.items()):
        shown.add_row(*key, str(count), str(answered[key]))
    console.print(shown)
    for line in missed:
        console.print(f"  {line}")
    total = sum(count for (_, expect), count in asked.items() if expect == "finding")
    caught = sum(count for (_, expect), count in answered.items() if expect == "finding")
    harmless = sum(asked[key] - answered[key] for key in asked if key[1] == "none")
    return [
        Verdict("dangerous edits found", f"{total}", f"{caught}", caught == total),
        Verdict("harmless edits with a finding", "0", f"{harmless}", harmless == 0),
    ], {"missed": missed}


def _mutants(program: Posted, kind: str, edits: Iterable[Edit]) -> tuple[Counter[str], list[str]]:
    """How mutants are answered: found, the same for the machine, other motion that is judged, or missed by name."""
    answers: Counter[str] = Counter()
    missed: list[str] = []
    own = trace(program.text, kind)
    for edit in edits:
        text = edit.text(program)
        other = trace(text, kind)
        if alike(own, other):
            answers["same"] += 1
        elif found(program, text):
            answers["found"] += 1
        elif only_moved(own, other) and other_poses(program, pose_program(text, program.scene, program.called)):
            answers["judged"] += 1
        else:
            missed.append(edit.name)
    return answers, missed


def systematic(console: Console, what: str) -> tuple[list[Verdict], dict[str, Any]]:
    """Lines or numbers of every style, for a machine with tables and one with heads."""
    shown = table(f"{what} changed", "machine", "format", "style", "mutants", "found", "same", "judged", "missed", "s")
    rows = []
    names: list[str] = []
    for machine in ("ac-table", "head-head"):
        for kind, style in KINDS:
            start = time.perf_counter()
            program = posted(kind, style, "none", machine)
            made = (
                line_edits(program, kind, style, poses=True)
                if what == "lines"
                else number_edits(program, kind, style, every=EVERY)
            )
            answers, missed = _mutants(program, kind, made)
            names += [f"{machine} {kind} {style}: {name}" for name in missed]
            counts = [answers[key] for key in ("found", "same", "judged")]
            seconds = round(time.perf_counter() - start)
            row = (machine, kind, style, sum(counts) + len(missed), *counts, len(missed), seconds)
            shown.add_row(*map(str, row))
            rows.append(row)
    console.print(shown)
    for name in names:
        console.print(f"  {name}")
    return [Verdict(f"mutants of {what} missed", "0", str(len(names)), not names)], {"rows": rows, "missed": names}


@click.command()
@click.option("--only", type=click.Choice(["posted", "list", "lines", "numbers"]), help="One part alone.")
def main(only: str | None) -> None:
    """Print how edits of posted programs are answered."""
    console = table_console()
    parts = {
        "posted": partial(as_posted, console),
        "list": partial(single, console),
        "lines": partial(systematic, console, "lines"),
        "numbers": partial(systematic, console, "numbers"),
    }
    verdicts, _ = measured(console, "edits of posted programs", parts, only)
    if not all(verdict.reached for verdict in verdicts):
        raise SystemExit(1)


if __name__ == "__main__":
    main()
