"""Work spread over the cores of this machine: kernels that leave Python alone, in threads."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

Result = TypeVar("Result")

PIECES = 8
"""Pieces of work for each core: their costs differ, and whoever is done first takes the next."""


def cores() -> int:
    """How many cores this process may use; fewer than there are where its affinity says so."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def threads() -> ThreadPoolExecutor:
    """Threads, one for each core."""
    return ThreadPoolExecutor(cores())


def beside(tasks: Sequence[Callable[[], Result]]) -> list[Result]:
    """What some tasks return, in their order, done side by side. What one of them raises is raised here."""
    if cores() == 1:
        return [task() for task in tasks]
    with threads() as pool:
        return list(pool.map(lambda task: task(), tasks))


def spread(run: Callable[[slice], None], count: int, least: int = 1) -> None:
    """Call `run` with slices that make up range(count), side by side, none but the last shorter than `least`.

    What `run` raises is raised here. Threads cost about 0.1 ms: `least` is how many are worth that.
    """
    workers = cores()
    size = max(-(-count // (PIECES * workers)), least)
    parts = [slice(first, min(first + size, count)) for first in range(0, count, size)]
    if workers == 1 or len(parts) < 2:
        for part in parts:
            run(part)
        return
    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(run, parts))
