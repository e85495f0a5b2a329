"""Measurements, and functions that measure times."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from statistics import median


@dataclass(frozen=True)
class Measurement:
    """The speed of one piece of work.

    Attributes:
        work: The measured work.
        value: The result, in `unit`.
        unit: The unit of both values.
        crowdnav: The value of CrowdNav's code, recorded once and not measured in this run; None if it is unknown.
    """

    work: str
    value: float
    unit: str
    crowdnav: float | None = None

    def row(self) -> tuple[str, str, str, str]:
        """Return the work, the values of crowdbench and CrowdNav, and the ratio of CrowdNav's to crowdbench's."""
        own = f"{self.value:.3g} {self.unit}"
        if self.crowdnav is None:
            return self.work, own, "", ""
        return self.work, own, f"{self.crowdnav:.3g} {self.unit}", f"{self.crowdnav / self.value:.1f}x"


def seconds(work: Callable[[], object]) -> float:
    """Return the time in seconds that a call takes."""
    begin = time.perf_counter()
    work()
    return time.perf_counter() - begin


def in_turns(rounds: int, *works: Callable[[], float]) -> list[float]:
    """Measure several functions in turns, so that other load on the machine affects all of them equally.

    Args:
        rounds: Number of measurements of each function, after a warm-up that does not count.
        works: Functions that do some work and return its duration, or another measure of it.

    Returns:
        The median of the values of each function.
    """
    for work in works:
        work()
    return [median(column) for column in zip(*([work() for work in works] for _ in range(rounds)), strict=True)]
