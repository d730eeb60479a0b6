"""Spreading a sequence over the face: the flute is slid along its contact to where it covers most."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from conflank_cli.detection.ruled_fit import fit_motion
from conflank_cli.detection.settling import settle
from conflank_cli.geometry.growth import away_from, best_slide, slid
from conflank_cli.geometry.workface import FaceSamples, WorkFace
from conflank_cli.limits import Limits
from conflank_cli.motion import Motion
from conflank_cli.tool import Tool

Array = npt.NDArray[np.float64]

# Sliding is exact to first order only, so what is left to slide is looked at again.
ROUNDS = 2


def spread(
    face: WorkFace, tool: Tool, start: Motion, lines: int, samples: FaceSamples, limits: Limits
) -> Motion | None:
    """A motion with `lines` of its lines slid so that the flute covers more; None if none would.

    Tracing keeps a line where it is along its own contact, a soft mode that costs nothing; so the flute may overhang
    the face at one end while the other end does not reach the edge. Does not promise that the motion covers more than
    `start` where sliding leaves the tolerance: the optimisation decides then.
    """
    motion: Motion | None = None
    for _ in range(ROUNDS):
        slides = best_slide(motion or start, tool, samples, limits)
        if not slides.any():
            break
        moved = slid(motion or start, tool, slides, away_from(face, motion or start))
        p, q = moved.ends(np.linspace(0.0, 1.0, lines))
        d = (q - p) / np.linalg.norm(q - p, axis=1)[:, None]
        motion = fit_motion(settle(face, tool, p, d, limits), tool.length, limits)
    return motion
