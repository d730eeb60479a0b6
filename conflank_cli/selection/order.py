"""The order of cuts: from the tip of a blade to its hub, sides of a thin blade in turn, tools together, short links.

A blade is stiff where metal still stands around it. So what is far from the hub is cut before what is near it, while
the blade below has its stock; and a thin blade is cut on both sides level by level, so that neither side is left to
bend under the other's cut. Where the hub is, geometry has to say: a part with a rotary pattern has its hub at the axis
of the pattern; otherwise the check geometry says it, most of which is hub, or, with whole wheels, lies around the axis
evenly. Where neither is there or says anything, only tools and links count.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from conflank_cli.geometry.workface import FaceSamples
from conflank_cli.job import Job
from conflank_cli.motion import Motion
from conflank_cli.scene import Scene
from conflank_cli.sweep import Sweep

Array = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]

# Patches whose middles differ in height by less than this share of what the faces span are on one level.
LEVEL = 0.25
# A blade is thin whose sides are nearer to each other than this share of the root of their area.
THIN = 0.15
# Sides face away from each other where the cosine between their normals is below this, on most of the points.
OPPOSITE, MOST = -0.5, 0.6
# The middle of the check geometry says where the hub is if it is off the faces by this share of what they span.
ASIDE = 0.1
# Poses from which the way of a sweep is taken.
POSES = 9


@dataclass(frozen=True, slots=True)
class Cut:
    """A sweep with what its place in the order depends on: the points it covers of its face."""

    sweep: Sweep
    covered: BoolArray


def in_order(scene: Scene, samples: Sequence[FaceSamples], cuts: Sequence[Cut]) -> tuple[list[int], list[Sweep], str]:
    """Numbers of the cuts in the order they are made, their sweeps each in the direction it is cut, and why so.

    samples: of each face, those that `covered` is about.
    """
    if not cuts:
        return [], [], ""
    heights, why = _heights(scene, samples)
    blades = blades_of(samples)
    middle = np.array([_height(heights, samples, cut) for cut in cuts])
    span = 1.0 if heights is None else float(np.ptp(np.concatenate(heights)))
    blade = [blades[cut.sweep.face] for cut in cuts]
    before = [
        [
            j
            for j in range(len(cuts))
            if blade[j] == blade[k] and heights is not None and middle[j] > middle[k] + LEVEL * span
        ]
        for k in range(len(cuts))
    ]
    ways = [_ways(scene.job, samples[cut.sweep.face], cut) for cut in cuts]
    order: list[int] = []
    sweeps: list[Sweep] = []
    end: Array | None = None
    while len(order) < len(cuts):
        last = cuts[order[-1]].sweep if order else None
        ready = [k for k in range(len(cuts)) if k not in order and all(j in order for j in before[k])]

        def merit(choice: tuple[int, int], last: Sweep | None = last, end: Array | None = end) -> tuple[float, ...]:
            k, way = choice
            sweep = cuts[k].sweep
            if last is None or end is None:
                return (-middle[k], 0.0, 0.0, 0.0, k, way)
            same_tool = sweep.tool == last.tool
            same_blade = blades[sweep.face] == blades[last.face]
            # The other side of a thin blade first, of anything else the same.
            turn = same_blade and (sweep.face != last.face or blades.count(blades[sweep.face]) == 1)
            link = float(np.linalg.norm(_middle(ways[k][way], 0.0) - end))
            return (float(not same_tool), float(not same_blade), float(not turn), link, k, way)

        k, way = min(((k, way) for k in ready for way in range(len(ways[k]))), key=merit)
        order.append(k)
        sweeps.append(replace(cuts[k].sweep, motion=ways[k][way]))
        end = _middle(ways[k][way], 1.0)
    if len(set(blade)) < len({cut.sweep.face for cut in cuts}):
        why += ", sides of thin blades in turn"
    return order, sweeps, why


def blades_of(samples: Sequence[FaceSamples]) -> list[int]:
    """For each face the number of its blade: two faces are one where they are the sides of a thin blade."""
    blades = list(range(len(samples)))
    for i, one in enumerate(samples):
        for j in range(i):
            if blades[i] == i and blades[j] == j and _is_thin(one, samples[j]):
                blades[i] = j
    return blades


def _is_thin(one: FaceSamples, other: FaceSamples) -> bool:
    """Whether two faces are sides of a thin blade: close, and each behind the other's metal."""
    distance, nearest = cKDTree(other.points).query(one.points)
    behind = np.einsum("ij,ij->i", other.points[nearest] - one.points, one.normals) < 0.0
    facing = np.einsum("ij,ij->i", one.normals, other.normals[nearest])
    size = np.sqrt(min(one.areas.sum(), other.areas.sum()))
    return float(np.mean((facing < OPPOSITE) & behind & (distance < THIN * size))) >= MOST


