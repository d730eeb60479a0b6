"""The reachability map: how well a cone can touch a face at every point of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from conflank_cli.cores import spread
from conflank_cli.detection.line_field import seed_lines, turned_lines
from conflank_cli.detection.tracing import sphere_heights
from conflank_cli.geometry.kernels.reach import NEAR_LOOP, reach_errors
from conflank_cli.geometry.workface import FaceSamples, WorkFace, loop_vertices
from conflank_cli.tool import Tool

Array = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

# A line counts where it touches along this share of the flute at least: less is a cut with a point.
ENGAGED = 1.0 / 3.0
# Spheres along the flute: more than a sequence is traced with, for a share of them is what is asked about.
SPHERES = 24
# Contact heights that are tried first, as shares of the flute. The outer ones touch near the edge of a face.
CONTACTS = (0.04, 0.36, 0.64, 0.96)
# Nothing more is tried at a point where the error is below this, mm: no tolerance is so narrow.
NEEDLESS = 5e-4
# A neighbour's line is tried where its error is below this share of the point's own; so many times at most it is handed
# on.
WORTH, ROUNDS = 0.7, 12
# Directions are tried whose bend alone would leave up to so many times the error found (and at most MOST_FOUND, mm, of
# that): by so much do higher orders make up for the second.
MARGIN, MOST_FOUND = 10.0, 0.05
# So many spheres up and down the flute a line is slid in its own direction.
SLIDES = (-6, -4, -2, 2, 4, 6)


@dataclass(frozen=True, slots=True)
class Reachability:
    """The least axis error of any line through each point of a face.

    Attributes
    ----------
    samples: the points, with areas.
    error: (N,) mm; inf where no line touches along enough of the flute.
    p, d: (N, 3) that line: its point in the plane of r_min, mm, and its direction from tip to spindle.
    height: (N,) mm, height on the axis of the sphere that touches at the point.
    footpoints: how many were computed.
    """

    samples: FaceSamples
    error: Array
    p: Array
    d: Array
    height: Array
    footpoints: int

    def share(self, tolerance: float) -> float:
        """Share of the area that some line reaches within `tolerance` mm."""
        areas = self.samples.areas
        return float(areas[self.error <= tolerance].sum() / areas.sum())


def reachability(
    face: WorkFace, tool: Tool, samples: FaceSamples, allowance: float = 0.0, engaged: float = ENGAGED
) -> Reachability:
    """Find the best line through every sample that touches along the share `engaged` of the flute at least.

    A line touches the face at a point with one of its spheres, within its error. Its axis error is the least e such
    that no sphere whose foot is on the face overcuts by more than e, and a run of spheres that holds the touching one
    and is that share of the flute long stays within e. It bounds what selection can reach with patches that are not
    narrower than that. Collision and the machine's reach are not looked at.
    """
    search = _Search.of(face, tool, samples, allowance, engaged)
    places = search.heights[np.round(np.array(CONTACTS) * (len(search.heights) - 1)).astype(np.int64)]
    seeds = seed_lines(face, tool, samples.uv, places, allowance)
    search.refine(seeds.sample, seeds.d, search.sphere(seeds.height))
    search.hand_on()
    short = np.flatnonzero(search.error > NEEDLESS)
    if len(short):
        bend = search.bend(MARGIN * np.minimum(search.error[short], MOST_FOUND))
        turned = turned_lines(face, tool, samples.uv[short], places, bend, allowance)
        search.refine(short[turned.sample], turned.d, search.sphere(turned.height))
        search.hand_on()
    search.slide()
    search.hand_on()
    lines = search.lines
    return Reachability(
        samples, search.error, lines[:, :3].copy(), lines[:, 3:].copy(), search.height, int(search.footpoints.sum())
    )


@dataclass(frozen=True, slots=True)
class _Search:
    """The best lines so far, and what improves them.

    Attributes
    ----------
    raster, vertices, loops: the trim, as `reach_errors` wants it.
    heights, radii: (J,) mm, of the spheres.
    least: spheres that have to touch.
    error (N,), lines (N, 6): p and d, height (N,), footpoints (N,): changed in place.
    """

    face: WorkFace
    samples: FaceSamples
    raster: Array
    vertices: Array
    loops: IntArray
    heights: Array
    radii: Array
    least: int
    error: Array
    lines: Array
    height: Array
    footpoints: IntArray

    @classmethod
    def of(cls, face: WorkFace, tool: Tool, samples: FaceSamples, allowance: float, engaged: float) -> _Search:
        heights = sphere_heights(tool, SPHERES)
        count = len(samples.uv)
        return cls(
            face,
            samples,
            _loops_marked(face.raster),
            *loop_vertices(face.face),
            heights,
            np.asarray(tool.sphere_radius(heights) + allowance),
            max(round(engaged * len(heights)), 1),
            np.full(count, np.inf),
            np.full((count, 6), np.nan),
            np.full(count, np.nan),
            np.zeros(count, dtype=np.int64),
        )

    def sphere(self, height: Array) -> IntArray:
        """Numbers of the spheres at heights (M,)."""
        return np.searchsorted(self.heights, height - 1e-9).astype(np.int64)

    def bend(self, error: Array) -> Array:
        """|wᵀ H w| that alone leaves `error` mm.

        A parabola over a run of length 2 a, shifted to leave least, is off by |wᵀ H w| a² / 4.
        """
        half_run = 0.5 * self.least * float(self.heights[1] - self.heights[0])
        return 4.0 * error / half_run**2

    def refine(self, sample: IntArray, d: Array, contact: IntArray) -> None:
        """Start from directions d (M, 3) at samples (M,), the spheres `contact` (M,) touching."""
        order = np.lexsort((contact, sample))
        starts = np.searchsorted(sample[order], np.arange(len(self.error) + 1)).astype(np.int64)
        directions, contacts, samples = d[order], contact[order], self.samples

        def run(part: slice) -> None:
            reach_errors(
                *self.face.projector.spans, self.face.sense, self.raster, self.vertices, self.loops,
                samples.points[part], samples.normals[part], samples.uv[part], starts[part.start : part.stop + 1],
                directions, contacts, self.heights, self.radii, self.least,
                self.error[part], self.lines[part], self.height[part], self.footpoints[part],
            )  # fmt: skip

        spread(run, len(self.error))

    def hand_on(self) -> None:
        """Try at each sample what its neighbours have found: a line touches all the points that its run passes."""
        better = np.ones(len(self.error), dtype=np.bool_)
        for _ in range(ROUNDS):
            sample, giver = self._neighbours(better)
            if not len(sample):
                return
            before = self.error.copy()
            d = self.lines[giver, 3:]
            centres = self.lines[giver, None, :3] + self.heights[:, None] * d[:, None]
            touching = centres - self.radii[:, None] * self.samples.normals[sample, None]
            off = np.linalg.norm(touching - self.samples.points[sample, None], axis=2)
            self.refine(sample, d, np.argmin(off, axis=1))
            better = self.error < before

    def _neighbours(self, better: npt.NDArray[np.bool_]) -> tuple[IntArray, IntArray]:
        """Pairs (sample, neighbour) where the neighbour has become better and its line is worth a try."""
        rows, columns = self.samples.shape
        index = np.full((rows + 2, columns + 2), -1, dtype=np.int64)
        row, column = self.samples.cell.T + 1
        index[row, column] = np.arange(len(self.error))
        samples, givers = [], []
        for i, j in ((-1, 0), (1, 0), (0, -1), (0, 1)):
            giver = index[row + i, column + j]
            worth = better[giver] & (self.error[giver] < WORTH * self.error)
            worth &= (giver >= 0) & (self.error > NEEDLESS)
            samples.append(np.flatnonzero(worth))
            givers.append(giver[worth])
        return np.concatenate(samples), np.concatenate(givers)

    def slide(self) -> None:
        """Let other spheres of each line touch at its point: the window then lies elsewhere on the face."""
        short = np.flatnonzero((self.error > NEEDLESS) & np.isfinite(self.error))
        contact = self.sphere(self.height[short])[:, None] + np.array(SLIDES)
        there = (contact >= 0) & (contact < len(self.heights))
        sample = np.broadcast_to(short[:, None], contact.shape)[there]
        self.refine(sample, self.lines[sample, 3:], contact[there])


def _loops_marked(raster: Array) -> Array:
    """The raster of a trim with NEAR_LOOP in each cell that a loop may pass: where a neighbour is not the same.

    A loop that is straight over a cell and parts one of its points from its middle parts one of those from it too.
    """
    around = np.lib.stride_tricks.sliding_window_view(np.pad(raster, 1, mode="edge"), (3, 3))
    return np.where(around.min(axis=(2, 3)) == around.max(axis=(2, 3)), raster, NEAR_LOOP)
