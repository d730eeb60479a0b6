"""Passes: what no sweep reaches within tolerance is finished with the ball of a tool, along streamlines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.interpolate import RegularGridInterpolator
from scipy.spatial import cKDTree

from conflank_cli.ball_pass import Pass
from conflank_cli.geometry.collision import DESIGN, FINE, Collider
from conflank_cli.geometry.workface import WorkFace
from conflank_cli.passes.axes import Axes
from conflank_cli.passes.path import Path, path_of
from conflank_cli.passes.region import Grid
from conflank_cli.passes.scallop import POSTING, Aim, line_distance
from conflank_cli.passes.streamlines import BRIDGE, Ball, streamlines
from conflank_cli.progress import Progress
from conflank_cli.scene import Scene
from conflank_cli.sweep import Sweep
from conflank_cli.tool import Tool

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

# Passes go this many distances of lines into what sweeps have covered.
OVERLAP = 1.5
# Steps that sweeps leave are cut down above this share of half the band of the tolerance, between nodes they may be
# higher; and passes are laid so that theirs are below this share.
STEP_SHARE, OWN_STEP_SHARE = 0.8, 0.9
# Where a sweep leaves a gap closer than this to the tolerance, mm, its border is not certain.
IN_DOUBT = 0.0005
# Ball and cone may be found this deep in the triangles of the face, mm: a pass touches it.
TOUCH = 0.002
# Distances from the paths of the ball's centre are looked up among points this far apart on them, mm.
TRACK = 0.1


def ball_passes(scene: Scene, sweeps: Sequence[Sweep], progress: Progress) -> tuple[list[Pass], dict[str, Any]]:
    """Passes over what the sweeps leave of every face, in cutting order, and a summary.

    The tool, the height of the scallop and the tolerances are the job's. Without sweeps the passes finish the whole
    face. The summary holds, by face, the share of the area that sweeps and both together cover, what is left in mm2 and
    why.
    """
    keys, tolerance = scene.job.selection.ball_passes, scene.job.tolerance
    tools = {tool.name: tool for tool in scene.tools}
    tool = tools[keys.tool] if keys.tool is not None else scene.tools[0]
    aim = Aim.of(tolerance, keys.scallop)
    collider = Collider.of(scene)
    found: list[Pass] = []
    reports = []
    with progress.stage("passes", len(scene.faces)) as stage:
        for index, design in enumerate(scene.faces):
            own = [sweep for sweep in sweeps if sweep.face == index]
            job = _FaceJob.of(
                WorkFace.of(design, 0.0), index, tool, aim, collider, tolerance.overcut, tolerance.undercut
            )
            passes, report = job.finish(own, tools, tolerance.allowance)
            found += passes
            reports.append({"face": design.number} | report)
            stage.advance()
    return found, {"passes": len(found), "passes_by_face": reports}


def _touching(collider: Collider, cutter: float) -> Collider:
    """The same with another limit for the cutter at the design faces, mm: a pass does not use up the tolerance."""
    bodies = (
        replace(body, margins=replace(body.margins, cutter=cutter)) if body.name == DESIGN else body
        for body in collider.bodies
    )
    return replace(collider, bodies=tuple(bodies))


@dataclass(frozen=True, slots=True)
class _FaceJob:
    """One face to be finished with one ball."""

    face: WorkFace
    index: int
    tool: Tool
    aim: Aim
    collider: Collider
    grid: Grid
    over: float
    under: float

    @classmethod
    def of(
        cls, face: WorkFace, index: int, tool: Tool, aim: Aim, collider: Collider, over: float, under: float
    ) -> _FaceJob:
        return cls(face, index, tool, aim, collider, Grid.of(face), over, under)

    def finish(
        self, sweeps: Sequence[Sweep], tools: dict[str, Tool], allowance: float
    ) -> tuple[list[Pass], dict[str, Any]]:
        """The passes over a face, and what is said of it in the summary."""
        grid, radius = self.grid, self.tool.ball_radius
        swept, border = grid.swept(sweeps, tools, allowance)
        needed = grid.needed(swept, border, self.under - POSTING - IN_DOUBT)
        limit = 0.5 * (self.over + self.under)
        needed |= grid.steps(swept, STEP_SHARE * limit)
        fits = grid.curvature * (radius + self.aim.contact) < 1.0
        ball = Ball(radius, self.aim.height, self.aim.contact)
        overlap = OVERLAP * float(line_distance(self.aim.height, radius, 0.0))
        cut = grid.distance(needed) < overlap
        room = max(self.over - POSTING + self.aim.contact - allowance, 0.0)
        sink = grid.sink(swept, cut, self.aim.height, OWN_STEP_SHARE * limit, room)
        touch = max(self.aim.contact - float(sink.max()) - TOUCH, allowance - self.over - FINE)
        collider = _touching(self.collider, touch)
        passes: list[Pass] = []
        gap = swept
        for spot in grid.spots(needed & fits, overlap):
            for item in self._spot(spot, overlap, ball, sink, collider):
                own = self._left(item, allowance)
                gained = (swept > self.under) & (own <= self.under)
                facts = {**item.facts, "gained_area_mm2": float(grid.area[gained].sum())}
                passes.append(replace(item, facts=facts))
                gap = np.minimum(gap, own)
        total = float(grid.area.sum())
        low, high = -self.over, self.under
        with_sweeps, with_both = (grid.area[(g >= low) & (g <= high)].sum() / total for g in (swept, gap))
        left = grid.inside & (gap > high)
        return passes, {
            "coverage_flank": float(with_sweeps),
            "coverage": float(with_both),
            "passes": len(passes),
            "left_mm2": {
                "the ball does not fit": float(grid.area[left & ~fits].sum()),
                "no axis is free": float(grid.area[left & fits].sum()),
            },
        }

    def _spot(self, spot: Flags, overlap: float, ball: Ball, sink: Array, collider: Collider) -> list[Pass]:
        sunk = RegularGridInterpolator((self.grid.u, self.grid.v), sink, bounds_error=False, fill_value=None)

        def offset(places: Array) -> Array:
            return np.asarray(ball.radius + ball.offset - sunk(places))

        lines = streamlines(self.face, self.grid, spot, overlap, ball)
        paths = [path_of(self.face, lines.places(chain), offset) for chain in lines.chains]
        if not paths:
            return []
        whole = Path(*(np.concatenate([getattr(path, name) for path in paths]) for name in ("centre", "normal", "way")))
        axes = Axes.of(collider, self.tool, whole)
        if axes is None:
            return []
        passes = []
        for path in paths:
            axis, free = axes.along(path)
            passes += self._cut(path, axis, free, collider)
        return passes

    def _cut(self, path: Path, axis: Array, free: Flags, collider: Collider) -> list[Pass]:
        """What is free of a path, between its poses too: in pieces where the rest is long or the way over it hits."""
        kept = np.flatnonzero(free)
        centre, axis = path.centre[kept], axis[kept]
        apart = np.linalg.norm(np.diff(centre, axis=0), axis=1)
        cuts = np.flatnonzero((np.diff(kept) > 1) & (apart > BRIDGE))
        # Between poses half a millimetre apart a ball stays on the face it touches; all else may stand anywhere.
        others = replace(collider, bodies=tuple(body for body in collider.bodies if body.name != DESIGN))
        passes = []
        for piece in np.split(np.arange(len(kept)), cuts + 1):
            if len(piece) < 2:
                continue
            p = centre[piece] - self.tool.ball_centre_height * axis[piece]
            for start, end in others.path(p, axis[piece], self.tool).free:
                whole = piece[int(np.ceil(start)) : int(end) + 1]
                if len(whole) > 1:
                    passes.append(self._pass(centre[whole], axis[whole]))
        return passes

    def _pass(self, centre: Array, axis: Array) -> Pass:
        length = float(np.linalg.norm(np.diff(centre, axis=0), axis=1).sum())
        facts = {"length_mm": length, "scallop_um": 1e3 * self.aim.height}
        return Pass(self.index, self.tool.name, centre - self.tool.ball_radius * axis, axis, facts)

    def _left(self, item: Pass, allowance: float) -> Array:
        """Gap less allowance that a pass leaves at the nodes, (U, V) mm; infinite where it is far."""
        grid, radius = self.grid, self.tool.ball_radius
        centre = item.tip + radius * item.axis
        gap = np.full(grid.inside.shape, np.inf)
        gap[grid.inside] = distance_to_polyline(grid.points[grid.inside], centre, radius + 1.0) - radius - allowance
        return gap


def distance_to_polyline(points: Array, corners: Array, reach: float) -> Array:
    """Distance of points (N, 3) to a polyline (M, 3), mm; infinite beyond `reach`."""
    length = np.linalg.norm(np.diff(corners, axis=0), axis=1)
    parts = np.maximum(np.ceil(length / TRACK).astype(np.int64), 1)
    owner = np.repeat(np.arange(len(parts)), parts)
    share = (np.arange(len(owner)) - np.repeat(np.cumsum(parts) - parts, parts)) / parts[owner]
    step = np.diff(corners, axis=0)[owner] / parts[owner][:, None]
    start = corners[owner] + share[:, None] * (corners[owner + 1] - corners[owner])
    # The nearest bit is one of those with the nearest middles.
    found, nearest = cKDTree(start + 0.5 * step).query(points, k=min(4, len(start)), distance_upper_bound=reach)
    found, nearest = found.reshape(len(points), -1), nearest.reshape(len(points), -1)
    distance = np.full(len(points), np.inf)
    for column in range(found.shape[1]):
        hit = np.isfinite(found[:, column])
        own = nearest[hit, column]
        square = np.maximum(np.einsum("ni,ni->n", step[own], step[own]), 1e-300)
        t = np.clip(np.einsum("ni,ni->n", points[hit] - start[own], step[own]) / square, 0.0, 1.0)
        away = np.linalg.norm(points[hit] - start[own] - t[:, None] * step[own], axis=1)
        distance[hit] = np.minimum(distance[hit], away)
    return distance
