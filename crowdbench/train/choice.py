"""Which point of a training curve is kept."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Protocol, TypeVar, runtime_checkable


@runtime_checkable
class Validation(Protocol):
    """A point of a training curve."""

    @property
    def success(self) -> float:
        """The success rate on validation cases, from 0 to 1."""

    @property
    def navigation_time_or_limit(self) -> float:
        """The mean time to the goal in seconds, the time limit for failures."""


Point = TypeVar("Point", bound=Validation)


def chosen(curve: Sequence[Point], cases: int) -> Point:
    """The point of a training curve whose network is kept: by success first, within noise, and by time second.

    Args:
        curve: The points.
        cases: The number of cases of each point.

    Returns:
        The quickest of the points whose success is at most one standard error below the largest (the rule of Breiman
        et al., *Classification and Regression Trees*, 1984); the latest one, if several are as quick. For the standard
        error two successes and two failures are added (Agresti and Coull 1998), or else it would be 0 where all
        cases succeed.
    """
    most = max(point.success for point in curve)
    share = (most * cases + 2) / (cases + 4)
    error = math.sqrt(share * (1 - share) / (cases + 4))
    return min(
        (point for point in reversed(curve) if point.success >= most - error),
        key=lambda point: point.navigation_time_or_limit,
    )
