"""Exact cover against brute force over all choices of a few sets."""

from __future__ import annotations

from itertools import chain, combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from conflank_cli.cover import greedy_cover, share_covered
from conflank_cli.selection.exact import ROUNDING, Price, cheapened, exact_cover, undominated, widened

SIDE = 12
CELLS = np.stack(np.meshgrid(np.arange(SIDE), np.arange(SIDE), indexing="ij"), axis=-1).reshape(-1, 2)


def boxes(rng: np.random.Generator, count: int) -> np.ndarray:
    """Sets (count, SIDE²) that are rectangles of the grid, as patches on a face are."""
    low = rng.integers(0, SIDE - 2, (count, 2))
    size = rng.integers(2, SIDE, (count, 2))
    inside = (low[:, None] <= CELLS) & ((low + size)[:, None] > CELLS)
    return np.asarray(inside.all(axis=2))


def every_choice(count: int) -> list[list[int]]:
    return [list(choice) for choice in chain.from_iterable(combinations(range(count), n) for n in range(1, count + 1))]


@settings(max_examples=40, deadline=None, derandomize=True)
@given(st.integers(0, 2**32 - 1), st.integers(2, 9), st.sampled_from([0.3, 0.6, 0.9, 1.0]), st.booleans())
def test_price_and_bound_against_all_choices(seed: int, count: int, goal: float, priced: bool) -> None:
    """The least price of all covers is found and proven, with sets that cost alike and with prices and classes."""
    rng = np.random.default_rng(seed)
    covers, areas = boxes(rng, count), rng.uniform(0.5, 2.0, SIDE**2)
    kinds = rng.integers(0, 2, count)
    price = (
        Price(rng.uniform(1.0, 5.0, count), np.array([kinds == 0, kinds == 1]), rng.uniform(0.0, 3.0, 2))
        if priced
        else Price.count(count)
    )
    step = 1e-3 if priced else 1.0
    greedy = greedy_cover(covers, areas, np.zeros(count), goal, 0.0)
    goal = min(goal, share_covered(covers, areas, greedy))
    found = exact_cover(covers, areas, CELLS, goal, price, greedy, step, 1000)
    reaching = [choice for choice in every_choice(count) if share_covered(covers, areas, choice) >= goal - ROUNDING]
    least = min(price.of(choice, 0.0) for choice in reaching)
    assert share_covered(covers, areas, found.chosen) >= goal - ROUNDING
    assert found.price == pytest.approx(price.of(found.chosen, 0.0), rel=1e-12)
    assert found.price <= price.of(greedy, 0.0) + 1e-9
    assert least - 1e-9 <= found.price <= least + step * priced + 1e-9
    assert found.price - step - 1e-6 <= found.bound <= least + 1e-6
    assert priced or found.gap == 0.0


@settings(max_examples=30, deadline=None, derandomize=True)
@given(st.integers(0, 2**32 - 1), st.integers(3, 9), st.integers(1, 3))
def test_no_exchange_of_two_makes_it_cheaper(seed: int, count: int, size: int) -> None:
    """Up to two sets are the cheapest of all that cover the goal; three, of all that share one with them."""
    rng = np.random.default_rng(seed)
    covers, areas = boxes(rng, count), rng.uniform(0.5, 2.0, SIDE**2)
    kinds = rng.integers(0, 2, count)
    classes = np.array([kinds == 0, kinds == 1])
    price = Price(rng.uniform(0.0, 0.3, count), classes, rng.uniform(0.0, 0.1, 2), area=1.0)
    start = [int(k) for k in rng.permutation(count)[:size]]
    goal = 0.8 * share_covered(covers, areas, start)
    found = cheapened(covers, areas, start, goal, price)
    every = [
        (price.of(choice, share), set(choice))
        for choice in map(list, combinations(range(count), size))
        for share in [share_covered(covers, areas, choice)]
        if share >= goal
    ]
    own = price.of(found, share_covered(covers, areas, found))
    assert len(set(found)) == size and share_covered(covers, areas, found) >= goal - ROUNDING
    near = [value for value, sets in every if len(sets & set(found)) >= size - 2]
    assert own == pytest.approx(min(near), abs=2.0 * ROUNDING)


def test_blocks_ask_for_less_and_are_split_until_the_answer_holds() -> None:
    """A chequered pair covers each block by half twice over; taken for complementary, it would cover everything."""
    black = CELLS.sum(axis=1) % 2 == 0
    left = CELLS[:, 0] < SIDE // 2
    covers = np.array([black, black, left, ~left & (CELLS[:, 1] < 10), CELLS[:, 1] >= 10])
    found = exact_cover(covers, np.ones(SIDE**2), CELLS, 1.0, Price.count(5), [2, 3, 4], 1.0, 1000)
    assert (found.price, found.bound) == (3.0, 3.0)


def test_dominated_sets_are_left_out_unless_their_class_or_price_says_otherwise() -> None:
    rows = [range(6), range(3), range(2, 9), range(2, 9)]
    covers = np.zeros((4, 12), dtype=np.bool_)
    for k, row in enumerate(rows):
        covers[k, list(row)] = True
    assert undominated(covers, Price.count(4)).tolist() == [0, 2]
    assert undominated(covers, Price.count(4), keep=[1]).tolist() == [0, 1, 2]
    cheap = Price(np.array([2.0, 1.0, 1.0, 1.0]), np.zeros((0, 4), dtype=np.bool_), np.zeros(0))
    assert undominated(covers, cheap).tolist() == [0, 1, 2]
    tools = Price(np.ones(4), np.array([[True, False, True, False], [False, True, False, True]]), np.ones(2))
    assert undominated(covers, tools).tolist() == [0, 1, 2, 3]


def test_exchanges_widen_a_cover() -> None:
    covers = np.array([CELLS[:, 0] < 3, CELLS[:, 0] < 6, CELLS[:, 0] >= 9, CELLS[:, 0] >= 6])
    assert sorted(widened(covers, np.ones(SIDE**2), [0, 2])) == [1, 3]


def test_no_time_at_all_leaves_the_incumbent_and_says_how_far_off_it_may_be() -> None:
    rng = np.random.default_rng(5)
    covers = boxes(rng, 40)
    greedy = greedy_cover(covers, np.ones(SIDE**2), np.zeros(40), 0.95, 0.0)
    found = exact_cover(covers, np.ones(SIDE**2), CELLS, 0.95, Price.count(40), greedy, 1.0, 0)
    assert found.chosen == sorted(greedy)
    assert found.price == len(greedy)
    assert 1.0 <= found.bound <= len(greedy)
    assert found.gap == (found.price - found.bound) / found.price
