"""Ruled flanks whose swept overcut in one sweep BladeCAM has published: geometry from formulas.

A rail is (r cos θ, r sin θ, z) over u in [0, 1], the face is the ruled surface from the hub's rail to the shroud's:

    r   = r0 + (r1 - r0) (u + 4 rc u (1 - u))
    θ   = wrap u + warp sin 2πu                     at the hub
    θ_s = θ + twist u + backsweep u²                at the shroud
    z   = span u                                    at the hub
    z_s = off + span u + lean span sin πu           at the shroud
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import radians, tan

import numpy as np
import numpy.typing as npt
from scipy.interpolate import make_interp_spline

from benchmarks.detection import whole
from conflank_cli.geometry.footpoint import Projector
from conflank_cli.geometry.gap import gap_field, motion_gap
from conflank_cli.geometry.growth import greville, lengthened
from conflank_cli.geometry.surface import BSplineSurface
from conflank_cli.geometry.workface import WorkFace
from conflank_cli.limits import Limits
from conflank_cli.motion import Motion, fitted
from conflank_cli.optimization.envelope_polish import Points, for_norm
from conflank_cli.optimization.minimax import HARD, Aim, least_worst
from conflank_cli.optimization.terms import Weights
from conflank_cli.tool import Tool

Array = npt.NDArray[np.float64]

# Rails are interpolated by a spline of this degree through so many points: 1e-9 mm from the formula between them.
DEGREE, NODES = 5, 61
# Points of a face: that linear programs begin with, that norms are taken over, that a sweep is judged on. So many if it
# had the same shape everywhere; where rulings spread, several times as many, and at the hub 0.2 mm apart at last.
FEW, POINTS, DENSE = 300, 3000, 10000
# Gaps are exact up to this, mm; and poses this far apart, mm, are looked at when a sweep is judged.
REACH, LOOK = 4.0, 0.25
# Rulings the first motion is fitted through, heights along each at which normals are taken.
RULINGS, HEIGHTS = 200, 25
# The tip starts so far below the hub, mm, and the motion goes on for so many mm beyond the first and last ruling.
BELOW, BEYOND = 2.5, 0.7
# Control points at first, and in the end; sizes that the cylinder takes on its way to its own.
COUNT_FIRST, COUNT, GROWTHS = 20, 40, 8
# Weights of fairness that are tried for a steady sweep, and one with which it may swing back for a while where that
# serves the face. Steady is what nowhere turns by more than a right angle from one time to the next.
FAIRNESS, FREE, STEADY = (30.0, 300.0), 1.0, 0.0
# Times and heights on the flute, as shares, at which steadiness is looked at.
TIMES, SHARES = 300, (0.1, 0.4, 0.7)
# Norms, each for STEPS_EACH steps: while the cylinder grows, and when it has.
WHILE_GROWING, FINALLY, STEPS_EACH = (2, 4), (2, 4, 8, 8, 16, 16, 32, 32), 4
# Everything counts, within so many mm.
EVERYTHING = Limits(5.0, 5.0)
# Programs between two looks at the dense points, so many looks; of what is worse there so many points join.
PROGRAMS, PROGRAMS_TRADE, LOOKS, JOIN = 12, 5, 3, 300
# Differences that do not matter, mm.
FLAT = 5e-4
# The least worst is looked for anew so often.
ANEW = 4
# Contacts within about this much time of a control point tell where the face is from there.
ABOUT = 0.05
# Half angles that are tried, as long as they are better.
HALF_ANGLES = tuple(radians(degrees) for degrees in (1.0, 2.0, 3.0, 4.0, 5.0))


@dataclass(frozen=True, slots=True)
class RuledFlank:
    """A ruled flank, the cylinder that cuts it, and the published overcut.

    Attributes
    ----------
    name: as the tables print it.
    hub, shroud: radii r0 and r1 of the rails, mm.
    span, off: height of the hub's rail and start of the shroud's above it, mm.
    radius, flute: of the cylinder, mm.
    published: overcut of the published sweep, mm.
    wrap, warp, twist, backsweep, lean, rc: as in the formulas.
    """

    name: str
    hub: tuple[float, float]
    shroud: tuple[float, float]
    span: float
    off: float
    radius: float
    flute: float
    published: float
    wrap: float = 0.0
    warp: float = 0.0
    twist: float = 0.0
    backsweep: float = 0.0
    lean: float = 0.0
    rc: float = 0.0

    @property
    def tool(self) -> Tool:
        """The cylinder, without shank and holder."""
        return Tool("CYLINDER", self.radius, self.radius, self.flute)

    def rails(self, u: Array) -> tuple[Array, Array]:
        """Points of the hub's and of the shroud's rail at u (N,), each (N, 3), mm."""
        theta = self.wrap * u + self.warp * np.sin(2.0 * np.pi * u)
        theta_shroud = theta + self.twist * u + self.backsweep * u * u
        rise = self.span * u
        lift = self.off + rise + self.lean * self.span * np.sin(np.pi * u)
        return self._rail(self.hub, theta, rise, u), self._rail(self.shroud, theta_shroud, lift, u)

    def _rail(self, radii: tuple[float, float], theta: Array, z: Array, u: Array) -> Array:
        r = radii[0] + (radii[1] - radii[0]) * (u + 4.0 * self.rc * u * (1.0 - u))
        return np.stack([r * np.cos(theta), r * np.sin(theta), z], axis=1)

    def surface(self) -> BSplineSurface:
        """The face: u along the rails, v from hub to shroud, each over [0, 1]."""
        u = np.linspace(0.0, 1.0, NODES)
        hub, shroud = self.rails(u)
        rails = make_interp_spline(u, np.hstack([hub, shroud]), DEGREE)
        poles = np.ascontiguousarray(rails.c.reshape(len(rails.c), 2, 3))
        return BSplineSurface(DEGREE, 1, rails.t, np.array([0.0, 0.0, 1.0, 1.0]), poles)


GALLERY = (
    RuledFlank("mixed flow", (30.0, 46.0), (42.0, 58.0), 22.0, 6.0, 4.0, 38.0, 0.076, wrap=0.55, twist=0.5, rc=0.5),
    RuledFlank("high twist", (34.0, 48.0), (46.0, 60.0), 20.0, 6.0, 3.5, 40.0, 0.112, wrap=0.45, twist=0.65),
    RuledFlank("tall leaned", (34.0, 50.0), (44.0, 58.0), 30.0, 8.0, 3.5, 32.0, 0.335, wrap=0.5, twist=0.45, lean=0.3),
)


@dataclass(frozen=True, slots=True)
class OneSweep:
    """A sweep over a whole flank: the motion, its cutter, and the worst overcut and stock left, mm."""

    motion: Motion
    tool: Tool
    overcut: float
    stock: float

    @property
    def worst(self) -> float:
        """The larger of overcut and stock left, mm."""
        return max(self.overcut, self.stock)

    @property
    def turn(self) -> float:
        """Least cosine between the ways across the axis at one time and the next: below 0 the axis swings back."""
        t = np.linspace(0.0, 1.0, TIMES)
        (p, q), (slope_p, slope_q) = self.motion.ends(t), self.motion.ends(t, 1)
        d = (q - p) / np.linalg.norm(q - p, axis=1)[:, None]
        least = 1.0
        for share in SHARES:
            way = (1.0 - share) * slope_p + share * slope_q
            way -= np.einsum("ni,ni->n", way, d)[:, None] * d
            way /= np.linalg.norm(way, axis=1)[:, None]
            least = min(least, float(np.einsum("ni,ni->n", way[1:], way[:-1]).min()))
        return least


@dataclass(frozen=True, slots=True)
class Sampled:
    """Points of a flank and its border, (N, 3): few, coarse (with areas), dense."""

    few: Array
    coarse: Points
    dense: Array

    @classmethod
    def of(cls, flank: RuledFlank) -> Sampled:
        """About FEW, POINTS and DENSE of them; those of the border stand for as much area as any other."""
        face = WorkFace.of(whole(flank.surface(), 1), 0.0)
        few, coarse, dense = (
            (face.samples(spacing), face.border(spacing)) for spacing in map(face.spacing, (FEW, POINTS, DENSE))
        )
        inside, border = coarse
        areas = np.concatenate([inside.areas, np.full(len(border), inside.areas.mean())])
        every = [np.vstack([samples.points, along]) for samples, along in (few, coarse, dense)]
        return cls(every[0], Points(every[1], areas), every[2])


def judged(motion: Motion, tool: Tool, points: Array) -> OneSweep:
    """The sweep of a motion, judged on points (N, 3)."""
    gap = motion_gap(motion, tool, points, reach=REACH, step=LOOK)[0]
    return OneSweep(motion, tool, float(-gap.min()), float(gap.max()))


def along_rulings(flank: RuledFlank, side: int, offset: float) -> Motion:
    """The axis parallel to each ruling, `offset` mm off it, its tip BELOW mm under the hub.

    side: +1 or -1 for the side that S_u x S_v points to, or not, on the first ruling. Where a ruled face is much
    twisted its normal turns by up to half a turn along one ruling; away from it is then the direction that is nearest
    to all these normals and their opposites, the first eigenvector of the sum of n nᵀ.
    """
    u = np.linspace(0.0, 1.0, RULINGS)
    projector = Projector.of(flank.surface())
    hub, shroud = flank.rails(u)
    d = (shroud - hub) / np.linalg.norm(shroud - hub, axis=1)[:, None]
    v = np.linspace(0.0, 1.0, HEIGHTS + 2)[1:-1]
    frame = projector.evaluate(np.repeat(u, HEIGHTS), np.tile(v, RULINGS))
    normal = np.cross(frame[:, 1], frame[:, 2])
    normal = (normal / np.linalg.norm(normal, axis=1)[:, None]).reshape(RULINGS, HEIGHTS, 3)
    away = np.linalg.eigh(np.einsum("uvi,uvj->uij", normal, normal))[1][:, :, -1]
    away -= np.einsum("ui,ui->u", away, d)[:, None] * d
    away /= np.linalg.norm(away, axis=1)[:, None]
    away *= np.cumprod([1.0, *np.sign(np.einsum("ui,ui->u", away[1:], away[:-1]))])[:, None]
    away *= side * np.sign(away[0] @ normal[0, HEIGHTS // 2])
    p = hub - BELOW * d + offset * away
    motion = fitted(u, np.hstack([p, p + flank.flute * d]), COUNT_FIRST)
    return lengthened(lengthened(motion, BEYOND, True), BEYOND, False).respaced(COUNT_FIRST)


def steady_sweep(flank: RuledFlank, side: int, sampled: Sampled) -> OneSweep:
    """The best steady sweep over the whole face; where none is steady, the one that turns least."""
    tried = [one_sweep(flank, side, sampled, fairness) for fairness in FAIRNESS]
    steady = [sweep for sweep in tried if sweep.turn > STEADY]
    return min(steady, key=lambda sweep: sweep.worst) if steady else max(tried, key=lambda sweep: sweep.turn)


def one_sweep(flank: RuledFlank, side: int, sampled: Sampled, fairness: float) -> OneSweep:
    """One sweep over the whole face with the cylinder, overcut and stock left made equally small.

    The cylinder grows from a thin one, which follows the rulings nearly exactly, to its size: a thick one started on
    the rulings would be far from the face where normals turn much, and Gauss-Newton would leave it on the wrong side.
    fairness: weight of it.
    """
    radii = flank.radius * np.arange(1, GROWTHS + 1) / GROWTHS
    motion = along_rulings(flank, side, radii[0])
    for radius in radii:
        tool = replace(flank.tool, r_min=float(radius), r_max=float(radius))
        if radius > radii[0]:
            motion = set_off(motion, tool, sampled.coarse.x, radii[0])
        motion = _lessened(motion, tool, sampled.coarse, WHILE_GROWING, fairness)
    motion = _lessened(motion.respaced(COUNT), flank.tool, sampled.coarse, FINALLY, fairness)
    best = balanced(motion, flank.tool, sampled)
    # A box that has become narrow at one corner of the face may be wide again, begun anew.
    for _ in range(ANEW):
        again = balanced(best.motion, flank.tool, sampled)
        if again.worst > best.worst - FLAT:
            break
        best = again
    return best


def balanced(motion: Motion, tool: Tool, sampled: Sampled, programs: int = PROGRAMS) -> OneSweep:
    """The sweep near a motion whose larger one of overcut and stock left is least."""
    return limited(motion, tool, sampled, None, programs)


def limited(motion: Motion, tool: Tool, sampled: Sampled, overcut: float | None, programs: int = PROGRAMS) -> OneSweep:
    """The sweep near a motion with the least stock left that keeps a limit on its overcut, mm; None: balances both.

    The programs see few points, and of the dense ones those that turned out to be worst; what the limit is still
    missed by in the end, the motion is set off the face.
    """
    points = sampled.few
    best = judged(motion, tool, sampled.dense)
    for _ in range(LOOKS):
        aim = Aim(points, np.ones(len(points), dtype=np.bool_), 0.0, overcut)
        motion, worst = least_worst(motion, tool, aim, programs)
        gap = motion_gap(motion, tool, sampled.dense, reach=REACH, step=LOOK)[0]
        found = OneSweep(motion, tool, float(-gap.min()), float(gap.max()))
        if _figure(found, overcut) < _figure(best, overcut):
            best = found
        if _figure(found, overcut) <= worst + FLAT:
            break
        # How much worse a point is than what the programs know, on either side.
        seen = motion_gap(motion, tool, points, reach=REACH, step=LOOK)[0]
        beyond = np.maximum(gap - seen.max(), seen.min() - gap)
        joining = np.argsort(-beyond)[:JOIN]
        points = np.vstack([points, sampled.dense[joining[beyond[joining] > 0.0]]])
    if overcut is not None and best.overcut > overcut:
        best = judged(set_off(best.motion, tool, points, best.overcut - overcut), tool, sampled.dense)
    return best


def cone(flank: RuledFlank, half_angle: float) -> Tool:
    """The cone with the cylinder's flute, and its radius in the middle of it."""
    rise = 0.5 * flank.flute * tan(half_angle)
    return replace(flank.tool, name="CONE", r_min=flank.radius - rise, r_max=flank.radius + rise)


