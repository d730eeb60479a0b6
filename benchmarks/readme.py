"""Tables of README and docs from results: `python -m benchmarks.readme` (make samples).

A block between ``<!-- figures:NAME -->`` and ``<!-- /figures:NAME -->`` is rewritten from the JSON files in
benchmarks/results, which the commands that measured wrote there. Nothing here measures, and nothing in the blocks
depends on the day or the machine but the times of the bench, which say so.
"""

from __future__ import annotations

import importlib
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from benchmarks import history, paper_tables, speed_tables
from benchmarks.tables import RESULTS, fixed, markdown, result

REPOSITORY = Path(__file__).resolve().parent.parent
FILES = ("README.md", "docs/method.md", "docs/tour.md", "docs/paper.md", "docs/history.md", "docs/speed.md")
SAMPLE = "BLISK1.H.verification.json"

_BLOCK = re.compile(r"<!-- figures:(?P<name>[\w-]+) -->\n(?P<body>.*?)<!-- /figures:(?P=name) -->", re.DOTALL)


# --- blocks ---------------------------------------------------------------------------------------------------------


def sample_table() -> str:
    """What the program of the sample blade cuts, by sweep and in all."""
    found = result(SAMPLE)
    sweeps = [
        [
            str(cut["number"]),
            cut["tool"],
            fixed(cut["length_mm"], 1),
            fixed(cut["covered_mm2"], 0),
            fixed(cut["gap_min_um"], 1),
            fixed(cut["gap_mean_abs_um"], 2),
            fixed(cut["gap_max_um"], 1),
            fixed(cut["time_s"], 1),
        ]
        for cut in found["sweeps"]
    ]
    headings = ["sweep", "<tool", "length mm", "covers mm²", "gap min µm", "mean abs µm", "max µm", "time s"]
    clearance = found["clearance_mm"]
    passes = found["passes"]
    sweep_time, pass_time = (sum(cut["time_s"] for cut in found[kind]) for kind in ("sweeps", "passes"))
    covered = f"{100.0 * found['coverage_flank']:.1f} %"
    if passes:
        covered += f" by the sweeps, {100.0 * found['coverage']:.1f} % with {len(passes)} passes of the ball"
    facts = [
        ["covered, by area", covered],
        ["mean of the absolute gap there", f"{fixed(found['gap_um']['mean_abs'], 2)} µm"],
        ["99 % of it below", f"{fixed(found['gap_um']['p99_abs'], 1)} µm"],
        ["deepest overcut, faces next to the flanks included", f"{fixed(found['overcut_max_um'], 1)} µm"],
        ["largest step between neighbouring cuts", f"{fixed(found['step_max_um'], 1)} µm"],
        ["least clearance of shank, holder", " mm, ".join(_least(clearance[k]) for k in ("shank", "holder")) + " mm"],
        ["time of sweeps, of passes", f"{sweep_time:.0f} s, {pass_time:.0f} s"],
        ["with all positioning", f"{fixed(found['time_s'], 0)} s"],
        ["findings", str(len(found["findings"])) if found["findings"] else "none"],
    ]
    return markdown(headings, sweeps) + "\n" + markdown(["<the whole program", "<"], facts)


def _least(figures: dict[str, Any]) -> str:
    return fixed(figures["least"], 2)


def bench_table() -> str:
    """The rows of `make bench`."""
    bench = result("bench.json")
    rows = [
        [
            row["case"],
            row["tool"],
            "–" if row["coverage"] is None else f"{100.0 * row['coverage']:.1f}",
            f"{100.0 * row['coverage_required']:.0f}",
            "–" if row["sweeps"] is None else str(row["sweeps"]),
            fixed(row["overcut_max_um"], 1),
            fixed(row["gap_mean_abs_um"], 2),
            f"{row['gap_mean_abs_required_um']:g}",
            f"{row['seconds']:.0f}",
            row["result"],
        ]
        for row in bench["rows"]
    ]
    headings = [
        "<case",
        "<tool",
        "covered %",
        "asked %",
        "sweeps",
        "overcut µm",
        "mean abs gap µm",
        "asked µm",
        "wall s",
        "<result",
    ]
    note = (
        f"Wall time of the whole job in a process of its own, on {bench['cores']} cores, {bench['jobs']} at a time; "
        f"the machine's load by other work was {bench['load']:g} when the bench began.\n"
    )
    return markdown(headings, rows) + "\n" + note


