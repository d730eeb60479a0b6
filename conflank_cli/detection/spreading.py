"""Spreading a sequence over the face: the flute is slid along its contact to where it covers most."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from conflank_cli.detection.ruled_fit import fit_motion
from conflank_cli.detection.tracing import Sequence, sphere_heights
from conflank_cli.geometry.growth import away_from, best_slide, slid
from conflank_cli.geometry.kernels.axis import refine_sequence
from conflank_cli.geometry.workface import FaceSamples, WorkFace
from conflank_cli.limits import Limits
from conflank_cli.motion import Motion
from conflank_cli.tool import Tool

Array = npt.NDArray[np.float64]

# Sliding is exact to first order only, so what is left to slide is looked at again.
ROUNDS = 2
# Lines after a slide are refined so often; stock left fades from this many tolerances on.
ITERATIONS, SCALE, DAMPING = 4, 1.5, 1e-3


def spread(face: WorkFace, tool: Tool, sequence: Sequence, samples: FaceSamples, limits: Limits) -> Motion | None:
    """The motion through a sequence with its lines slid so that the flute covers more; None if none would.

    Tracing keeps a line where it is along its own contact, a soft mode that costs nothing; so the flute may overhang
    the face at one end while the other end does not reach the edge. Does not promise that the motion covers more than
    the sequence where sliding leaves the tolerance: the optimisation decides then.
    """
    motion = fit_motion(sequence.p, sequence.d, tool.length)
    moved: Motion | None = None
    heights = sphere_heights(tool)
    radii = np.asarray(tool.sphere_radius(heights) + limits.allowance)
    middle = len(heights) // 2
    for _ in range(ROUNDS):
        slides = best_slide(motion, tool, samples, limits)
        if not slides.any():
            break
        moved = slid(motion, tool, slides, away_from(face, motion))
        p, q = moved.ends(np.linspace(0.0, 1.0, len(sequence.p)))
        d = (q - p) / np.linalg.norm(q - p, axis=1)[:, None]
        start = face.projector.project(p + heights[middle] * d)
        refine_sequence(
            *face.projector.spans, face.sense, face.raster, p, d, heights, radii, middle, start.u, start.v,
            SCALE * limits.under, ITERATIONS, DAMPING,
        )  # fmt: skip
        motion = moved = fit_motion(p, d, tool.length)
    return moved
