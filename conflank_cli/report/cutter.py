"""The outline of a cutter: what is turned about the tool axis to draw it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from conflank_cli.tool import Section, Tool

Array = npt.NDArray[np.float64]

BALL_STEPS = 16
"""Points on the outline of the ball."""


@dataclass(frozen=True, slots=True)
class Outline:
    """One part of a cutter: "flute", "shank" or "holder", with its outline.

    Attributes
    ----------
    kind: which part it is.
    heights, radii: (N,) from below, mm; heights above the tip point.
    """

    kind: str
    heights: Array
    radii: Array


def flute_outline(tool: Tool) -> Outline:
    """Ball and cone, from the tip point to r_max."""
    angle = np.linspace(0.0, np.pi / 2 - tool.half_angle, BALL_STEPS)
    heights = np.append(tool.ball_radius * (1.0 - np.cos(angle)), tool.length - tool.tip_height)
    return Outline("flute", heights, np.append(tool.ball_radius * np.sin(angle), tool.r_max))


def outlines(tool: Tool) -> tuple[Outline, ...]:
    """Flute, shank and holder, closed at both ends of the latter two."""
    flute = flute_outline(tool)
    found = [flute]
    low = float(flute.heights[-1])
    for kind, sections in (("shank", tool.shank), ("holder", tool.holder)):
        if sections:
            found.append(_stack(kind, sections, low))
            low += sum(section.length for section in sections)
    return tuple(found)


def _stack(kind: str, sections: tuple[Section, ...], low: float) -> Outline:
    heights, radii = [low], [0.0]
    for section in sections:
        heights += [low, low + section.length]
        radii += [section.diameter_low / 2, section.diameter_high / 2]
        low += section.length
    return Outline(kind, np.array([*heights, low]), np.array([*radii, 0.0]))
