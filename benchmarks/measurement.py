"""Measurements, and how times are taken."""

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
        crowdnav: The same in CrowdNav's code, recorded once and not measured in this run; None where there is no such
            record.
    """

    work: str
    value: float
    unit: str
    crowdnav: float | None = None

    def row(self) -> tuple[str, str, str, str]:
        """Return work, speed, CrowdNav's, and how many times less time crowdbench takes."""
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
