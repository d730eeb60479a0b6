"""Detection: from a face and a tool to ordered sequences of lines, without a proposal by the user."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from conflank_cli.cores import threads
from conflank_cli.detection.clustering import represent
from conflank_cli.detection.line_field import seed_lines
from conflank_cli.detection.ruled_fit import fit_motion
from conflank_cli.detection.settling import Contact, settle
from conflank_cli.detection.spreading import spread
from conflank_cli.detection.tracing import sphere_heights, trace
from conflank_cli.errors import NumericalError
from conflank_cli.geometry.screening import Screen
from conflank_cli.geometry.workface import WorkFace
from conflank_cli.limits import Limits
from conflank_cli.motion import Motion
from conflank_cli.once import Once
from conflank_cli.progress import Progress
from conflank_cli.scene import Scene
from conflank_cli.sweep import Sweep
from conflank_cli.tool import Tool


@dataclass(frozen=True, slots=True)
class Density:
    """How densely a face is searched.

    contacts: contact points on a face, about. heights: places on the flute, as fractions of it. alike: overlap above
    which two sequences are one family. families: so many of the largest are kept, and those that cover what these miss.
    """

    contacts: int
    heights: tuple[float, ...]
    alike: float
    families: int


DENSITIES = {
    "quick": Density(50, (0.5,), 0.6, 40),
    "normal": Density(140, (0.15, 0.5, 0.85), 0.75, 100),
    "exhaustive": Density(600, (0.05, 0.25, 0.5, 0.75, 0.95), 0.85, 400),
}

# Sequences that cover less than this share of the face are not worth a sweep.
SMALLEST = 0.004
# Points that candidates are screened with are this far apart, mm; what is optimised later is screened more finely.
SCREEN_SPACING = 2.0
# Samples that give the raster cells their areas, about.
AREA_SAMPLES = 40000
# So many of the largest families also come slid to where the flute covers most; the others show what else there is.
SPREAD = 12
# Points of the face on which a sequence is spread over it, about.
SPREAD_SAMPLES = 1500


def detect(scene: Scene, progress: Progress) -> list[Sweep]:
    """Find candidate sweeps for every face and tool of the scene.

    Raises
    ------
    NumericalError: not a single line fits on any face with any tool.
    """
    density = DENSITIES[scene.job.detection.density]
    limits = Limits.of(scene.job.tolerance)
    screen = Once(partial(Screen.of, scene, SCREEN_SPACING))
    sweeps: list[Sweep] = []
    with progress.stage("detect", len(scene.faces) * len(scene.tools)) as stage:
        for index, design in enumerate(scene.faces):
            for tool in scene.tools:
                face = WorkFace.under(design, tool)
                found = _families(face, tool, density, screen, limits)
                sweeps.extend(Sweep(index, tool.name, motion, facts) for motion, facts in found)
                stage.advance()
    if not sweeps:
        raise NumericalError(
            f"{scene.part_name}: faces {', '.join(str(face.number) for face in scene.faces)}",
            f"no line of {', '.join(tool.name for tool in scene.tools)} that touches a face within tolerance",
            "at least one sequence of lines",
            "Use a smaller tool, a wider tolerance, or check the side the cutter works on.",
        )
    return sweeps


def _families(
    face: WorkFace, tool: Tool, density: Density, screen: Once[Screen], limits: Limits
) -> list[tuple[Motion, dict[str, float]]]:
    """One motion, and what was measured of its sequence, for each family of sweeps of one tool on one face."""
    dense = face.samples(face.spacing(AREA_SAMPLES))
    contacts = face.samples(face.spacing(density.contacts)).uv
    heights = sphere_heights(tool)
    places = heights[np.round(np.array(density.heights) * (len(heights) - 1)).astype(int)]
    seeds = seed_lines(face, tool, contacts, places, limits.allowance)
    traced = trace(face, tool, seeds, dense, screen, limits)
    families = represent(traced, density.alike, SMALLEST * float(dense.areas.sum()), density.families)
    samples = face.samples(face.spacing(SPREAD_SAMPLES))

    def motions(rank: int) -> tuple[Contact, list[Motion]]:
        """The lines of a family, settled, and the motions through them."""
        sequence = traced.sequences[families[rank]]
        contact = settle(face, tool, sequence.p, sequence.d, limits)
        motion = fit_motion(contact, tool.length, limits)
        wider = spread(face, tool, motion, len(contact.p), samples, limits) if rank < SPREAD else None
        return contact, [motion] if wider is None else [motion, wider]

    with threads() as pool:
        fitted = list(pool.map(motions, range(len(families))))
    found: list[tuple[Motion, dict[str, float]]] = []
    for family, (contact, through) in zip(families, fitted, strict=True):
        facts = {
            "lines": float(len(contact.p)),
            "area_mm2": float(traced.cell_areas[traced.cells[family]].sum()),
        }
        on_face = contact.error[contact.on > 0.5]
        if on_face.size:
            facts["axis_error_mean_um"] = 1e3 * float(np.abs(on_face).mean())
        found.extend((motion, facts) for motion in through)
    return found
