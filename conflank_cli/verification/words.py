"""The words of motion blocks, which both languages of the control share."""

from __future__ import annotations

import re
from dataclasses import dataclass
from math import pi

from conflank_cli.verification.program import NUMBER, Vector, number

INCH = 25.4
ROTARY = "ABC"
_RADIANS = pi / 180.0

_WORD = re.compile(
    rf"""\s*(?:
      (?P<axis>I?[XYZABC])\s*(?:(?P<value>{NUMBER})|(?P<parameter>[+-]?Q[LRS]?\d+))
    | (?P<component>[NT][XYZ])\s*(?P<part>{NUMBER})
    | F\s*(?P<feed>MAX|AUTO|{NUMBER}|Q[LRS]?\d+)
    | (?P<variant>F[UTZ])\s*{NUMBER}
    | (?P<side>R[0LR])(?![A-Z0-9])
    | M\s*(?P<function>\d+)
    | MB\s*(?P<back>MAX|{NUMBER})
    )""",
    re.VERBOSE,
)

_VALUE = r"([+-]?[\d.,]+)"
PLAIN = "".join(rf"(?:{letter}\s*{_VALUE}\s*)?" for letter in "XYZABC")
PLAIN += rf"(?:TX\s*{_VALUE}\s*TY\s*{_VALUE}\s*TZ\s*{_VALUE}\s*)?"
"""The usual words in the usual order, as a regular expression: nearly all blocks of a program match it, and quickly."""

_USED = re.compile(r"(?<![A-Z])I?([ABC])\s*[+-]?(?:[\d.,]|Q)")


def lines_of(text: str) -> list[str]:
    """The lines of a program, without a mark of the byte order.

    Bytes that are no UTF-8, which come as lone surrogates (the text keeps its hash so), are letters of Latin-1 here: an
    old editor's umlaut in a comment may be quoted in a finding.
    """
    if not text.isascii() and any("\ud800" <= letter <= "\udfff" for letter in text):
        text = text.encode("utf-8", "surrogateescape").decode("latin-1")
    return text.lstrip("\ufeff").splitlines()


@dataclass(frozen=True, slots=True)
class Words:
    """The words of a motion block, angles in radians, lengths as programmed; None stands for a value not known."""

    axes: dict[str, float | None]
    vector: dict[str, float]
    normal: bool
    feed: str | None
    side: str | None
    functions: tuple[int, ...]
    back: str | None
    rest: str


def split_words(text: str, unit: float) -> Words:
    """Take the words of a block apart; `rest` keeps what is no word."""
    axes: dict[str, float | None] = {}
    vector: dict[str, float] = {}
    functions: list[int] = []
    normal = False
    feed = side = back = None
    place = 0
    while place < len(text):
        found = _WORD.match(text, place)
        if found is None:
            break
        place = found.end()
        if axis := found["axis"]:
            value = None if found["value"] is None else number(found["value"])
            if value is not None:
                value = value * _RADIANS if axis[-1] in ROTARY else value * unit
            axes[axis] = value
        elif component := found["component"]:
            if component[0] == "T":
                vector[component[1]] = number(found["part"])
            else:
                normal = True
        elif found["feed"]:
            # F after M128 caps the compensating movement; it is not the cutting feed.
            feed = feed if functions[-1:] == [128] else found["feed"]
        elif found["side"]:
            side = found["side"]
        elif found["function"]:
            functions.append(int(found["function"]))
        elif found["back"]:
            back = found["back"]
    return Words(axes, vector, normal, feed, side, tuple(functions), back, text[place:].strip())


def plain_words(groups: tuple[str | None, ...], unit: float) -> tuple[dict[str, float | None], Vector | None] | None:
    """Axes and vector of the groups that `PLAIN` has found; None where one is no number after all."""
    axes: dict[str, float | None] = {}
    try:
        for letter, value in zip("XYZABC", groups, strict=False):
            if value is not None:
                if "," in value:
                    value = value.replace(",", ".")
                axes[letter] = float(value) * (_RADIANS if letter in ROTARY else unit)
        i, j, k = groups[6:9]
        if i is None or j is None or k is None:
            return axes, None
        return axes, (number(i), number(j), number(k))
    except ValueError:
        return None


def rotary_letters(text: str) -> set[str]:
    """Letters of the rotary words in the words of a motion block."""
    return set(_USED.findall(text))
