"""What a sweep has to add to be worth its time."""

from __future__ import annotations

import numpy as np
import pytest

from conflank_cli.motion import Motion, uniform_knots
from conflank_cli.selection.choice import LEAST_GAIN, Candidate, choose, least_gain
from conflank_cli.sweep import Sweep
from tests.verification.scenes import plane_face, scene_of

SIDE = 40
CELLS = np.stack(np.meshgrid(np.arange(SIDE), np.arange(SIDE), indexing="ij"), axis=-1).reshape(-1, 2)
AREAS = np.ones(SIDE**2)
MOTION = Motion(uniform_knots(4), np.zeros((4, 3)), np.eye(4, 3))


def candidate(covered: np.ndarray) -> Candidate:
    gap = np.where(covered, 0.001, 1.0)
    return Candidate(Sweep(0, "T1", MOTION, {}), gap, covered, 10.0, np.array([1.0, 0.0, 0.0]), np.array([0.0, 0, 1]))


def test_sweeps_are_weighed_against_what_all_of_them_cover() -> None:
    """Where half of a face is inside of a hub, six of its 1600 points are more than half a per cent of the rest."""
    half = CELLS[:, 0] < SIDE // 2
    corner = half & (CELLS[:, 0] < 2) & (CELLS[:, 1] < 3)
    assert np.count_nonzero(corner) == 6
    covers = np.array([half & ~corner, corner])
    assert least_gain(covers, AREAS) == pytest.approx(0.5 * LEAST_GAIN)
    job = scene_of(plane_face((0.0, 1.0), (0.0, 1.0))).job
    own = [candidate(row) for row in covers]
    assert len(choose(own, AREAS, CELLS, job, (), 0.9).items) == 2
    # With the rest of the face in reach they are not worth a sweep of their own.
    assert len(choose([*own, candidate(~half)], AREAS, CELLS, job, (), 1.0).items) == 2


def test_nothing_that_may_be_cut_makes_an_empty_choice() -> None:
    job = scene_of(plane_face((0.0, 1.0), (0.0, 1.0))).job
    for items in ([], [candidate(np.zeros(SIDE**2, dtype=np.bool_))]):
        assert choose(items, AREAS, CELLS, job, (), 0.9).items == []
