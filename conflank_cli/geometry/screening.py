"""What a motion may not do and is trimmed for: hit the part with cutter, shank or holder, leave the machine's reach."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from conflank_cli.copies import seen_from_first
from conflank_cli.cores import spread
from conflank_cli.geometry.face import CheckMesh, DesignFace
from conflank_cli.geometry.gap import travel
from conflank_cli.geometry.kernels.clearance import poses_clear
from conflank_cli.geometry.outline import COARSE, FINE, Margins, Outline
from conflank_cli.geometry.workface import WorkFace
from conflank_cli.job import Job
from conflank_cli.machine_frame import reachable_axes
from conflank_cli.motion import Motion
from conflank_cli.scene import Scene
from conflank_cli.tool import Tool

Array = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]

# Poses of a motion are judged this far apart, mm, at whatever end of the assembly moves most.
STEP = 1.0
# Poses from which that distance is taken.
SWINGS = 33
# Points are at most this far apart, mm, and thinned to half of that: between them a ball of radius 1.5 in a fillet of
# radius 2 could cut some 15 µm deeper, 30 µm at worst. What is chosen or posted is held against whole triangles.
POINT_SPACING = 0.8
# Foreign bodies can be large; their margins are wider than what is missed between points so far apart, mm.
OBSTACLE_SPACING = 1.0
# Their triangles are cut down to this, mm, and what is out of reach is left away.
LARGEST = 20.0
# Shank and holder keep this much more than their margins, mm, for what lies between the poses and points looked at.
RESERVE = 0.02
# Edge of the cells that points are grouped in, mm: a few hundred cells on a blade, some twenty points in each.
CELL = 2.0
# And of the blocks that cells are grouped in, mm.
BLOCK = 8.0
# Shorter stretches than this are not worth a cut, mm of travel.
SHORTEST = 3.0
# Fewer poses than this are not worth a thread.
WORTH_A_THREAD = 256


@dataclass(frozen=True, slots=True)
class PointCells:
    """Points in cells of CELL, these in blocks of BLOCK, to be passed over as a whole.

    Attributes
    ----------
    points: (N, 3), sorted by cell.
    starts: (C + 1,) where each cell begins among them; centres (C, 3) and radii (C,) of their bounding spheres.
    blocks: (B + 1,) where each block begins among the cells; block_centres (B, 3) and block_radii (B,) likewise.
    """

    points: Array
    starts: IntArray
    centres: Array
    radii: Array
    blocks: IntArray
    block_centres: Array
    block_radii: Array

    @classmethod
    def of(cls, points: Array) -> PointCells:
        """Group points (N, 3)."""
        key = np.floor((points - points.min(axis=0, initial=np.inf)) / CELL).astype(np.int64)
        block = _packed(key // round(BLOCK / CELL))
        _, cell = np.unique(np.stack([block, _packed(key)]), axis=1, return_inverse=True)
        order = np.argsort(cell, kind="stable")
        ordered = np.ascontiguousarray(points[order])
        starts = _starts(cell[order])
        first = starts[:-1]
        blocks = _starts(block[order][first])
        return cls(ordered, starts, *_spheres(ordered, starts), blocks, *_spheres(ordered, starts[blocks]))

    def clear(self, p: Array, d: Array, tool: Tool, margins: Margins, free: BoolArray) -> None:
        """Take those poses (M, 3) out of the free ones (M,) at which a tool comes too near to a point."""
        if not len(self.points):
            return
        outline = Outline.of(tool, margins, float(self.radii.max()), float(self.block_radii.max()))
        poses_clear(
            p, d, self.points, self.starts, self.centres, self.radii,
            self.blocks, self.block_centres, self.block_radii,
            outline.lowest, float(FINE), outline.squares, FINE / COARSE, outline.widest, free,
        )  # fmt: skip


def mesh_points(mesh: CheckMesh, spacing: float) -> Array:
    """Points on a mesh, at most `spacing` mm apart and not much closer, shape (N, 3)."""
    if not len(mesh.triangles):
        return np.zeros((0, 3))
    corners = mesh.vertices[mesh.triangles]
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    counts = np.ceil(edges / spacing).astype(int)
    parts = [mesh.vertices[np.unique(mesh.triangles)]]
    for count in np.unique(counts[counts > 1]):
        weights = np.array([(i, j, count - i - j) for i in range(count + 1) for j in range(count + 1 - i)]) / count
        inner = weights[np.all(weights < 1.0, axis=1)]
        parts.append(np.einsum("wc,tcx->twx", inner, corners[counts == count]).reshape(-1, 3))
    points = np.concatenate(parts)
    key = np.floor(points / (0.5 * spacing)).astype(np.int64)
    _, first = np.unique(_packed(key), return_index=True)
    return points[np.sort(first)]


def _face_points(faces: Sequence[DesignFace], spacing: float) -> Array:
    """Points of faces and of their borders, about `spacing` mm apart, (N, 3)."""
    works = [WorkFace.of(face, 0.0) for face in faces]
    points = [part for work in works for part in (work.samples(spacing).points, work.border(spacing))]
    return np.concatenate([np.zeros((0, 3)), *points])


def _within_reach(scene: Scene, points: Array, spacing: float) -> Array:
    """Points of the obstacles that a tool at the design faces, of which `points` (N, 3) are given, can come near."""
    foreign = scene.check.only(scene.check.face < 0)
    if not len(foreign.triangles):
        return np.zeros((0, 3))
    reach = max(tool.top - tool.tip_height for tool in scene.tools)
    low, high = points.min(axis=0) - reach, points.max(axis=0) + reach
    corners = foreign.vertices[foreign.triangles]
    while True:
        corners = corners[((corners.min(axis=1) <= high) & (corners.max(axis=1) >= low)).all(axis=1)]
        sides = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2)
        long = sides.max(axis=1, initial=0.0) > LARGEST
        if not long.any():
            break
        # Halved across the longest side, and only what is near goes on: a body may be far larger than the part.
        rows, k = np.arange(int(long.sum())), sides[long].argmax(axis=1)
        a, b, c = (corners[long][rows, (k + i) % 3] for i in range(3))
        middle = 0.5 * (a + b)
        halves = [np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)]
        corners = np.concatenate([corners[~long], *halves])
    triangles = np.arange(3 * len(corners), dtype=np.int32).reshape(-1, 3)
    found = mesh_points(CheckMesh(corners.reshape(-1, 3), triangles, triangles[:, 0]), spacing)
    return np.asarray(found[((found >= low) & (found <= high)).all(axis=1)])


def _packed(key: IntArray) -> IntArray:
    """One number for each row of a table of cell indices (N, 3)."""
    low = key.min(axis=0, initial=0)
    size = key.max(axis=0, initial=0) - low + 1
    shifted = key - low
    return np.asarray((shifted[:, 0] * size[1] + shifted[:, 1]) * size[2] + shifted[:, 2])


def _starts(labels: IntArray) -> IntArray:
    """Where runs of equal labels (N,) begin, and where the last ends."""
    return np.flatnonzero(np.r_[True, labels[1:] != labels[:-1], True][: len(labels) + 1])


def _spheres(points: Array, starts: IntArray) -> tuple[Array, Array]:
    """Spheres about the middles of runs of points (N, 3): centres (C, 3), radii (C,)."""
    if len(starts) < 2:
        return np.zeros((0, 3)), np.zeros(0)
    counts = np.diff(starts)
    centres = np.add.reduceat(points, starts[:-1]) / counts[:, None]
    away = np.linalg.norm(points - np.repeat(centres, counts, axis=0), axis=1)
    return centres, np.maximum.reduceat(away, starts[:-1])


@dataclass(frozen=True, slots=True)
class Screen:
    """What every motion is held against.

    Attributes
    ----------
    job: machine and setup: an axis out of reach is a violation too.
    design: points of the design faces; cutter and shank may not overcut them, the holder keeps its margin.
    rest: points of what regions leave of design faces, for which the same holds.
    check: points of the check geometry; the cutter may not overcut it (it is the same part), shank and holder keep
        their margins.
    obstacles: points of foreign bodies where a tool reaches them; every component keeps its margin.
    design_margins, check_margins, obstacle_margins: those distances.
    """

    job: Job
    design: PointCells
    rest: PointCells
    check: PointCells
    obstacles: PointCells
    design_margins: Margins
    check_margins: Margins
    obstacle_margins: Margins

    @classmethod
    @lru_cache(maxsize=2)
    def of(cls, scene: Scene, spacing: float = POINT_SPACING) -> Screen:
        """The screen of a job, with points about `spacing` mm apart; kept for the next stage that asks."""
        scene = seen_from_first(scene)
        points, beyond = _face_points(scene.faces, spacing), _face_points(scene.rest, spacing)
        over, allowance = scene.job.tolerance.overcut, scene.job.tolerance.allowance
        margin = scene.job.obstacles.margin
        return cls(
            scene.job,
            PointCells.of(points),
            PointCells.of(beyond),
            PointCells.of(mesh_points(scene.check.only(scene.check.face >= 0), spacing)),
            PointCells.of(_within_reach(scene, points, max(spacing, OBSTACLE_SPACING))),
            # The shank leaves the top of the cone tangentially: what the cone may overcut, it overcuts too.
            Margins(allowance - over, allowance - over, margin.holder + RESERVE),
            Margins(-over, margin.shank + RESERVE, margin.holder + RESERVE),
            Margins(margin.cutter + RESERVE, margin.shank + RESERVE, margin.holder + RESERVE),
        )

    @property
    def around(self) -> Screen:
        """The same without the design faces: what stands around them."""
        return replace(self, design=PointCells.of(np.zeros((0, 3))))

    def free(self, p: Array, d: Array, tool: Tool, slack: float = 0.0, parallel: bool = False) -> BoolArray:
        """Which poses (M,), axis points p at height 0 and directions d (M, 3), violate nothing.

        `slack` mm of violation is let pass, for poses that are still to be moved.
        """
        free = reachable_axes(self.job, d)
        self._clear(p, d, tool, slack, free, WORTH_A_THREAD if parallel else len(p))
        return free

    def free_along(self, p: Array, d: Array, tool: Tool) -> BoolArray:
        """Which poses (K, S) violate nothing: axis points p at height 0 (K, S, 3), S for each direction of d (K, 3)."""
        count, size = p.shape[:2]
        free = np.repeat(reachable_axes(self.job, d), size)
        self._clear(np.ascontiguousarray(p.reshape(-1, 3)), np.repeat(d, size, axis=0), tool, 0.0, free, count * size)
        return free.reshape(count, size)

    def _clear(self, p: Array, d: Array, tool: Tool, slack: float, free: BoolArray, least: int) -> None:
        """Take poses (M, 3) that hit something out of the free ones (M,); `least` are worth a thread."""

        def run(part: slice) -> None:
            for cells, margins in (
                (self.design, self.design_margins),
                (self.rest, self.design_margins),
                (self.check, self.check_margins),
                (self.obstacles, self.obstacle_margins),
            ):
                cells.clear(p[part], d[part], tool, margins.less(slack), free[part])

        spread(run, len(p), least)

    def allowed(self, motion: Motion, tool: Tool) -> Motion | None:
        """The longest stretch of a motion that violates nothing, or None where there is none worth a cut."""
        # Where the axis swings, the top of the holder travels furthest.
        p, q = motion.ends(np.linspace(0.0, 1.0, SWINGS))
        high = p + tool.top / tool.length * (q - p)
        longest = max(float(np.linalg.norm(np.diff(x, axis=0), axis=1).sum()) for x in (p, high))
        length = travel(motion)
        count = max(int(np.ceil(longest / STEP)), 8) + 1
        times = np.linspace(0.0, 1.0, count)
        p, q = motion.ends(times)
        d = (q - p) / np.linalg.norm(q - p, axis=1)[:, None]
        stretch = longest_run(self.free(p, d, tool))
        if stretch is None:
            return None
        start, end = float(times[stretch[0]]), float(times[stretch[1]])
        if (end - start) * length < SHORTEST:
            return None
        return motion if (start, end) == (0.0, 1.0) else motion.restricted(start, end)


def longest_between(motion: Motion, times: Array) -> Motion | None:
    """The longest stretch of a motion that keeps SHORTEST / 2 mm of travel from every one of `times`, or None."""
    length = travel(motion)
    away = 0.5 * SHORTEST / length
    edges = np.concatenate([[-away], np.sort(times), [1.0 + away]])
    widest = int(np.argmax(np.diff(edges)))
    start, end = float(edges[widest] + away), float(edges[widest + 1] - away)
    return motion.restricted(start, end) if (end - start) * length >= SHORTEST else None


def longest_run(free: BoolArray) -> tuple[int, int] | None:
    """First and last index of the longest run of True, or None."""
    change = np.diff(np.concatenate([[False], free, [False]]).astype(np.int8))
    starts, ends = np.flatnonzero(change == 1), np.flatnonzero(change == -1) - 1
    if not len(starts):
        return None
    best = int(np.argmax(ends - starts))
    return int(starts[best]), int(ends[best])
