"""What is in the way of a motion: which component of the tool comes too near to what, or the machine's reach."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from conflank_cli.geometry.screening import CELL, PointCells, Screen, mesh_points
from conflank_cli.machine_frame import reachable_axes
from conflank_cli.motion import Motion
from conflank_cli.scene import Scene
from conflank_cli.tool import Tool

Array = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]

# Poses of a motion that are looked at, and of those in which something is hit.
POSES, HITS = 65, 8
# Points on the check geometry are this far apart, mm: enough to name a face.
SPACING = 1.0
MACHINE = "machine"
DESIGN = "design"


@dataclass(frozen=True, slots=True, order=True)
class Obstruction:
    """What forbids a pose.

    component: "ball", "cone", "shank" or "holder"; "machine" for an axis out of reach.
    obstacle: number of the face that is hit, as text, "obstacle" for foreign bodies, "design" for the design faces;
    empty for the machine.
    """

    component: str
    obstacle: str

    @property
    def text(self) -> str:
        """As a sentence has it."""
        if self.component == MACHINE:
            return "axis out of the machine's reach"
        if self.obstacle == DESIGN:
            return f"{self.component} into the design face"
        return f"{self.component} too near to " + (
            self.obstacle if not self.obstacle.isdigit() else f"face {self.obstacle}"
        )


@dataclass(frozen=True, slots=True)
class Obstacles:
    """The scene as it is searched for what is hit: points (N, 3) of the check geometry with the face of each (N,)."""

    scene: Scene
    screen: Screen
    check_only: Screen
    tree: cKDTree | None
    face: IntArray

    @classmethod
    def of(cls, scene: Scene, screen: Screen) -> Obstacles:
        """Prepare a scene."""
        check_only = replace(screen, design=PointCells.of(np.zeros((0, 3))))
        points, faces = [], []
        for number in np.unique(scene.check.face):
            own = type(scene.check)(
                scene.check.vertices,
                scene.check.triangles[scene.check.face == number],
                scene.check.face[scene.check.face == number],
            )
            found = mesh_points(own, SPACING)
            points.append(found)
            faces.append(np.full(len(found), int(number)))
        if not points:
            return cls(scene, screen, check_only, None, np.zeros(0, dtype=np.int64))
        return cls(scene, screen, check_only, cKDTree(np.concatenate(points)), np.concatenate(faces))

    def obstruction(self, motion: Motion, tool: Tool) -> Obstruction | None:
        """What most forbids a motion, None where nothing does at the poses that are looked at."""
        p, q = motion.ends(np.linspace(0.0, 1.0, POSES))
        return self.at(p, (q - p) / np.linalg.norm(q - p, axis=1)[:, None], tool)

    def at(self, p: Array, d: Array, tool: Tool, slack: float = 0.0) -> Obstruction | None:
        """The same of poses: axis points p at height 0, directions d (M, 3); `slack` mm of violation is let pass."""
        free = self.screen.free(p, d, tool, slack)
        if free.all():
            return None
        out = ~free & ~reachable_axes(self.scene.job, d)
        hit = np.flatnonzero(~free & ~out)
        if out.sum() >= len(hit):
            return Obstruction(MACHINE, "")
        hit = hit[~self.check_only.free(p[hit], d[hit], tool, slack)]
        if self.tree is None or not len(hit):
            return Obstruction("cone", DESIGN)
        found = [item for k in hit[:: max(len(hit) // HITS, 1)] for item in self._nearest(p[k], d[k], tool)]
        return min(found, key=lambda item: item[0])[1]

    def _nearest(self, p: Array, d: Array, tool: Tool) -> list[tuple[float, Obstruction]]:
        """Slack and nearest obstacle of each component at one pose."""
        assert self.tree is not None
        margin = self.screen.check_margins
        names = [("cone", 0.0, tool.length, tool.r_min, tool.r_max, margin.cutter)]
        top = tool.length
        for name, sections, keep in (("shank", tool.shank, margin.shank), ("holder", tool.holder, margin.holder)):
            for part in sections:
                low, high = 0.5 * part.diameter_low, 0.5 * part.diameter_high
                names.append((name, top, top + part.length, low, high, keep))
                top += part.length
        radius = max(item[4] for item in names) + margin.holder + CELL
        heights = np.arange(0.0, top + radius, radius)
        near = self.tree.query_ball_point(p + heights[:, None] * d, 1.5 * radius)
        index = np.unique(np.concatenate([np.asarray(item, dtype=np.int64) for item in near]))
        if not len(index):
            return [(np.inf, Obstruction("cone", DESIGN))]
        away = np.asarray(self.tree.data)[index] - p
        z = away @ d
        r = np.linalg.norm(away - z[:, None] * d, axis=1)
        found = []
        ball = np.hypot(z - tool.ball_centre_height, r) - tool.ball_radius - margin.cutter
        slacks = [("ball", ball)]
        slacks += [(name, _to_section(z, r, *sizes[:4]) - sizes[4]) for name, *sizes in names]
        for name, slack in slacks:
            k = int(slack.argmin())
            number = int(self.face[index[k]])
            found.append((float(slack[k]), Obstruction(name, str(number) if number >= 0 else "obstacle")))
        return found


def _to_section(z: Array, r: Array, low: float, high: float, r_low: float, r_high: float) -> Array:
    """Distance, in the half plane (z along the axis, r across it), to a truncated cone; negative within it."""
    slope = np.array([high - low, r_high - r_low])
    length = float(np.linalg.norm(slope))
    beside = ((r - r_low) * slope[0] - (z - low) * slope[1]) / length
    inside = np.maximum(np.maximum(low - z, z - high), beside)
    share = np.clip(((z - low) * slope[0] + (r - r_low) * slope[1]) / length**2, 0.0, 1.0)
    flank = np.hypot(z - low - share * slope[0], r - r_low - share * slope[1])
    discs = [np.hypot(z - height, np.maximum(r - radius, 0.0)) for height, radius in ((low, r_low), (high, r_high))]
    return np.asarray(np.where(inside <= 0.0, inside, np.minimum(flank, np.minimum(*discs))))
