"""Where a scene is judged, whatever the program."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

from conflank_cli.scene import Scene
from conflank_cli.verification.clearance import Target, targets_of
from conflank_cli.verification.sampling import FaceSample, sample_face


@dataclass(frozen=True, slots=True)
class Places:
    """Where a scene is judged, whatever the program.

    Attributes
    ----------
    samples: points on each design face.
    targets: what components keep their distance from.
    """

    samples: tuple[FaceSample, ...]
    targets: tuple[Target, ...]

    @classmethod
    @lru_cache(maxsize=1)
    def of(cls, scene: Scene, points_per_face: int) -> Places:
        """Those of a scene; kept for whoever asks next."""
        return cls(tuple(sample_face(face, points_per_face) for face in scene.faces), targets_of(scene))
