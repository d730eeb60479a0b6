"""Streamlines over a spot: parameter lines as far apart as the scallop allows, joined to and fro."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.interpolate import RegularGridInterpolator

from conflank_cli.geometry.workface import WorkFace
from conflank_cli.passes.region import Grid
from conflank_cli.passes.scallop import line_distance

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

# Places at which a line is looked at are this far apart, mm.
LOOK = 0.1
# A line goes on over what needs no pass where that is shorter than this, mm, and from line to line so far on the face.
BRIDGE = 3.0
# A turn from line to line costs as much time as this way, mm.
TURN = 1.0
# The metric between two lines is looked at on both; what it does in between is small at this share.
SHARE = 0.97
# More lines than this over one spot mean that the parameters say nothing about distances.
MOST_LINES = 5000


@dataclass(frozen=True, slots=True)
class Line:
    """A stretch of the parameter line at `across`, from `start` to `end` in the other parameter."""

    across: float
    start: float
    end: float


@dataclass(frozen=True, slots=True)
class Ball:
    """What the distance of lines depends on, mm: radius, height of the scallop, how far the contact is off the face."""

    radius: float
    scallop: float
    offset: float


@dataclass(frozen=True, slots=True)
class Streamlines:
    """Lines over one spot, in chains that are cut without lifting.

    along: 0 where lines run along u, 1 along v. chains: the lines of each in cutting order, each in cutting direction.
    """

    along: int
    chains: tuple[tuple[Line, ...], ...]

    def places(self, chain: Sequence[Line]) -> list[Array]:
        """Corners of a chain in the parameters, one array (2, 2) for each line and each way to the next."""
        corners: list[Array] = []
        for line in chain:
            piece = np.array([[line.start, line.across], [line.end, line.across]])
            piece = piece if self.along == 0 else piece[:, ::-1]
            if corners:
                corners.append(np.stack([corners[-1][1], piece[0]]))
            corners.append(piece)
        return corners


def streamlines(face: WorkFace, grid: Grid, spot: Flags, overlap: float, ball: Ball) -> Streamlines:
    """Lines over a spot and `overlap` mm round it, along u or along v, whichever is the shorter way."""
    away = RegularGridInterpolator((grid.u, grid.v), grid.distance(spot), bounds_error=False, fill_value=None)
    both = [_Family(face, grid, spot, away, overlap, ball, along) for along in (0, 1)]
    laid = [(family, family.lines()) for family in both]
    family, lines = min(laid, key=lambda item: item[0].way(item[1]))
    return Streamlines(family.along, family.chains(lines))


@dataclass(frozen=True, slots=True)
class _Family:
    """Parameter lines one way over a spot; `away` is the distance to it, mm, by parameters."""

    face: WorkFace
    grid: Grid
    spot: Flags
    away: RegularGridInterpolator
    overlap: float
    ball: Ball
    along: int

    def lines(self) -> list[list[Line]]:
        """Stretches of each line that has any, from one side of the spot to the other."""
        grid, along = self.grid, self.along
        axes = (grid.u, grid.v)
        rows = np.flatnonzero(self.spot.any(axis=along))
        low, high = (float(x) for x in axes[1 - along][[rows[0], rows[-1]]])
        per_mm = float(np.mean(np.diff(axes[1 - along]))) / grid.pitch[1 - along]
        limits = axes[1 - along][[0, -1]]
        # A line on the very border of the box is a line on the face.
        low = max(low - self.overlap * per_mm, float(limits[0]))
        high = min(high + self.overlap * per_mm, float(limits[1]))
        columns = np.flatnonzero(self.spot.any(axis=1 - along))
        reach = int(np.ceil(self.overlap / grid.pitch[along])) + 1
        first, last = max(columns[0] - reach, 0), min(columns[-1] + reach, len(axes[along]) - 1)
        count = max(int((last - first) * grid.pitch[along] / LOOK), 8) + 1
        run = np.linspace(axes[along][first], axes[along][last], count)
        found: list[list[Line]] = []
        across = low
        for _ in range(MOST_LINES):
            inside, step = self._look(run, across, per_mm)
            stretches = self._stretches(run, inside, across)
            if stretches:
                found.append(stretches)
            if across >= high:
                break
            # The metric and the curvature at the next line may ask for less.
            step = min(step, max(self._look(run, min(across + step, high), per_mm)[1], 0.5 * step))
            across = min(across + SHARE * step, high)
        return found

    def _look(self, run: Array, across: float, per_mm: float) -> tuple[Flags, float]:
        """Which places of a line are to be cut, and how far in the parameter the next line may be."""
        places = np.stack([run, np.full(len(run), across)], axis=1)
        places = places if self.along == 0 else np.ascontiguousarray(places[:, ::-1])
        # Lines run out over the trim, where the surface goes on: a slanted border is not left in steps.
        inside = np.asarray(self.away(places) <= self.overlap)
        if not inside.any():
            return inside, self.overlap * per_mm
        own = places[inside]
        frame = self.face.projector.evaluate(own[:, 0], own[:, 1])
        feed, cross = frame[:, 1 + self.along], frame[:, 2 - self.along]
        forth = feed / np.linalg.norm(feed, axis=1, keepdims=True)
        aside = cross - np.einsum("ni,ni->n", cross, forth)[:, None] * forth
        speed = np.linalg.norm(aside, axis=1)
        normal = self.face.sense * np.cross(frame[:, 1], frame[:, 2])
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        bend = -curvature_along(frame, normal, aside)
        # Lines are laid on the face; what they leave is on the face offset by what the contact is off it.
        grown = 1.0 + bend * self.ball.offset
        distance = line_distance(self.ball.scallop, self.ball.radius, bend / grown) / grown
        return inside, float(np.min(distance / speed))

    def _stretches(self, run: Array, inside: Flags, across: float) -> list[Line]:
        edges = np.flatnonzero(np.diff(np.concatenate([[False], inside, [False]]).astype(np.int8)))
        half = 0.5 * (run[1] - run[0])
        most = BRIDGE / LOOK
        stretches: list[Line] = []
        before = 0
        for start, end in zip(edges[::2], edges[1::2] - 1, strict=True):
            a, b = float(max(run[start] - half, run[0])), float(min(run[end] + half, run[-1]))
            if stretches and (start - before) <= most:
                stretches[-1] = Line(across, stretches[-1].start, b)
            else:
                stretches.append(Line(across, a, b))
            before = end
        return stretches

    def way(self, lines: list[list[Line]]) -> float:
        """Length of all lines and turns, about, mm."""
        scale = self.grid.pitch[self.along] / float(np.mean(np.diff((self.grid.u, self.grid.v)[self.along])))
        return sum(abs(line.end - line.start) * scale + TURN for row in lines for line in row)

    def chains(self, lines: list[list[Line]]) -> tuple[tuple[Line, ...], ...]:
        """Lines joined to and fro: each goes on from a chain that ended beside it, within `BRIDGE` of its end."""
        done: list[list[Line]] = []
        open_: list[list[Line]] = []
        for row in lines:
            rest = list(row)
            grown: list[list[Line]] = []
            for chain in open_:
                at = (chain[-1].end, chain[-1].across)
                ways = [
                    (self._apart(at, (a, line.across)), k, flipped)
                    for k, line in enumerate(rest)
                    for flipped, a in ((False, line.start), (True, line.end))
                ]
                nearest = min(ways, default=(np.inf, 0, False))
                if nearest[0] <= BRIDGE:
                    line = rest.pop(nearest[1])
                    chain.append(Line(line.across, line.end, line.start) if nearest[2] else line)
                    grown.append(chain)
                else:
                    done.append(chain)
            open_ = grown + [[line] for line in rest]
        return tuple(tuple(chain) for chain in (*done, *open_))

    def _apart(self, one: tuple[float, float], other: tuple[float, float]) -> float:
        places = np.array([one, other]) if self.along == 0 else np.array([one, other])[:, ::-1]
        points = self.face.projector.evaluate(places[:, 0], places[:, 1])[:, 0]
        return float(np.linalg.norm(points[1] - points[0]))


def curvature_along(frame: Array, normals: Array, direction: Array) -> Array:
    """Normal curvature (N,) of the face along tangent directions (N, 3), positive where it bends towards the cutter.

    frame (N, 6, 3) holds S, Su, Sv, Suu, Suv, Svv.
    """
    e, f, g = (np.einsum("ni,ni->n", frame[:, a], frame[:, b]) for a, b in ((1, 1), (1, 2), (2, 2)))
    x, y = (np.einsum("ni,ni->n", direction, frame[:, k]) for k in (1, 2))
    det = np.maximum(e * g - f * f, 1e-300)
    a, b = (g * x - f * y) / det, (e * y - f * x) / det
    second = [np.einsum("ni,ni->n", frame[:, k], normals) for k in (3, 4, 5)]
    form = second[0] * a * a + 2.0 * second[1] * a * b + second[2] * b * b
    return np.asarray(form / np.maximum(e * a * a + 2.0 * f * a * b + g * b * b, 1e-300))
