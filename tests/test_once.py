"""Values that are made when they are first asked for."""

from __future__ import annotations

import pickle
import threading
import time

import pytest

from conflank_cli.once import Once


def test_a_value_is_made_once_for_all_threads() -> None:
    made = []

    def make() -> object:
        time.sleep(0.02)
        made.append(object())
        return made[-1]

    once, found = Once(make), []
    threads = [threading.Thread(target=lambda: found.append(once())) for _ in range(4)]
    assert made == []
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(made) == 1 and found == 4 * made


def test_what_could_not_be_made_is_tried_again() -> None:
    answers = iter([ValueError("not yet"), None])

    def make() -> None:
        answer = next(answers)
        if answer is not None:
            raise answer

    once = Once(make)
    with pytest.raises(ValueError, match="not yet"):
        once()
    assert once() is None and once() is None


def test_another_process_is_handed_what_was_made() -> None:
    """What makes it, a lambda, could not be."""
    once = Once(lambda: [1, 2])
    again = pickle.loads(pickle.dumps(once))
    assert again() == [1, 2] == once()
    assert again() is again()
