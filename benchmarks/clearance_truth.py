"""Clearances by an authority of its own: the collision library FCL, on faceted sections of the tool."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from conflank_cli.tool import Tool

Array = npt.NDArray[np.float64]

# Facets round a section: the chords of a holder of radius 20 stay 0.8 µm inside of it.
FACETS = 360
# Radius of the point of a cone, mm.
POINT = 1e-6


def frusta(tool: Tool) -> list[tuple[str, float, float, float, float]]:
    """Component, heights of both ends and radii there of every section above the ball."""
    rows = [("cone", 0.0, tool.length, tool.r_min, tool.r_max)]
    top = tool.length
    for name, sections in (("shank", tool.shank), ("holder", tool.holder)):
        for part in sections:
            rows.append((name, top, top + part.length, 0.5 * part.diameter_low, 0.5 * part.diameter_high))
            top += part.length
    return rows


def model(vertices: Array, triangles: npt.NDArray[Any]) -> Any:
    """Triangles as FCL has them."""
    import fcl

    made = fcl.BVHModel()
    made.beginModel(len(vertices), len(triangles))
    made.addSubModel(vertices, triangles)
    made.endModel()
    return made


def frustum_model(low: float, high: float, r_low: float, r_high: float) -> Any:
    """A closed frustum of `FACETS` facets about the z axis."""
    angle = 2.0 * np.pi * np.arange(FACETS) / FACETS
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    discs = [np.column_stack([radius * ring, np.full(FACETS, z)]) for radius, z in ((r_low, low), (r_high, high))]
    vertices = np.vstack([*discs, [[0.0, 0.0, low], [0.0, 0.0, high]]])
    here = np.arange(FACETS)
    beside = (here + 1) % FACETS
    bottom, top = np.full(FACETS, 2 * FACETS), np.full(FACETS, 2 * FACETS + 1)
    triangles = np.concatenate(
        [
            np.stack([here, beside, here + FACETS], axis=1),
            np.stack([beside, beside + FACETS, here + FACETS], axis=1),
            np.stack([bottom, beside, here], axis=1),
            np.stack([top, here + FACETS, beside + FACETS], axis=1),
        ]
    )
    return model(vertices, triangles)


@dataclass(frozen=True, slots=True)
class Truth:
    """A mesh that FCL holds poses of a tool against."""

    part: Any
    tool: Tool

    @classmethod
    def of(cls, vertices: Array, triangles: npt.NDArray[Any], tool: Tool) -> Truth:
        """Prepare a mesh, vertices (N, 3) and triangles (M, 3)."""
        import fcl

        return cls(fcl.CollisionObject(model(vertices, triangles), fcl.Transform()), tool)

    def clearance(self, component: str, p: Array, d: Array) -> float:
        """Distance of a component at a pose from the mesh, mm; 0 where they meet."""
        import fcl

        found = np.inf
        for shape, place in self._shapes(component, p, d, 0.0):
            thing = fcl.CollisionObject(shape, place)
            if fcl.collide(thing, self.part, fcl.CollisionRequest(), fcl.CollisionResult()):
                return 0.0
            found = min(found, fcl.distance(thing, self.part, fcl.DistanceRequest(), fcl.DistanceResult()))
        return found

    def reaches(self, component: str, p: Array, d: Array, depth: float) -> bool:
        """Whether the mesh reaches deeper than `depth` mm into a section of a component.

        What lies deeper in a frustum than that is a frustum again, or a cone, and in a ball a ball.
        """
        import fcl

        return any(
            fcl.collide(fcl.CollisionObject(shape, place), self.part, fcl.CollisionRequest(), fcl.CollisionResult())
            for shape, place in self._shapes(component, p, d, depth)
        )

    def _shapes(self, component: str, p: Array, d: Array, depth: float) -> list[tuple[Any, Any]]:
        """The sections of a component at a pose, eroded by `depth`; none where nothing is left of one."""
        import fcl

        tool = self.tool
        if component == "ball":
            if tool.ball_radius <= depth:
                return []
            return [(fcl.Sphere(tool.ball_radius - depth), fcl.Transform(p + tool.ball_centre_height * d))]
        side = np.cross(d, [1.0, 0.0, 0.0] if abs(d[0]) < 0.7 else [0.0, 1.0, 0.0])
        side /= np.linalg.norm(side)
        place = fcl.Transform(np.stack([side, np.cross(d, side), d], axis=1), p)
        made = []
        for name, low, high, r_low, r_high in frusta(tool):
            if name != component:
                continue
            slope = (r_high - r_low) / (high - low)
            inward = depth * np.hypot(1.0, slope)
            low_in, high_in = low + depth, high - depth
            r_low_in = r_low + slope * depth - inward
            r_high_in = r_high - slope * depth - inward
            # An end that is eroded away leaves a point.
            if r_low_in < POINT < r_high_in:
                low_in, r_low_in = high_in - (r_high_in - POINT) / slope, POINT
            if r_high_in < POINT < r_low_in:
                high_in, r_high_in = low_in + (POINT - r_low_in) / slope, POINT
            if high_in > low_in and min(r_low_in, r_high_in) >= POINT:
                made.append((frustum_model(low_in, high_in, r_low_in, r_high_in), place))
        return made
