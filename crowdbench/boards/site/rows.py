"""The rows of a board's tables."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from crowdbench.boards.entry import DecisionTime, Verification
from crowdbench.boards.site.texts import why_unranked
from crowdbench.boards.standings import Standing, Standings
from crowdbench.evaluate.summary import Estimate


@dataclass(frozen=True)
class Band:
    """A mean with its interval on an axis from 0 to 100.

    Attributes:
        low: Where the interval begins.
        mean: The mean.
        high: Where it ends.
    """

    low: float
    mean: float
    high: float

    @property
    def width(self) -> float:
        """The length of the interval, at least so long that it can be seen."""
        return max(self.high - self.low, 1.0)


@dataclass(frozen=True)
class Row:
    """A row of a table of entries.

    Attributes:
        standing: The entry.
        is_measured: Whether its figures were measured in the season; otherwise they are what its authors report.
        band: Its success.
        undecided: The names of ranked entries that are neither better nor worse.
        is_tied: Whether another entry has the same rank.
        begins: Whether the row above it has another rank.
        why: Why it has no rank; empty where it has one.
    """

    standing: Standing
    is_measured: bool
    band: Band
    undecided: Sequence[str] = ()
    is_tied: bool = False
    begins: bool = False
    why: str = ""

    @property
    def verification(self) -> Verification | None:
        """What was found in the season."""
        return self.standing.season

    @property
    def speed(self) -> DecisionTime | None:
        """How long its decisions took, if that was measured in the season."""
        return self.standing.season.decision_time if self.standing.season else None


def is_measured(standing: Standing) -> bool:
    """Whether an entry's figures were measured in the season."""
    return standing.season is not None and bool(standing.season.figures)


def success_axis(found: Standings) -> float:
    """Where the axis of success begins, as a share; it ends at 1. The same for all entries of a board."""
    lows = [one.figures["success_rate"].low for one in (*found.ranked, *found.others)]
    return min(math.floor(10.0 * min((low for low in lows if math.isfinite(low)), default=0.0)) / 10.0, 0.9)


def band(estimate: Estimate, begin: float) -> Band:
    """A share with its interval on an axis that ends at 1.

    Args:
        estimate: The share.
        begin: Where the axis begins, as a share.

    Returns:
        In per cent of the length of the axis.
    """
    low, mean, high = (
        100.0 * min(max((value - begin) / (1.0 - begin), 0.0), 1.0) if math.isfinite(value) else 0.0
        for value in (estimate.low, estimate.mean, estimate.high)
    )
    return Band(low, mean, high)


def ranked_rows(found: Standings) -> list[Row]:
    """The rows of the ranked entries, the best first."""
    begin = success_axis(found)
    ranks = [one.rank.rank if one.rank else 0 for one in found.ranked]
    return [
        Row(
            standing=one,
            is_measured=True,
            band=band(one.figures["success_rate"], begin),
            undecided=_undecided(found, index),
            is_tied=ranks.count(ranks[index]) > 1,
            begins=index > 0 and ranks[index - 1] != ranks[index],
        )
        for index, one in enumerate(found.ranked)
    ]


def _undecided(found: Standings, index: int) -> list[str]:
    pairs = [one.entries for one in found.comparisons if one.better is None and index in one.entries]
    return [found.ranked[b if a == index else a].entry.name for a, b in pairs]


def other_rows(found: Standings) -> list[Row]:
    """The rows of the entries without a rank, by name."""
    begin = success_axis(found)
    return [
        Row(
            standing=one,
            is_measured=is_measured(one),
            band=band(one.figures["success_rate"], begin),
            why=why_unranked(one, found.board.spec.flags),
        )
        for one in found.others
    ]
