"""What no post can write, whatever the control: paths without cuts, poses that are no poses, tools mixed up."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from postprocessors.errors import PostError
from postprocessors.toolpath import Cutter, Stretch, ToolPath

Array = npt.NDArray[np.float64]

UNIT_SLACK = 1e-6
"""Deviation of an axis vector's length from 1 that is taken for rounding."""


def check_path(path: ToolPath, coordinate_limit: float) -> None:
    """Refuse a tool path that means nothing, or has coordinates beyond `coordinate_limit` (mm)."""
    if not path.operations or not path.faces:
        raise PostError("tool path", "no cut" if path.faces else "no face", "at least one", "Select sweeps first.")
    numbers: dict[int, Cutter] = {}
    for operation in path.operations:
        known = numbers.setdefault(operation.cutter.number, operation.cutter)
        if known != operation.cutter:
            found = f"number {known.number} for {known.name} and {operation.cutter.name}"
            raise PostError("[tools]", found, "one number for each tool", "Give each tool its own number.")
        if not operation.stretches:
            raise PostError(f"tool {operation.cutter.name}", "no cut", "at least one", "Select sweeps first.")
        for stretch in operation.stretches:
            _check_stretch(stretch, coordinate_limit)


def check_cutters(path: ToolPath, number_limit: int, spindle_limit: float) -> None:
    """Refuse tool numbers and speeds that the control does not know."""
    for operation in path.operations:
        cutter = operation.cutter
        where = f"[tools] {cutter.name}"
        if not 0 <= cutter.number <= number_limit:
            raise PostError(f"{where} number", f"{cutter.number}", f"0 .. {number_limit}", "Renumber the tool.")
        if not 0.0 < cutter.spindle_rpm <= spindle_limit:
            expected = f"above 0, up to {spindle_limit}"
            raise PostError(f"{where} spindle_rpm", f"{cutter.spindle_rpm}", expected, "Correct the speed.")


def check_coordinates(where: str, points: Array, limit: float) -> None:
    """Refuse points (N, 3) beyond `limit` (mm)."""
    beyond = np.abs(points).max(axis=1) > limit
    if beyond.any():
        pose = int(np.flatnonzero(beyond)[0])
        expected = f"within +-{limit} mm"
        raise PostError(f"{where}, pose {pose + 1}", f"{points[pose].tolist()}", expected, "Check [part] scale.")


def _check_stretch(stretch: Stretch, coordinate_limit: float) -> None:
    where = f"{stretch.purpose.value} {stretch.cut}"
    count = len(stretch.tip)
    if (
        stretch.tip.shape != (count, 3)
        or stretch.axis.shape != (count, 3)
        or stretch.feed.shape != (count,)
        or not count
    ):
        found = f"shapes {stretch.tip.shape}, {stretch.axis.shape}, {stretch.feed.shape}"
        raise PostError(where, found, "(N, 3), (N, 3) and (N,) with N > 0", "Report this tool path.")
    sound = np.isfinite(stretch.tip).all(axis=1) & (np.abs(np.linalg.norm(stretch.axis, axis=1) - 1.0) <= UNIT_SLACK)
    sound &= np.isfinite(stretch.feed) & (stretch.feed >= 0.0)
    if not sound.all():
        pose = int(np.flatnonzero(~sound)[0])
        found = f"tip {stretch.tip[pose].tolist()}, axis {stretch.axis[pose].tolist()}, feed {stretch.feed[pose]}"
        expected = "finite numbers, an axis of length 1, a feed >= 0"
        raise PostError(f"{where}, pose {pose + 1}", found, expected, "Optimise the sweep again.")
    check_coordinates(where, stretch.tip, coordinate_limit)