def best_cone(flank: RuledFlank, start: OneSweep, sampled: Sampled) -> OneSweep:
    """The best sweep with a cone of the same flute and radius in its middle: half angles one step on while it helps."""
    best = start
    for half_angle in HALF_ANGLES:
        tool = cone(flank, half_angle)
        # The generator stays where it is, so the ends of the axis move by what the radii there change.
        away = _away(best.motion, best.tool, sampled.coarse.x)
        p = best.motion.p + (tool.r_min - best.tool.r_min) * away
        q = best.motion.q + (tool.r_max - best.tool.r_max) * away
        motion = _lessened(Motion(best.motion.knots, p, q), tool, sampled.coarse, FINALLY, FAIRNESS[-1])
        found = balanced(motion, tool, sampled)
        if found.worst >= best.worst:
            break
        best = found
    return best


def trade(start: OneSweep, sampled: Sampled, shares: Sequence[float]) -> list[OneSweep]:
    """Sweeps with ever less overcut, each with the least stock left that allows, from a balanced one on.

    shares: of the balanced overcut, limits in turn. Each begins with the one before, set off the face by what its
    overcut has to lose. One that a stricter limit turns out to serve better gives way to the sweep of that limit.
    """
    sweeps = [start]
    for share in shares:
        last, limit = sweeps[-1], share * start.overcut
        motion = set_off(last.motion, last.tool, sampled.coarse.x, max(last.overcut - limit, 0.0))
        sweeps.append(limited(motion, last.tool, sampled, limit, PROGRAMS_TRADE))
    return [min(sweeps[k:], key=lambda sweep: sweep.stock) for k in range(len(sweeps))]


