"""Q parameters of a program: their values, the functions FN 0 to FN 13, and formulas.

A parameter has the value that the program has given it. What it held before the program began, and what a function that
is not followed has put into it, is not known; neither is anything computed from it.

Source: HEIDENHAIN iTNC 530 user's manual, chapter "Programming: Q Parameters".
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from math import (
    acos,
    asin,
    atan,
    atan2,
    cos,
    degrees,
    exp,
    fmod,
    hypot,
    isfinite,
    log,
    log10,
    pi,
    radians,
    sin,
    sqrt,
    tan,
)

from conflank_cli.verification.numbers import NUMBER, number

PARAMETER = r"Q[LR]?\d{1,4}"
"""Name of a numeric parameter, as a regular expression."""

VALUE = rf"(?:{NUMBER}|[+-]?{PARAMETER})"
"""A number or a parameter with an optional sign, as a regular expression."""

PLANE_ANGLES = {"Q120": "A", "Q121": "B", "Q122": "C"}
"""Parameters into which the control puts the positions of the rotary axes for a tilted plane."""

_TOKEN = re.compile(rf"\s*({PARAMETER}|\d+(?:[.,]\d*)?|[.,]\d+|[A-Z]+|[-+*/^%()])")

_FUNCTIONS: Mapping[str, Callable[[float], float]] = {
    "SIN": lambda x: sin(radians(x)),
    "COS": lambda x: cos(radians(x)),
    "TAN": lambda x: tan(radians(x)),
    "ASIN": lambda x: degrees(asin(x)),
    "ACOS": lambda x: degrees(acos(x)),
    "ATAN": lambda x: degrees(atan(x)),
    "SQRT": sqrt,
    "SQ": lambda x: x * x,
    "LN": log,
    "LOG": log10,
    "EXP": exp,
    "NEG": lambda x: -x,
    "INT": lambda x: float(int(x)),
    "ABS": abs,
    "FRAC": lambda x: fmod(x, 1.0),
    "SGN": lambda x: float((x > 0.0) - (x < 0.0)),
}
"""Functions of a formula, angles in degrees."""

_OPERATORS: Mapping[str, Callable[[float, float], float]] = {
    "+": lambda a, b: a + b,
    "-": lambda a, b: a - b,
    "*": lambda a, b: a * b,
    "/": lambda a, b: a / b,
    "%": fmod,
    "^": lambda a, b: a**b,
}

_NUMBERED: Mapping[int, tuple[str, Callable[..., float]]] = {
    0: (rf"({VALUE})", lambda a: a),
    1: (rf"({VALUE})\s*\+\s*({VALUE})", lambda a, b: a + b),
    2: (rf"({VALUE})\s*-\s*({VALUE})", lambda a, b: a - b),
    3: (rf"({VALUE})\s*\*\s*({VALUE})", lambda a, b: a * b),
    4: (rf"({VALUE})\s*DIV\s*({VALUE})", lambda a, b: a / b),
    5: (rf"SQRT\s*({VALUE})", sqrt),
    6: (rf"SIN\s*({VALUE})", lambda a: sin(radians(a))),
    7: (rf"COS\s*({VALUE})", lambda a: cos(radians(a))),
    8: (rf"({VALUE})\s*LEN\s*({VALUE})", hypot),
    13: (rf"({VALUE})\s*ANG\s*({VALUE})", lambda a, b: degrees(atan2(a, b)) % 360.0),
}
"""The functions FN n: form of what stands behind the equals sign, and what it is."""

_COMPARISONS: Mapping[int, Callable[[float, float], bool]] = {
    9: lambda a, b: a == b,
    10: lambda a, b: a != b,
    11: lambda a, b: a > b,
    12: lambda a, b: a < b,
}
"""The conditional jumps FN n."""

COMPARED = {9: "EQU", 10: "NE", 11: "GT", 12: "LT"}
"""How the conditional jumps spell their comparison."""


class Parameters:
    """The values of all parameters; None where one is not known."""

    def __init__(self) -> None:
        self._values: dict[str, float | None] = {}

    def value(self, text: str) -> float | None:
        """Value of a number or a parameter with an optional sign; None where it is not known."""
        sign = -1.0 if text[0] == "-" else 1.0
        name = text.lstrip("+-")
        if name[0] != "Q":
            return number(text)
        known = self._values.get(name)
        return None if known is None else sign * known

    def set(self, name: str, value: float | None) -> None:
        """Give a parameter a value."""
        self._values[name] = value if value is not None and isfinite(value) else None

    def numbered(self, function: int, text: str) -> float | None:
        """Value of function FN `function` of the text behind its equals sign; None where it is not known.

        Raises
        ------
        ValueError: the function is not followed, or the text is not of its form.
        """
        if function not in _NUMBERED:
            raise ValueError(f"FN {function} is not followed")
        form, compute = _NUMBERED[function]
        found = re.fullmatch(form, text.strip())
        if found is None:
            raise ValueError(f"FN {function} not understood")
        return self._computed(compute, [self.value(group) for group in found.groups()])

    def iso_numbered(self, function: int, operands: list[str]) -> float | None:
        """The same for the function D `function` of an ISO program, with its operands P01, P02.

        Raises
        ------
        ValueError: the function is not followed, or has another number of operands.
        """
        if function not in _NUMBERED:
            raise ValueError(f"D{function:02d} is not followed")
        form, compute = _NUMBERED[function]
        if len(operands) != re.compile(form).groups:
            raise ValueError(f"D{function:02d} not understood")
        return self._computed(compute, [self.value(operand) for operand in operands])

    def holds(self, function: int, first: str, second: str) -> bool | None:
        """Whether the condition of jump FN `function` holds; None where it is not known."""
        a, b = self.value(first), self.value(second)
        return None if a is None or b is None else _COMPARISONS[function](a, b)

    def formula(self, text: str) -> float | None:
        """Value of a formula; None where it depends on what is not known.

        Raises
        ------
        ValueError: it is no formula.
        """
        return _Formula(self, text).value()

    def _computed(self, compute: Callable[..., float], operands: list[float | None]) -> float | None:
        if None in operands:
            return None
        try:
            return float(compute(*operands))
        except (ValueError, ZeroDivisionError, OverflowError):
            return None


class _Formula:
    """A formula that is being evaluated: powers before products before sums; functions bind to what follows them."""

    def __init__(self, parameters: Parameters, text: str) -> None:
        self._parameters = parameters
        self._tokens: list[str] = []
        place = 0
        text = text.strip()
        while place < len(text):
            found = _TOKEN.match(text, place)
            if found is None:
                raise ValueError(f"formula not understood: {text[:60]}")
            self._tokens.append(found[1])
            place = found.end()
        self._text = text
        self._depth = 0

    def value(self) -> float | None:
        result = self._sum()
        if self._tokens:
            raise ValueError(f"formula not understood: {self._text[:60]}")
        return result

    def _sum(self) -> float | None:
        self._depth += 1
        if self._depth > 50:
            raise ValueError("formula with more than 50 brackets within each other")
        result = self._chain(self._product, "+-")
        self._depth -= 1
        return result

    def _product(self) -> float | None:
        return self._chain(self._power, "*/%")

    def _power(self) -> float | None:
        return self._chain(self._operand, "^")

    def _chain(self, operand: Callable[[], float | None], operators: str) -> float | None:
        result = operand()
        while self._tokens and self._tokens[0] in operators:
            operator = self._tokens.pop(0)
            other = operand()
            result = self._parameters._computed(_OPERATORS[operator], [result, other])
        return result

    def _operand(self) -> float | None:
        if not self._tokens:
            raise ValueError(f"formula not understood: {self._text[:60]}")
        token = self._tokens.pop(0)
        if token in "+-":
            value = self._operand()
            return value if token == "+" or value is None else -value
        if token == "(":
            value = self._sum()
            if not self._tokens or self._tokens.pop(0) != ")":
                raise ValueError(f"formula without its closing bracket: {self._text[:60]}")
            return value
        if token in _FUNCTIONS:
            return self._parameters._computed(_FUNCTIONS[token], [self._operand()])
        if token == "PI":
            return pi
        if token[0].isalpha() and token[0] != "Q":
            raise ValueError(f"function {token} is not followed")
        return self._parameters.value(token)
