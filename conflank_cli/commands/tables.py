"""Tables for people: plain text from rich, as wide as the terminal or as their content."""

from __future__ import annotations

import io
import shutil
import sys
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

from rich.box import SIMPLE_HEAD
from rich.console import Console, JustifyMethod
from rich.table import Table

from conflank_cli.verification.result import CutFigures, FileHash, Place, Verification

if TYPE_CHECKING:
    from conflank_cli.posting.summary import PostSummary
    from conflank_cli.scene import Scene
    from conflank_cli.sweep import Sweep

# Where nobody looks at a terminal a table may be as wide as it likes.
_WIDE = 1000

# Digits of a hash that are shown: enough to tell files apart; --json and the verification have all.
DIGITS = 12
# The region of a design face that is judged whole.
WHOLE = (0.0, 1.0, 0.0, 1.0)

# Characters between two columns, and on both sides of all.
_BETWEEN, _EDGES = 3, 2


def text_table(columns: Sequence[str], rows: Sequence[Sequence[object]], title: str = "") -> str:
    """Rows under headings, as text; a heading that starts with "<" is for text, all others for numbers on the right.

    Where the terminal is too narrow for all columns, those that are left follow as a table of their own with the first
    column again: a figure that is cut short would be a wrong one.
    """
    cells = [[cell_text(cell) for cell in row] for row in rows]
    width = shutil.get_terminal_size().columns if sys.stderr.isatty() or sys.stdout.isatty() else _WIDE
    stacks = [[column.removeprefix("<"), *(row[k] for row in cells)] for k, column in enumerate(columns)]
    full = [max(map(len, stack)) for stack in stacks]
    # Words of headings and texts may stand one below the other, figures not.
    least = [
        max(
            len(word)
            for n, cell in enumerate(stack)
            for word in (cell.split() if n == 0 or is_text else [cell]) or [""]
        )
        for stack, is_text in zip(stacks, (column.startswith("<") for column in columns), strict=True)
    ]
    parts = []
    for group in _groups(least, width):
        table = Table(box=SIMPLE_HEAD, title=title or None, title_justify="left", title_style="", pad_edge=False)
        spare = width - _width(least[k] for k in group)
        for k in group:
            more = max(min(full[k] - least[k], spare), 0)
            spare -= more
            justify: JustifyMethod = "left" if columns[k].startswith("<") else "right"
            table.add_column(stacks[k][0], justify=justify, width=least[k] + more)
        for row in cells:
            table.add_row(*(row[k] for k in group))
        buffer = io.StringIO()
        # Markup off: a face called "[/b]" is a name, not a command.
        Console(file=buffer, width=width, markup=False, emoji=False, highlight=False).print(table)
        parts.append("".join(f"{line.rstrip()}\n" for line in buffer.getvalue().splitlines() if line.strip()))
    return "\n".join(parts)


def _width(columns: Iterable[int]) -> int:
    """Width of a table of columns of these widths."""
    return sum(each + _BETWEEN for each in columns) - _BETWEEN + _EDGES


def _groups(least: Sequence[int], width: int) -> list[list[int]]:
    """Numbers of the columns of each table that fits; the first column leads them all."""
    groups = [[0]]
    for k in range(1, len(least)):
        if len(groups[-1]) > 1 and _width(least[each] for each in (*groups[-1], k)) > width:
            groups.append([0])
        groups[-1].append(k)
    return groups


def cell_text(value: object) -> str:
    """A value as a cell: at most two decimals, and a dash for what is not known."""
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.2f}"
    if isinstance(value, list | tuple):
        return " ".join(cell_text(item) for item in value)
    return str(value)


def stage_table(scene: Scene, sweeps: Sequence[Sweep]) -> str:
    """How many sweeps a stage has for each face and tool, the area of the largest, and how well they fit."""
    groups: dict[tuple[int, str], list[Sweep]] = {}
    for sweep in sweeps:
        groups.setdefault((scene.faces[sweep.face].number, sweep.tool), []).append(sweep)

    def known(group: list[Sweep], fact: str) -> list[float]:
        return [sweep.facts[fact] for sweep in group if fact in sweep.facts]

    rows = [
        (
            number,
            tool,
            len(group),
            max(known(group, "area_mm2"), default=None),
            min(known(group, "axis_error_mean_um"), default=None),
            max(known(group, "axis_error_mean_um"), default=None),
        )
        for (number, tool), group in groups.items()
    ]
    columns = ["face", "<tool", "sweeps", "largest mm²", "mean axis error µm, least", "most"]
    return text_table(columns, rows).rstrip("\n")


