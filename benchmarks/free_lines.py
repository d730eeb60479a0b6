"""What of a face single poses can touch with nothing in the way: the blind search of `benchmarks.blind_search`, held
against everything around.

At each sample of a face, with each of some spheres of the cone at it and in every direction, the axis is shifted and
tilted so that its run of spheres touches as well as a straight line of corrections lets it. Poses whose error is within
tolerance then have to keep every limit of the exact `Collider`, and the machine has to reach them. A sample is
reachable if one such pose touches it, and so is what is touched along with it. No sweep covers more than that, but for
what a run shorter than asked for leaves behind: what can be reached is an upper bound for coverage by any number of
sweeps, and takes no notice of how poses follow each other.

What the ball can touch is asked in the same way, with directions spread over the half space above the face.
"""

from __future__ import annotations

from dataclasses import replace
from math import cos, sin

import msgspec
import numpy as np
import numpy.typing as npt
from numba import njit

from benchmarks.blind_search import BlindSearch, line_error, line_errors, score
from conflank_cli.cores import spread
from conflank_cli.geometry.collision import Collider
from conflank_cli.geometry.screening import Screen
from conflank_cli.geometry.workface import FaceSamples, WorkFace
from conflank_cli.passes.axes import directions
from conflank_cli.scene import Scene
from conflank_cli.tool import Tool

Array = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]

# Spheres that touch at a sample; close together at the low end, which comes nearest to what the face ends at.
CONTACTS = (0, 1, 2, 4, 7, 10, 13, 16, 19, 22, 23)
# Directions at a sample, 3 degrees apart: what a run of a third of the flute leaves within tolerance is wider.
DIRECTIONS = 120
# A pose may overcut by so much more than the tolerance, mm: it was found with spheres, and is not refined further.
LENIENT = 0.002
# Poses of one sample that are held against whole triangles at a time.
BATCH = 8


@njit(cache=True, nogil=True)
def _lines_at(surface, sense, trim, x, n, uv, contacts, heights, radii, half_angle, least, tolerance, found, poses):  # type: ignore[no-untyped-def]
    """Poses within tolerance at one sample: found (H, DIRECTIONS) bool, poses (H, DIRECTIONS, 6) p and d."""
    t1 = np.array([0.0, n[2], -n[1]]) if abs(n[0]) < 0.6 else np.array([-n[2], 0.0, n[0]])
    t1 /= np.sqrt(np.sum(t1**2))
    t2 = np.array([n[1] * t1[2] - n[2] * t1[1], n[2] * t1[0] - n[0] * t1[2], n[0] * t1[1] - n[1] * t1[0]])
    directions = found.shape[1]
    spacing = heights[1] - heights[0]
    for task in range(contacts.shape[0] * directions):
        k = task // directions
        m = task % directions
        contact = contacts[k]
        error = np.empty(heights.shape[0])
        on = np.empty(heights.shape[0], dtype=np.bool_)
        normal = np.empty((heights.shape[0], 3))
        angle = m * (2.0 * np.pi / directions)
        phi = half_angle
        delta = 0.0
        found[k, m] = False
        # The straight line of one round guesses; that of the second has next to nothing left to correct.
        for turn in range(3):
            d = np.cos(phi) * (np.cos(angle) * t1 + np.sin(angle) * t2) + np.sin(phi) * n
            centre = x + (radii[contact] + delta) * n
            line_errors(surface, sense, trim, centre, d, heights, radii, contact, uv[0], uv[1], error, on, normal)
            if line_error(error, on, contact, least)[0] <= tolerance:
                found[k, m] = True
                poses[k, m, :3] = centre - heights[contact] * d
                poses[k, m, 3:] = d
                if turn > 0:
                    break
            left, _, shift, tilt = score(error, on, contact, least)
            if left > tolerance:
                break
            delta -= shift
            phi -= tilt / spacing


