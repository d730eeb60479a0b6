"""The words of motion blocks, which both languages of the control share."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from math import pi

from conflank_cli.verification.numbers import MOST, MOST_COMPONENT, number
from conflank_cli.verification.parameters import PLANE_ANGLES, VALUE

INCH = 25.4
ROTARY = "ABC"
_RADIANS = pi / 180.0

Vector = tuple[float, float, float]
Value = Callable[[str], float | None]
"""From the text of a number or parameter to its value, None where that is not known."""

_WORD = re.compile(
    rf"""\s*(?:
      (?P<polar>I?P[AR])\s*(?P<way>{VALUE})
    | (?P<axis>I?[XYZABC])\s*(?P<value>{VALUE})
    | (?P<component>[NT][XYZ])\s*(?P<part>{VALUE})
    | (?P<variant>F\s*(?:MAXT|[UTZ]\s*{VALUE}))
    | F\s*(?P<feed>MAX|AUTO|{VALUE})
    | DR(?P<turn>[+-])(?![\d.,Q])
    | (?P<side>R[0LR])(?![\w.,+-])
    | R\s*(?P<radius>{VALUE})
    | MB\s*(?P<back>MAX|{VALUE})
    | M\s*(?P<function>\d+)
    )""",
    re.VERBOSE,
)

_NUMBER = r"([+-]?[\d.,]+)"
PLAIN = "".join(rf"(?:{letter}\s*{_NUMBER}\s*)?" for letter in "XYZABC")
PLAIN += rf"(?:TX\s*{_NUMBER}\s*TY\s*{_NUMBER}\s*TZ\s*{_NUMBER}\s*)?"
"""The usual words in the usual order, as a regular expression: nearly all blocks of a program match it, and quickly."""

_USED = re.compile(r"(?<![A-Z])I?([ABC])\s*[+-]?(?:[\d.,]|Q)")


@dataclass(slots=True)
class Words:
    """The words of a motion block; angles in radians, lengths in mm; None stands for a value that is not known.

    Attributes
    ----------
    axes: coordinates by letter, with a leading I for increments.
    plane: rotary letters whose value is the control's own for the tilted plane (Q120 to Q122).
    polar: PR (mm) and PA (radians), with a leading I for increments.
    vector, normal: components of the tool vector and of the surface normal by letter.
    radius, turn: R and DR of an arc; turn +1 counter-clockwise, -1 clockwise, 0 where none is given.
    feed: what follows F, or None; variant: a feed that is none per minute.
    cap: F behind M128, which caps the compensating movement; it is not the cutting feed.
    side: R0, RL or RR.
    functions: M functions in their order; back: MB of M140.
    rest: what is no word; wrong: words that the control would refuse, and why.
    """

    axes: dict[str, float | None] = field(default_factory=dict)
    plane: set[str] = field(default_factory=set)
    polar: dict[str, float | None] = field(default_factory=dict)
    vector: dict[str, float | None] = field(default_factory=dict)
    normal: dict[str, float | None] = field(default_factory=dict)
    radius: list[float | None] = field(default_factory=list)
    turn: int = 0
    feed: str | None = None
    variant: str | None = None
    cap: str | None = None
    side: str | None = None
    functions: tuple[int, ...] = ()
    back: str | None = None
    rest: str = ""
    wrong: list[str] = field(default_factory=list)

    def once(self, name: str, before: object) -> None:
        """Note a word that stands in the block already: `before` is not None then."""
        if before is not None:
            self.wrong.append(f"{name} stands twice in the block")

    def take_radius(self, text: str, unit: float, value: Value) -> None:
        """Take an R word."""
        self.once("R", self.radius or None)
        radius = value(text)
        self.radius = [None if radius is None or not abs(radius) <= MOST else radius * unit]

    def take_feed(self, text: str) -> None:
        """Take an F word."""
        if self.functions[-1:] == (128,) and self.cap is None:
            self.cap = text
        else:
            self.once("F", self.feed)
            self.feed = text

    def coordinate(self, word: str, text: str, unit: float, value: Value) -> None:
        """Take a coordinate, a polar word or a component of a vector."""
        store = self.polar if word[-2:-1] == "P" else self.axes
        scale = _RADIANS if word[-1] in ROTARY else unit
        most = MOST
        if word[0] in "NT":
            store, scale, most = (self.vector if word[0] == "T" else self.normal), 1.0, MOST_COMPONENT
        letter = word[-1] if word[0] in "NT" else word
        if any(letter.removeprefix("I") == known.removeprefix("I") for known in store):
            self.wrong.append(f"{word} stands twice in the block")
        if word in ROTARY and PLANE_ANGLES.get(text.lstrip("+")) == word:
            self.plane.add(word)
        known = value(text)
        if known is not None and not abs(known) <= most:
            self.wrong.append(f"{word}{text[:20]} is beyond what the control takes (+-{most})")
            known = None
        store[letter] = None if known is None else known * scale


def split_words(text: str, unit: float, value: Value) -> Words:
    """Take the words of a conversational block apart.

    Parameters
    ----------
    text: the block, in capitals.
    unit: mm in a unit of length.
    value: from the text of a number or parameter to its value.
    """
    words = Words()
    place = 0
    while place < len(text):
        found = _WORD.match(text, place)
        if found is None:
            break
        place = found.end()
        _take(words, found, unit, value)
    words.rest = text[place:].strip()
    return words


def _take(words: Words, found: re.Match[str], unit: float, value: Value) -> None:
    """One word of a block."""
    kind = found.lastgroup
    if kind in ("value", "way", "part"):
        words.coordinate(found["axis"] or found["polar"] or found["component"], found[kind], unit, value)
    elif kind == "function":
        words.functions = (*words.functions, int(found["function"]))
    elif kind == "feed":
        words.take_feed(found["feed"])
    elif kind == "variant":
        words.variant = found["variant"]
    elif kind == "side":
        words.once("radius compensation", words.side)
        words.side = found["side"]
    elif kind == "turn":
        words.once("DR", words.turn or None)
        words.turn = 1 if found["turn"] == "+" else -1
    elif kind == "radius":
        words.take_radius(found["radius"], unit, value)
    elif kind == "back":
        words.once("MB", words.back)
        words.back = found["back"]


def plain_words(groups: tuple[str | None, ...], unit: float) -> tuple[dict[str, float | None], Vector | None] | None:
    """Axes and vector of the groups that `PLAIN` has found.

    None where one is no number after all, or beyond what the control takes.
    """
    axes: dict[str, float | None] = {}
    try:
        for letter, text in zip("XYZABC", groups, strict=False):
            if text is not None:
                value = float(text.replace(",", ".") if "," in text else text)
                if not -MOST <= value <= MOST:
                    return None
                axes[letter] = value * (_RADIANS if letter in ROTARY else unit)
        i, j, k = groups[6:9]
        if i is None or j is None or k is None:
            return axes, None
        vector = (number(i), number(j), number(k))
    except ValueError:
        return None
    return None if max(map(abs, vector)) > MOST_COMPONENT else (axes, vector)


def rotary_letters(text: str) -> set[str]:
    """Letters of the rotary words in the words of a motion block."""
    return set(_USED.findall(text))
