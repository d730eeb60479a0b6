from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from conflank_cli.cad.loops import clip, inside, merge, rectangle, tidy


def _star(seed, centre=(0.5, 0.5), size=0.45):
    rng = np.random.default_rng(seed)
    angle = np.linspace(0, 2 * np.pi, 18, endpoint=False)
    radius = size * rng.uniform(0.3, 1.0, 18)
    return np.stack([centre[0] + radius * np.cos(angle), centre[1] + radius * np.sin(angle)], axis=1)


def _winding_inside(loop, points):
    """By the winding number: the sum of the angles under which a point sees the edges."""
    start = loop[None] - points[:, None]
    end = np.roll(loop, -1, axis=0)[None] - points[:, None]
    cross = start[..., 0] * end[..., 1] - start[..., 1] * end[..., 0]
    angle = np.arctan2(cross, np.einsum("nki,nki->nk", start, end)).sum(axis=1)
    return np.abs(angle) > np.pi


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**31 - 1), st.floats(0.1, 0.45), st.floats(0.5, 0.9), st.floats(0.1, 0.45), st.floats(0.5, 0.9))
def test_clip_is_the_intersection_with_the_box(seed, u0, u1, v0, v1):
    outer, hole = _star(seed), _star(seed + 1, size=0.12)
    points = np.random.default_rng(seed).uniform(0, 1, (300, 2))
    expected = _winding_inside(outer, points) ^ _winding_inside(hole, points)
    np.testing.assert_array_equal(inside([outer, hole], points), expected)
    in_box = (points[:, 0] > u0) & (points[:, 0] < u1) & (points[:, 1] > v0) & (points[:, 1] < v1)
    clipped = clip([outer, hole], (u0, u1, v0, v1))
    np.testing.assert_array_equal(inside(clipped, points), expected & in_box)
    lines = [(0, u0), (0, u1), (1, v0), (1, v1)]
    np.testing.assert_array_equal(inside(merge(clipped, lines, 1e-9), points), expected & in_box)


def test_two_copies_that_meet_become_one_loop():
    left, right = rectangle((0.6, 1.0, 0.0, 1.0)), rectangle((1.0, 1.3, 0.0, 1.0))
    (merged,) = merge([left, right], [(0, 1.0)], 1e-9)
    assert not np.any((merged[:, 0] == 1.0) & (merged[:, 1] > 0.0) & (merged[:, 1] < 1.0))
    assert merged[:, 0].min() == 0.6 and merged[:, 0].max() == 1.3
    edges = np.roll(merged, -1, axis=0) - merged
    assert not np.any((merged[:, 0] == 1.0) & (edges[:, 0] == 0.0))


def test_a_loop_that_leaves_the_box_and_comes_back_leaves_no_bridge():
    comb = np.array([[0, 0], [3, 0], [3, 2], [2, 2], [2, 0.5], [1, 0.5], [1, 2], [0, 2]], dtype=float)
    clipped = clip([comb], (-1.0, 4.0, 1.0, 3.0))
    merged = merge(clipped, [(1, 1.0)], 1e-9)
    assert sorted(float(np.ptp(loop[:, 0])) for loop in merged) == [1.0, 1.0]


def test_tidy_drops_repeated_points():
    loop = np.array([[0, 0], [0, 0], [1, 0], [1, 1], [1, 1], [0, 0]], dtype=float)
    assert sorted(map(tuple, tidy(loop, 1e-12).tolist())) == [(0, 0), (1, 0), (1, 1)]
