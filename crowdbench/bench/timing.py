"""How times are measured."""

from __future__ import annotations

import time
from collections.abc import Callable
from statistics import median


def seconds(work: Callable[[], object]) -> float:
    """Time in seconds that a call takes."""
    begin = time.perf_counter()
    work()
    return time.perf_counter() - begin


def in_turns(rounds: int, *works: Callable[[], float]) -> list[float]:
    """Measure several works by turns, so that other load on the machine affects all of them alike.

    Args:
        rounds: How many times each work is measured, after once that does not count.
        works: Each does something and returns how long it took, or another measure of it.

    Returns:
        The median of what each work returned.
    """
    for work in works:
        work()
    return [median(column) for column in zip(*([work() for work in works] for _ in range(rounds)), strict=True)]
