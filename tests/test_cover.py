"""Greedy cover against brute force over all choices of a few sets."""

from __future__ import annotations

from itertools import combinations
from math import log

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from conflank_cli.cover import fewest_cover, greedy_cover, shortlist

EVEN = np.ones(12)


def sets(*rows: range | list[int], count: int = 12) -> np.ndarray:
    covers = np.zeros((len(rows), count), dtype=np.bool_)
    for k, row in enumerate(rows):
        covers[k, list(row)] = True
    return covers


def area(covers: np.ndarray, areas: np.ndarray, chosen: list[int]) -> float:
    return float(areas[covers[chosen].any(axis=0)].sum()) if chosen else 0.0


@settings(max_examples=150, deadline=None, derandomize=True)
@given(st.integers(0, 2**32 - 1), st.integers(1, 8), st.sampled_from([0.5, 0.8, 0.95, 1.0]))
def test_cover_against_all_choices(seed: int, count: int, target: float) -> None:
    """What can be reached is reached, with no set to spare, and with no more sets than the bound of Wolsey allows."""
    rng = np.random.default_rng(seed)
    covers = rng.random((count, 20)) < rng.uniform(0.1, 0.6)
    areas = rng.uniform(0.5, 2.0, 20)
    least = 1e-9  # nothing is too small: only then is reaching the target promised
    chosen = greedy_cover(covers, areas, rng.random(count), target, least)
    assert len(set(chosen)) == len(chosen)
    wanted = target * areas.sum() - 1e-9
    best = {
        n: max(area(covers, areas, list(choice)) for choice in combinations(range(count), n)) for n in range(count + 1)
    }
    if best[count] >= wanted:
        assert area(covers, areas, chosen) >= wanted
        fewest = min(n for n, reached in best.items() if reached >= wanted)
        smallest = min(a for a in areas)
        # Greedy within 1 % of the largest gain: H = 1 + ln(area / smallest step); generous, but a bound.
        assert len(chosen) <= max(1, int((1.0 + log(areas.sum() / smallest)) * max(fewest, 1) / 0.99) + 1)
    else:
        assert area(covers, areas, chosen) >= best[count] - 1e-9
    for k in chosen:
        rest = [other for other in chosen if other != k]
        assert area(covers, areas, rest) < min(wanted + 1e-9, area(covers, areas, chosen))


def test_largest_gain_first_and_stop_at_the_target() -> None:
    covers = sets(range(5), range(3, 9), range(8, 12))
    assert greedy_cover(covers, EVEN, np.zeros(3), 0.5, 0.01) == [1]
    # After set 1 (six points) the others add three each; both are needed for everything.
    assert sorted(greedy_cover(covers, EVEN, np.zeros(3), 1.0, 0.01)) == [0, 1, 2]


def test_areas_count_not_points() -> None:
    areas = np.array([10.0, 1.0, 1.0, 1.0])
    covers = sets([0], [1, 2, 3], count=4)
    assert greedy_cover(covers, areas, np.zeros(2), 0.7, 0.01) == [0]


def test_superfluous_sets_are_taken_out_again() -> None:
    """The middle one is the largest, and the two after it cover all that it did."""
    covers = sets(range(2, 10), range(6), range(6, 12))
    assert sorted(greedy_cover(covers, EVEN, np.zeros(3), 1.0, 0.01)) == [1, 2]


def test_of_about_equal_gains_the_more_accurate() -> None:
    many = np.ones(1000)
    covers = sets(range(500), range(500, 995), range(500, 960), count=1000)
    # 495 is within 1 % of 500, 460 is not, however accurate.
    assert greedy_cover(covers, many, np.array([3.0, 2.0, 1.0]), 0.4, 0.01) == [1]
    assert greedy_cover(covers, many, np.array([2.0, 3.0, 1.0]), 0.4, 0.01) == [0]


def test_gains_below_the_least_are_not_worth_it() -> None:
    covers = sets(range(11), [11])
    assert greedy_cover(covers, EVEN, np.zeros(2), 1.0, 0.10) == [0]
    assert greedy_cover(covers, EVEN, np.zeros(2), 1.0, 0.08) == [0, 1]


def test_nothing_to_choose_from() -> None:
    assert greedy_cover(np.zeros((0, 12), dtype=np.bool_), EVEN, np.zeros(0), 0.9, 0.01) == []
    assert greedy_cover(sets([], []), EVEN, np.zeros(2), 0.9, 0.01) == []
    assert shortlist(np.zeros((0, 12), dtype=np.bool_), EVEN, np.zeros(0), 1.0, 5, 0.01) == []


def test_no_set_is_chosen_that_adds_nothing_even_where_any_gain_counts() -> None:
    assert greedy_cover(sets(range(6), range(5)), EVEN, np.array([0.0, 1.0]), 1.0, 0.0) == [0]


def test_shortlist_takes_one_good_cover_after_the_other() -> None:
    covers = sets(range(6), range(6, 12), range(5), range(5, 12), [3])
    errors = np.array([1.0, 1.0, 2.0, 2.0, 0.0])
    found = shortlist(covers, EVEN, errors, 1.0, 4, 0.09)
    assert sorted(found[:2]) in ([0, 3], [2, 3])  # the best cover: the seven points first
    assert len(found) >= 4 and len(set(found)) == len(found)
    # Point 3 alone is 8 % of the area and below the least gain.
    assert 4 not in shortlist(covers, EVEN, errors, 1.0, 10, 0.09)
    assert 4 in shortlist(covers, EVEN, errors, 1.0, 10, 0.05)


def test_another_first_choice_can_save_a_set() -> None:
    """The largest set is bait: it takes the middles of two halves, and three sets are needed where two would do."""
    covers = sets(range(6), range(6, 12), [0, 1, 2, 3, 6, 7, 8, 9], [4, 5, 10])
    assert len(greedy_cover(covers, EVEN, np.zeros(4), 1.0, 0.01)) == 3
    assert sorted(fewest_cover(covers, EVEN, np.zeros(4), 1.0, 0.01)) == [0, 1]
