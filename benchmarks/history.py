"""How figures went from version to version: a line for each in benchmarks/results/history.jsonl, a table, a picture.

``python -m benchmarks.history add`` takes the figures from the JSON files that benchmarks have written into
benchmarks/results; with a revision (``add HEAD~3``) from those files as that commit has them. ``plot`` draws them to
docs/pictures/history.png. What has been added already is not added again: a line stands for a version and a commit, and
a commit whose figures are those of the line before needs none.
"""

from __future__ import annotations

import json
import re
import subprocess
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import click
import msgspec

from benchmarks.tables import RESULTS, fixed, markdown

REPOSITORY = RESULTS.parent.parent
HISTORY = RESULTS / "history.jsonl"
PICTURE = REPOSITORY / "docs" / "pictures" / "history.png"
VERSION = "conflank_cli/__init__.py"
SAMPLE = "BLISK1.H.verification.json"
BENCH = "bench.json"
KINDS = {"covered %": "covered, %", "mean |g| um": "mean |g|, µm", "wall s": "wall time of the job, s"}
"""What the picture shows of the bench, and its titles."""

_NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?")
_VERSION = re.compile(r'__version__ = "([^"]+)"')


class Release(msgspec.Struct, frozen=True):
    """Figures of one commit: by file and what they are of, in the units that their names end in."""

    version: str
    commit: str
    figures: dict[str, float]


def figures_of(results: Mapping[str, Any]) -> dict[str, float]:
    """The figures in results, by name of file."""
    found: dict[str, float] = {}
    for row in results.get(BENCH, {"rows": []})["rows"]:
        name = f"bench: {row['case']} {row['tool']}"
        if row["coverage"] is not None:
            found |= {f"{name}, covered %": round(100.0 * row["coverage"], 2), f"{name}, sweeps": row["sweeps"]}
        if row["gap_mean_abs_um"] is not None:
            found[f"{name}, mean |g| um"] = row["gap_mean_abs_um"]
        found[f"{name}, wall s"] = row["seconds"]
    if SAMPLE in results:
        sample = results[SAMPLE]
        found |= {
            "sample: covered by sweeps %": round(100.0 * sample.get("coverage_flank", sample["coverage"]), 2),
            "sample: sweeps": len(sample["sweeps"]),
            "sample: mean |g| um": sample["gap_um"]["mean_abs"],
            "sample: deepest overcut um": sample["overcut_max_um"],
            "sample: time of the program s": sample["time_s"],
        }
    for file, document in sorted(results.items()):
        for what, verdict in document.get("verdicts", {}).items() if isinstance(document, dict) else ():
            number = _NUMBER.search(str(verdict[0]))
            if number is not None:
                found[f"{file.removesuffix('.json')}: {what}"] = float(number[0])
    return {name: float(value) for name, value in found.items()}


def with_release(history: Sequence[Release], release: Release) -> list[Release]:
    """History with one more line; the line of the same version and commit is replaced.

    Nothing is added that differs from the last line in nothing but the commit.
    """
    same = [k for k, old in enumerate(history) if (old.version, old.commit) == (release.version, release.commit)]
    if same:
        return [release if k == same[0] else old for k, old in enumerate(history)]
    if history and (history[-1].version, history[-1].figures) == (release.version, release.figures):
        return list(history)
    return [*history, release]


def read(file: Path = HISTORY) -> list[Release]:
    """All lines of a history, oldest first; none where there is no file."""
    if not file.exists():
        return []
    return [msgspec.json.decode(line, type=Release) for line in file.read_bytes().splitlines() if line.strip()]


def write(history: Sequence[Release], file: Path = HISTORY) -> None:
    """Write a history, a line for each release."""
    file.write_bytes(b"".join(msgspec.json.encode(release) + b"\n" for release in history))


