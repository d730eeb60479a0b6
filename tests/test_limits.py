"""Where the stages aim within a tolerance."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from conflank_cli.job import Tolerance
from conflank_cli.limits import Limits

LENGTHS = st.floats(0.0, 1.0)


def test_equal_tolerances_are_aimed_at_as_they_are() -> None:
    assert Limits.of(Tolerance(0.010, 0.010, 0.1)) == Limits(0.010, 0.010, 0.1)
    assert Limits.of(Tolerance(0.005, 0.010)) == Limits(0.005, 0.010, 0.0)


def test_where_overcut_is_forbidden_the_aim_lies_above_the_face() -> None:
    limits = Limits.of(Tolerance(0.0, 0.03, 0.2))
    assert (limits.over, limits.under, limits.allowance) == pytest.approx((0.01, 0.02, 0.21))
    limits = Limits.of(Tolerance(0.03, 0.0))
    assert (limits.over, limits.under, limits.allowance) == pytest.approx((0.02, 0.01, -0.01))


@given(LENGTHS, LENGTHS, LENGTHS)
def test_the_band_stays_where_the_job_has_it(over: float, under: float, allowance: float) -> None:
    limits = Limits.of(Tolerance(over, under, allowance))
    assert limits.allowance - limits.over == pytest.approx(allowance - over, abs=1e-12)
    assert limits.allowance + limits.under == pytest.approx(allowance + under, abs=1e-12)
    assert min(limits.over, limits.under) >= (over + under) / 3.0 - 1e-12
