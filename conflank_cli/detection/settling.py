"""Settling a sequence: its lines refined to the end, and how they touch the face."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from conflank_cli.detection.tracing import FADED, sphere_heights
from conflank_cli.geometry.kernels.axis import refine_sequence
from conflank_cli.geometry.workface import WorkFace
from conflank_cli.limits import Limits
from conflank_cli.tool import Tool

Array = npt.NDArray[np.float64]

# Refinement ends by itself where it has converged.
ITERATIONS, DAMPING = 8, 1e-3


@dataclass(frozen=True, slots=True)
class Contact:
    """Lines in order and how they touch a face.

    Attributes
    ----------
    p, d: (K, 3) points in the plane of r_min, mm, and unit directions.
    heights: (J,) of the spheres on them, mm.
    error: (K, J) axis error, mm.
    on: (K, J) 1 on the face, 0 beside it, -1 where there is no footpoint.
    normal: (K, J, 3) unit surface normals towards the cutter.
    weight: (K, J) what each sphere counts in a fit, in [0, 1].
    """

    p: Array
    d: Array
    heights: Array
    error: Array
    on: Array
    normal: Array
    weight: Array


def settle(face: WorkFace, tool: Tool, p: Array, d: Array, limits: Limits) -> Contact:
    """Refine lines (K, 3) each until they move no more."""
    p, d = p.copy(), d.copy()
    heights = sphere_heights(tool)
    radii = np.asarray(tool.sphere_radius(heights) + limits.allowance)
    middle = len(heights) // 2
    start = face.projector.project(p + heights[middle] * d)
    shape = (len(p), len(heights))
    error, on, weight, normal = np.empty(shape), np.empty(shape), np.empty(shape), np.empty((*shape, 3))
    refine_sequence(
        *face.projector.spans, face.sense, face.raster, p, d, heights, radii, middle, start.u, start.v,
        FADED * limits.under, ITERATIONS, DAMPING, error, normal, on, weight,
    )  # fmt: skip
    return Contact(p, d, heights, error, on, normal, weight)