def markdown_table(history: Sequence[Release] | None = None) -> str:
    """The figures of bench and sample: the first, the last but one, the last."""
    history = read() if history is None else history
    if not history:
        return "Nothing has been added yet.\n"
    shown = list(dict.fromkeys([0, max(len(history) - 2, 0), len(history) - 1]))
    last = history[-1].figures
    names = [name for name in last if name.startswith(("bench: ", "sample: "))]
    rows = [[name.replace("|", "\\|"), *(_cell(history[k].figures.get(name)) for k in shown)] for name in names]
    return markdown(["<figure", *(f"{history[k].version}, {history[k].commit}" for k in shown)], rows)


def _cell(value: float | None) -> str:
    return fixed(value, 0 if value is not None and value == round(value) else 2)


def draw(history: Sequence[Release], file: Path) -> None:
    """The figures of the bench, release by release; its exact envelopes as one line, their mean."""
    from matplotlib.figure import Figure

    from docs.pictures import save

    history = [release for release in history if any(name.startswith("bench: ") for name in release.figures)]
    figure = Figure(figsize=(11.0, 3.6), layout="constrained", dpi=80)
    axes = figure.subplots(1, len(KINDS))
    for ax, (what, title) in zip(axes, KINDS.items(), strict=True):
        lines: dict[str, dict[int, list[float]]] = {}
        for n, release in enumerate(history):
            for name, value in release.figures.items():
                if name.startswith("bench: ") and name.endswith(f", {what}"):
                    case = name.removeprefix("bench: ").split(",")[0]
                    label = "envelopes, mean" if case.startswith("envelope") else case
                    lines.setdefault(label, {}).setdefault(n, []).append(value)
        for k, (label, line) in enumerate(lines.items()):
            means = [sum(values) / len(values) for values in line.values()]
            ax.plot(list(line), means, marker="o", ms=3, lw=1.2, color=f"C{k % 10}", label=label)
        ax.set_title(title, fontsize=10)
        ax.set_xticks(range(len(history)), [release.commit for release in history], rotation=90, fontsize=7)
        ax.grid(alpha=0.3)
    axes[-1].set_ylim(bottom=0.0)
    handles = {label: line for ax in axes for line, label in zip(*ax.get_legend_handles_labels(), strict=True)}
    if handles:
        figure.legend(handles.values(), handles.keys(), loc="outside right center", fontsize=8)
    save(figure, file)


def _git(*words: str) -> str:
    return subprocess.run(["git", *words], cwd=REPOSITORY, check=True, capture_output=True, text=True).stdout


def release_at(revision: str | None) -> Release:
    """The figures of a revision, or of the files as they are, which the last commit then stands for."""
    commit = _git("rev-parse", "--short=7", revision or "HEAD").strip()
    folder = RESULTS.relative_to(REPOSITORY).as_posix()
    read_text: Callable[[str], str]
    if revision is None:
        names = [path.name for path in RESULTS.glob("*.json")]

        def read_text(path: str) -> str:
            return (REPOSITORY / path).read_text(encoding="utf-8")
    else:
        names = [Path(line).name for line in _git("ls-tree", "--name-only", commit, f"{folder}/").splitlines()]

        def read_text(path: str) -> str:
            return _git("show", f"{commit}:{path}")

    version = _VERSION.search(read_text(VERSION))
    if version is None:
        raise click.ClickException(f"{VERSION} of {commit} has no __version__")
    results = {name: json.loads(read_text(f"{folder}/{name}")) for name in sorted(names) if name.endswith(".json")}
    return Release(version[1], commit, figures_of(results))


@click.group()
def main() -> None:
    """Figures from version to version."""


@main.command()
@click.argument("revision", required=False)
def add(revision: str | None) -> None:
    """Add the figures of benchmarks/results, or of what was there at REVISION."""
    history = read()
    longer = with_release(history, release_at(revision))
    write(longer)
    click.echo(f"{len(longer)} releases, {len(longer) - len(history)} more than before")


@main.command()
def plot() -> None:
    """Draw the figures of the bench."""
    draw(read(), PICTURE)


if __name__ == "__main__":
    main()
