"""How times are taken."""

from __future__ import annotations

import time
from collections.abc import Callable
from statistics import median


def seconds(work: Callable[[], object]) -> float:
    """How long some work takes once."""
    begin = time.perf_counter()
    work()
    return time.perf_counter() - begin


def in_turns(rounds: int, *works: Callable[[], float]) -> list[float]:
    """The median of what each work gives over rounds in which all work in turn, after one that does not count.

    In turns, so that what else the machine does meets all of them.
    """
    for work in works:
        work()
    return [median(column) for column in zip(*([work() for work in works] for _ in range(rounds)), strict=True)]
