"""Values that are made when they are first asked for."""

from __future__ import annotations

from collections.abc import Callable
from threading import Lock
from typing import Generic, TypeVar

Made = TypeVar("Made")


class Once(Generic[Made]):
    """A value that is made when it is first asked for, once, whichever thread asks; who asks meanwhile waits."""

    def __init__(self, make: Callable[[], Made]) -> None:
        self._make = make
        self._lock = Lock()
        self._made: list[Made] = []

    def __call__(self) -> Made:
        """The value; raises what making it raises, and where it was not made it is tried again."""
        with self._lock:
            if not self._made:
                self._made.append(self._make())
            return self._made[0]

    def __reduce__(self) -> tuple[Callable[[Made], Once[Made]], tuple[Made]]:
        """Another process is handed the value itself: what makes it may not be able to go there."""
        return _made, (self(),)


def _made(value: Made) -> Once[Made]:
    return Once(lambda: value)
