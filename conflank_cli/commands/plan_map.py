"""What a plan covers and why it leaves the rest, as tables, as JSON and as a picture."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from conflank_cli.commands.tables import text_table
from conflank_cli.coverage import REASON_WORDS, FaceCoverage, Reason
from conflank_cli.report.colours import GREYS
from conflank_cli.report.picture_file import DPI, FORMATS, picture_suffix
from conflank_cli.scene import Scene
from conflank_cli.sweep import Sweep

# Size of one map, inches.
PANEL = 4.2


def summary_tables(summary: Mapping[str, Any]) -> str:
    """Coverage by face with the proof, what is left and why, and what is in the way."""
    timed = any(face["objective"] == "time" for face in summary["faces"])
    what = "time s" if timed else "sweeps"
    faces = text_table(
        ["face", "area mm²", "covered %", "sweeps", f"{what} chosen", "greedy", "at least", "gap %"],
        [
            (
                face["face"], face["area_mm2"], 100.0 * face["coverage"], face["sweeps"],
                *((face[name] if timed else round(face[name])) for name in ("price", "greedy", "bound")),
                100.0 * face["gap"],
            )
            for face in summary["faces"]
        ],
    )  # fmt: skip
    left = [
        (face["face"], area, 100.0 * area / face["area_mm2"], REASON_WORDS[Reason[name.upper()]])
        for face in summary["faces"]
        for name, area in face["left_mm2"].items()
    ]
    forbidden = [
        (face["face"], area, 100.0 * area / face["area_mm2"], what_)
        for face in summary["faces"]
        for what_, area in face["in_the_way_mm2"].items()
    ]
    parts = [faces]
    if left:
        parts.append(text_table(["face", "left mm²", "%", "<why"], left))
    if forbidden:
        parts.append(text_table(["face", "left mm²", "%", "<in the way"], forbidden))
    if summary["order"]:
        parts.append(f"cut {summary['order']}\n")
    return "\n".join(parts)


def draw(scene: Scene, sweeps: Sequence[Sweep], coverage: Sequence[FaceCoverage], file: str) -> bytes:
    """Every face over (u, v): a colour for each sweep where it leaves least, greys and browns for why the rest is left.

    Raises
    ------
    UsageError: the file's suffix is no picture format known here.
    """
    suffix = picture_suffix(file)
    # Half a second to import, and only pictures need it.
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
    from matplotlib.patches import Patch

    figure, panels = plt.subplots(
        1, len(coverage), figsize=(PANEL * len(coverage) + 2.6, PANEL), squeeze=False, layout="constrained"
    )
    colours = plt.get_cmap("tab20")(np.arange(20))[:, :3]
    handles = []
    for index, (panel, design, points) in enumerate(zip(panels[0], scene.faces, coverage, strict=True)):
        shade = np.ones((len(points.areas), 3))
        for reason, grey in GREYS.items():
            shade[points.reason == reason] = matplotlib.colors.to_rgb(grey)
        for number, sweep in enumerate(sweeps):
            if sweep.face == index:
                shade[points.sweep == number] = colours[number % len(colours)]
                label = f"sweep {number + 1}, {sweep.tool}, face {design.number}"
                handles.append(Patch(color=colours[number % len(colours)], label=label))
        panel.scatter(*points.uv.T, c=shade, s=3, marker="s", linewidths=0)
        total = float(points.areas.sum())
        covered = 100.0 * points.area(Reason.COVERED) / total
        panel.set_title(f"face {design.number} {design.name}: {covered:.1f} % covered", fontsize=8)
        panel.set_xticks([])
        panel.set_yticks([])
    for reason, grey in GREYS.items():
        area = sum(points.area(reason) for points in coverage)
        if area:
            handles.append(Patch(facecolor=grey, edgecolor="0.5", label=f"{REASON_WORDS[reason]}: {area:.0f} mm²"))
    figure.legend(handles=handles, loc="outside right upper", fontsize=7)
    buffer = io.BytesIO()
    with matplotlib.rc_context({"svg.hashsalt": "conflank"}):
        figure.savefig(buffer, format=suffix[1:], dpi=DPI, metadata=FORMATS[suffix])
    plt.close(figure)
    return buffer.getvalue()
