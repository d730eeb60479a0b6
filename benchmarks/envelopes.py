"""Exact envelopes: faces that are what a known motion of a conical tool leaves behind.

A sphere of the cutter sits at c(t, h) on the axis at height h above the plane of r_min and has the radius
ρ(h) = r_min cos α + h sin α. Its contact with the envelope is x = c - ρ n, where the unit vector n points from the
surface to the axis. The envelope of |x - c|² = ρ² asks for

    along h:  <x - c, -c_h> = ρ ρ'   with c_h = d, ρ' = sin α:   <n, d> = sin α
    along t:  <x - c, -ċ>  = 0       (ρ does not change):        <n, ċ> = 0

which n = sin α d + cos α (cos ψ w + sin ψ d x w) solves with w the direction of ċ across d and
cos ψ = -tan α <ċ, d> / |ċ across d|. The two signs of ψ are the two sides of the cut.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import cos, sin, tan
from pathlib import Path
from typing import TypeVar

import numpy as np
import numpy.typing as npt
from scipy.interpolate import make_interp_spline
from scipy.spatial.transform import Rotation

from benchmarks.jobs import job_text
from conflank_cli.geometry.footpoint import Projector
from conflank_cli.geometry.surface import BSplineSurface
from conflank_cli.tool import CATALOGUE, Tool

Array = npt.NDArray[np.float64]
# Real, or complex where a derivative is taken.
Times = TypeVar("Times", npt.NDArray[np.float64], npt.NDArray[np.complex128])

# A step without cancellation: derivatives along t are exact to rounding (complex step).
COMPLEX_STEP = 1e-30

PATCH = (0.05, 0.95)  # the part of the motion whose envelope is the face
MARGIN = 0.03  # share of the cone left over at either end
SURFACE_ERROR = 5e-6  # mm, between the spline and the closed form; twice as fine as what is promised
LARGEST_OVERLAP = 2e-5  # mm of swept gap on the face, beyond which the motion cuts its own envelope
LEAST_STRETCH = 0.2  # of the speed of the contact over that of the axis: less is a crease in the making
LARGEST_TILT = 0.4  # rad
POSES = 401


def cylinder() -> Tool:
    """A cylindrical ball-end mill, diameter 6, flute 25 mm."""
    t1 = CATALOGUE["T1"]
    return Tool("CYL6", 3.0, 3.0, 25.0, t1.shank, t1.holder, 4)


@dataclass(frozen=True, slots=True)
class KnownMotion:
    """A smooth rigid motion in closed form.

    The middle of the flute runs along `path`; the axis starts as `frame`'s third column and turns by the rotation
    vector `turn` (both in `frame`, a pose of the whole case in space).

    Attributes
    ----------
    path, turn: (terms, 3) coefficients of t and of cos(π k t) - 1 for k = 1, 2, …; mm and radians.
    frame: (3, 3) rotation of the whole case; origin (3,): its place, mm.
    middle: height of the middle of the flute above the plane of r_min, mm.
    length: distance from the plane of r_min to that of r_max, mm.
    """

    path: Array
    turn: Array
    frame: Array
    origin: Array
    middle: float
    length: float

    def axis(self, t: Times) -> tuple[Times, Times]:
        """Point p in the plane of r_min and unit direction d at times t (N,), real or complex, each (N, 3)."""
        waves = np.stack([t] + [np.cos(np.pi * k * t) - 1.0 for k in range(1, len(self.path))], axis=1)
        centre = waves @ self.path
        spin = waves @ self.turn
        # Rodrigues for the third unit vector; sin(x)/x and (1 - cos x)/x² as functions of x² stay analytic at zero.
        square = np.sum(spin * spin, axis=1)[:, None]
        first, second = _sinc_of_square(square), _versine_of_square(square)
        up = np.array([0.0, 0.0, 1.0])
        direction = up + first * np.cross(spin, up) + second * np.cross(spin, np.cross(spin, up))
        base = centre - self.middle * direction
        return base @ self.frame.T + self.origin, direction @ self.frame.T

    def velocity(self, t: Array) -> tuple[Array, Array]:
        """Time derivatives of p and d, each (N, 3)."""
        p, d = self.axis(np.asarray(t + 1j * COMPLEX_STEP, dtype=np.complex128))
        slopes = np.stack([p.imag, d.imag]).astype(np.float64) / COMPLEX_STEP
        return slopes[0], slopes[1]

    def ends(self, t: Array) -> tuple[Array, Array]:
        """Points p(t) and q(t) as `conflank_cli.motion.Motion.ends` gives them, each (N, 3)."""
        p, d = self.axis(t)
        return p, p + self.length * d


def _sinc_of_square(square: Times) -> Times:
    """sin(x) / x as a function of x²: a power series, exact to rounding for x below 2."""
    total, term = np.ones_like(square), np.ones_like(square)
    for k in range(1, 14):
        term = -term * square / ((2 * k) * (2 * k + 1))
        total = total + term
    return total


def _versine_of_square(square: Times) -> Times:
    """(1 - cos x) / x² as a function of x², likewise."""
    total, term = np.full_like(square, 0.5), np.full_like(square, 0.5)
    for k in range(1, 14):
        term = -term * square / ((2 * k + 1) * (2 * k + 2))
        total = total + term
    return total


@dataclass(frozen=True, slots=True)
class EnvelopeCase:
    """A face that one sweep of a tool cuts exactly.

    Attributes
    ----------
    tool: the tool.
    motion: the motion in closed form, t in [0, 1]; it overshoots the face at both ends.
    t: (POSES,) times; p, q: (POSES, 3) the axis ends at these times, mm.
    surface: the envelope patch; u is the time, v the height of the contact over the flute length.
    sense: +1 where S_u x S_v points towards the tool.
    """

    tool: Tool
    motion: KnownMotion
    t: Array
    p: Array
    q: Array
    surface: BSplineSurface
    sense: int


def contact(tool: Tool, motion: KnownMotion, t: Array, fraction: Array, side: int) -> tuple[Array, Array]:
    """Contact points and unit normals towards the axis, each (N, 3).

    Parameters
    ----------
    t: times (N,).
    fraction: heights (N,) of the contact above the plane of r_min, over the flute length.
    side: +1 or -1, the side of the cut.
    """
    alpha = tool.half_angle
    # The contact lies ρ sin α below its sphere's centre: z = h - ρ sin α, solved for h.
    height = fraction * tool.length / cos(alpha) ** 2 + tool.r_min * tan(alpha)
    p, d = motion.axis(t)
    p_dot, d_dot = motion.velocity(t)
    c_dot = p_dot + height[:, None] * d_dot
    along = np.sum(c_dot * d, axis=1)[:, None]
    across = c_dot - along * d
    speed = np.linalg.norm(across, axis=1)[:, None]
    cosine = -tan(alpha) * along / speed
    w = across / speed
    with np.errstate(invalid="ignore"):  # no envelope where the axis moves along itself: NaN, and the draw is refused
        sine = side * np.sqrt(1.0 - cosine * cosine)
    normal = sin(alpha) * d + cos(alpha) * (cosine * w + sine * np.cross(d, w))
    centre = p + height[:, None] * d
    return centre - tool.sphere_radius(height)[:, None] * normal, normal


def cutter_distance(tool: Tool, p: Array, d: Array, points: Array) -> Array:
    """Signed distance from points to the ball and the cone at poses p, d; shapes broadcast to (..., 3); mm.

    Above the plane of r_max the cutter is taken for open ended (nothing there cuts): the distance is to its upper rim.
    """
    alpha = tool.half_angle
    relative = points - p
    z = np.sum(relative * d, axis=-1)
    r = np.linalg.norm(relative - z[..., None] * d, axis=-1)
    along = z * cos(alpha) + (r - tool.r_min) * sin(alpha)
    cone = (r - tool.r_min) * cos(alpha) - z * sin(alpha)
    ball = np.hypot(r, z - tool.ball_centre_height) - tool.ball_radius
    rim = np.hypot(r - tool.r_max, z - tool.length)
    distance: Array = np.where(along < 0.0, ball, np.where(along > tool.length / cos(alpha), rim, cone))
    return distance


def swept_gap(
    tool: Tool, axis: Callable[[Array], tuple[Array, Array]], points: Array, poses: int = POSES
) -> tuple[Array, Array]:
    """Swept gap by brute force: least signed distance from each point to the cutter over all poses of a motion.

    Parameters
    ----------
    axis: p and d at times in [0, 1].
    points: (N, 3) mm.

    Returns the gaps (N,) in mm and the times (N,) where they occur. All poses are tried for all points, then each of
    the two lowest valleys is refined by golden sections. Nothing is shared with the package.
    """
    t = np.linspace(0.0, 1.0, poses)
    p, d = axis(t)
    distance = np.stack([cutter_distance(tool, p[k], d[k], points) for k in range(poses)], axis=1)
    padded = np.pad(distance, ((0, 0), (1, 1)), constant_values=np.inf)
    valley = (distance <= padded[:, :-2]) & (distance <= padded[:, 2:])
    ranked = np.argsort(np.where(valley, distance, np.inf), axis=1)[:, :2]
    gaps, times = [], []
    for choice in ranked.T:
        low, high = t[np.maximum(choice - 1, 0)], t[np.minimum(choice + 1, poses - 1)]
        golden = (np.sqrt(5.0) - 1.0) / 2.0
        for _ in range(36):
            left, right = high - golden * (high - low), low + golden * (high - low)
            nearer = cutter_distance(tool, *axis(left), points) < cutter_distance(tool, *axis(right), points)
            low, high = np.where(nearer, low, left), np.where(nearer, right, high)
        middle = 0.5 * (low + high)
        gaps.append(cutter_distance(tool, *axis(middle), points))
        times.append(middle)
    best = np.argmin(gaps, axis=0)
    index = np.arange(len(points))
    return np.stack(gaps)[best, index], np.stack(times)[best, index]


def random_motion(tool: Tool, rng: np.random.Generator) -> KnownMotion:
    """A motion as on a blade: 30 to 60 mm across the axis, which turns by 10 to 40 degrees on the way."""
    length = rng.uniform(30.0, 60.0)
    path = np.zeros((4, 3))
    path[0] = [length, 0.0, rng.normal() * 0.08 * length]
    for k in (1, 2, 3):
        path[k] = rng.normal(size=3) * np.array([0.02, 0.08, 0.03]) * length / k**2
    turn = np.zeros((4, 3))
    axis = rng.normal(size=3)
    axis[2] *= 0.3  # spin about the tool's own axis does nothing
    turn[0] = axis / np.linalg.norm(axis[:2]) * np.radians(rng.uniform(10.0, 40.0))
    for k in (1, 2, 3):
        turn[k] = rng.normal(size=3) * np.radians(4.0) / k**2
    # The axis stays within reach of a rotary table: up, but for LARGEST_TILT and its own turning.
    tilt, heading = rng.uniform(0.0, LARGEST_TILT), rng.uniform(0.0, 2.0 * np.pi, 2)
    frame = Rotation.from_euler("ZXZ", [heading[0], tilt, heading[1]]).as_matrix()
    return KnownMotion(path, turn, frame, rng.uniform(-50.0, 50.0, 3), 0.5 * tool.length, tool.length)


def random_envelopes(tool: Tool, count: int, seed: int) -> list[EnvelopeCase]:
    """Draw motions until `count` of them leave a regular envelope that they do not cut again.

    Equal seeds give equal cases; different tools get different motions.
    """
    rng = np.random.default_rng([seed, *tool.name.encode()])
    cases: list[EnvelopeCase] = []
    while len(cases) < count:
        motion, side = random_motion(tool, rng), int(rng.choice([-1, 1]))
        surface = _envelope_surface(tool, motion, side)
        if surface is None:
            continue
        sense = _regular_sense(tool, motion, side, surface)
        if sense == 0 or _overlaps(tool, motion, side):
            continue
        t = np.linspace(0.0, 1.0, POSES)
        cases.append(EnvelopeCase(tool, motion, t, *motion.ends(t), surface, sense))
    return cases


def _grid(u: Array, v: Array) -> tuple[Array, Array]:
    """Tensor grid, flattened."""
    uu, vv = np.meshgrid(u, v, indexing="ij")
    return uu.ravel(), vv.ravel()


def _envelope_surface(tool: Tool, motion: KnownMotion, side: int) -> BSplineSurface | None:
    """The patch as a bicubic interpolant, refined until it is `SURFACE_ERROR` close between its nodes, else None."""
    for nu, nv in ((24, 10), (40, 14), (64, 20), (96, 28)):
        u, v = np.linspace(*PATCH, nu), np.linspace(MARGIN, 1.0 - MARGIN, nv)
        points, _ = contact(tool, motion, *_grid(u, v), side)
        if not np.all(np.isfinite(points)):
            return None
        along_u = make_interp_spline(u, points.reshape(nu, nv, 3), k=3, axis=0)
        along_v = make_interp_spline(v, np.moveaxis(along_u.c, 1, 0), k=3, axis=0)
        poles = np.ascontiguousarray(np.moveaxis(along_v.c, 0, 1))
        surface = BSplineSurface(3, 3, along_u.t, along_v.t, poles)
        between = _grid(np.linspace(*PATCH, 3 * nu + 1), np.linspace(MARGIN, 1.0 - MARGIN, 3 * nv + 1))
        exact, _ = contact(tool, motion, *between, side)
        error = np.linalg.norm(Projector.of(surface).evaluate(*between)[:, 0] - exact, axis=1).max()
        if error <= SURFACE_ERROR:
            return surface
    return None


def _regular_sense(tool: Tool, motion: KnownMotion, side: int, surface: BSplineSurface) -> int:
    """+1 or -1 as S_u x S_v points towards the tool or away from it all over the patch; 0 if it is not regular.

    Regular means that the contact moves steadily, at no less than `LEAST_STRETCH` of the axis, and never backwards.
    """
    t, fraction = _grid(np.linspace(*PATCH, 60), np.linspace(MARGIN, 1.0 - MARGIN, 16))
    frame = Projector.of(surface).evaluate(t, fraction)
    _, normal = contact(tool, motion, t, fraction, side)
    p_dot, d_dot = motion.velocity(t)
    speed = np.linalg.norm(p_dot + (fraction * tool.length)[:, None] * d_dot, axis=1)
    area = np.sum(np.cross(frame[:, 1], frame[:, 2]) * normal, axis=1)
    # Across the generator, per time; a crease turns it round.
    stretch = area / (np.linalg.norm(frame[:, 2], axis=1) * speed)
    if np.all(stretch > LEAST_STRETCH):
        return 1
    return -1 if np.all(stretch < -LEAST_STRETCH) else 0


def _overlaps(tool: Tool, motion: KnownMotion, side: int) -> bool:
    """Whether the tool cuts into its own envelope anywhere on the patch."""
    t, fraction = _grid(np.linspace(*PATCH, 40), np.linspace(MARGIN, 1.0 - MARGIN, 9))
    points, _ = contact(tool, motion, t, fraction, side)
    gap, _ = swept_gap(tool, motion.axis, points, 161)
    return bool(gap.min() < -LARGEST_OVERLAP)


def write_job(case: EnvelopeCase, folder: Path, name: str) -> Path:
    """Write the face as STEP and a job that asks for it; returns the path of the job.

    The face is oriented along S_u x S_v, so `side` says where the tool is.
    """
    from benchmarks.occ import write_step  # the CAD kernel is only needed here

    folder.mkdir(parents=True, exist_ok=True)
    write_step(case.surface, folder / f"{name}.step")
    job = folder / f"{name}.toml"
    side = "outside" if case.sense > 0 else "inside"
    text = job_text(f"{name}.step", 0, side, case.tool, tolerance=0.010, coverage=0.97, program=name.upper())
    job.write_text(text, encoding="utf-8")
    return job
