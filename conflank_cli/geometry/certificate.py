"""The certificate of a sweep: bounds on its swept gap that hold on the whole surface, not only at samples."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from conflank_cli.geometry.gap import cutter_of, polynomials_of, travel
from conflank_cli.geometry.kernels import gap_bound as kernel
from conflank_cli.geometry.workface import WorkFace, loop_vertices
from conflank_cli.limits import Limits
from conflank_cli.motion import Motion
from conflank_cli.tool import Tool

Array = npt.NDArray[np.float64]

# Cells begin at about this size, mm: where nothing is cut they stay so.
ROOT = 2.0
# Samples of the motion are so far apart, mm: well below the radius of any cutter.
STEP = 0.5
# Speeds and accelerations are looked at so many times between two samples.
PARTS = 4
# What a bound may exceed what has been found at nodes by, mm; of an overcut that is deep anyway, this share.
AIM, SHARE = 0.0007, 0.02
# Cells this small, mm, are not halved any more: for the overcut, and at the border of what is covered.
FLOOR_OVERCUT, FLOOR_COVERED = 0.01, 0.06
# The most nodes, some seconds of work: beyond, cells stay as large as they are, and so do their bounds.
MOST_NODES = 4e6


@dataclass(frozen=True, slots=True)
class GapCells:
    """Pieces of a trimmed face that cover it, each with bounds of the swept gap; N of them.

    Attributes
    ----------
    box: (N, 4) u0, u1, v0, v1.
    lower, upper: (N,) bounds of g less allowance in mm. Where a cell is off, they are only as good as that needs: 0 and
        inf where it is above the flute or far away.
    state: (N,) WITHIN tolerance all over, OFF it all over, or DOUBT: too small to go on.
    area: (N,) mm2 on the trimmed face; 0 where it was not needed.
    overcut_sampled, gap_sampled: deepest overcut on the face, and largest |g| within tolerance, at the nodes, mm.
    nodes: number of points at which the gap was evaluated.
    """

    box: Array
    lower: Array
    upper: Array
    state: npt.NDArray[np.int64]
    area: Array
    overcut_sampled: float
    gap_sampled: float
    nodes: int


@dataclass(frozen=True, slots=True)
class Certificate:
    """What is certain of a sweep on a face, and the sampled figures beside it.

    Attributes
    ----------
    overcut: nowhere on the trimmed face is more than this cut away, mm.
    gap: |g| is nowhere more than this on the certified area, mm.
    area: area in mm2 that is within tolerance at each of its points.
    doubt: area in mm2 along the border of it that is too narrow to tell.
    overcut_sampled, gap_sampled: the largest at points of the face, mm; the bounds cannot be less.
    nodes: number of points at which the gap was evaluated.
    """

    overcut: float
    gap: float
    area: float
    doubt: float
    overcut_sampled: float
    gap_sampled: float
    nodes: int


def certify(motion: Motion, tool: Tool, face: WorkFace, limits: Limits) -> Certificate:
    """Bounds on the overcut over a whole face and on |g| over what a sweep covers of it; g is less allowance.

    With an allowance the flute counts as longer by as much.
    """
    cells = gap_cells(motion, tool, face, limits)
    within, doubt = cells.state == kernel.WITHIN, cells.state == kernel.DOUBT
    bound = np.maximum(cells.upper[within], -cells.lower[within])
    return Certificate(
        max(0.0, float(-cells.lower.min(initial=0.0))),
        float(bound.max(initial=0.0)),
        float(cells.area[within].sum()),
        float(cells.area[doubt].sum()),
        cells.overcut_sampled,
        cells.gap_sampled,
        cells.nodes,
    )


def gap_cells(motion: Motion, tool: Tool, face: WorkFace, limits: Limits) -> GapCells:
    """Bounds of the swept gap on pieces of a face, as close as the figures of a `Certificate` need them."""
    polynomials, breaks = polynomials_of(motion)
    samples = max(int(np.ceil(travel(motion) / STEP)), 16)
    poses = np.empty((samples + 1, kernel.POSE))
    kernel.moving_poses(polynomials, breaks, samples, poses)
    roots, places = _roots(face)
    figures = np.zeros(3)
    spans = face.projector.spans
    table = kernel.bounded_cells(
        spans.breaks_u,
        spans.breaks_v,
        spans.coefficients,
        roots,
        places,
        *loop_vertices(face.face),
        polynomials,
        breaks,
        poses,
        *_motion_bounds(motion, tool, samples),
        cutter_of(tool),
        np.array([limits.over, limits.under, limits.allowance]),
        np.array([AIM, SHARE, FLOOR_OVERCUT, FLOOR_COVERED, MOST_NODES]),
        figures,
    )
    return GapCells(
        table[:, : kernel.V1 + 1],
        table[:, kernel.LOWER],
        table[:, kernel.UPPER],
        table[:, kernel.STATE].astype(np.int64),
        table[:, kernel.AREA],
        float(figures[0]),
        float(figures[1]),
        int(figures[2]),
    )


def _motion_bounds(motion: Motion, tool: Tool, samples: int) -> tuple[Array, Array]:
    """Least second derivatives of distances by t between samples, times -1 (samples,); and what else the kernel asks.

    The distance from a fixed point is the largest of its distances from tangent planes of the cutter, which move with
    it; its second derivative is no less than minus what the planes are accelerated: 2 |ω||v| + |v̇|.
    """
    t = np.linspace(0.0, 1.0, PARTS * samples + 1)
    p, q = motion.ends(t)
    length = np.linalg.norm(q - p, axis=1)
    d = (q - p) / length[:, None]
    velocity, acceleration = motion.ends(t, 1), motion.ends(t, 2)

    def norm(x: Array) -> Array:
        return np.asarray(np.linalg.norm(x, axis=1))

    turn = norm(velocity[1] - velocity[0]) / length
    swing = norm(acceleration[1] - acceleration[0]) / length
    radius = max(tool.r_max, tool.ball_radius)
    speed = np.maximum(norm(velocity[0]), norm(velocity[1])) + radius * turn
    rush = np.maximum(norm(acceleration[0]), norm(acceleration[1])) + radius * (swing + turn**2)
    drift = np.max([np.abs(np.einsum("ti,ti->t", v, d)) for v in velocity], axis=0) + radius * turn
    bend = 2.0 * turn * speed + rush
    # Accelerations are linear between knots: what lies between two values is no larger, but for a knot between them.
    around = np.max([bend[k : len(bend) - PARTS + k : PARTS] for k in range(PARTS + 1)], axis=0)
    around = np.max([around, np.append(around[1:], 0.0), np.append(0.0, around[:-1])], axis=0)
    return around, np.array([speed.max(), drift.max(), turn.max()])


def _roots(face: WorkFace) -> tuple[npt.NDArray[np.int64], Array]:
    """Cells that cover the box of the face's loops, none across a knot: span (N, 2) and local a0, a1, b0, b1 (N, 4)."""
    spans = face.projector.spans
    corners = np.concatenate(face.face.loops)
    low, high = corners.min(axis=0), corners.max(axis=0)
    pieces = []
    for breaks, start, end in ((spans.breaks_u, low[0], high[0]), (spans.breaks_v, low[1], high[1])):
        first = np.maximum(breaks[:-1], start)
        last = np.minimum(breaks[1:], end)
        pieces.append([(k, first[k], last[k]) for k in np.flatnonzero(last > first)])
    index, place = [], []
    for i, u0, u1 in pieces[0]:
        for j, v0, v1 in pieces[1]:
            u, v = np.array([u0, u1, u0, u1, 0.5 * (u0 + u1)]), np.array([v0, v0, v1, v1, 0.5 * (v0 + v1)])
            frame = face.projector.evaluate(u, v)
            count_u, count_v = (
                max(int(np.ceil(np.linalg.norm(frame[:, m], axis=1).max() * width / ROOT)), 1)
                for m, width in ((1, u1 - u0), (2, v1 - v0))
            )
            breaks_u, breaks_v = spans.breaks_u, spans.breaks_v
            a = (np.linspace(u0, u1, count_u + 1) - breaks_u[i]) / (breaks_u[i + 1] - breaks_u[i])
            b = (np.linspace(v0, v1, count_v + 1) - breaks_v[j]) / (breaks_v[j + 1] - breaks_v[j])
            for k in range(count_u):
                for m in range(count_v):
                    index.append((i, j))
                    place.append((a[k], a[k + 1], b[m], b[m + 1]))
    return np.array(index, dtype=np.int64).reshape(-1, 2), np.array(place).reshape(-1, 4)
