"""The reachability map: how well a cone can touch a face at every point of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from conflank_cli.detection.line_field import seed_lines
from conflank_cli.detection.tracing import sphere_heights
from conflank_cli.geometry.kernels.reach import reach_errors
from conflank_cli.geometry.workface import FaceSamples, WorkFace
from conflank_cli.tool import Tool

Array = npt.NDArray[np.float64]

# A line counts where it touches along this share of the flute at least: less is a cut with a point.
ENGAGED = 1.0 / 3.0
# Contact heights that are tried, as shares of the flute; between them a line through the same point differs little.
CONTACTS = (0.08, 0.36, 0.64, 0.92)


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
    heights = sphere_heights(tool)
    radii = np.asarray(tool.sphere_radius(heights) + allowance)
    places = np.round(np.array(CONTACTS) * (len(heights) - 1)).astype(np.int64)
    seeds = seed_lines(face, tool, samples.uv, heights[places], allowance)
    order = np.argsort(seeds.sample, kind="stable")
    starts = np.searchsorted(seeds.sample[order], np.arange(len(samples.uv) + 1)).astype(np.int64)
    contacts = np.searchsorted(heights, seeds.height[order] - 1e-9).astype(np.int64)
    least = max(round(engaged * len(heights)), 1)
    count = len(samples.uv)
    error, lines, height = np.empty(count), np.full((count, 6), np.nan), np.full(count, np.nan)
    footpoints = np.zeros(count, dtype=np.int64)
    reach_errors(
        *face.projector.spans, face.sense, face.raster, samples.points, samples.normals, samples.uv, starts,
        seeds.d[order], contacts, heights, radii, least, error, lines, height, footpoints,
    )  # fmt: skip
    return Reachability(samples, error, lines[:, :3].copy(), lines[:, 3:].copy(), height, int(footpoints.sum()))
