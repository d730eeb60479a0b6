"""Evaluation and footpoints against the CAD kernel."""

from __future__ import annotations

import numpy as np
import pytest
from OCP.Extrema import Extrema_GenLocateExtPS
from OCP.GeomAdaptor import GeomAdaptor_Surface
from OCP.GeomAPI import GeomAPI_ProjectPointOnSurf
from OCP.gp import gp_Pnt, gp_Vec

from benchmarks.occ import occ_surface
from benchmarks.shapes import clamped_knots, smooth_surface
from conflank_cli.geometry.footpoint import CLAMPED, FAILED, INTERIOR, Projector


@pytest.mark.parametrize("degrees", [(1, 2), (2, 1), (2, 2), (3, 3), (3, 5), (5, 4)])
@pytest.mark.parametrize("rational", [False, True])
def test_values_and_all_derivatives(degrees: tuple[int, int], rational: bool) -> None:
    """With interior knots of multiplicity up to the degree less one, at parameters between the knots."""
    rng = np.random.default_rng(31)
    repeat = max(1, degrees[0] - 1)
    knots_u = np.concatenate(
        [np.full(degrees[0] + 1, 2.0), [2.5], np.full(repeat, 3.25), [4.0], np.full(degrees[0] + 1, 6.0)]
    )
    surface = smooth_surface(rng, degrees, knots=(knots_u, clamped_knots(degrees[1], 3)), rational=rational)
    oracle = occ_surface(surface)
    u, v = rng.uniform(2.0, 6.0, 100), rng.uniform(0.0, 1.0, 100)
    found = Projector.of(surface).evaluate(u, v)
    point, vectors = gp_Pnt(), [gp_Vec() for _ in range(5)]
    for k in range(100):
        oracle.D2(u[k], v[k], point, *vectors)
        su, sv, suu, svv, suv = ([w.X(), w.Y(), w.Z()] for w in vectors)
        expected = np.array([[point.X(), point.Y(), point.Z()], su, sv, suu, suv, svv])
        scale = np.maximum(1.0, np.abs(expected).max(axis=1, keepdims=True))
        np.testing.assert_array_less(np.abs(found[k] - expected) / scale, 1e-11)


@pytest.mark.parametrize("rational", [False, True])
def test_cold_footpoints_are_the_nearest_projection(rational: bool) -> None:
    """Every orthogonal projection that OCP finds is at least as far as ours, and one of them is ours."""
    rng = np.random.default_rng(32)
    surface = smooth_surface(rng, (3, 3), (6, 4), rational=rational, bulge=5.0)
    projector, oracle = Projector.of(surface), occ_surface(surface)
    points = rng.uniform([0.0, 0.0, -8.0], [60.0, 30.0, 8.0], (60, 3))
    found = projector.project(points)
    compared = 0
    for k, point in enumerate(points):
        solver = GeomAPI_ProjectPointOnSurf(gp_Pnt(*map(float, point)), oracle)
        if found.flag[k] == INTERIOR:
            assert solver.NbPoints() > 0
            assert solver.LowerDistance() == pytest.approx(abs(found.distance[k]), abs=1e-8)
            nearest = solver.NearestPoint()
            # OCP stops at 1e-7 of parameter.
            np.testing.assert_allclose(found.foot[k], [nearest.X(), nearest.Y(), nearest.Z()], atol=2e-5)
            compared += 1
        elif solver.NbPoints() > 0:
            assert found.flag[k] == CLAMPED
            assert np.linalg.norm(point - found.foot[k]) <= solver.LowerDistance() + 1e-9
    assert compared > 30


def test_warm_footpoints_agree_with_a_local_search() -> None:
    rng = np.random.default_rng(33)
    surface = smooth_surface(rng, (3, 3), (17, 7), bulge=3.0)
    projector, adaptor = Projector.of(surface), GeomAdaptor_Surface(occ_surface(surface))
    points = rng.uniform([3.0, 3.0, -4.0], [55.0, 27.0, 4.0], (200, 3))
    cold = projector.project(points)
    keep = cold.flag == INTERIOR
    start_u = np.clip(cold.u + rng.uniform(-5e-3, 5e-3, 200), 0.0, 1.0)
    start_v = np.clip(cold.v + rng.uniform(-5e-3, 5e-3, 200), 0.0, 1.0)
    warm = projector.project(points, start_u, start_v)
    assert keep.sum() > 150
    assert not np.any(warm.flag[keep] == FAILED)
    for k in np.flatnonzero(keep):
        search = Extrema_GenLocateExtPS(adaptor, 1e-10, 1e-10)
        search.Perform(gp_Pnt(*map(float, points[k])), float(start_u[k]), float(start_v[k]))
        assert search.IsDone()
        assert np.sqrt(search.SquareDistance()) == pytest.approx(abs(warm.distance[k]), abs=1e-9)
        at = search.Point().Value()
        np.testing.assert_allclose(warm.foot[k], [at.X(), at.Y(), at.Z()], rtol=0.0, atol=1e-7)
