"""What stands on the table, and whether a cutter is above all of it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from math import pi

import numpy as np
import numpy.typing as npt
from scipy.spatial import ConvexHull, QhullError

from conflank_cli.scene import Scene
from conflank_cli.tool import Tool
from conflank_cli.verification.kinematics import Frame, from_cad
from conflank_cli.verification.sampling import sample_face

Array = npt.NDArray[np.float64]

SURFACE_POINTS = 2000
"""Points of a design face from which it is told how high it stands, about."""


MOST_COPIES = 720
"""Copies of a pattern that are looked at: half a degree apart they stand as high as any between them, to 1e-5 of the
pattern's radius."""


@dataclass(frozen=True, slots=True)
class Standing:
    """All that stands on the table: points of the convex hull of it, (H, 3) mm, in the program's frame."""

    points: Array

    @classmethod
    def of(cls, scene: Scene, frame: Frame) -> Standing:
        """Design faces, whole, and what is around them, as often as there are copies, cut or not, and obstacles."""
        allowance = scene.job.tolerance.allowance
        samples = [sample_face(face, SURFACE_POINTS) for face in (*scene.faces, *scene.rest)]
        part = [sample.points + allowance * sample.normals for sample in samples]
        part.append(_corners(scene, foreign=False))
        corners = _hull(np.concatenate(part))
        points = [from_cad(frame, _corners(scene, foreign=True), np.zeros((0, 3)))[0]]
        copies = scene.job.setup.copies
        for number in sorted({*copies.order, *range(0, copies.count, -(-copies.count // MOST_COPIES))}):
            turned = replace(frame, turned=(copies.axis, 2.0 * pi * number / copies.count))
            points.append(from_cad(turned, corners, np.zeros((0, 3)))[0])
        return cls(_hull(np.concatenate(points)))

    def height(self, up: Array) -> float:
        """How high it stands along a unit vector, mm."""
        return float((self.points @ up).max())


def _corners(scene: Scene, foreign: bool) -> Array:
    """Corners of the triangles of the part, or of the obstacles."""
    mesh = scene.check
    return np.asarray(mesh.vertices[np.unique(mesh.triangles[(mesh.face < 0) == foreign])])


def _hull(points: Array) -> Array:
    """Those of the points that no other can be beyond in any direction; all of them where they lie in a plane."""
    try:
        return np.asarray(points[ConvexHull(points).vertices])
    except QhullError:
        return points


@lru_cache(maxsize=32)
def discs(tool: Tool) -> tuple[tuple[float, float], ...]:
    """Height above the tip and radius of the discs whose hull is the cutter above its ball, mm."""
    found, height = [(0.0, tool.r_min), (tool.length, tool.r_max)], tool.length
    for section in (*tool.shank, *tool.holder):
        found.append((height, section.diameter_low / 2.0))
        height += section.length
        found.append((height, section.diameter_high / 2.0))
    return tuple((height - tool.tip_height, radius) for height, radius in found)


def lowest(tool: Tool, tip: Array, axis: Array, up: Array) -> Array:
    """How low the whole cutter, holder included, reaches along unit vectors at poses: (N,) mm; the rest (N, 3)."""
    along = np.einsum("ij,ij->i", axis, up)
    across = np.sqrt(np.maximum(1.0 - along**2, 0.0))
    low = tool.ball_radius * along - tool.ball_radius
    for height, radius in discs(tool):
        low = np.minimum(low, height * along - radius * across)
    return np.asarray(np.einsum("ij,ij->i", tip, up) + low)
