"""What can go wrong in a post, as a user reads it: where, what was found, what was expected, and what to do next."""

from __future__ import annotations


class PostError(Exception):
    """A program cannot be written; nothing has been written.

    Parameters
    ----------
    where: file, option, or sweep and pose.
    found: what is there.
    expected: what should be there.
    next_step: what the user can do about it.
    """

    def __init__(self, where: str, found: str, expected: str, next_step: str) -> None:
        super().__init__(where, found, expected, next_step)
        self.where = where
        self.found = found
        self.expected = expected
        self.next_step = next_step

    def __str__(self) -> str:
        return f"{self.where}: found {self.found}; expected {self.expected}. {self.next_step}"


class DeviceError(PostError):
    """A port or a control did not do its part; what was being transferred is not under its final name."""


class Interrupted(KeyboardInterrupt):
    """Ctrl-C or SIGTERM during a transfer.

    Parameters
    ----------
    text: what has gone out or come in, and what to do about it; no full stop.
    """

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self.text = text