def set_off(motion: Motion, tool: Tool, points: Array, distance: float) -> Motion:
    """The motion moved away from the face by so many mm."""
    shift = distance * _away(motion, tool, points)
    return Motion(motion.knots, motion.p + shift, motion.q + shift)


def _figure(sweep: OneSweep, overcut: float | None) -> float:
    """What `Aim` makes small, of a sweep as it was judged."""
    if overcut is None:
        return sweep.worst
    return sweep.stock + HARD * max(sweep.overcut - overcut, 0.0)


def _away(motion: Motion, tool: Tool, points: Array) -> Array:
    """Unit vectors (n, 3) from the face to the axis, one for each control point: means over the contacts about it."""
    field = gap_field(motion, tool, points)
    near = np.exp(-(((field.time - greville(motion)[:, None]) / ABOUT) ** 2))
    away = near @ (field.rows[:, :3] + field.rows[:, 3:])
    return np.asarray(away / np.linalg.norm(away, axis=1)[:, None])


def _lessened(motion: Motion, tool: Tool, points: Points, norms: Sequence[int], fairness: float) -> Motion:
    """Newton steps on the p-norm of the gap; the poses that count are looked for anew after each few."""
    for norm in norms:
        motion = for_norm(tool, motion, points, EVERYTHING, Weights(mu2=fairness), (norm,) * STEPS_EACH)
    return motion
