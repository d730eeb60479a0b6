"""A sweep: one continuous flank cut of one tool over one face, as the stages hand it on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from conflank_cli.motion import Motion


@dataclass(frozen=True, slots=True)
class Sweep:
    """One flank cut.

    Attributes
    ----------
    face: index into the scene's faces (not the CAD face number).
    tool: name of the tool.
    motion: the motion of the tool axis, cut to the stretch that is used; t runs in cutting direction.
    facts: what the stages measured, by name with the unit in the name (e.g. ``axis_error_mean_um``); scalars only.
    """

    face: int
    tool: str
    motion: Motion
    facts: Mapping[str, float] = field(default_factory=dict)
