"""Footpoints a second and core, warm and cold, beside the CAD kernel's projection and Newton steps on SciPy's splines.

Run with ``python -m benchmarks.footpoints``. The surface is a bicubic 20 x 10 net, blade-sized; the points lie up to
5 mm off it; warm starts are up to 5e-3 of the parameter range away, as they are between neighbouring poses of a sweep.
All methods see the same points, take turns, and are timed by what they use of one core.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from OCP.Extrema import Extrema_GenLocateExtPS
from OCP.Geom import Geom_BSplineSurface
from OCP.GeomAdaptor import GeomAdaptor_Surface
from OCP.GeomAPI import GeomAPI_ProjectPointOnSurf
from OCP.gp import gp_Pnt
from rich.console import Console
from rich.table import Table
from scipy.interpolate import NdBSpline

from benchmarks.occ import occ_surface
from benchmarks.shapes import smooth_surface
from conflank_cli.geometry.footpoint import INTERIOR, Projector
from conflank_cli.geometry.kernels import footpoint as kernel
from conflank_cli.geometry.surface import BSplineSurface

Array = npt.NDArray[np.float64]

REQUIRED_PER_SECOND = 4.0e6
REQUIRED_ACCURACY = 1e-9  # mm
START_ERROR = 5e-3
DISTANCE = 5.0  # mm, of points from the surface at most
POINTS = 200_000
SCIPY_POINTS = 5_000
NEWTON_STEPS = 2  # from the warm starts: so many reach the accuracy
OCP_WARM_POINTS = 10_000
OCP_COLD_POINTS = 300
JUDGED = 1000
REPEATS = 7


@dataclass(frozen=True, slots=True)
class Row:
    """One line of the table: points a second and core, and the largest distance from the known feet in mm."""

    name: str
    per_second: float
    foot_error: float
    distance_error: float


@dataclass(frozen=True, slots=True)
class Query:
    """Points off a surface with their known feet and starts near them.

    points, feet (N, 3) mm; distance (N,) mm, signed by the normal; start (2, N), parameters.
    """

    points: Array
    feet: Array
    distance: Array
    start: Array

    @classmethod
    def random(cls, rng: np.random.Generator, projector: Projector, count: int) -> Query:
        """Random points over the surface of a projector."""
        box = projector.spans.box
        low, size = box[[0, 2]], box[[1, 3]] - box[[0, 2]]
        u, v = (low + size * rng.uniform(0.02, 0.98, (count, 2))).T
        frame = projector.evaluate(u, v)
        normal = np.cross(frame[:, 1], frame[:, 2])
        normal /= np.linalg.norm(normal, axis=1)[:, None]
        distance = rng.uniform(-DISTANCE, DISTANCE, count)
        start = np.stack([u, v]) + size[:, None] * rng.uniform(-START_ERROR, START_ERROR, (2, count))
        return cls(frame[:, 0] + distance[:, None] * normal, frame[:, 0], distance, start)

    def errors(self, feet: Array, distance: Array) -> tuple[float, float]:
        """Largest errors of the first feet, mm, and of their distances, given without sign."""
        count = len(feet)
        foot_error = float(np.linalg.norm(feet - self.feet[:count], axis=1).max())
        return foot_error, float(np.abs(np.abs(distance) - np.abs(self.distance[:count])).max())


@dataclass(frozen=True, slots=True)
class Method:
    """A way to find footpoints: of how many points at once, how, and the largest errors of what it found last."""

    name: str
    count: int
    work: Callable[[], None]
    errors: Callable[[], tuple[float, float]]


def core_seconds(works: list[Callable[[], None]], repeats: int) -> list[float]:
    """Least time of one core of each work, which take turns: what else the machine does only adds."""
    taken: list[list[float]] = [[] for _ in works]
    for _ in range(repeats + 1):
        for work, times in zip(works, taken, strict=True):
            start = time.thread_time()
            work()
            times.append(time.thread_time() - start)
    return [min(times) for times in taken]


def measure(count: int = POINTS, repeats: int = REPEATS) -> list[Row]:
    """All rows, ours first; every method sees the same surface and (a part of) the same points."""
    rng = np.random.default_rng(37)
    surface = smooth_surface(rng, (3, 3), (17, 7))
    assert surface.poles.shape == (20, 10, 3)
    projector = Projector.of(surface)
    query = Query.random(rng, projector, count)
    methods = [*_our_methods(projector, query), _scipy_method(surface, query), *_ocp_methods(surface, query)]
    seconds = core_seconds([method.work for method in methods], repeats)
    return [
        Row(method.name, method.count / taken, *method.errors()) for method, taken in zip(methods, seconds, strict=True)
    ]


def _our_methods(projector: Projector, query: Query) -> list[Method]:
    """The kernel from the starts, and from the seeds that the index has."""
    count = len(query.points)
    at, normal = np.empty((count, 3)), np.empty((count, 3))
    found, flag = np.empty(count), np.empty(count, dtype=np.int64)

    def run(start: Array) -> None:
        kernel.footpoints(*projector.spans, query.points, start[0].copy(), start[1].copy(), at, normal, found, flag)

    def from_index() -> None:
        run(projector.seeds[projector.tree.query(query.points)[1]].T)

    def errors(work: Callable[[], None]) -> tuple[float, float]:
        work()
        assert np.all(flag == INTERIOR)
        return query.errors(at, found)

    works = {
        "conflank, warm": lambda: run(query.start),
        "conflank, cold (seeds looked up within the time)": from_index,
    }
    return [Method(name, count, work, lambda work=work: errors(work)) for name, work in works.items()]  # type: ignore[misc]


def _scipy_method(surface: BSplineSurface, query: Query) -> Method:
    """Newton's method for the foot, all points at once, on SciPy's tensor-product splines."""
    spline = NdBSpline((surface.knots_u, surface.knots_v), surface.poles, (surface.degree_u, surface.degree_v))
    points = query.points[:SCIPY_POINTS]
    start = query.start[:, :SCIPY_POINTS].T
    u0, u1, v0, v1 = surface.domain
    found = np.empty_like(start)

    def work() -> None:
        uv = start.copy()
        for _ in range(NEWTON_STEPS):
            s, su, sv, suu, suv, svv = (
                spline(uv, nu=order) for order in ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2))
            )
            r = s - points
            along_u, along_v = (np.einsum("ij,ij->i", r, way) for way in (su, sv))
            a, b, c = (
                np.einsum("ij,ij->i", one, other) + np.einsum("ij,ij->i", r, bend)
                for one, other, bend in ((su, su, suu), (su, sv, suv), (sv, sv, svv))
            )
            step = np.stack([b * along_v - c * along_u, b * along_u - a * along_v]) / (a * c - b * b)
            uv = np.clip(uv + step.T, [u0, v0], [u1, v1])
        found[:] = uv

    def errors() -> tuple[float, float]:
        feet = spline(found)
        return query.errors(feet, np.linalg.norm(points - feet, axis=1))

    return Method(f"SciPy NdBSpline, {NEWTON_STEPS} Newton steps, warm", len(points), work, errors)


def _ocp_methods(surface: BSplineSurface, query: Query) -> list[Method]:
    """OCP's local search from our starts (warm), and its projection without a start (cold).

    The points are made beforehand and the results read afterwards, so that the time is the search and one call into it,
    a fraction of a microsecond.
    """
    geometry: Geom_BSplineSurface = occ_surface(surface)
    adaptor = GeomAdaptor_Surface(geometry)
    solver = GeomAPI_ProjectPointOnSurf()
    solver.Init(geometry, *geometry.Bounds(), 1e-9)
    warm = [gp_Pnt(*map(float, point)) for point in query.points[:OCP_WARM_POINTS]]
    cold = warm[:OCP_COLD_POINTS]
    starts = query.start[:, :OCP_WARM_POINTS].T.tolist()

    def from_starts() -> None:
        # The search refers to the adaptor, but does not keep it.
        search = Extrema_GenLocateExtPS(adaptor)
        for point, (u, v) in zip(warm, starts, strict=True):
            search.Perform(point, u, v)

    def from_nowhere() -> None:
        for point in cold:
            solver.Perform(point)

    def warm_errors() -> tuple[float, float]:
        search = Extrema_GenLocateExtPS(adaptor)
        feet, distance = [], []
        for point, (u, v) in zip(warm[:JUDGED], starts[:JUDGED], strict=True):
            search.Perform(point, u, v)
            place = search.Point().Value()
            feet.append((place.X(), place.Y(), place.Z()))
            distance.append(search.SquareDistance() ** 0.5)
        return query.errors(np.array(feet), np.array(distance))

    def cold_errors() -> tuple[float, float]:
        feet, distance = [], []
        for point in cold[:JUDGED]:
            solver.Perform(point)
            place = solver.NearestPoint()
            feet.append((place.X(), place.Y(), place.Z()))
            distance.append(solver.LowerDistance())
        return query.errors(np.array(feet), np.array(distance))

    return [
        Method("OCP Extrema_GenLocateExtPS, warm", len(warm), from_starts, warm_errors),
        Method("OCP GeomAPI_ProjectPointOnSurf, cold", len(cold), from_nowhere, cold_errors),
    ]


def report(console: Console) -> bool:
    """Print the table; True where speed and accuracy are what is required."""
    rows = measure()
    table = Table(title=f"Footpoints, bicubic 20 x 10 net, {POINTS} points, time of one core, least of {REPEATS}")
    for heading in ("method", "points/s", "largest foot error mm", "largest distance error mm", "conflank warm is"):
        table.add_column(heading, justify="left" if heading == "method" else "right")
    for row in rows:
        ratio = f"{rows[0].per_second / row.per_second:.1f} x"
        table.add_row(row.name, f"{row.per_second:,.0f}", f"{row.foot_error:.1e}", f"{row.distance_error:.1e}", ratio)
    console.print(table)
    fast = rows[0].per_second >= REQUIRED_PER_SECOND
    accurate = max(rows[0].foot_error, rows[0].distance_error) <= REQUIRED_ACCURACY
    console.print(
        f"required: warm >= {REQUIRED_PER_SECOND:,.0f} points/s: {'pass' if fast else 'MISS'}; "
        f"accurate to {REQUIRED_ACCURACY:g} mm: {'pass' if accurate else 'MISS'}"
    )
    return fast and accurate


if __name__ == "__main__":
    raise SystemExit(0 if report(Console()) else 1)
