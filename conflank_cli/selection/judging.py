"""What of a sweep may be cut, what it covers, and what was taken off it for which reason."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from conflank_cli.coverage import Reason
from conflank_cli.geometry.certificate import Certificate, certify
from conflank_cli.geometry.collision import Collider
from conflank_cli.geometry.face import DesignFace
from conflank_cli.geometry.gap import motion_gap
from conflank_cli.geometry.screening import Screen, longest_between
from conflank_cli.geometry.workface import FaceSamples, WorkFace
from conflank_cli.limits import Limits
from conflank_cli.motion import DEGREE, Motion
from conflank_cli.scene import Scene
from conflank_cli.selection.choice import Candidate
from conflank_cli.selection.obstruction import obstruction_of
from conflank_cli.selection.remainder import POINTS as SPARSE_POINTS
from conflank_cli.selection.remainder import Lost
from conflank_cli.sweep import Sweep
from conflank_cli.tool import Tool

Array = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]

# Points on a face from which sweeps are chosen: their spacing, under a millimetre on a blade, is a fifth of the
# narrowest patch worth a sweep. A choice makes the most of where they lie, which flatters its coverage by up to 0.2 %.
POINTS = 6000
# Points on a face on which a choice is measured: with four times as many no coverage changes by more than 0.05 %.
FINE_POINTS = 24000
# What posting may change of the swept gap, mm: so much of the tolerance is left to it.
POSTING = 0.0005
# A sweep that overcuts by at most this share of the band too much is moved off the face rather than cut short, by so
# much more than what is missing, so many times.
MOST_LIFT, LIFT_MORE, LIFTS = 0.3, 1.1, 3


@dataclass(frozen=True, slots=True)
class Face:
    """A design face with the points it is judged on, from few to many."""

    work: WorkFace
    sparse: FaceSamples
    coarse: FaceSamples
    fine: FaceSamples

    @classmethod
    def of(cls, design: DesignFace) -> Face:
        """Sample a face."""
        work = WorkFace.of(design, 0.0)
        return cls(work, *(work.samples(work.spacing(count)) for count in (SPARSE_POINTS, POINTS, FINE_POINTS)))


@dataclass(frozen=True, slots=True)
class CutOff:
    """A sweep that something was taken off.

    Attributes
    ----------
    steps: what it was each time before, and whether it hit something then or else cut too deep.
    left: what is left of it, if anything.
    """

    steps: tuple[tuple[Sweep, bool], ...]
    left: Candidate | None

    @property
    def face(self) -> int:
        """Index of its face."""
        return self.steps[0][0].face


@dataclass(frozen=True, slots=True)
class Judge:
    """What sweeps are held against.

    Attributes
    ----------
    scene: its job and tools count.
    tools: by name.
    faces: in the order of the scene.
    screen, collider: what is in the way, at points and exactly.
    over, under: the tolerance less what posting may change, mm.
    """

    scene: Scene
    tools: Mapping[str, Tool]
    faces: tuple[Face, ...]
    screen: Screen
    collider: Collider
    over: float
    under: float

    @classmethod
    @lru_cache(maxsize=1)
    def of(cls, scene: Scene) -> Judge:
        """Prepare a scene; kept, since that can be done before there are sweeps."""
        tolerance = scene.job.tolerance
        return cls(
            scene,
            {tool.name: tool for tool in scene.tools},
            tuple(Face.of(design) for design in scene.faces),
            Screen.of(scene),
            Collider.of(scene),
            tolerance.overcut - POSTING,
            tolerance.undercut - POSTING,
        )

    def gap(self, sweep: Sweep, points: Array) -> tuple[Array, Array]:
        """Swept gap of a sweep less allowance at points (N, 3), mm, and the times that give it."""
        return motion_gap(sweep.motion, self.tools[sweep.tool], points, self.scene.job.tolerance.allowance)

    def trimmed(self, sweep: Sweep) -> tuple[Candidate | None, CutOff | None]:
        """What of a sweep may be cut, and what was taken off it."""
        able, steps = self._free_part(sweep)
        if not steps:
            return able, None
        # What overcuts a little all along is no longer hit once it is moved off the face.
        whole, excess = self._judged(sweep)
        up = self.raised(whole, excess) if excess > 0.0 else None
        if up is not None:
            both = [item for item in (able, self._free_part(up.sweep)[0]) if item is not None]
            areas = self.faces[sweep.face].coarse.areas
            able = max(both, key=lambda item: float(areas[item.covered].sum()), default=None)
        return able, CutOff(steps, able)

    def raised(self, item: Candidate, excess: float) -> Candidate | None:
        """A sweep moved off the face by what it overcuts too much, None where that is too much or does not help."""
        for _ in range(LIFTS):
            if excess > MOST_LIFT * (self.over + self.under):
                return None
            sweep = item.sweep
            motion = lifted(sweep.motion, self.faces[sweep.face].sparse, LIFT_MORE * excess)
            item, excess = self._judged(replace(sweep, motion=motion))
            if excess <= 0.0:
                return item
        return None

    def without_collision(self, item: Candidate) -> Candidate | None:
        """The same item where nothing is hit, else what is left of it."""
        sweep = item.sweep
        motion = self.collider.allowed(sweep.motion, self.tools[sweep.tool])
        if motion is None or motion is sweep.motion:
            return item if motion is not None else None
        return self._judged(replace(sweep, motion=motion))[0]

    def certificate(self, item: Candidate) -> Certificate:
        """Bounds of the gap of a sweep all over its face."""
        # A certificate is about the face that is aimed at, which lies off the design face by `aim`.
        limits = Limits.of(self.scene.job.tolerance)
        aim = limits.allowance - self.scene.job.tolerance.allowance
        room = replace(limits, over=self.over + aim, under=self.under - aim)
        sweep = item.sweep
        found = certify(sweep.motion, self.tools[sweep.tool], self.faces[sweep.face].work, room)
        return replace(found, overcut=found.overcut - aim, gap=found.gap + abs(aim))

    def lost(self, cut: CutOff, asked: BoolArray) -> list[Lost]:
        """What was taken off a sweep, at those of the sparse points of its face that are `asked` for, (N,)."""
        points = self.faces[cut.face].sparse.points[asked]

        def covered(sweep: Sweep) -> BoolArray:
            gap = self.gap(sweep, points)[0]
            return np.asarray((gap >= -self.over) & (gap <= self.under))

        rest = np.zeros(len(points), dtype=np.bool_) if cut.left is None else covered(cut.left.sweep)
        found = []
        for sweep, hits in reversed(cut.steps):
            own = covered(sweep)
            if np.any(own & ~rest):
                there = np.zeros(len(asked), dtype=np.bool_)
                there[asked] = own
                what = obstruction_of(self.collider, sweep.motion, self.tools[sweep.tool]) if hits else None
                found.append(Lost(Reason.OVERCUT, None, there) if what is None else Lost.to(what, there))
            rest |= own
        return found

    def _judged(self, sweep: Sweep) -> tuple[Candidate, float]:
        """A sweep as a candidate, and by how much it overcuts beyond the tolerance at the points of the choice."""
        candidate, _ = self._with_times(sweep)
        return candidate, float(-self.over - candidate.gap.min())

    def _with_times(self, sweep: Sweep) -> tuple[Candidate, Array]:
        """A sweep as a candidate, and the times at which the gap at its points is what it is."""
        gap, time = self.gap(sweep, self.faces[sweep.face].coarse.points)
        covered = (gap >= -self.over) & (gap <= self.under)
        clearance = self.scene.job.program.safe.clearance
        return Candidate.of(sweep, self.tools[sweep.tool], gap, covered, clearance), time

    def _free_part(self, sweep: Sweep) -> tuple[Candidate | None, tuple[tuple[Sweep, bool], ...]]:
        """Its longest stretch without collision or overcut, and what it was each time before it was cut short."""
        steps: tuple[tuple[Sweep, bool], ...] = ()
        motion = self.screen.allowed(sweep.motion, self.tools[sweep.tool])
        if motion is not sweep.motion:
            steps = ((sweep, True),)
            if motion is None:
                return None, steps
        own = replace(sweep, motion=motion)
        candidate, time = self._with_times(own)
        deep = candidate.gap < -self.over
        if not deep.any():
            return candidate, steps
        # Between the poses and points of the screen a sweep may still cut deeper; its swept gap has the last word.
        steps = (*steps, (own, False))
        motion = longest_between(motion, time[deep])
        if motion is None:
            return None, steps
        candidate, excess = self._judged(replace(sweep, motion=motion))
        return candidate if excess <= 0.0 else None, steps


def lifted(motion: Motion, samples: FaceSamples, amount: float) -> Motion:
    """The motion moved off the face by about `amount` mm: across its axis, away from the metal."""
    knots = motion.knots
    p, q = motion.ends(np.mean([knots[k : len(knots) - DEGREE - 1 + k] for k in (1, 2, 3)], axis=0))
    normal = samples.normals[cKDTree(samples.points).query(0.5 * (p + q))[1]]
    axis = (q - p) / np.linalg.norm(q - p, axis=1)[:, None]
    away = normal - np.einsum("ij,ij->i", normal, axis)[:, None] * axis
    away *= amount / np.linalg.norm(away, axis=1)[:, None]
    return replace(motion, p=motion.p + away, q=motion.q + away)
