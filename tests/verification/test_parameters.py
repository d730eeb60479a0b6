"""Q parameters against Python's own arithmetic."""

from __future__ import annotations

from math import atan2, cos, degrees, hypot, radians, sin

import pytest
from hypothesis import given
from hypothesis import strategies as st

from conflank_cli.verification.parameters import Parameters

SMALL = st.integers(-9, 9)


@st.composite
def formulas(draw: st.DrawFn, depth: int = 3) -> tuple[str, str]:
    """A formula as the control writes it, and as Python does."""
    if depth == 0 or draw(st.booleans()):
        value = abs(draw(SMALL))
        return str(value), f"{value}.0"
    left, right = draw(formulas(depth=depth - 1)), draw(formulas(depth=depth - 1))
    kind = draw(st.sampled_from(["+", "-", "*", "()", "SIN", "COS", "SQ", "NEG"]))
    if kind in "+-*":
        return f"{left[0]} {kind} {right[0]}", f"{left[1]} {kind} {right[1]}"
    if kind == "()":
        return f"( {left[0]} )", f"({left[1]})"
    python = {"SIN": "sin(radians({}))", "COS": "cos(radians({}))", "SQ": "(({}) ** 2)", "NEG": "(-({}))"}[kind]
    return f"{kind} ( {left[0]} )", python.format(left[1])


@given(formulas())
def test_formulas_are_those_of_python(formula: tuple[str, str]) -> None:
    text, python = formula
    expected = eval(python, {"sin": sin, "cos": cos, "radians": radians})
    assert Parameters().formula(text) == pytest.approx(expected, rel=1e-12, abs=1e-9)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("2 + 3 * 4", 14.0),
        ("2 * 3 ^ 2", 18.0),
        ("10 - 4 - 3", 3.0),
        ("-3 * -2", 6.0),
        ("SIN 30 + 1", 1.5),
        ("SQRT 9 * 2", 6.0),
        ("2 * PI", 6.283185307179586),
        ("1,5 + .5", 2.0),
        ("INT -2.7", -2.0),
        ("FRAC 2.75", 0.75),
        ("7 % 4", 3.0),
        ("ATAN 1", 45.0),
    ],
)
def test_precedence_and_functions(text: str, value: float) -> None:
    assert Parameters().formula(text) == pytest.approx(value, abs=1e-12)


@pytest.mark.parametrize("text", ["2 +", "( 2", "2 )", "FOO 3", "2 & 3", "", "(" * 60 + "1" + ")" * 60])
def test_what_is_no_formula_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"not|bracket"):
        Parameters().formula(text)


@pytest.mark.parametrize(
    ("function", "text", "value"),
    [
        (0, "+60", 60.0),
        (1, "-Q2 + -5", -9.0),
        (2, "+10 - +Q2", 6.0),
        (3, "+Q2 * +3", 12.0),
        (4, "+Q2 DIV +2", 2.0),
        (5, "SQRT +Q2", 2.0),
        (6, "SIN +30", 0.5),
        (7, "COS +60", 0.5),
        (8, "+3 LEN +Q2", hypot(3.0, 4.0)),
        (13, "+1 ANG +Q2", degrees(atan2(1.0, 4.0))),
    ],
)
def test_numbered_functions(function: int, text: str, value: float) -> None:
    parameters = Parameters()
    parameters.set("Q2", 4.0)
    assert parameters.numbered(function, text) == pytest.approx(value, abs=1e-12)


def test_what_is_not_known_stays_so() -> None:
    parameters = Parameters()
    assert parameters.value("+Q7") is None
    assert parameters.formula("Q7 * 0") is None
    assert parameters.numbered(1, "+Q7 + +1") is None
    assert parameters.holds(9, "+Q7", "+1") is None
    assert parameters.formula("1 / 0") is None
    assert parameters.formula("SQRT -1") is None
    parameters.set("Q7", 1e308)
    parameters.set("Q8", parameters.formula("Q7 * 10"))
    assert parameters.value("Q8") is None


@pytest.mark.parametrize(("function", "true"), [(9, (2, 2)), (10, (2, 3)), (11, (3, 2)), (12, (2, 3))])
def test_jumps(function: int, true: tuple[int, int]) -> None:
    parameters = Parameters()
    assert parameters.holds(function, f"+{true[0]}", f"+{true[1]}") is True
    false = (2, 3) if function == 9 else (2, 2)
    assert parameters.holds(function, f"+{false[0]}", f"+{false[1]}") is False
