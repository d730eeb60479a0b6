"""Where programs come from and go to, as the protocols see it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

LONGEST_REFUSAL = 32
"""Characters of the text with which a request is refused."""


class Refusal(Exception):
    """A request that is not granted.

    Parameters
    ----------
    text: for the control's screen, at most 32 characters.
    reason: for the user here.
    """

    def __init__(self, text: str, reason: str) -> None:
        super().__init__(text, reason)
        self.text = text[:LONGEST_REFUSAL]
        self.reason = reason


@dataclass(frozen=True, slots=True)
class Entry:
    """A program in a directory: name with extension, size in bytes."""

    name: str
    size: int


class Sink(Protocol):
    """A program that is arriving. Under its final name there is nothing before `commit`."""

    def write(self, line: bytes) -> None:
        """Add a line, given without its end."""

    def commit(self) -> None:
        """The program is complete."""

    def discard(self) -> None:
        """It will never be."""


class Store(Protocol):
    """A folder of programs, or a single one."""

    def directory(self) -> list[Entry]:
        """What can be read, in order."""

    def read(self, name: str, kind: str) -> Iterator[bytes]:
        """Lines of a program without their ends.

        `name` is as the control sent it, with or without extension; `kind` is the control's letter for the type.

        Raises
        ------
        Refusal: there is none, or it must not be sent.
        """

    def create(self, name: str, kind: str) -> Sink:
        """A program to be written.

        Raises
        ------
        Refusal: not a legal name, or there is one already.
        """
