"""The pictures of docs/paper.md, from what `benchmarks.paper` measured."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from conflank_cli.geometry.workface import FaceSamples
from conflank_cli.report.colours import CUTS, cut_colour, gap_colours
from docs.pictures import PICTURES, save

if TYPE_CHECKING:
    from benchmarks.paper import Measured

Array = npt.NDArray[np.float64]

TOOLS = {"T1": CUTS[0], "T2": CUTS[1], "T3": CUTS[2], "all": "#222222", "CT1": CUTS[6]}
METHOD_COLOURS = {"following the rulings": CUTS[1], "two points": CUTS[3], "triple tangent": CUTS[2]}
COLUMNS = 4
DPI = 80
FAR = 1.0
"""Gaps above this are drawn as if they were this, mm: where no sweep comes near there is none."""


def draw(found: Sequence[Measured], figures: dict[str, Any]) -> None:
    """Write all pictures for which there is something to show.

    figures: as benchmarks/results/paper.json has them.
    """
    limit = float(figures["tolerance_um"])
    save(coverage(figures["faces"]), PICTURES / "paper_coverage.png")
    save(methods(figures["faces"]), PICTURES / "paper_methods.png")
    parts: dict[str, list[Measured]] = {}
    for face in found:
        if face.figures["sample"]:
            parts.setdefault(face.name.split(",")[0], []).append(face)
    for title, name in (("blisk blade", "paper_largest.png"), ("impeller", "paper_impeller.png")):
        if title in parts:
            save(largest(parts[title], limit, 3 if title == "blisk blade" else 2), PICTURES / name)
    if "blisk blade" in parts:
        save(rulings(parts["blisk blade"], limit), PICTURES / "paper_rulings.png")


def coverage(faces: Sequence[dict[str, Any]]) -> Figure:
    """Coverage against the number of sweeps: each tool, and the best of all three."""
    rows = -(-len(faces) // COLUMNS)
    figure = Figure(figsize=(12.0, 2.75 * rows), layout="constrained", dpi=DPI)
    axes = figure.subplots(rows, COLUMNS, sharex=True, sharey=True, squeeze=False)
    for face, ax in zip(faces, axes.flat, strict=False):
        lines = {name: row["coverage"] for name, row in face["tools"].items()} | {"all": face["together"]["coverage"]}
        for name, line in lines.items():
            shares = 100.0 * np.array([0.0, *line])
            ax.plot(range(len(shares)), shares, color=TOOLS[name], marker="o", ms=2.5, lw=1.2,
                    label="T1, T2 and T3" if name == "all" else name)  # fmt: skip
        ax.plot([8], [90.0], marker="*", ms=10, color="#d62728", ls="none", label="the paper, on its blades")
        ax.set_title(face["face"], fontsize=9)
        ax.set(xlim=(0.0, 10.2), ylim=(0.0, 102.0))
        ax.grid(alpha=0.3)
    _legend(list(axes.flat), len(faces))
    figure.supxlabel("sweeps, in the order in which each adds most", fontsize=10)
    figure.supylabel("covered within tolerance, % of the area", fontsize=10)
    return figure


def methods(faces: Sequence[dict[str, Any]]) -> Figure:
    """Coverage against cutting time: our sweeps with T1, a cylinder's, and strips of other methods."""
    rows = -(-len(faces) // COLUMNS)
    figure = Figure(figsize=(12.0, 2.75 * rows), layout="constrained", dpi=DPI)
    axes = figure.subplots(rows, COLUMNS, sharey=True, squeeze=False)
    for face, ax in zip(faces, axes.flat, strict=False):
        for name, row in (("T1", face["tools"].get("T1")), ("CT1", face["cylinder"])):
            if row is not None:
                label = "conflank, T1" if name == "T1" else "conflank, cylinder of T1's mean radius"
                ax.plot(np.cumsum(row["cutting_seconds"]), 100.0 * np.array(row["coverage"]), color=TOOLS[name],
                        marker="o", ms=3, lw=1.2, label=label)  # fmt: skip
        for name, points in face["methods"].items():
            ax.plot([point["cutting_seconds"] for point in points], [100.0 * point["coverage"] for point in points],
                    color=METHOD_COLOURS[name], marker="s", ms=3, lw=1.2, label=name)  # fmt: skip
        ball = face["ball"]
        if ball["passes"]:
            ax.plot([ball["cutting_seconds"]], [100.0 * ball["coverage"]], marker="D", ms=5, color="#555555", ls="none",
                    label="ball alone")  # fmt: skip
        ax.set_xscale("log")
        ax.set_ylim(0.0, 103.0)
        ax.set_title(face["face"], fontsize=9)
        ax.grid(alpha=0.3)
    _legend(list(axes.flat), len(faces))
    figure.supxlabel("time of the cuts at F1000, s, without the ways between them", fontsize=10)
    figure.supylabel("covered within tolerance, % of the area", fontsize=10)
    return figure


def largest(faces: Sequence[Measured], limit: float, count: int) -> Figure:
    """Patches of the largest sweeps of T1, T2, T3 on each side: the gap of the posted text."""
    along, across = _extent(faces[0].samples)
    height = min(2.3, 3.3 * across / along) + 0.4
    figure = Figure(figsize=(12.0, height * len(faces)), layout="constrained", dpi=DPI)
    tools = [name for name in TOOLS if name in faces[0].figures["tools"]]
    axes = figure.subplots(len(faces), len(tools), squeeze=False)
    for row, face in zip(axes, faces, strict=True):
        for ax, name in zip(row, tools, strict=True):
            posted = face.posted.of_tools([name]).greedy(face.samples.areas)
            gap = np.minimum.reduce(posted.gaps[:count])
            _gap_image(ax, face.samples, gap, limit)
            for k in range(min(count, len(posted.gaps))):
                _outline(ax, face.samples, np.abs(1e3 * posted.gaps[k]) <= limit, cut_colour(k))
            share = 100.0 * posted.coverage(face.samples.areas)[min(count, len(posted.gaps)) - 1]
            ax.set_title(f"{face.name}: {count} sweeps of {name}, {share:.1f} %", fontsize=9)
    _scale(figure, axes, limit)
    return figure


def rulings(faces: Sequence[Measured], limit: float) -> Figure:
    """Sweeps that follow rulings, few and many, beside three of ours."""
    counts = [count for count in (1, 2, 4, 20) if all(count in face.strips for face in faces)]
    figure = Figure(figsize=(12.0, 2.4 * len(faces)), layout="constrained", dpi=DPI)
    axes = figure.subplots(len(faces), len(counts) + 1, squeeze=False)
    for row, face in zip(axes, faces, strict=True):
        for ax, count in zip(row, counts, strict=False):
            strips = face.strips[count]
            _gap_image(ax, face.samples, strips.gap, limit)
            share = 100.0 * strips.coverage(face.samples, 1e-3 * limit)
            ax.set_title(f"{face.name}\n{count} following rulings: {share:.1f} %", fontsize=8)
        posted = face.posted.of_tools(["T1"]).greedy(face.samples.areas)
        gap = np.minimum.reduce(posted.gaps[:4])
        _gap_image(row[-1], face.samples, gap, limit)
        share = 100.0 * posted.coverage(face.samples.areas)[min(4, len(posted.gaps)) - 1]
        row[-1].set_title(f"{face.name}\n4 of conflank: {share:.1f} %", fontsize=8)
    _scale(figure, axes, limit)
    return figure


# -- parts of a picture ----------------------------------------------------------------------------------------------


def _extent(samples: FaceSamples) -> tuple[float, float]:
    """Mean lengths of the grid's lines along u and v, mm."""
    grid = np.full((*samples.shape, 3), np.nan)
    grid[samples.cell[:, 0], samples.cell[:, 1]] = samples.points
    lengths = []
    for axis in (0, 1):
        steps = np.linalg.norm(np.diff(grid, axis=axis), axis=2)
        lengths.append(float(np.nanmean(steps)) * (samples.shape[axis] - 1))
    return lengths[0], lengths[1]


def _raster(samples: FaceSamples, values: Array) -> Array:
    raster = np.full(samples.shape, np.nan)
    raster[samples.cell[:, 0], samples.cell[:, 1]] = values
    return raster.T


def _gap_image(ax: Axes, samples: FaceSamples, gap: Array, limit: float) -> None:
    along, across = _extent(samples)
    ax.imshow(
        _raster(samples, 1e3 * np.minimum(gap, FAR)), origin="lower", extent=(0.0, along, 0.0, across),
        cmap=gap_colours(), norm=Normalize(-limit, limit), interpolation="nearest",
    )  # fmt: skip
    ax.set(xticks=[], yticks=[])


def _outline(ax: Axes, samples: FaceSamples, inside: npt.NDArray[np.bool_], colour: str) -> None:
    along, across = _extent(samples)
    raster = np.nan_to_num(_raster(samples, inside.astype(np.float64)))
    x = (np.arange(samples.shape[0]) + 0.5) / samples.shape[0] * along
    y = (np.arange(samples.shape[1]) + 0.5) / samples.shape[1] * across
    if raster.any() and not raster.all():
        ax.contour(x, y, raster, levels=[0.5], colors=[colour], linewidths=1.4)


def _scale(figure: Figure, axes: npt.NDArray[np.object_], limit: float) -> None:
    scale = ScalarMappable(Normalize(-limit, limit), gap_colours())
    bar = figure.colorbar(scale, ax=axes.ravel().tolist(), extend="both", shrink=0.8)
    bar.set_label("gap, µm: red cut too deep, grey left", fontsize=8)


def _legend(axes: Sequence[Axes], used: int) -> None:
    """The legend in the first place that is not used, if there is one; all those are cleared."""
    for ax in axes[used:]:
        ax.set_axis_off()
    handles, labels = axes[0].get_legend_handles_labels()
    if used < len(axes):
        axes[used].legend(handles, labels, fontsize=9, loc="upper left")
    else:
        axes[0].legend(handles, labels, fontsize=6, loc="lower right")
