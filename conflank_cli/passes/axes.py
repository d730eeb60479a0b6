"""Tool axes for passes: which are free at places over a spot, and the smoothest way through them along a path."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, pi, radians, sin, sqrt

import numpy as np
import numpy.typing as npt
from scipy.interpolate import PchipInterpolator
from scipy.spatial import cKDTree

from conflank_cli.geometry.collision import Collider
from conflank_cli.job import Job
from conflank_cli.machine_frame import Frame, machine_of
from conflank_cli.passes.path import Path
from conflank_cli.tool import Tool

Array = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]

# Directions that are tried, evenly over the sphere: some 8 degrees apart.
DIRECTIONS = 600
# The contact keeps this much from the dead centre of the ball, where nothing cuts, and the cone from the face.
DEAD_CENTRE = radians(10.0)
CONE_OFF = radians(3.0)
# Axes keep this much from the machine's singular pose, where its first rotary axis would whip round.
SINGULAR = radians(6.0)
# Distance of the places for which free directions are looked up, and of the stations of a path at which the axis is
# chosen, mm: what is in the way is larger.
NODE = 2.5
STATION = 2.0
# Nothing is gained where obstacles are further from an axis than this; nearer than half the distance of directions
# counts the same.
FAR = radians(30.0)
NEAR = radians(4.0)
# Cost of a turn from station to station, by its square in radians, against that of obstacles, 1 / distance squared.
TURNING = 300.0
# An axis turns by no more than this from station to station.
LARGEST_TURN = radians(25.0)
# Rounds in which axes that hit something between the places looked up are chosen anew.
ROUNDS = 4


def directions() -> Array:
    """Unit vectors (DIRECTIONS, 3) evenly over the sphere: Fibonacci's spiral."""
    k = np.arange(DIRECTIONS) + 0.5
    z = 1.0 - 2.0 * k / DIRECTIONS
    angle = pi * (1.0 + sqrt(5.0)) * k
    ring = np.sqrt(1.0 - z * z)
    return np.stack([ring * np.cos(angle), ring * np.sin(angle), z], axis=1)


def on_ball(normal: Array, axis: Array, tool: Tool, slack: float = 0.0) -> Flags:
    """Whether a contact with these normals is on the ball where it cuts, broadcast over (..., 3); slack in radians."""
    level = np.einsum("...i,...i->...", normal, axis)
    return np.asarray((level <= cos(DEAD_CENTRE - slack)) & (level >= sin(tool.half_angle + CONE_OFF - slack)))