def _heights(scene: Scene, samples: Sequence[FaceSamples]) -> tuple[list[Array] | None, str]:
    """Height above the hub of the points of each face, mm; None where the hub is not known. And how it is known."""
    copies = scene.job.setup.copies
    points = np.concatenate([sample.points for sample in samples])
    if copies.count > 1:
        axis = np.asarray(copies.axis) / np.linalg.norm(copies.axis)
        across = [sample.points - (sample.points @ axis)[:, None] * axis for sample in samples]
        return [
            np.linalg.norm(x, axis=1) for x in across
        ], "from tip to hub by the distance from the axis of the copies"
    triangles = scene.check.triangles[scene.check.face >= 0]
    corners = scene.check.vertices[triangles]
    areas = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    if areas.sum() > 0.0:
        weights = np.concatenate([sample.areas for sample in samples])
        to_hub = np.average(corners.mean(axis=1), axis=0, weights=areas) - np.average(points, axis=0, weights=weights)
        if np.linalg.norm(to_hub) > ASIDE * np.linalg.norm(np.ptp(points, axis=0)):
            down = to_hub / np.linalg.norm(to_hub)
            return [-(sample.points @ down) for sample in samples], "from tip to hub by where the rest of the part is"
    return None, "by short links: nothing says where the hub is"


def _height(heights: list[Array] | None, samples: Sequence[FaceSamples], cut: Cut) -> float:
    """Height of the middle of what a cut covers, mm; 0 for all where heights are not known."""
    if heights is None or not cut.covered.any():
        return 0.0
    areas = samples[cut.sweep.face].areas[cut.covered]
    return float(heights[cut.sweep.face][cut.covered] @ areas / areas.sum())


def _ways(job: Job, samples: FaceSamples, cut: Cut) -> list[Motion]:
    """The motion as it may be cut: in the direction that mills as the job asks, or in both."""
    motion = cut.sweep.motion
    if job.program.cutting == "both":
        return [motion, reversed_motion(motion)]
    climbs = climb(motion, samples, cut.covered) > 0.0
    return [motion if climbs == (job.program.cutting == "climb") else reversed_motion(motion)]


def climb(motion: Motion, samples: FaceSamples, covered: BoolArray) -> float:
    """Positive where a motion climb-mills what it covers with a spindle that turns clockwise seen from above.

    Where the edge touches, it runs along d x n (n away from the metal): climb milling is feed against that.
    """
    p, q = motion.ends(np.linspace(0.0, 1.0, POSES))
    middle = 0.5 * (p + q)
    index = np.flatnonzero(covered) if covered.any() else np.arange(len(covered))
    nearest = index[cKDTree(samples.points[index]).query(middle)[1]]
    against = np.cross(samples.normals[nearest], q - p)
    return float(np.einsum("ij,ij->", np.diff(middle, axis=0), 0.5 * (against[1:] + against[:-1])))


def reversed_motion(motion: Motion) -> Motion:
    """The same motion the other way."""
    return Motion(
        np.ascontiguousarray(1.0 - motion.knots[::-1]),
        np.ascontiguousarray(motion.p[::-1]),
        np.ascontiguousarray(motion.q[::-1]),
    )


def _middle(motion: Motion, t: float) -> Array:
    p, q = motion.ends([t])
    return np.asarray(0.5 * (p + q)[0])
