"""Blind search for lines: every direction at a point of a face is tried, the best are refined.

The reference for the reachability map of `conflank_cli.detection`. It knows nothing of curvature and shares only the
footpoint kernel with it. The question is the same: a line touches the face at x with sphere j0 of the cone (J spheres
at equal heights, radii ρ_j) where that sphere's centre is x + (ρ_j0 + δ) n. Its axis errors are ε_j = distance - ρ_j
at spheres whose foot is on the trimmed face. The error of the line is the least e such that

    (a) ε_j >= -e for every sphere on the face, and
    (b) a run of at least `least` spheres on the face that holds j0 has |ε_j| <= e,

and the reach error of x is the least over δ, the direction of the axis and j0.

A direction is d = cos φ (cos θ t1 + sin θ t2) + sin φ n. First δ = 0 and φ is the half angle of the cone, as for a cone
on a plane, while θ runs round in steps of a degree: the score of a direction is what is left of (a) and (b) after the
best shift and tilt, found from the errors by a straight line. Every local minimum of the score over θ is then refined
in (δ, θ, φ) by Newton's method on the p-norm of the errors that count, p rising to 64.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt
from numba import njit

from conflank_cli.cores import spread
from conflank_cli.geometry.face import DesignFace
from conflank_cli.geometry.kernels.footpoint import INTERIOR, project
from conflank_cli.geometry.workface import FaceSamples, WorkFace, on_face
from conflank_cli.tool import Tool

Array = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

SPHERES = 24
LEAST_RUN = 8  # a third of the flute
DIRECTIONS = 360
# Spheres that touch at the point: no run of LEAST_RUN lies between two neighbours.
CONTACTS = (1, 4, 7, 10, 13, 16, 19, 22)
# Refined at most for each point and height; there are hardly ever more than ten minima.
STARTS = 40
# Refined lines that are kept for each point and height, best first.
KEPT = 8
# A direction whose score is above this is no start, mm: refinement changes what the score leaves out, which is small.
HOPELESS_SCORE = 0.25
# Given up after the steps at p = 2 above this error, mm.
HOPELESS = 0.15
# Exponents of the norm, in order.
NORMS = (2, 2, 2, 2, 4, 4, 8, 8, 16, 16, 32, 32, 64, 64)
PLAIN = 4  # of these, the first so many are least squares
# Relative size of the smallest Levenberg term; it grows while a step fails.
LEAST_DAMPING = 1e-9
# Steps of one norm that may fail before the next one is tried; a step that moves the line less than LAST_STEP, mm, is
# the last.
RETRIES, LAST_STEP = 3, 1e-7
# Cells a side of the table that tells most points on the face from those off it without looking at the loops.
TABLE = 512
INSIDE, OFF, NEAR_LOOP = 1, 0, 2


@dataclass(frozen=True, slots=True)
class Trim:
    """Which parameters lie on a trimmed face, exactly.

    Attributes
    ----------
    vertices: (M, 2) of the loops one after the other. starts: (K + 1,) where each begins.
    table: (TABLE, TABLE) over the box of the loops: INSIDE, OFF, or NEAR_LOOP, where the loops have to be asked.
    box: (4,) u0, u1, v0, v1 of the table.
    """

    vertices: Array
    starts: IntArray
    table: npt.NDArray[np.int8]
    box: Array

    @classmethod
    def of(cls, face: DesignFace) -> Trim:
        vertices = np.ascontiguousarray(np.concatenate(face.loops))
        starts = np.cumsum([0, *(len(loop) for loop in face.loops)]).astype(np.int64)
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        size = (high - low) / TABLE
        middle = [low[k] + (np.arange(TABLE) + 0.5) * size[k] for k in (0, 1)]
        grid = np.stack(np.meshgrid(*middle, indexing="ij"), axis=-1).reshape(-1, 2)
        table = np.where(on_face(face, grid), INSIDE, OFF).astype(np.int8).reshape(TABLE, TABLE)
        for loop in face.loops:
            for a, b in pairwise(np.vstack([loop, loop[:1]])):
                count = int(np.ceil(np.abs((b - a) / size).max() * 2.0)) + 1
                cells = ((a + np.linspace(0.0, 1.0, count)[:, None] * (b - a) - low) / size).astype(int)
                for du in (-1, 0, 1):
                    for dv in (-1, 0, 1):
                        i, j = np.clip(cells + np.array([du, dv]), 0, TABLE - 1).T
                        table[i, j] = NEAR_LOOP
        return cls(vertices, starts, table, np.array([low[0], high[0], low[1], high[1]]))


@dataclass(frozen=True, slots=True)
class BlindLines:
    """What the blind search found at N points with H contact heights, K lines each.

    Attributes
    ----------
    error: (N,) reach error, mm; inf where there is no line.
    every: (N, H, K) errors of the distinct minima, mm, best first; inf where there are fewer.
    p, d: (N, H, K, 3) those lines: the point in the plane of r_min, mm, and the unit direction tip to spindle.
    on: (N, H, K) how many of the spheres are on the face.
    contacts: (H,) the spheres that touch at the point.
    footpoints: how many were computed.
    """

    error: Array
    every: Array
    p: Array
    d: Array
    on: IntArray
    contacts: IntArray
    footpoints: int


@njit(forceinline=True)
def _on_trim(u, v, vertices, starts, table, box):  # type: ignore[no-untyped-def]
    if u < box[0] or u > box[1] or v < box[2] or v > box[3]:
        return False
    n = table.shape[0]
    i = min(int((u - box[0]) / (box[1] - box[0]) * n), n - 1)
    j = min(int((v - box[2]) / (box[3] - box[2]) * n), n - 1)
    if table[i, j] != NEAR_LOOP:
        return table[i, j] == INSIDE
    odd = False
    for loop in range(starts.shape[0] - 1):
        b = starts[loop + 1] - 1
        for a in range(starts[loop], starts[loop + 1]):
            if (vertices[a, 1] > v) != (vertices[b, 1] > v):
                share = (v - vertices[a, 1]) / (vertices[b, 1] - vertices[a, 1])
                if u < vertices[a, 0] + share * (vertices[b, 0] - vertices[a, 0]):
                    odd = not odd
            b = a
    return odd


@njit(cache=True)
def line_errors(surface, sense, trim, centre, d, heights, radii, contact, u0, v0, error, on, normal):  # type: ignore[no-untyped-def]
    """Axis errors (J,) of the line through `centre` at the sphere `contact`, feet followed outwards from there.

    surface: breaks_u, breaks_v, coefficients, box. trim: vertices, starts, table, box. Fills error, on (J,) bool and
    normal (J, 3) towards the cutter.
    """
    u1 = u0
    v1 = v0
    for side in range(2):
        u = u1
        v = v1
        j = contact if side == 0 else contact - 1
        while 0 <= j < heights.shape[0]:
            h = heights[j] - heights[contact]
            r = project(
                surface[0], surface[1], surface[2], surface[3],
                centre[0] + h * d[0], centre[1] + h * d[1], centre[2] + h * d[2], u, v,
            )  # fmt: skip
            u = r[0]
            v = r[1]
            error[j] = sense * r[8] - radii[j]
            normal[j, 0] = sense * r[5]
            normal[j, 1] = sense * r[6]
            normal[j, 2] = sense * r[7]
            on[j] = r[9] == INTERIOR and _on_trim(u, v, trim[0], trim[1], trim[2], trim[3])
            if j == contact:
                u1 = u
                v1 = v
            j += 1 if side == 0 else -1


@njit(cache=True)
def line_error(error, on, contact, least):  # type: ignore[no-untyped-def]
    """Error of a line by its definition, and the first sphere of the best run (-1: none)."""
    over = 0.0
    for j in range(error.shape[0]):
        if on[j]:
            over = max(over, -error[j])
    best = np.inf
    first = -1
    for a in range(max(0, contact - least + 1), min(contact, error.shape[0] - least) + 1):
        largest = 0.0
        for j in range(a, a + least):
            largest = max(largest, abs(error[j])) if on[j] else np.inf
        if largest < best:
            best = largest
            first = a
    return max(over, best), first


@njit(cache=True)
def score(error, on, contact, least):  # type: ignore[no-untyped-def]
    """What the best shift and tilt leave of a line's error: (score, first sphere of the run, shift, tilt a sphere).

    For each run a straight line is fitted to its errors; the score is the largest residual in it, or the overcut that
    the other spheres have against the straight line, whichever is more.
    """
    count = error.shape[0]
    best = np.inf
    first = -1
    shift = 0.0
    tilt = 0.0
    spread = least * (least * least - 1) / 12.0
    for a in range(max(0, contact - least + 1), min(contact, count - least) + 1):
        mean = 0.0
        slope = 0.0
        there = True
        for j in range(a, a + least):
            if not on[j]:
                there = False
                break
            mean += error[j] / least
            slope += error[j] * (j - a - 0.5 * (least - 1)) / spread
        if not there:
            continue
        largest = 0.0
        for j in range(count):
            left = error[j] - mean - slope * (j - a - 0.5 * (least - 1))
            if a <= j < a + least:
                largest = max(largest, abs(left))
            elif on[j]:
                largest = max(largest, -left)
        if largest < best:
            best = largest
            first = a
            tilt = slope
            shift = mean + slope * (contact - a - 0.5 * (least - 1))
    return best, first, shift, tilt


@njit(forceinline=True)
def _counts(j, error, on, first, least):  # type: ignore[no-untyped-def]
    """Whether an error takes part in the norm: in the run, or overcut anywhere on the face."""
    return first <= j < first + least or (on[j] and error[j] < 0.0)


@njit(cache=True)
def refine(surface, sense, trim, x, n, t1, t2, contact, u0, v0, heights, radii, least, delta, theta, phi, out):  # type: ignore[no-untyped-def]
    """Least error of a line near (δ, θ, φ) that touches at x with the sphere `contact`.

    Fills out (8,): error, δ, θ, φ, spheres on the face, d. Returns the footpoints used.
    """
    count = heights.shape[0]
    span = heights[count - 1] - heights[0]
    error, kept_error = np.empty(count), np.empty(count)
    on, kept_on = np.empty(count, dtype=np.bool_), np.empty(count, dtype=np.bool_)
    normal, rows = np.empty((count, 3)), np.empty((count, 3))
    matrix, right, step = np.empty((3, 3)), np.empty(3), np.zeros(3)
    centre, d = np.empty(3), np.empty(3)
    now = np.array([delta, theta, phi])
    trial = now.copy()
    out[0] = np.inf
    used = 0
    first = -1
    largest = np.inf
    damping = LEAST_DAMPING
    stage = 0  # the first evaluation is of the start
    failures = 0
    while True:
        c, s = np.cos(trial[2]), np.sin(trial[2])
        ct, st = np.cos(trial[1]), np.sin(trial[1])
        for k in range(3):
            d[k] = c * (ct * t1[k] + st * t2[k]) + s * n[k]
            centre[k] = x[k] + (radii[contact] + trial[0]) * n[k]
        line_errors(surface, sense, trim, centre, d, heights, radii, contact, u0, v0, error, on, normal)
        used += count
        whole, run = line_error(error, on, contact, least)
        if run >= 0 and whole < out[0]:
            out[0] = whole
            out[1:4] = trial
            out[4] = on.sum()
            out[5:8] = d
        better = run >= 0
        if better and stage > 0:
            norm = NORMS[stage - 1]
            before = _norm(kept_error, kept_on, first, least, largest, norm)
            better = _norm(error, on, run, least, whole, norm) < before
        if better:
            now[:] = trial
            first = run
            largest = whole
            kept_error[:] = error
            kept_on[:] = on
            for j in range(count):
                arm = heights[j] - heights[contact]
                rows[j] = 0.0
                for k in range(3):
                    rows[j, 0] += normal[j, k] * n[k]
                    rows[j, 1] += normal[j, k] * arm * c * (ct * t2[k] - st * t1[k])
                    rows[j, 2] += normal[j, k] * arm * (c * n[k] - s * (ct * t1[k] + st * t2[k]))
            damping = max(0.1 * damping, LEAST_DAMPING)
            failures = 0
        elif stage == 0:
            return used
        else:
            failures += 1
            damping = max(30.0 * damping, 1e-3)
        if failures == 0 or failures == RETRIES:
            if stage == PLAIN and out[0] > HOPELESS:
                return used
            if stage == len(NORMS):
                return used
            stage += 1
            failures = 0
        norm = NORMS[stage - 1]
        _newton(kept_error, kept_on, rows, first, least, largest, norm, damping, span, matrix, right, step)
        if norm == NORMS[-1] and max(abs(step[0]), span * abs(step[1]), span * abs(step[2])) < LAST_STEP:
            return used
        trial[:] = now + step


@njit(cache=True)
def _norm(error, on, first, least, largest, norm):  # type: ignore[no-untyped-def]
    """The p-norm of the errors that count, scaled by the largest on the way so that nothing overflows."""
    total = 0.0
    scale = max(largest, 1e-12)
    for j in range(error.shape[0]):
        if _counts(j, error, on, first, least):
            total += (abs(error[j]) / scale) ** norm
    return scale * total ** (1.0 / norm)


@njit(cache=True)
def _newton(error, on, rows, first, least, largest, norm, damping, span, matrix, right, step):  # type: ignore[no-untyped-def]
    """Newton step of the p-norm: weights (|ε| / largest)^(p - 2), the Hessian being p - 1 times the plain one."""
    matrix[:] = 0.0
    right[:] = 0.0
    for j in range(error.shape[0]):
        if not _counts(j, error, on, first, least):
            continue
        w = (abs(error[j]) / max(largest, 1e-12)) ** (norm - 2)
        for a in range(3):
            right[a] -= w * rows[j, a] * error[j]
            for b in range(3):
                matrix[a, b] += (norm - 1) * w * rows[j, a] * rows[j, b]
    trace = matrix[0, 0] + (matrix[1, 1] + matrix[2, 2]) / (span * span)
    matrix[0, 0] += damping * trace + 1e-12
    matrix[1, 1] += (damping * trace + 1e-12) * span * span
    matrix[2, 2] += (damping * trace + 1e-12) * span * span
    step[:] = np.linalg.solve(matrix, right)
    longest = max(abs(step[0]) / 0.5, abs(step[1]) / 0.05, abs(step[2]) / 0.05)
    if longest > 1.0:
        step /= longest


@njit(cache=True, nogil=True)
def _search(surface, sense, trim, points, normals, uv, contacts, heights, radii, half_angle, least, found, used):  # type: ignore[no-untyped-def]
    """Fill found (N, H, KEPT, 8), rows as in `refine`, and used (N, H)."""
    places = contacts.shape[0]
    for task in range(points.shape[0] * places):
        i = task // places
        k = task % places
        contact = contacts[k]
        x = points[i]
        n = normals[i]
        t1 = np.array([0.0, n[2], -n[1]]) if abs(n[0]) < 0.6 else np.array([-n[2], 0.0, n[0]])
        t1 /= np.sqrt(np.sum(t1**2))
        t2 = np.array([n[1] * t1[2] - n[2] * t1[1], n[2] * t1[0] - n[0] * t1[2], n[0] * t1[1] - n[1] * t1[0]])
        centre = x + radii[contact] * n
        error = np.empty(heights.shape[0])
        on = np.empty(heights.shape[0], dtype=np.bool_)
        normal = np.empty((heights.shape[0], 3))
        scores = np.empty(DIRECTIONS)
        shifts = np.empty(DIRECTIONS)
        tilts = np.empty(DIRECTIONS)
        for m in range(DIRECTIONS):
            angle = m * (2.0 * np.pi / DIRECTIONS)
            d = np.cos(half_angle) * (np.cos(angle) * t1 + np.sin(angle) * t2) + np.sin(half_angle) * n
            line_errors(surface, sense, trim, centre, d, heights, radii, contact, uv[i, 0], uv[i, 1], error, on, normal)
            scores[m], _, shifts[m], tilts[m] = score(error, on, contact, least)
        used[i, k] = DIRECTIONS * heights.shape[0]
        starts = np.empty(DIRECTIONS, dtype=np.int64)
        count = 0
        for m in range(DIRECTIONS):
            lowest = scores[m] <= scores[m - 1] and scores[m] <= scores[(m + 1) % DIRECTIONS]
            if lowest and scores[m] < HOPELESS_SCORE:
                starts[count] = m
                count += 1
        order = np.argsort(scores[starts[:count]])
        spacing = heights[1] - heights[0]
        line = np.empty(8)
        filled = 0
        for a in range(min(count, STARTS)):
            m = starts[order[a]]
            angle = m * (2.0 * np.pi / DIRECTIONS)
            used[i, k] += refine(
                surface, sense, trim, x, n, t1, t2, contact, uv[i, 0], uv[i, 1], heights, radii, least,
                -shifts[m], angle, half_angle - tilts[m] / spacing, line,
            )  # fmt: skip
            # The straight line guesses a step that may leave the face: the direction itself is a start as well.
            if line[0] > HOPELESS:
                used[i, k] += refine(
                    surface, sense, trim, x, n, t1, t2, contact, uv[i, 0], uv[i, 1], heights, radii, least,
                    0.0, angle, half_angle, line,
                )  # fmt: skip
            # Sorted by error, each direction (within about two degrees) once.
            known = -1
            for b in range(filled):
                if found[i, k, b, 5:8] @ line[5:8] > 0.9994:
                    known = b
                    break
            if line[0] == np.inf or (known >= 0 and found[i, k, known, 0] <= line[0]):
                continue
            if known >= 0:
                for b in range(known, filled - 1):
                    found[i, k, b] = found[i, k, b + 1]
                filled -= 1
            place = filled
            while place > 0 and found[i, k, place - 1, 0] > line[0]:
                place -= 1
            for b in range(min(filled, KEPT - 1), place, -1):
                found[i, k, b] = found[i, k, b - 1]
            if place < KEPT:
                found[i, k, place] = line
                filled = min(filled + 1, KEPT)


@dataclass(frozen=True, slots=True)
class BlindSearch:
    """A face and a tool made ready: `search` for the lines at points, `check` for the error of given lines."""

    face: WorkFace
    tool: Tool
    trim: Trim
    heights: Array
    radii: Array
    least: int

    @classmethod
    def of(cls, face: WorkFace, tool: Tool, allowance: float = 0.0, least: int = LEAST_RUN) -> BlindSearch:
        heights = np.linspace(*tool.centre_range, SPHERES)
        return cls(face, tool, Trim.of(face.face), heights, tool.sphere_radius(heights) + allowance, least)

    @property
    def _trim(self) -> tuple[Array, IntArray, npt.NDArray[np.int8], Array]:
        return self.trim.vertices, self.trim.starts, self.trim.table, self.trim.box

    def search(self, samples: FaceSamples, contacts: tuple[int, ...] = CONTACTS) -> BlindLines:
        """All lines through the samples."""
        places = np.array(contacts, dtype=np.int64)
        found = np.full((len(samples.uv), len(places), KEPT, 8), np.inf)
        used = np.zeros(found.shape[:2], dtype=np.int64)
        surface, trim = tuple(self.face.projector.spans), self._trim

        def run(part: slice) -> None:
            _search(
                surface, self.face.sense, trim, samples.points[part], samples.normals[part], samples.uv[part],
                places, self.heights, self.radii, self.tool.half_angle, self.least, found[part], used[part],
            )  # fmt: skip

        spread(run, len(samples.uv))
        every = found[..., 0]
        there = np.isfinite(every)
        d = np.where(there[..., None], found[..., 5:8], np.nan)
        shift = np.where(there, found[..., 1], np.nan) + self.radii[places][:, None]
        p = samples.points[:, None, None] + shift[..., None] * samples.normals[:, None, None]
        p = p - self.heights[places][:, None, None] * d
        on = np.where(there, found[..., 4], 0.0).astype(np.int64)
        return BlindLines(every.min(axis=(1, 2)), every, p, d, on, places, int(used.sum()))

    def check(self, samples: FaceSamples, p: Array, d: Array, height: Array) -> tuple[Array, Array]:
        """Errors (N,) of one given line at each sample, and how far its sphere is from touching there (N,), mm."""
        error, off = np.full(len(p), np.inf), np.full(len(p), np.inf)
        for i in np.flatnonzero(np.isfinite(p).all(axis=1) & np.isfinite(height)):
            contact = int(np.argmin(np.abs(self.heights - height[i])))
            centre = p[i] + self.heights[contact] * d[i]
            values, on, normal = np.empty(SPHERES), np.empty(SPHERES, dtype=np.bool_), np.empty((SPHERES, 3))
            line_errors(
                tuple(self.face.projector.spans), self.face.sense, self._trim, centre, d[i], self.heights, self.radii,
                contact, samples.uv[i, 0], samples.uv[i, 1], values, on, normal,
            )  # fmt: skip
            error[i] = line_error(values, on, contact, self.least)[0]
            touch = samples.points[i] + (self.radii[contact] + values[contact]) * samples.normals[i]
            off[i] = float(np.linalg.norm(centre - touch))
        return error, off

    def refined(self, samples: FaceSamples, index: IntArray, d: Array, height: Array) -> tuple[Array, Array]:
        """Lines from direction d (M, 3) at samples `index` (M,), refined as in the search: errors (M,), d (M, 3)."""
        error, direction = np.full(len(index), np.inf), np.array(d)
        for k, i in enumerate(index):
            contact = int(np.argmin(np.abs(self.heights - height[k])))
            n = samples.normals[i]
            t1 = np.cross(n, d[k])
            t1 /= np.linalg.norm(t1)
            out = np.empty(8)
            refine(
                tuple(self.face.projector.spans), self.face.sense, self._trim, samples.points[i], n, np.cross(t1, n),
                t1, contact, samples.uv[i, 0], samples.uv[i, 1], self.heights, self.radii, self.least,
                0.0, 0.0, float(np.arcsin(np.clip(n @ d[k], -1.0, 1.0))), out,
            )  # fmt: skip
            error[k] = out[0]
            if np.isfinite(out[0]):
                direction[k] = out[5:8]
        return error, direction
