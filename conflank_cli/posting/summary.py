"""What a program will do on its machine, as far as that is known before it runs: time, travel, deviations."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import radians

import numpy as np
import numpy.typing as npt

from conflank_cli.job import Job
from conflank_cli.machine_frame import machine_of
from conflank_cli.posting.mounting import axis_positions, mounting_of
from conflank_cli.posting.spacing import POSTED_WITHIN
from postprocessors.kinematics.timing import Profile, least_seconds, profile
from postprocessors.kinematics.travel import TravelCheck, check_travel
from postprocessors.kinematics.visits import VisitWords, visits_with_words
from postprocessors.machines.machine import Machine
from postprocessors.toolpath import Purpose, ToolPath

Array = npt.NDArray[np.float64]

STANDING = 1e-9
"""mm or degrees: an axis that moves less between two poses stands; a sweep begins at the last pose of its approach."""


@dataclass(frozen=True, slots=True)
class CutTime:
    """One sweep or pass: its number, tool, blocks in contact, way of the tip (mm), seconds without and with links."""

    cut: str
    tool: str
    blocks: int
    length_mm: float
    seconds: float
    with_links: float


@dataclass(frozen=True, slots=True)
class PostSummary:
    """What is known of a program before it runs.

    Attributes
    ----------
    machine: it is for.
    cuts: in the order they run.
    seconds: predicted for all of them with their links, without tool changes and what lies above the safe planes.
    posting_mm: largest deviation of the programmed cutter from the planned motion.
    control_mm: what cycle 32 allows the control on top, T + h TA with the tallest cutter.
    travel: of X, Y and Z.
    """

    machine: Machine
    cuts: tuple[CutTime, ...]
    seconds: float
    posting_mm: float
    control_mm: float
    travel: TravelCheck

    def lines(self) -> Iterator[tuple[str, str]]:
        """Facts by name, for people."""
        yield "predicted", f"{self.seconds / 60.0:.2f} min, without tool changes and ways above the safe plane"
        yield (
            "deviation",
            f"{1000.0 * self.posting_mm:.1f} µm at most by posting; cycle 32 lets the control add"
            f" {1000.0 * self.control_mm:.1f} µm (T + h TA)",
        )
        yield "travel", self._travel()
        if not self.machine.verified:
            yield "machine", f"{self.machine.name}: its data is not verified (verified = false in its file)"

    def _travel(self) -> str:
        travel = self.travel
        if travel.complete:
            box = ", ".join(
                f"{letter} {low:.1f} .. {high:.1f}"
                for letter, low, high in zip("XYZ", travel.low, travel.high, strict=True)
            )
            return f"{box}: {travel.margin:.1f} mm from the nearest limit"
        x, y, z = travel.zero
        lengths = ", ".join(f"{name} {length:.1f} mm long" for name, length in travel.supposed.items())
        place = f"X{x:.1f} Y{y:.1f} Z{z:.1f}" + (f" and {lengths}" if lengths else "")
        return (
            "checked for its extent only, since [machine] zero and gauge_length are not both given; it fits, best with"
            f" the datum at {place}: {travel.margin:.1f} mm from the nearest limit"
        )


@dataclass(frozen=True, slots=True)
class MachineRun:
    """A tool path as the machine runs it: its visits with rotary words, and the travel of X, Y and Z."""

    visits: tuple[VisitWords, ...]
    travel: TravelCheck


def machine_run(job: Job, machine: Machine, path: ToolPath) -> MachineRun:
    """Choose the rotary words of a tool path and check the travels.

    Raises
    ------
    PostError: the machine cannot run it.
    """
    visits = visits_with_words(machine, path)
    return MachineRun(visits, check_travel(machine, visits, mounting_of(job)))


def summarize(job: Job, path: ToolPath, known: MachineRun | None = None) -> PostSummary:
    """Predict what the program of a tool path does on the job's machine.

    `known`: how the machine runs it, where that has been found out before.

    Raises
    ------
    PostError: the machine cannot run it.
    """
    machine = machine_of(job)
    found = known or machine_run(job, machine, path)
    visits = found.visits
    cuts: dict[tuple[str, int], CutTime] = {}
    total = 0.0
    for visit in visits:
        run = visit_profile(machine, job, visit)
        total += run.total
        way = np.linalg.norm(np.diff(visit.tip, axis=0), axis=1)
        # Block k ends at pose k + 1; the first pose of a stretch is where the one before ended.
        owner = np.concatenate([[stretch.cut] * len(stretch.tip) for stretch in visit.stretches])[1:]
        purpose = np.concatenate([[stretch.purpose.value] * len(stretch.tip) for stretch in visit.stretches])[1:]
        cutting = np.isin(purpose, (Purpose.SWEEP.value, Purpose.PASS.value))
        numbers = dict.fromkeys(owner.tolist())
        for cut in numbers:
            own = owner == cut
            chosen = own & cutting
            kind = str(purpose[chosen][0])
            before = cuts.get((kind, cut))
            cuts[kind, cut] = CutTime(
                f"{kind} {cut}",
                visit.tool,
                int((chosen & (way > 0.0)).sum()) + (before.blocks if before else 0),
                float(way[chosen].sum()) + (before.length_mm if before else 0.0),
                float(run.seconds[chosen].sum()) + (before.seconds if before else 0.0),
                # Filtering adds its time once to what is run in one go.
                float(run.seconds[own].sum()) + run.tail / len(numbers) + (before.with_links if before else 0.0),
            )
    program = job.program.cycle32
    heights = [operation.cutter.length + operation.cutter.r_min for operation in path.operations]
    swing = program.t if program.ta is None else max(heights) * radians(program.ta)
    return PostSummary(machine, tuple(cuts.values()), total, POSTED_WITHIN, program.t + swing, found.travel)


def visit_profile(machine: Machine, job: Job, visit: VisitWords) -> Profile:
    """How the machine runs from the safe plane to the cut, through it and back."""
    axes = axis_positions(machine, mounting_of(job), visit.tool, visit.tip, visit.words)
    return profile(axes, nominal_seconds(machine, visit, axes), machine.limits)


def nominal_seconds(machine: Machine, visit: VisitWords, axes: Array) -> Array:
    """Seconds of each block of a visit at its programmed feed, (N - 1,); 0 where nothing moves and no block is written.

    axes: positions of the five axes, (N, 5).
    """
    feed = np.concatenate([stretch.feed for stretch in visit.stretches])[1:]
    way = np.linalg.norm(np.diff(visit.tip, axis=0), axis=1)
    # A rapid block takes what its slowest axis needs; one without motion is not written.
    nominal = np.where(feed > 0.0, 60.0 * way / np.where(feed > 0.0, feed, 1.0), least_seconds(machine, axes))
    still = (np.abs(np.diff(axes, axis=0)) < STANDING).all(axis=1)
    return np.asarray(np.where(still, 0.0, nominal))
