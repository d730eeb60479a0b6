"""Footpoints a second and core, warm and cold, and the CAD kernel's own projection on the same points.

Run with ``python -m benchmarks.footpoints``. The surface is a bicubic 20 x 10 net, blade-sized; the points lie up to
5 mm off it; warm starts are up to 5e-3 of the parameter range away, as they are between neighbouring poses of a sweep.
"""

from __future__ import annotations

import statistics
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

from benchmarks.occ import occ_surface
from benchmarks.shapes import smooth_surface
from conflank_cli.geometry.footpoint import INTERIOR, Projector
from conflank_cli.geometry.kernels import footpoint as kernel

Array = npt.NDArray[np.float64]

REQUIRED_PER_SECOND = 2.0e6
REQUIRED_ACCURACY = 1e-9  # mm
START_ERROR = 5e-3
POINTS = 200_000
OCP_WARM_POINTS = 10_000
OCP_COLD_POINTS = 300
REPEATS = 7


@dataclass(frozen=True, slots=True)
class Row:
    """One line of the table: points a second and core, and the largest distance from the known feet in mm."""

    name: str
    per_second: float
    foot_error: float
    distance_error: float


def median_seconds(work: Callable[[], None], repeats: int) -> float:
    """Median run time of `work` after one run that does not count."""
    work()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return statistics.median(times)


def measure(count: int = POINTS, repeats: int = REPEATS) -> list[Row]:
    """All rows, ours first; every method sees the same surface and (a part of) the same points."""
    rng = np.random.default_rng(37)
    surface = smooth_surface(rng, (3, 3), (17, 7))
    assert surface.poles.shape == (20, 10, 3)
    projector = Projector.of(surface)
    u, v = rng.uniform(0.02, 0.98, (2, count))
    frame = projector.evaluate(u, v)
    normal = np.cross(frame[:, 1], frame[:, 2])
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    distance = rng.uniform(-5.0, 5.0, count)
    feet = frame[:, 0]
    points = feet + distance[:, None] * normal
    warm = np.stack([u, v]) + rng.uniform(-START_ERROR, START_ERROR, (2, count))

    at, found_normal = np.empty((count, 3)), np.empty((count, 3))
    found, flag = np.empty(count), np.empty(count, dtype=np.int64)

    def run(start: Array) -> None:
        kernel.footpoints(*projector.spans, points, start[0].copy(), start[1].copy(), at, found_normal, found, flag)

    def from_index() -> None:
        run(projector.seeds[projector.tree.query(points)[1]].T)

    rows = []
    for name, work in (
        ("conflank, warm", lambda: run(warm)),
        ("conflank, cold (seeds looked up within the time)", from_index),
    ):
        seconds = median_seconds(work, repeats)
        assert np.all(flag == INTERIOR)
        foot_error = float(np.linalg.norm(at - feet, axis=1).max())
        rows.append(Row(name, count / seconds, foot_error, float(np.abs(found - distance).max())))
    rows.extend(_ocp_rows(occ_surface(surface), points, feet, distance, warm))
    return rows


def _ocp_rows(geometry: Geom_BSplineSurface, points: Array, feet: Array, distance: Array, warm: Array) -> list[Row]:
    """OCP's local search from our starts (warm), and its projection without a start (cold).

    The points are made beforehand and the results read afterwards, so that the time is the search and one call into it,
    a fraction of a microsecond.
    """
    adaptor = GeomAdaptor_Surface(geometry)
    queries = [gp_Pnt(*map(float, point)) for point in points[:OCP_WARM_POINTS]]
    starts = warm[:, :OCP_WARM_POINTS].T.tolist()
    search = Extrema_GenLocateExtPS(adaptor)

    def local() -> None:
        for query, (u, v) in zip(queries, starts, strict=True):
            search.Perform(query, u, v)

    seconds = median_seconds(local, 3)
    foot_error = distance_error = 0.0
    for k in range(1000):
        search.Perform(queries[k], *starts[k])
        place = search.Point().Value()
        foot_error = max(foot_error, float(np.linalg.norm([place.X(), place.Y(), place.Z()] - feet[k])))
        distance_error = max(distance_error, abs(float(np.sqrt(search.SquareDistance())) - abs(distance[k])))
    rows = [Row("OCP Extrema_GenLocateExtPS, warm", len(queries) / seconds, foot_error, distance_error)]

    solver = GeomAPI_ProjectPointOnSurf()
    solver.Init(geometry, *geometry.Bounds(), 1e-9)
    few = queries[:OCP_COLD_POINTS]

    def cold() -> None:
        for query in few:
            solver.Perform(query)

    seconds = median_seconds(cold, 1)
    foot_error = distance_error = 0.0
    for k, query in enumerate(few[:100]):
        solver.Perform(query)
        place = solver.NearestPoint()
        foot_error = max(foot_error, float(np.linalg.norm([place.X(), place.Y(), place.Z()] - feet[k])))
        distance_error = max(distance_error, abs(solver.LowerDistance() - abs(distance[k])))
    rows.append(Row("OCP GeomAPI_ProjectPointOnSurf, cold", len(few) / seconds, foot_error, distance_error))
    return rows


def report(console: Console) -> bool:
    """Print the table; True where speed and accuracy are what is required."""
    rows = measure()
    table = Table(title=f"Footpoints, bicubic 20 x 10 net, {POINTS} points, one core, median of {REPEATS}")
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
