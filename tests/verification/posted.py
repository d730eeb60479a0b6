"""A small part that is posted in every style for every shipped machine: what the tests by mutation edit.

A block on the table, turned in the job's setup. Its west and its east side are cut by a sweep each, linked around it;
then, after a full retract, the ball makes a pass on the west side. The sweeps are exact: the cone lies on the plane.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import numpy.typing as npt

from conflank_cli.ball_pass import Pass
from conflank_cli.geometry.face import CheckMesh, DesignFace
from conflank_cli.geometry.surface import BSplineSurface
from conflank_cli.job import parse_job
from conflank_cli.motion import fitted
from conflank_cli.once import Once
from conflank_cli.posting.program import post_programs
from conflank_cli.scene import Scene
from conflank_cli.sweep import Sweep
from conflank_cli.tool import CATALOGUE

Array = npt.NDArray[np.float64]

T1 = CATALOGUE["T1"]
LONG, LOW, HIGH, DEEP = 12.0, 3.0, 20.0, 60.0
"""The block in the CAD frame: y 0 .. LONG, z LOW .. HIGH, x 0 .. DEEP, mm."""
POINTS = 300
"""Points on each design face: sweeps are exact, and what mutants cut they cut by far more than points are apart."""

JOB = """
[part]
file = "block.step"
[[part.design]]
face = 4
[[part.design]]
face = 5
[tools]
use = ["T1"]
[setup]
rotate_deg = [0.0, -25.0, 0.0]
translate = [5.0, -7.0, 40.0]
"""

STYLES = (
    ("h", "tcpm", "none"),
    ("h", "m128", "none"),
    ("h", "ln", "none"),
    ("h", "tcpm", "sweep"),
    ("i", "m128", "none"),
    ("apt", "multax", "none"),
)
"""Format, style and split of the programs that are posted."""
MACHINES = ("ac-table", "bc-table", "head-table", "head-head", "nutating-head")


NOTHING = CheckMesh(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int32), np.zeros(0, dtype=np.int32))


def _mesh() -> CheckMesh:
    """The four sides of the block beside the design faces."""
    x, y, z = (0.0, DEEP), (0.0, LONG), (LOW, HIGH)
    quads = [[(x[0], b, z[0]), (x[1], b, z[0]), (x[1], b, z[1]), (x[0], b, z[1])] for b in y]
    quads += [[(x[0], y[0], c), (x[1], y[0], c), (x[1], y[1], c), (x[0], y[1], c)] for c in z]
    triangles = [[4 * k + a, 4 * k + b, 4 * k + c] for k in range(4) for a, b, c in ((0, 1, 2), (0, 2, 3))]
    vertices = np.array(quads, dtype=np.float64).reshape(-1, 3)
    return CheckMesh(vertices, np.array(triangles, dtype=np.int32), np.full(8, 9, dtype=np.int32))


def _side(number: int, x: float, sense: int) -> DesignFace:
    poles = np.array([[[x, y, z] for z in (LOW, HIGH)] for y in (0.0, LONG)])
    clamped = np.array([0.0, 0.0, 1.0, 1.0])
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    return DesignFace(number, "", BSplineSurface(1, 1, clamped, clamped, poles), (corners,), sense)


def block_scene(extra: str = "") -> Scene:
    """The block as a job has it; `extra`: more of the job's file."""
    job = parse_job((JOB + extra).encode(), "job.toml", Path())
    return Scene(job, "block", (_side(4, 0.0, -1), _side(5, DEEP, 1)), (T1,), Once(_mesh), {})


def _sweep(face: int) -> Sweep:
    """The cone lies on a side and swings along it by 0.2 rad as it goes north."""
    outward = -1.0 if face == 0 else 1.0
    way = np.linspace(0.0, 1.0, 60)
    lean, alpha = 0.2 * way - 0.1, T1.half_angle
    axis = np.stack(
        [np.full(60, outward * np.sin(alpha)), np.cos(alpha) * np.sin(lean), np.cos(alpha) * np.cos(lean)], axis=1
    )
    x = (0.0 if face == 0 else DEEP) + outward * T1.r_min * np.cos(alpha)
    p = np.stack([np.full(60, x), -2.0 + (LONG + 4.0) * way, np.full(60, LOW - 1.0)], axis=1)
    return Sweep(face, "T1", fitted(way, np.hstack([p, p + T1.length * axis]), 14))


def _pass() -> Pass:
    """The ball along the west side, its axis leaned west."""
    way = np.linspace(0.0, 1.0, 4)
    lean = 0.5 + 0.1 * way
    axis = np.stack([-np.sin(lean), np.zeros(4), np.cos(lean)], axis=1)
    centre = np.stack([np.full(4, -T1.ball_radius), 2.0 + 8.0 * way, np.full(4, 10.0)], axis=1)
    return Pass(0, "T1", centre - T1.ball_radius * axis, axis)


@dataclass(frozen=True, slots=True, eq=False)
class Posted:
    """A program as it is posted, the parts it calls by the name of their file, and the job it is posted for."""

    text: str
    parts: Mapping[str, str]
    scene: Scene

    @property
    def called(self) -> Callable[[str], str | None]:
        """From the name of a file to its text."""
        return self.parts.get


@cache
def posted(kind: str = "h", style: str = "tcpm", split: str = "none", machine: str = "ac-table") -> Posted:
    """The block's plan in a format and style, for a machine."""
    scene = block_scene(
        f'[machine]\nname = "{machine}"\n[program]\nformat = "{kind}"\nstyle = "{style}"\nsplit = "{split}"\n'
    )
    (first, *parts), _, _ = post_programs(scene, [_sweep(0), _sweep(1)], [_pass()])
    return Posted(first.text, {f"{part.name}.H": part.text for part in parts}, scene)