def _fitting(search: BlindSearch, samples: FaceSamples, n: int, tolerance: float) -> tuple[Array, Array]:
    """Poses (M, 3), (M, 3) that touch at one sample within tolerance, whatever is in the way."""
    face, contacts = search.face, np.array(CONTACTS, dtype=np.int64)
    trim = (search.trim.vertices, search.trim.starts, search.trim.table, search.trim.box)
    found = np.empty((len(contacts), DIRECTIONS), dtype=np.bool_)
    poses = np.empty((*found.shape, 6))

    def run(part: slice) -> None:
        _lines_at(
            tuple(face.projector.spans), face.sense, trim, samples.points[n], samples.normals[n], samples.uv[n],
            contacts[part], search.heights, search.radii, search.tool.half_angle, search.least, tolerance,
            found[part], poses[part],
        )  # fmt: skip

    spread(run, len(contacts))
    return np.ascontiguousarray(poses[found][:, :3]), np.ascontiguousarray(poses[found][:, 3:])


def touched(points: Array, p: Array, d: Array, tool: Tool, tolerance: float) -> BoolArray:
    """Which points (N, 3) any of the poses (M, 3) leaves within tolerance of ball or cone."""
    inside = np.zeros(len(points), dtype=np.bool_)
    alpha = tool.half_angle
    for start, axis in zip(p, d, strict=True):
        offset = points - start
        z = offset @ axis
        r = np.sqrt(np.maximum(np.einsum("ni,ni->n", offset, offset) - z * z, 0.0))
        beside = (r - tool.r_min) * cos(alpha) - z * sin(alpha)
        along = z * cos(alpha) + (r - tool.r_min) * sin(alpha)
        round_ = np.hypot(z - tool.ball_centre_height, r) - tool.ball_radius
        inside |= (along >= 0.0) & (along <= tool.length / cos(alpha)) & (np.abs(beside) <= tolerance)
        inside |= (along < 0.0) & (np.abs(round_) <= tolerance)
    return inside


def _lenient(scene: Scene) -> tuple[Screen, Collider]:
    """What is around, with a little more overcut than the job allows."""
    tolerance = scene.job.tolerance
    wider = msgspec.structs.replace(tolerance, overcut=tolerance.overcut + LENIENT)
    around = replace(scene, job=msgspec.structs.replace(scene.job, tolerance=wider))
    return Screen.of(around), Collider.of(around)


def ball_reached(scene: Scene, samples: FaceSamples) -> BoolArray:
    """Which samples (N,) of a face the ball of any tool of a scene can touch with nothing in the way."""
    screen, collider = _lenient(scene)
    aimed = samples.points + scene.job.tolerance.allowance * samples.normals
    every = directions()
    reached = np.zeros(len(samples.areas), dtype=np.bool_)
    for tool in scene.tools:
        for n in np.flatnonzero(~reached):
            # Below its largest circle a ball goes over into the cone.
            d = every[every @ samples.normals[n] >= sin(tool.half_angle)]
            p = aimed[n] + tool.ball_radius * samples.normals[n] - tool.ball_centre_height * d
            open_ = np.flatnonzero(screen.free(p, d, tool, parallel=True))
            reached[n] = bool(len(open_)) and bool(collider.free(p[open_], d[open_], tool).any())
    return reached


def freely_reached(scene: Scene, index: int, samples: FaceSamples, least: int) -> BoolArray:
    """Which samples (N,) of a face of a scene single poses of any of its tools touch with nothing in the way.

    A line touches with `least` of SPHERES at least.
    """
    tolerance = scene.job.tolerance
    limit = 0.5 * (tolerance.overcut + tolerance.undercut)
    screen, collider = _lenient(scene)
    aimed = samples.points + tolerance.allowance * samples.normals
    reached = np.zeros(len(samples.areas), dtype=np.bool_)
    # In no order, so far from each other at first: what one pose touches along with its own is not asked about.
    order = np.random.default_rng(1).permutation(len(samples.areas))
    for tool in scene.tools:
        face = WorkFace.under(scene.faces[index], tool)
        search = BlindSearch.of(face, tool, tolerance.allowance, least)
        for n in order:
            if reached[n]:
                continue
            p, d = _fitting(search, samples, int(n), limit)
            open_ = np.flatnonzero(screen.free(p, d, tool, parallel=True)) if len(p) else np.zeros(0, dtype=np.int64)
            for k in range(0, len(open_), BATCH):
                part = open_[k : k + BATCH]
                free = collider.free(p[part], d[part], tool)
                if free.any():
                    reached[n] = True
                    reached |= touched(aimed, p[part][free], d[part][free], tool, limit)
                    break
    return reached