@dataclass(frozen=True, slots=True)
class Axes:
    """Directions for one tool over one spot.

    directions (K, 3): those that are free at some place. free (P, K): at which. cost (P, K): of taking each.
    places: index over the places (P, 3). singular (3,): direction, either way, that the axis keeps off.
    """

    collider: Collider
    tool: Tool
    directions: Array
    free: Flags
    cost: Array
    places: cKDTree
    singular: Array

    @classmethod
    def of(cls, collider: Collider, tool: Tool, path: Path) -> Axes | None:
        """Look up free directions along a path; None where there is nowhere any."""
        chosen = _thinned(path.centre, NODE)
        centre, normal = path.centre[chosen], path.normal[chosen]
        every = directions()
        away = singular_axis(collider.scene.job)
        every = every[np.abs(every @ away) < cos(SINGULAR)]
        place, candidate = np.nonzero(on_ball(normal[:, None], every[None], tool))
        free = np.zeros((len(centre), len(every)), dtype=np.bool_)
        free[place, candidate] = free_poses(collider, tool, centre[place], every[candidate])
        if not free.any():
            return None
        # Where a direction hits something or is none for the ball its neighbours are no good choice either.
        angle = np.arccos(np.clip(every @ every.T, -1.0, 1.0))
        room = np.stack([angle[:, ~row].min(axis=1, initial=FAR) for row in free])
        some = free.any(axis=0)
        with_any = free.any(axis=1)
        return cls(
            collider,
            tool,
            every[some],
            free[with_any][:, some],
            1.0 / np.clip(room[with_any][:, some], NEAR, FAR) ** 2,
            cKDTree(centre[with_any]),
            away,
        )

    def along(self, path: Path) -> tuple[Array, Flags]:
        """Axes (N, 3) along a path, and at which places they are free (N,)."""
        last = float(path.way[-1])
        count = max(int(np.ceil(last / STATION)), 1) + 1
        stations = np.searchsorted(path.way, np.linspace(0.0, last, count)).clip(0, len(path.way) - 1)
        stations = np.unique(stations)
        node = self.places.query(path.centre[stations])[1]
        cost = np.where(self.free[node], self.cost[node], np.inf)
        at_hand = on_ball(path.normal[stations][:, None], self.directions[None], self.tool)
        cost = np.where(at_hand | ~at_hand.any(axis=1, keepdims=True), cost, np.inf)
        cost[~np.isfinite(cost).any(axis=1)] = 1.0
        best: tuple[Array, Flags] | None = None
        for _ in range(ROUNDS):
            chosen = self._smoothest(cost)
            axis = self._between(path, stations, chosen)
            free = free_poses(self.collider, self.tool, path.centre, axis) & on_ball(
                path.normal, axis, self.tool, 0.5 * CONE_OFF
            )
            if best is None or free.sum() > best[1].sum():
                best = axis, free
            if free.all():
                break
            # What led into something at a place is avoided at the stations beside it, with its neighbours.
            beside = np.searchsorted(stations, np.flatnonzero(~free)).clip(1, max(len(stations) - 1, 1))
            for station in np.unique(np.concatenate([beside, beside - 1])).clip(0, len(stations) - 1):
                near = self.directions @ self.directions[chosen[station]] > cos(2.0 * NEAR)
                if np.isfinite(np.where(near, np.inf, cost[station])).any():
                    cost[station, near] = np.inf
        assert best is not None
        return best

    def _smoothest(self, cost: Array) -> IntArray:
        """Direction of each station (M,) for costs (M, K): dynamic programming over turns from station to station."""
        turn = np.arccos(np.clip(self.directions @ self.directions.T, -1.0, 1.0))
        middle = self.directions[:, None] + self.directions[None]
        middle /= np.maximum(np.linalg.norm(middle, axis=2, keepdims=True), 1e-300)
        # Turns too large, or over the singular pose, only where there is no other way.
        price = TURNING * turn**2 + np.where(
            (turn > LARGEST_TURN) | (np.abs(middle @ self.singular) > cos(0.5 * SINGULAR)), 1e4, 0.0
        )
        total, back = cost[0], []
        for row in cost[1:]:
            ways = total[:, None] + price
            origin = ways.argmin(axis=0)
            back.append(origin)
            total = ways[origin, np.arange(len(row))] + row
        chosen = [int(total.argmin())]
        for origin in reversed(back):
            chosen.append(int(origin[chosen[-1]]))
        return np.array(chosen[::-1])

    def _between(self, path: Path, stations: IntArray, chosen: IntArray) -> Array:
        if len(stations) == 1:
            return np.repeat(self.directions[chosen], len(path.way), axis=0)
        axis = PchipInterpolator(path.way[stations], self.directions[chosen])(path.way)
        return np.asarray(axis / np.linalg.norm(axis, axis=1, keepdims=True))


def free_poses(collider: Collider, tool: Tool, centre: Array, axis: Array) -> Flags:
    """Which poses (M,) with the ball at these centres (M, 3) and axes (M, 3) hit nothing and are in reach."""
    return collider.free(centre - tool.ball_centre_height * axis, axis, tool)


def singular_axis(job: Job) -> Array:
    """Unit vector along the machine's first rotary axis, (3,), CAD frame: a tool along it leaves that axis no say."""
    return np.asarray(machine_of(job).rotary[0].direction @ Frame.of(job.setup).rotation)


def _thinned(points: Array, spacing: float) -> IntArray:
    """Indices of one point in each cube of side `spacing`, the one nearest to its middle."""
    cell = np.floor(points / spacing)
    off = np.linalg.norm(points / spacing - cell - 0.5, axis=1)
    order = np.lexsort((off, cell[:, 2], cell[:, 1], cell[:, 0]))
    first = np.concatenate([[True], (np.diff(cell[order], axis=0) != 0.0).any(axis=1)])
    return np.sort(order[first])
