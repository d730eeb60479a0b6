"""Exact collision: cutter, shank and holder against triangles, at poses and along whole motions.

`Screen` looks at points and poses some distance apart and is quick; this looks at whole triangles, and at a motion
between its poses too, and is for what may be chosen and for what is posted.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from conflank_cli.copies import seen_from_first
from conflank_cli.cores import spread
from conflank_cli.geometry.face import CheckMesh
from conflank_cli.geometry.face_mesh import face_mesh, mesh_sags, open_edges
from conflank_cli.geometry.gap import polynomials_of, travel
from conflank_cli.geometry.kernels.collision import (
    crossings,
    grow_tree,
    hits_along,
    least_along,
    poses_free,
    poses_least,
)
from conflank_cli.geometry.outline import Margins, assembly
from conflank_cli.geometry.screening import SHORTEST
from conflank_cli.machine_frame import reachable_axes
from conflank_cli.motion import Motion
from conflank_cli.scene import Scene
from conflank_cli.tool import Tool

Array = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]

COMPONENTS = ("ball", "cone", "shank", "holder")
DESIGN = "design face"
# Column of the sections: with which sign the sag of a triangle counts.
SAG_SIGN = 7
# A motion is looked at until what cannot be told moves less than this, mm; what hits is trimmed to COARSE.
FINE, COARSE = 0.001, 0.05
# What a motion keeps more than its margins, mm: what posting changes at cutter and shank, and at the holder further up.
RESERVE, HOLDER_RESERVE = 0.0005, 0.003
# The least clearance along a motion is known within this, mm.
RESOLUTION = 0.005
# Triangles of the design faces are off them by about so much, mm: they are cut to micrometres.
DESIGN_DEFLECTION = 0.001
# Of the faces beside them as well, as far as a cutter reaches from a design face.
PART_DEFLECTION = 0.002
# Beyond this a clearance does not matter and is not looked for, mm.
REACH = 10.0
# Stretches of hits of one motion; more would be joined.
MOST_HITS = 1024
# Fewer poses than this are not worth a thread.
WORTH_A_THREAD = 64
# A direction that no edge of a mesh is likely to be along.
RAY = np.array([0.5377, 0.2147, 0.8154])


class Tree(NamedTuple):
    """Triangles in a tree of bounding boxes that halves their number at each node, numbered in preorder.

    corners (T, 3, 3) mm and sag (T,) mm of the triangles in the tree's order; order (T,) their numbers before.
    first, last (M,): the triangles of a node; right (M,): its second child (the first is the next node), -1 for a leaf.
    centre (M, 3) of its box, half (M, 3) of the box's sides, radius (M,) of a sphere; sags (M,): the largest sag in it.
    """

    corners: Array
    sag: Array
    order: IntArray
    first: IntArray
    last: IntArray
    right: IntArray
    centre: Array
    half: Array
    radius: Array
    sags: Array


@dataclass(frozen=True, slots=True)
class Body:
    """Triangles that keep the same margins.

    Attributes
    ----------
    name: what it is, for messages: "design face", "rest" of design faces outside their regions, "part" or "obstacle".
    tree: the triangles; their sag counts against everything, but on design faces, which it is meant to touch, for the
        cutter.
    face: (T,) CAD face number of each triangle in the tree's order; obstacles count down from -1.
    margins: distances to keep, mm.
    closed: obstacles that have an inside, by number.
    """

    name: str
    tree: Tree
    face: IntArray
    margins: Margins
    closed: tuple[int, ...] = ()

    @classmethod
    def of(cls, name: str, mesh: CheckMesh, margins: Margins, sag: Array | None = None) -> Body:
        """Grow the tree of a mesh; `sag` (M,) as `mesh_sags` has it if not given."""
        order, tree = _grown(mesh, mesh_sags(mesh) if sag is None else sag)
        face = mesh.face[order].astype(np.int64)
        foreign = [int(number) for number in np.unique(face) if number < 0]
        closed = tuple(number for number in foreign if not open_edges(mesh.only(mesh.face == number)))
        return cls(name, tree, face, margins, closed)

    def felt(self, sections: Array) -> Array:
        """Sections (S, 8) of a tool as this body is held against them."""
        if self.name == DESIGN:
            return sections
        sections = sections.copy()
        sections[:, SAG_SIGN] = -1.0
        return sections


class Reason(NamedTuple):
    """What is nearest to one component, or nearest to what it may not pass.

    Attributes
    ----------
    component: "ball", "cone", "shank" or "holder".
    body: what it is near, by the name of the body.
    face: its CAD face number; -1 - k for obstacle k.
    place: (3,) where on it, mm.
    clearance: signed distance, mm, sag counted; inside, the depth as a negative number.
    limit: the least that is allowed, mm.
    time: t of the motion or path, or the number of the pose.
    """

    component: str
    body: str
    face: int
    place: Array
    clearance: float
    limit: float
    time: float

    @property
    def slack(self) -> float:
        """How much more than the least it is, mm; negative where it is too near."""
        return self.clearance - self.limit


@dataclass(frozen=True, slots=True)
class Clearances:
    """Clearance of each component (in the order of `COMPONENTS`) at M poses, to what leaves it the least slack.

    slack, clearance, limit (M, 4) mm, infinite (limit 0) where nothing is within `REACH`; body (M, 4) index into those
    of the collider or -1; face (M, 4); place (M, 4, 3) mm.
    """

    slack: Array
    clearance: Array
    limit: Array
    body: IntArray
    face: IntArray
    place: Array


@dataclass(frozen=True, slots=True)
class Course:
    """What there is to say of a motion or path.

    free: intervals (N, 2) of its time, in order, in which every component keeps its limit everywhere between poses.
    length: time at its end; 1 for a motion, the number of stretches for a path.
    """

    free: Array
    length: float

    @property
    def clear(self) -> bool:
        """Whether all of it is free."""
        return bool(len(self.free) == 1 and self.free[0, 0] <= 0.0 and self.free[0, 1] >= self.length)


@dataclass(frozen=True, slots=True)
class Collider:
    """Everything a tool may run into.

    Attributes
    ----------
    scene: the machine's reach and the setup are taken from it.
    bodies: design faces, what regions leave of them, the rest of the part, obstacles; those that there are.
    names: of the obstacles.
    """

    scene: Scene
    bodies: tuple[Body, ...]
    names: tuple[str, ...] = ()

    @classmethod
    @lru_cache(maxsize=1)
    def of(cls, scene: Scene) -> Collider:
        """All bodies of a scene with the margins of its job; kept for the next stage that asks."""
        scene = seen_from_first(scene)
        job = scene.job
        over, allowance, margin = job.tolerance.overcut, job.tolerance.allowance, job.obstacles.margin
        bodies = []
        if scene.faces:
            pieces = [face_mesh(face, DESIGN_DEFLECTION) for face in scene.faces]
            # The shank leaves the top of the cone tangentially: what the cone may overcut, it overcuts too. What the
            # cutter leaves is judged by the swept gap; here what cannot be told between poses is let pass.
            limits = Margins(allowance - over - FINE, allowance - over, margin.holder + HOLDER_RESERVE)
            sag = np.concatenate([sag for _, sag in pieces])
            bodies.append(Body.of(DESIGN, CheckMesh.joined([mesh for mesh, _ in pieces]), limits, sag))
        if scene.rest:
            pieces = [face_mesh(face, DESIGN_DEFLECTION) for face in scene.rest]
            keep = RESERVE + allowance - over
            limits, sag = Margins(keep, keep, margin.holder + HOLDER_RESERVE), np.concatenate([s for _, s in pieces])
            bodies.append(Body.of("rest", CheckMesh.joined([mesh for mesh, _ in pieces]), limits, sag))
        own, sag = _part_mesh(scene)
        if len(own.triangles):
            limits = Margins(RESERVE - over, margin.shank + RESERVE, margin.holder + HOLDER_RESERVE)
            bodies.append(Body.of("part", own, limits, sag))
        foreign = scene.check.only(scene.check.face < 0)
        if len(foreign.triangles):
            limits = Margins(margin.cutter + RESERVE, margin.shank + RESERVE, margin.holder + HOLDER_RESERVE)
            bodies.append(Body.of("obstacle", foreign, limits))
        return cls(scene, tuple(bodies), tuple(job.obstacles.meshes))

    def poses(self, p: Array, d: Array, tool: Tool, reach: float = REACH) -> Clearances:
        """Clearances at poses, axis points p at height 0 and unit directions d (M, 3), where slack is below `reach`.

        Where the assembly touches nothing but is inside of a closed obstacle, the clearance to it is that negative.
        """
        count = len(p)
        found = Clearances(
            np.full((count, 4), reach), np.full((count, 4), np.inf), np.zeros((count, 4)),
            np.full((count, 4), -1, dtype=np.int64), np.zeros((count, 4), dtype=np.int64), np.zeros((count, 4, 3)),
        )  # fmt: skip
        p, d = np.ascontiguousarray(p), np.ascontiguousarray(d)
        sections, component = sections_of(tool)

        def run(part: slice) -> None:
            own = Clearances(*(getattr(found, name)[part] for name in Clearances.__slots__))
            for number, body in enumerate(self.bodies):
                _nearest(number, body, p[part], d[part], tool, sections, component, own)

        spread(run, count, WORTH_A_THREAD)
        found.slack[found.body < 0] = np.inf
        return found

    def free(self, p: Array, d: Array, tool: Tool) -> BoolArray:
        """Which poses (M,), axis points p at height 0 and directions d (M, 3), keep every limit and are in reach."""
        p, d = np.ascontiguousarray(p), np.ascontiguousarray(d)
        free = reachable_axes(self.scene.job, d)
        sections, component = sections_of(tool)
        for body in self.bodies:
            poses_free(body.tree, p, d, body.felt(sections), _limits(body.margins, component), free)
            free &= ~self._within(body, p, d, tool)
        return free

    def motion(self, motion: Motion, tool: Tool, design: bool = True) -> Course:
        """The times at which a motion is free, between its poses too.

        With `design` off the cutter is not held against the design faces: what it leaves on them is judged by its swept
        gap. Rotary ranges of the machine are looked at where `allowed` is asked.
        """
        return self._course(*polynomials_of(motion), tool, design)

    def path(self, p: Array, d: Array, tool: Tool) -> Course:
        """The times (number of the pose, and the share of the way to the next) at which a path of poses is free.

        Between poses (N, 3) the point at height 0 goes straight and the axis swings in its plane.
        """
        return self._course(*_straight(p, d, tool), tool, True)

    def least(self, motion: Motion, tool: Tool, design: bool = True) -> tuple[Reason, ...]:
        """For each component the place and time at which a motion leaves it the least slack, within `RESOLUTION`."""
        return self._least(*polynomials_of(motion), tool, design)

    def least_on_path(self, p: Array, d: Array, tool: Tool) -> tuple[Reason, ...]:
        """The same for a path of poses (N, 3), as `path` has it."""
        return self._least(*_straight(p, d, tool), tool, True)

    def allowed(self, motion: Motion, tool: Tool) -> Motion | None:
        """The longest stretch of a motion on which nothing is hit, or None where there is none worth a cut.

        The cutter's overcut of the design faces is not judged here.
        """
        course = self.motion(motion, tool, design=False)
        if course.clear:
            return motion
        if not len(course.free):
            return None
        start, end = course.free[np.argmax(np.diff(course.free, axis=1)[:, 0])]
        if (end - start) * travel(motion) < SHORTEST:
            return None
        return motion.restricted(float(start), float(end))

    def describe(self, reason: Reason) -> str:
        """A reason as a sentence."""
        target = f"face {reason.face}" if reason.face >= 0 else f"obstacle {self.names[-1 - reason.face]}"
        return f"{reason.component} {reason.clearance:.3f} mm from {target}, {reason.limit:.3f} mm is the least allowed"

    def _bodies(self, tool: Tool, design: bool) -> list[tuple[int, Body, Array, IntArray, Array]]:
        """Number, body, sections, components and limits of everything to be held against each other."""
        sections, component = sections_of(tool)
        chosen = []
        for number, body in enumerate(self.bodies):
            kept = np.ones(len(component), dtype=np.bool_)
            if body.name == DESIGN and not design:
                kept = component >= COMPONENTS.index("shank")
            if kept.any():
                limits = _limits(body.margins, component)
                chosen.append((number, body, body.felt(sections)[kept], component[kept], limits[kept]))
        return chosen

    def _course(self, polynomials: Array, breaks: Array, tool: Tool, design: bool) -> Course:
        free = np.array([[breaks[0], breaks[-1]]])
        hits = np.empty((MOST_HITS, 2))
        for _, body, sections, _, limits in self._bodies(tool, design):
            count = hits_along(body.tree, polynomials, breaks, sections, limits, COARSE, FINE, hits)
            free = _without(free, hits[:count])
        # A stretch that touches nothing is inside of a closed obstacle as a whole, or outside.
        for body in self.bodies:
            if body.closed and len(free):
                middle = _poses_at(polynomials, breaks, free.mean(axis=1))
                free = free[~self._within(body, *middle, tool)]
        return Course(free, float(breaks[-1]))

    def _least(self, polynomials: Array, breaks: Array, tool: Tool, design: bool) -> tuple[Reason, ...]:
        slack, value, time = np.full(4, REACH), np.full(4, np.inf), np.zeros(4)
        triangle, place = np.full(4, -1, dtype=np.int64), np.zeros((4, 3))
        nearest: dict[int, Reason] = {}
        for _, body, sections, component, limits in self._bodies(tool, design):
            triangle[:] = -1
            least_along(
                body.tree, polynomials, breaks, sections, component, limits, RESOLUTION,
                slack, value, time, triangle, place,
            )  # fmt: skip
            for c in np.flatnonzero(triangle >= 0):
                nearest[int(c)] = Reason(
                    COMPONENTS[c], body.name, int(body.face[triangle[c]]), place[c].copy(), float(value[c]),
                    float(value[c] - slack[c]), float(time[c]),
                )  # fmt: skip
        return tuple(nearest[c] for c in sorted(nearest))

    def _within(self, body: Body, p: Array, d: Array, tool: Tool) -> BoolArray:
        """At which poses the tip is inside of a closed obstacle."""
        return np.asarray([bool(_around(body, point, direction, tool)) for point, direction in zip(p, d, strict=True)])


def _part_mesh(scene: Scene) -> tuple[CheckMesh, Array]:
    """Triangles of the part beside its design faces, and how far the faces may be off them, (M,) mm.

    Where a cutter reaches from a design face they are made anew from the CAD surfaces, as close as overcut is counted.
    """
    own = scene.check.only(scene.check.face >= 0)
    corners = np.concatenate([np.zeros((0, 3)), *(face.surface.poles.reshape(-1, 3) for face in scene.faces)])
    if not len(own.triangles) or not len(corners):
        return own, mesh_sags(own)
    reach = max(tool.length + tool.r_max for tool in scene.tools)
    low, high = corners.min(axis=0) - reach, corners.max(axis=0) + reach

    def is_near(number: int) -> bool:
        places = own.vertices[own.triangles[own.face == number]].reshape(-1, 3)
        return len(places) > 0 and bool((places.min(axis=0) <= high).all() and (places.max(axis=0) >= low).all())

    fine = [face for face in scene.neighbours if is_near(face.number)]
    rest = own.only(~np.isin(own.face, [face.number for face in fine]))
    pieces = [(rest, mesh_sags(rest)), *(face_mesh(face, PART_DEFLECTION) for face in fine)]
    return CheckMesh.joined([mesh for mesh, _ in pieces]), np.concatenate([sag for _, sag in pieces])


def sections_of(tool: Tool) -> tuple[Array, IntArray]:
    """The assembly as the kernels read it: rows (S, 8), and the component (S,) each belongs to."""
    rows = [(tool.ball_centre_height, tool.ball_centre_height, tool.ball_radius, tool.ball_radius, 0.0, 1.0, 1.0, 1.0)]
    component = [0]
    table, names = assembly(tool)
    for (low, high, r_low, r_high), name in zip(table, names, strict=True):
        slant = np.hypot(high - low, r_high - r_low)
        sign = 1.0 if name == "cutter" else -1.0
        rows.append((low, high, r_low, r_high, (r_high - r_low) / slant, (high - low) / slant, 0.0, sign))
        component.append(COMPONENTS.index("cone" if name == "cutter" else name))
    return np.array(rows), np.array(component, dtype=np.int64)


def _limits(margins: Margins, component: IntArray) -> Array:
    return np.array([margins.cutter, margins.cutter, margins.shank, margins.holder])[component]


def _nearest(
    number: int, body: Body, p: Array, d: Array, tool: Tool, sections: Array, component: IntArray, found: Clearances
) -> None:
    """Take over what one body leaves less slack than what was found so far."""
    triangle = np.full(found.face.shape, -1, dtype=np.int64)
    limits = _limits(body.margins, component)
    felt = body.felt(sections)
    poses_least(body.tree, p, d, felt, component, limits, found.slack, found.clearance, triangle, found.place)
    nearer = triangle >= 0
    found.body[nearer] = number
    found.face[nearer] = body.face[triangle[nearer]]
    found.limit[nearer] = (found.clearance - found.slack)[nearer]
    if body.closed:
        for k, (point, direction) in enumerate(zip(p, d, strict=True)):
            around = _around(body, point, direction, tool)
            for c in np.flatnonzero(np.isin(found.face[k], around) & (found.clearance[k] > 0.0)):
                found.slack[k, c] -= 2.0 * found.clearance[k, c]
                found.clearance[k, c] *= -1.0
            for c in np.flatnonzero(found.body[k] < 0) if around else ():
                # So deep inside that the surface is out of reach.
                found.slack[k, c], found.clearance[k, c] = -np.inf, -np.inf
                found.body[k, c], found.face[k, c], found.place[k, c] = number, around[0], point
                found.limit[k, c] = _limits(body.margins, np.array([c]))[0]


def _around(body: Body, p: Array, d: Array, tool: Tool) -> list[int]:
    """Closed obstacles that the centre of the ball is inside of."""
    if not body.closed:
        return []
    most = -int(body.face.min())
    asked = np.zeros(most, dtype=np.bool_)
    asked[[-1 - number for number in body.closed]] = True
    count = np.zeros(most, dtype=np.int64)
    centre = p + tool.ball_centre_height * d
    ray = RAY / np.linalg.norm(RAY)
    crossings(body.tree, *centre, *ray, -1 - body.face, asked, count)
    return [-1 - int(k) for k in np.flatnonzero(count % 2)]


def _straight(p: Array, d: Array, tool: Tool) -> tuple[Array, Array]:
    """A path of poses as spans of polynomials (N - 1, 4, 6) with their breaks."""
    ends = np.hstack([p, p + tool.length * d])
    polynomials = np.zeros((len(p) - 1, 4, 6))
    polynomials[:, 0], polynomials[:, 1] = ends[:-1], np.diff(ends, axis=0)
    return polynomials, np.arange(len(p), dtype=np.float64)


def _poses_at(polynomials: Array, breaks: Array, t: Array) -> tuple[Array, Array]:
    """Poses (M, 3), (M, 3) of spans of polynomials at times."""
    span = np.clip(np.searchsorted(breaks, t, side="right") - 1, 0, len(polynomials) - 1)
    s = ((t - breaks[span]) / np.diff(breaks)[span])[:, None]
    own = polynomials[span]
    ends = own[:, 0] + s * (own[:, 1] + s * (own[:, 2] + s * own[:, 3]))
    d = ends[:, 3:] - ends[:, :3]
    return np.ascontiguousarray(ends[:, :3]), d / np.linalg.norm(d, axis=1)[:, None]


def _without(free: Array, hits: Array) -> Array:
    """Intervals (N, 2) less other intervals (H, 2), both in order."""
    left = []
    for start, end in free:
        for a, b in hits:
            if b <= start or a >= end:
                continue
            if a > start:
                left.append((start, a))
            start = max(start, b)
        if start < end:
            left.append((start, end))
    return np.array(left).reshape(-1, 2)


def _grown(mesh: CheckMesh, sag: Array) -> tuple[IntArray, Tree]:
    """The order of a mesh's triangles in their tree, and the tree."""
    corners = np.ascontiguousarray(mesh.vertices[mesh.triangles.astype(np.int64)])
    count = len(corners)
    order = np.arange(count)
    first, last, right = (np.zeros(2 * count + 1, dtype=np.int64) for _ in range(3))
    centre, half = np.zeros((2 * count + 1, 3)), np.zeros((2 * count + 1, 3))
    radius, sags = np.zeros(2 * count + 1), np.zeros(2 * count + 1)
    nodes = first, last, right, centre, half, radius, sags
    size = grow_tree(corners, corners.mean(axis=1), sag, order, *nodes) if count else 0
    tree = Tree(
        np.ascontiguousarray(corners[order]), np.ascontiguousarray(sag[order]), order, first[:size].copy(),
        last[:size].copy(), right[:size].copy(), centre[:size].copy(), half[:size].copy(), radius[:size].copy(),
        sags[:size].copy(),
    )  # fmt: skip
    return order, tree