def knots_table() -> str:
    """Mean |g| against the spacing of control points."""
    measured = result("knot_spacing.json")
    tools = list(dict.fromkeys(row["tool"] for row in measured["rows"]))
    spacings = list(dict.fromkeys(row["spacing_mm"] for row in measured["rows"]))
    cell = {(row["tool"], row["spacing_mm"]): f"{row['least_um']:g} … {row['most_um']:g}" for row in measured["rows"]}
    rows = [[tool, *(cell[tool, spacing] for spacing in spacings)] for tool in tools]
    return markdown(["<tool", *(f"{spacing:g} mm" for spacing in spacings)], rows)


def gallery_table() -> str:
    """One sweep over each ruled flank: what it overcuts and leaves."""
    rows = []
    for name, figures in result("optimization.json")["gallery"].items():
        over, stock = figures["cylinder"][0]
        cone_over, cone_stock = figures["cone"][0]
        forbidden = figures["cylinder"][-1]
        rows.append(
            [
                name,
                f"{figures['published_um']:g}",
                f"{over:.0f} / {stock:.0f}",
                f"{forbidden[0]:.0f} / {forbidden[1]:.0f}",
                f"{cone_over:.0f} / {cone_stock:.0f}, {figures['half_angle_deg']:g}°",
            ]
        )
    headings = ["<flank", "published overcut µm", "overcut / stock µm", "with no overcut", "with the best cone"]
    return markdown(headings, rows)


def largest_table() -> str:
    """The largest single sweep of real blades, stage by stage."""

    def cell(figures: dict[str, float] | None) -> str:
        return "–" if figures is None else f"{100.0 * figures['share']:.1f} ({figures['mean_um']:.2f})"

    stages = ("before", "polished", "grown", "grown, accurate")
    rows = [
        [row["face"], row["tool"], *(cell(row[stage]) for stage in stages)]
        for row in result("optimization.json")["blades"]["rows"]
    ]
    return markdown(["<face", "<tool", "before", "polished", "grown", "largest with at most 2 µm"], rows)


def _tour(block: str) -> Callable[[], str]:
    def text() -> str:
        said = result("tour.json")[block]
        code = f"\n(exit code {said['code']})" if said["code"] else ""
        output = f"\n{said['output']}" if said["output"] else ""
        typed = "\n".join(f"$ {line}" for line in said["typed"].splitlines())
        return f"```text\n{typed}{output}{code}\n```\n"

    return text


def _job() -> str:
    job = (REPOSITORY / "sample_parts" / "blisk_blade" / "job.toml").read_text(encoding="utf-8")
    return f"```toml\n{job}```\n"


