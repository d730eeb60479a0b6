"""Vectors of four numbers in compiled functions: what they do there is what their Python says."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pytest
from numba import njit

from conflank_cli.geometry.kernels.lanes import components, dot, lanes, load

Array = npt.NDArray[np.float64]


def sums(numbers: Array) -> tuple[float, ...]:
    one, other = load(numbers.reshape(3, 4), 3), load(numbers, 8)
    return components(one + other - lanes(numbers[0], 1.0, 2.0, 3.0))


def products(numbers: Array) -> tuple[float, ...]:
    one, other = load(numbers, 0), load(numbers, 4)
    return components(0.5 * one * other + other * numbers[1])


def scalar_product(numbers: Array) -> tuple[float, ...]:
    return (dot(load(numbers, 1), load(numbers, 7)),)


def through_a_loop(numbers: Array) -> tuple[float, ...]:
    """A vector that changes from turn to turn, and two ways to one."""
    total = lanes(0.0, 0.0, 0.0, 0.0)
    for k in range(0, numbers.size - 3, 2):
        total = total * 0.25 + load(numbers, k) if numbers[0] > 0.0 or k > 4 else total - load(numbers, k)
    return components(total)


@pytest.mark.parametrize("work", [sums, products, scalar_product, through_a_loop])
def test_compiled_it_is_what_python_says(work: Callable[[Array], tuple[float, ...]]) -> None:
    compiled = njit(work)
    for seed in range(10):
        numbers = np.random.default_rng(seed).normal(size=12)
        np.testing.assert_allclose(compiled(numbers), work(numbers), rtol=1e-14, atol=1e-15)


def test_of_an_array_that_is_not_contiguous_nothing_is_loaded() -> None:
    with pytest.raises(Exception, match="load"):
        njit(lambda numbers: dot(load(numbers, 0), load(numbers, 0)))(np.ones((4, 8))[:, ::2])
