"""The tables of docs/paper.md, from benchmarks/results/paper.json."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from benchmarks.tables import fixed, markdown, result

FILE = "paper.json"
PAPER_SWEEPS = 8
ASKED = 0.90
FIGURE_15 = (1, 2, 4, 20)
CROSSED = "not with"


def _faces() -> list[dict[str, Any]]:
    faces: list[dict[str, Any]] = result(FILE)["faces"]
    return faces


def _at(coverage: Sequence[float], count: int) -> str:
    return fixed(100.0 * coverage[min(count, len(coverage)) - 1], 1) if coverage else "–"


def _for(coverage: Sequence[float], share: float) -> str:
    return str(next((k for k, reached in enumerate(coverage, start=1) if reached >= share), "–"))


def _joined(sweeps: Sequence[dict[str, Any]], key: str) -> list[str]:
    """Mean of absolutes, signed mean and extremes over several sweeps, each counting as much as any other."""
    rows = [sweep[key] for sweep in sweeps]
    mean_abs, mean = (sum(row[name] for row in rows) / len(rows) for name in ("mean_abs", "mean"))
    low, high = min(row["min"] for row in rows), max(row["max"] for row in rows)
    return [fixed(mean_abs, 2), f"{mean:+.2f}", f"{low:.1f} … {high:.1f}"]


def verdict_table() -> str:
    """What the paper states against what was measured."""
    verdicts = result(FILE)["verdicts"].items()
    rows = [[what.replace("|", "\\|"), found, "" if reached else "missed"] for what, (found, reached) in verdicts]
    return markdown(["<figure", "measured", "<"], rows)


def sweeps_table() -> str:
    """Coverage by tool, and the three largest sweeps: axis error, gap of the posted text, time."""
    rows = []
    for face in _faces():
        for name, tool in face["tools"].items():
            coverage, large = tool["coverage"], tool["largest"]
            seconds = sum(sweep["seconds"] for sweep in large) / len(large)
            rulings = sum(sweep["rulings_epsilon_um"]["mean_abs"] for sweep in large) / len(large)
            rows.append(
                [
                    face["face"], name, *(_at(coverage, k) for k in (3, PAPER_SWEEPS)), _for(coverage, ASKED),
                    *_joined(large, "epsilon_um"), *_joined(large, "gap_um"), fixed(seconds, 1), fixed(rulings, 0),
                ]
            )  # fmt: skip
    return markdown(
        [
            "<face", "<tool", "3 sweeps %", "8 sweeps %", "for 90 %", "mean abs ε", "signed", "extremes", "mean abs g",
            "signed", "extremes", "s a sweep", "rulings: mean abs ε",
        ],
        rows,
    )  # fmt: skip


def together_table() -> str:
    """Coverage with all three tools in the drawer."""
    rows = []
    for face in _faces():
        together = face["together"]
        coverage, used = together["coverage"], together["tools"]
        counts = ", ".join(f"{used.count(name)} {name}" for name in dict.fromkeys(sorted(used)))
        within_reach = together.get("reachable")
        rows.append(
            [
                face["face"], *(_at(coverage, k) for k in (1, 2, 3, 4, PAPER_SWEEPS)), _at([together["best"]], 1),
                "" if within_reach is None else _at([within_reach], 1), _for(coverage, ASKED), counts,
            ]
        )  # fmt: skip
    return markdown(
        ["<face", "1", "2", "3", "4", "8 sweeps", "best 8", "in reach", "for 90 %", "<tools of the best 8"], rows
    )


def rulings_table() -> str:
    """Strips that follow the rulings, few and many."""
    rows = []
    for face in _faces():
        by_count = {point["sweeps"]: point for point in face["methods"]["following the rulings"]}
        cells = []
        for count in FIGURE_15:
            point = by_count.get(count)
            cells.append(
                "–"
                if point is None
                else f"{_at([point['coverage']], 1)} ({fixed(point['overcut_um'], 0)} / {fixed(point['stock_um'], 0)})"
            )
        own = face["tools"].get("T1", {"coverage": []})["coverage"]
        rows.append([face["face"], *cells, _at(own, 4)])
    return markdown(["<face", *(str(count) for count in FIGURE_15), "conflank, 4 sweeps"], rows)


def methods_table() -> str:
    """What each method needs to cover what eight sweeps with T1 cover."""
    rows = []
    for face in _faces():
        own = face["tools"].get("T1")
        if own is None:
            continue
        count = min(PAPER_SWEEPS, len(own["coverage"]))
        wanted = own["coverage"][count - 1]
        cells = [f"{count}: {fixed(sum(own['cutting_seconds'][:count]), 0)} s"]
        for points in face["methods"].values():
            reaching = next((point for point in points if point["coverage"] >= wanted), None)
            best = max(points, key=lambda point: point["coverage"])
            cells.append(
                f"{CROSSED} {points[-1]['sweeps']}: {_at([best['coverage']], 1)} %"
                if reaching is None
                else f"{reaching['sweeps']}: {fixed(reaching['cutting_seconds'], 0)} s"
            )
        cylinder = face["cylinder"]
        cells.append("–" if cylinder is None else f"{_at(cylinder['coverage'], PAPER_SWEEPS)} %")
        ball = face["ball"]
        cells.append(f"{fixed(ball['cutting_seconds'], 0)} s, {fixed(100.0 * ball['coverage'], 1)} %")
        rows.append([face["face"], fixed(100.0 * wanted, 1), *cells])
    return markdown(
        ["<face", "covered %", "conflank", "following the rulings", "two points", "triple tangent",
         "conflank, 8 with a cylinder", "ball alone"],
        rows,
    )  # fmt: skip


def impeller_table() -> str:
    """The two best patches on each side of the impeller."""
    rows = []
    for face in _faces():
        if not face["face"].startswith("impeller"):
            continue
        for name, tool in face["tools"].items():
            for number, sweep in enumerate(tool["largest"][:2], start=1):
                gap, error = sweep["gap_um"], sweep["epsilon_um"]
                rows.append(
                    [face["face"], name, str(number), fixed(100.0 * sweep["share"], 1), fixed(error["mean_abs"], 2),
                     fixed(gap["mean_abs"], 2), f"{gap['min']:.1f} … {gap['max']:.1f}", fixed(sweep["seconds"], 1)]
                )  # fmt: skip
    return markdown(["<face", "<tool", "patch", "% of the face", "mean abs ε", "mean abs g", "extremes", "s"], rows)


def left_out() -> str:
    """Which parts were not there."""
    names = result(FILE)["left_out"]
    return f"Left out of this run: {', '.join(names)}.\n" if names else "All parts were there.\n"


BLOCKS: dict[str, Callable[[], str]] = {
    "paper-verdicts": verdict_table,
    "paper-sweeps": sweeps_table,
    "paper-together": together_table,
    "paper-rulings": rulings_table,
    "paper-methods": methods_table,
    "paper-impeller": impeller_table,
    "paper-left-out": left_out,
}
