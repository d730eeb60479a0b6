"""The reachability of every face by every tool, as a table, as JSON and as a picture."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass

import msgspec
import numpy as np

from conflank_cli.commands.tables import text_table
from conflank_cli.detection.reachability import Reachability, reachability
from conflank_cli.geometry.workface import WorkFace
from conflank_cli.progress import Progress
from conflank_cli.report.picture_file import DPI, FORMATS, picture_suffix
from conflank_cli.scene import Scene

# Shares of the flute along which a line has to touch.
ENGAGED = (("1/3", 1.0 / 3.0), ("2/3", 2.0 / 3.0), ("9/10", 0.9))
# Multiples of the tolerance at which areas are stated.
MULTIPLES = (0.5, 1.0, 2.0)
# Size of one map, inches.
PANEL = 3.2


@dataclass(frozen=True, slots=True)
class ReachMap:
    """The map of one face, tool and engaged share (a label); tolerance in mm."""

    face: int
    name: str
    tool: str
    engaged: str
    tolerance: float
    found: Reachability

    @property
    def area(self) -> float:
        """Area of the face, mm2."""
        return float(self.found.samples.areas.sum())


def reach_maps(scene: Scene, points: int, progress: Progress) -> list[ReachMap]:
    """All maps of a scene, faces first, then tools, then engaged shares."""
    # A line's error is shared out evenly between overcut and stock, so what counts is half the band.
    tolerance = 0.5 * (scene.job.tolerance.overcut + scene.job.tolerance.undercut)
    maps = []
    with progress.stage("reach", len(scene.faces) * len(scene.tools) * len(ENGAGED)) as stage:
        for design in scene.faces:
            for tool in scene.tools:
                face = WorkFace.under(design, tool)
                samples = face.samples(face.spacing(points))
                for label, share in ENGAGED:
                    found = reachability(face, tool, samples, scene.job.tolerance.allowance, share)
                    maps.append(ReachMap(design.number, design.name, tool.name, label, tolerance, found))
                    stage.advance()
    return maps


def as_table(maps: Sequence[ReachMap]) -> str:
    """Share of the area that is reached, in per cent."""
    within = [f"within {1e3 * multiple * maps[0].tolerance:g} µm %" for multiple in MULTIPLES]
    columns = ["face", "<name", "<tool", "<engaged", "area mm²", *within, "median µm"]
    rows = [
        (
            item.face,
            item.name,
            item.tool,
            item.engaged,
            item.area,
            *(100.0 * item.found.share(multiple * item.tolerance) for multiple in MULTIPLES),
            1e3 * float(np.median(item.found.error)),
        )
        for item in maps
    ]
    return text_table(columns, rows)


def as_document(maps: Sequence[ReachMap]) -> str:
    """Everything as JSON, with the points in mm and their least axis error in µm (null where no line fits)."""
    content = [
        {
            "face": item.face,
            "name": item.name,
            "tool": item.tool,
            "engaged": item.engaged,
            "area_mm2": item.area,
            "tolerance_um": 1e3 * item.tolerance,
            "share": {f"{multiple:g}": item.found.share(multiple * item.tolerance) for multiple in MULTIPLES},
            "points": item.found.samples.points.round(6).tolist(),
            "uv": item.found.samples.uv.round(9).tolist(),
            "area_of_point_mm2": item.found.samples.areas.round(6).tolist(),
            "error_um": [float(e) if np.isfinite(e) else None for e in (1e3 * item.found.error).round(4)],
        }
        for item in maps
    ]
    return msgspec.json.encode({"units": {"length": "mm"}, "maps": content}).decode() + "\n"


def draw(maps: Sequence[ReachMap], file: str) -> bytes:
    """The maps over (u, v), a row for each face and tool: colour from 0 to twice the tolerance, grey beyond.

    Raises
    ------
    UsageError: the file's suffix is no picture format known here.
    """
    suffix = picture_suffix(file)
    # Half a second to import, and only pictures need it.
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    columns = len(ENGAGED)
    rows = len(maps) // columns
    figure, panels = plt.subplots(
        rows, columns, figsize=(PANEL * columns + 0.8, PANEL * rows), squeeze=False, layout="constrained"
    )
    for panel, item in zip(panels.ravel(), maps, strict=True):
        limit = 2e3 * item.tolerance
        error = 1e3 * item.found.error
        beyond = error > limit
        uv = item.found.samples.uv
        panel.scatter(*uv[beyond].T, c="0.8", s=14, marker="s", linewidths=0)
        shown = panel.scatter(
            *uv[~beyond].T, c=error[~beyond], cmap="viridis_r", vmin=0.0, vmax=limit, s=14, marker="s", linewidths=0
        )
        title = f"face {item.face} {item.name}, {item.tool}, {item.engaged} of the flute"
        panel.set_title(title, fontsize=8)
        panel.set_xticks([])
        panel.set_yticks([])
    figure.colorbar(shown, ax=panels, label="least axis error, µm (grey: more)")
    buffer = io.BytesIO()
    with matplotlib.rc_context({"svg.hashsalt": "conflank"}):
        figure.savefig(buffer, format=suffix[1:], dpi=DPI, metadata=FORMATS[suffix])
    plt.close(figure)
    return buffer.getvalue()