CONSTANTS: tuple[tuple[str, str, str], ...] = (
    ("detection.tracing", "SPHERES", "spheres along the flute on which a line is judged"),
    ("detection.tracing", "STEP", "mm from line to line of a sequence"),
    ("detection", "SMALLEST", "share of the face below which a sequence is dropped"),
    ("geometry.workface", "OVERHANG", "share of the flute by which the surface is continued"),
    ("detection.ruled_fit", "SHARE", "share of the tolerance that a detected motion may be off its lines"),
    ("detection.ruled_fit", "RIGID", "mm by which \\|pq\\| may be off L in a detected motion"),
    ("optimization.task", "PAPER_STEPS", "steps with the paper's weights"),
    ("optimization.task", "FADE_STEPS", "steps in which μ₂ and μ₅ fade"),
    ("optimization.task", "SETTLE_STEPS", "steps that settle"),
    ("optimization.task", "LEAST_FADE", "factor on μ₂ and μ₅ in the end"),
    ("optimization.task", "STIFFEST", "largest factor on μ₄"),
    ("optimization.task", "SCALE_FIRST", "σ at first, in undercut tolerances"),
    ("optimization.task", "SCALE_LAST", "σ in the end"),
    ("optimization.task", "FINE_SPACING", "mm between control points while settling"),
    ("optimization.task", "FINE_FEWEST", "control points while settling, at least"),
    ("optimization.task", "SETTLE_PROXIMITY", "factor on μ₃ while settling"),
    ("optimization.gauss_newton", "SPARSE", "one pose and height in so many counts in all steps but the last"),
    ("geometry.kernels.gauss_newton", "OFF_FACE", "weight of samples off the face"),
    ("geometry.kernels.gauss_newton", "BARRIER_FROM", "share of the overcut tolerance at which the barrier begins"),
    ("geometry.kernels.gauss_newton", "BARRIER_GAIN", "how steeply it grows"),
    ("optimization", "RESCUED", "of those that would be in good covers were nothing in the way, so many are slid"),
    (
        "optimization",
        "AT_A_TIME",
        "sweeps in good covers that are worked on at a time, about, for each face and tool",
    ),
    ("optimization", "ROUNDS", "times that such are looked for"),
    ("optimization.task", "LENGTHEN", "mm by which a motion is continued"),
    (
        "optimization.task",
        "STEADY",
        "share of its velocity with which an axis moves across itself at least, after growth and polish",
    ),
    ("optimization.task", "POLISH_PROXIMITY", "factor on μ₃ in the polish on the swept gap"),
    ("optimization.envelope_polish", "FAIR", "factor on μ₂ and μ₅ there"),
    ("optimization.envelope_polish", "STIFF", "factor on μ₄ there"),
    ("selection.choice", "LEAST_GAIN", "share of what all sweeps cover that one must add"),
    ("posting.spacing", "CHORD_TOLERANCE", "mm between a block and the exact motion"),
    ("verification.sampling", "POINTS_PER_FACE", "points at which a face is judged"),
    ("verification.poses", "CELL_LENGTH", "mm, longest cell of the motion"),
)


def constants_table() -> str:
    """Constants that docs/method.md speaks of, as the code has them."""
    rows = []
    for module, name, meaning in CONSTANTS:
        value = getattr(importlib.import_module(f"conflank_cli.{module}"), name)
        rows.append([f"`{module}.{name}`", f"{value:g}", meaning])
    return markdown(["<constant", "value", "<meaning"], rows)


BLOCKS: dict[str, Callable[[], str]] = {
    "sample": sample_table,
    "bench": bench_table,
    "knots": knots_table,
    "gallery": gallery_table,
    "largest": largest_table,
    "constants": constants_table,
    "job": _job,
    "history": history.markdown_table,
    **paper_tables.BLOCKS,
    **speed_tables.BLOCKS,
    **{
        f"tour-{block}": _tour(block)
        for block in ("inspect", "run", "plan", "program", "verify", "thicker", "findings", "send", "missing", "stages")
    },
}


def filled(text: str, where: str) -> str:
    """A document with all its blocks made anew.

    Raises
    ------
    ValueError: a block that nothing makes, or a marker without its other half.
    """

    def block(match: re.Match[str]) -> str:
        name = match["name"]
        if name not in BLOCKS:
            raise ValueError(f"{where}: no figures called {name}; there are {', '.join(BLOCKS)}")
        return f"<!-- figures:{name} -->\n{BLOCKS[name]()}<!-- /figures:{name} -->"

    if text.count("<!-- figures:") != len(_BLOCK.findall(text)) or text.count("<!-- /figures:") != len(
        _BLOCK.findall(text)
    ):
        raise ValueError(f"{where}: a marker of figures without its other half")
    return _BLOCK.sub(block, text)


@click.command()
@click.option(
    "--sample", type=click.Path(exists=True, path_type=Path), help="First keep this verification as the sample's."
)
def main(sample: Path | None) -> None:
    """Rewrite the blocks of README and docs."""
    if sample is not None:
        (RESULTS / SAMPLE).write_bytes(sample.read_bytes())
    for name in FILES:
        path = REPOSITORY / name
        text = path.read_text(encoding="utf-8")
        path.write_text(filled(text, name), encoding="utf-8")


if __name__ == "__main__":
    main()
