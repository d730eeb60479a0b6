"""What is in the way of a motion: which component of the tool comes too near to what, or the machine's reach."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from conflank_cli.geometry.collision import COMPONENTS, DESIGN, REACH, Collider
from conflank_cli.machine_frame import reachable_axes
from conflank_cli.motion import Motion
from conflank_cli.tool import Tool

Array = npt.NDArray[np.float64]

# Poses of a motion that are looked at for a name of what is in the way.
POSES = 33
MACHINE = "machine"


@dataclass(frozen=True, slots=True, order=True)
class Obstruction:
    """What forbids a pose.

    component: "ball", "cone", "shank" or "holder"; "machine" for an axis out of reach.
    obstacle: what is hit; empty for the machine.
    """

    component: str
    obstacle: str

    @property
    def text(self) -> str:
        """In words."""
        if self.component == MACHINE:
            return "axis out of the machine's reach"
        return f"{self.component} too near to {self.obstacle}"


def obstruction_of(collider: Collider, motion: Motion, tool: Tool) -> Obstruction | None:
    """What most forbids a motion; None where nothing does at the poses that are looked at."""
    p, q = motion.ends(np.linspace(0.0, 1.0, POSES))
    return obstruction_at(collider, p, (q - p) / np.linalg.norm(q - p, axis=1)[:, None], tool)


def obstruction_at(
    collider: Collider, p: Array, d: Array, tool: Tool, slack: float = 0.0, design: bool = False
) -> Obstruction | None:
    """The same of poses: axis points p at height 0, directions d (M, 3).

    `slack` mm of violation is let pass. The cutter is held against the design faces only with `design`.
    """
    reached = reachable_axes(collider.scene.job, d)
    # What keeps its limits does not matter here; how deep inside of an obstacle a tool is has to be looked for.
    inside = any(body.closed for body in collider.bodies)
    found = collider.poses(p, d, tool, REACH if inside else 0.0)
    lack = np.where(reached[:, None], found.slack, np.inf)
    if not design:
        own = np.array([body.name == DESIGN for body in collider.bodies], dtype=np.bool_)
        touching = (found.body >= 0) & own[np.maximum(found.body, 0)] if len(own) else np.zeros(lack.shape, np.bool_)
        touching[:, [COMPONENTS.index("shank"), COMPONENTS.index("holder")]] = False
        lack[touching] = np.inf
    pose, component = np.unravel_index(int(np.argmin(lack)), lack.shape)
    hits = int((lack.min(axis=1) < -slack).sum())
    if int((~reached).sum()) > hits:
        return Obstruction(MACHINE, "")
    if not hits:
        return None
    face = int(found.face[pose, component])
    return Obstruction(COMPONENTS[component], f"face {face}" if face >= 0 else f"obstacle {collider.names[-1 - face]}")