def judgement(verification: Verification) -> str:
    """What a program cuts, as a table of its cuts and a few lines below it."""
    columns = ["cut", "<tool", "length mm", "covered mm²", "gap min µm", "mean µm", "max µm", "time s"]
    rows = [_cut_row("sweep", cut) for cut in verification.sweeps] + [
        _cut_row("pass", cut) for cut in verification.passes
    ]
    stock = verification.stock_max_um
    mean = verification.gap_um.mean_abs
    lines = [
        ("coverage", f"{100.0 * verification.coverage:.2f} %{_by_sweeps(verification)}"),
        ("gap", "-" if mean is None else f"{mean:.2f} µm in the mean over the covered area"),
        ("overcut", f"{verification.overcut_max_um:.2f} µm at most{_where(verification.overcut_max_at)}"),
        ("stock", "-" if stock is None else f"{stock:.2f} µm at most{_where(verification.stock_max_at)}"),
        ("time", f"{verification.time_s / 60.0:.1f} min{_by_kind(verification)}"),
        ("control", _control(verification.control_tolerance_um)),
        ("unknown", unknown_moves(verification)),
        *judged_against(verification),
        ("findings", str(len(verification.findings)) if verification.findings else "none"),
    ]
    text = text_table(columns, rows) if rows else ""
    text += "\n" + "".join(f"{name:<13} {value}\n" for name, value in lines)
    text += "".join(f"  {finding.title}: {finding.text}\n" for finding in verification.findings)
    return text.rstrip("\n")


def unknown_moves(verification: Verification) -> str:
    """How many moves of a program are not known."""
    count = verification.unknown_moves
    if count == 0:
        return "no move"
    return f"{count:,} {'move' if count == 1 else 'moves'} whose way is neither followed nor proven to be free"


def judged_against(verification: Verification) -> list[tuple[str, str]]:
    """What a program was judged against, each with its name: files with the first digits of their hashes, limits."""
    against = verification.against
    limits, placement = against.limits, against.placement
    obstacles = "".join(f", obstacle {_hashed(each)}" for each in against.obstacles)
    datum = placement.datum
    preset = f"preset {datum}" if isinstance(datum, int) else "datum shifted by {:g} {:g} {:g}".format(*datum)
    copies = ""
    if placement.copies_count > 1:
        numbers = " ".join(map(str, placement.copies))
        copies = f", copies {numbers} of {placement.copies_count}"
    faces = ", ".join(
        f"face {each.face}" + ("" if each.region == WHOLE else " region {:g} {:g} {:g} {:g}".format(*each.region))
        for each in against.regions
    )
    return [
        ("part", f"{_hashed(against.part)}{obstacles}"),
        ("faces", f"{faces}{copies}"),
        (
            "limits",
            f"overcut {1e3 * limits.overcut_mm:g}, undercut {1e3 * limits.undercut_mm:g} µm, allowance "
            f"{limits.allowance_mm:g} mm, coverage {100.0 * limits.coverage:g} %, to obstacles {limits.cutter_mm:g} "
            f"{limits.shank_mm:g} {limits.holder_mm:g} mm",
        ),
        (
            "job",
            f"sha256 {against.job_sha256[:DIGITS]}, machine {_hashed(against.machine)}, {preset}; judged by conflank "
            f"{against.program_version}",
        ),
    ]


def _hashed(each: FileHash) -> str:
    return f"{each.name} (sha256 {'not known' if each.sha256 is None else each.sha256[:DIGITS]})"


def prediction(summary: PostSummary) -> str:
    """What a program will do on its machine, cut by cut."""
    columns = ["cut", "<tool", "blocks", "length mm", "time s", "with links s"]
    rows = [(cut.cut, cut.tool, cut.blocks, cut.length_mm, cut.seconds, cut.with_links) for cut in summary.cuts]
    return text_table(columns, rows) + "\n" + facts_of(summary)


def facts_of(summary: PostSummary) -> str:
    """What a program will do on its machine as a whole."""
    return "\n".join(f"{name:<13} {text}" for name, text in summary.lines())


def _control(tolerance_um: float | None) -> str:
    if tolerance_um is None:
        return "may deviate by an unknown amount: the program sets no tolerance"
    return f"may deviate by {tolerance_um:.1f} µm more (T + h TA of cycle 32)"


def _by_sweeps(verification: Verification) -> str:
    return f", {100.0 * verification.coverage_flank:.2f} % without the passes" if verification.passes else ""


def _by_kind(verification: Verification) -> str:
    """How long sweeps and passes cut, where there are passes; the rest of the time is on the way to them."""
    if not verification.passes:
        return ""
    minutes = [sum(cut.time_s for cut in cuts) / 60.0 for cuts in (verification.sweeps, verification.passes)]
    return ", sweeps {:.1f} and passes {:.1f} min of it".format(*minutes)


def _where(place: Place | None) -> str:
    if place is None:
        return ""
    face = f"face {place.face}" if place.face >= 0 else "an obstacle"
    program = "" if place.program is None else f" of {place.program}"
    return f", {face}" + ("" if place.block is None else f", block {place.block}{program}")


def _cut_row(kind: str, cut: CutFigures) -> tuple[object, ...]:
    gaps = (cut.gap_min_um, cut.gap_mean_abs_um, cut.gap_max_um)
    return (f"{kind} {cut.number}", cut.tool, cut.length_mm, cut.covered_mm2, *gaps, cut.time_s)
