"""Ranks entries by success. The rank of an entry is an interval.

Success is the primary endpoint, and the only one that ranks. The differences in success between all entries of a board
have simultaneous bounds, paired by case: with a confidence of 95 % all of them hold together. An entry is surely better
than another if the bounds of their difference are above 0, and equivalent to it if they are within `MARGIN` of 0. The
rank goes from 1 plus the number of entries that are surely better to the number of entries minus those that are surely
worse (Mogstad, Romano, Shaikh and Wilhelm 2024).

A tier begins at an entry if each entry before it is surely better than it and than each following one. Entries of the
same rank are listed by success weighted by completion time (SCT), which is an order and no rank.
"""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from crowdbench_leaderboards.pages.paired_bootstrap import studentise

CONFIDENCE = 0.95
"""Joint confidence of the bounds of all pairs of a board."""

NORMAL = 1.96
"""The least number of standard errors of a significant difference. If few cases differ, the number of a bootstrap is
smaller, because it draws from no other cases."""

MARGIN = 0.02
"""The difference in success that is too small to matter."""

Successes = Float[np.ndarray, "scenario case"]
"""1 where an entry succeeds, 0 elsewhere."""

Weights = Float[np.ndarray, "scenario"]


@dataclass(frozen=True)
class Pair:
    """Two entries, compared case by case.

    Attributes:
        higher: The name of the entry of higher success.
        lower: The name of the other entry.
        difference: The difference in success.
        error: The half width of its simultaneous interval.
        is_sure: True if the higher entry is surely better.
    """

    higher: str
    lower: str
    difference: float
    error: float
    is_sure: bool

    @property
    def is_equivalent(self) -> bool:
        """True if the entries surely differ by less than `MARGIN`."""
        return self.difference + self.error < MARGIN


@dataclass(frozen=True)
class Rank:
    """The rank of an entry, an interval.

    Attributes:
        first: 1 plus the number of entries that are surely better.
        last: The number of entries minus those that are surely worse.
    """

    first: int
    last: int

    def __str__(self) -> str:
        """Return the interval, or a single rank."""
        return f"{self.first} to {self.last}" if self.last > self.first else f"{self.first}"


def compare_all(
    successes: Mapping[str, Successes], weights: Weights, blocks: Sequence[Int[np.ndarray, "case"]] | None = None
) -> list[Pair]:
    """Compare each entry with all entries of lower success.

    Args:
        successes: The successes of each entry by its name, in the same cases.
        weights: The weight of each scenario; the sum is 1.
        blocks: The block of each case of each scenario, if cases of the same block are not independent: then the
            bootstrap resamples blocks.
    """
    mean = {name: float(weights @ values.mean(axis=1)) for name, values in successes.items()}
    names = sorted(mean, key=lambda name: (-mean[name], name))
    if len(names) < 2:
        return []
    higher, lower = np.triu_indices(len(names), 1)
    every = np.array([successes[name] for name in names])
    error, deviations = studentise((every[higher] - every[lower]).swapaxes(0, 1), weights, blocks)
    # The largest studentised deviation of all pairs, of either sign.
    error = error * max(float(np.quantile(np.abs(deviations).max(axis=1), CONFIDENCE)), NORMAL)
    difference = np.array([mean[names[a]] - mean[names[b]] for a, b in zip(higher, lower, strict=True)])
    sure = np.zeros((len(names), len(names)), bool)
    sure[higher, lower] = difference > error
    for k in range(len(names)):
        # Bounds that hold together also imply the order of the first and the last of three.
        sure |= sure[:, k, None] & sure[k]
    figures = zip(difference.tolist(), error.tolist(), sure[higher, lower].tolist(), strict=True)
    return [Pair(*pair, *each) for pair, each in zip(itertools.combinations(names, 2), figures, strict=True)]


def ranks(names: Sequence[str], pairs: Iterable[Pair]) -> dict[str, Rank]:
    """Return the rank of each entry, by name.

    Args:
        names: The names of the entries.
        pairs: The result of `compare_all`.
    """
    sure = [pair for pair in pairs if pair.is_sure]
    better, worse = Counter(pair.lower for pair in sure), Counter(pair.higher for pair in sure)
    return {name: Rank(1 + better[name], len(names) - worse[name]) for name in names}


def sort_entries(rank: Mapping[str, Rank], sct: Mapping[str, float]) -> list[str]:
    """Return the names of entries by rank, and within a rank by SCT, the largest first."""
    return sorted(rank, key=lambda name: (rank[name].first, rank[name].last, -sct[name], name))


def tiers(order: Sequence[Rank]) -> list[bool]:
    """Return which entries begin a tier; the ranks are in the order of `sort_entries`."""
    # The number of entries that are surely better than this one is the number of entries before it.
    return [rank.first == place for place, rank in enumerate(order, start=1)]


def pareto(costs: Float[np.ndarray, "entry cost"]) -> Bool[np.ndarray, "entry"]:
    """Return which entries are in the Pareto set: no other entry is better in a cost and worse in none.

    Args:
        costs: Quantities to minimise, such as failures and time.
    """
    not_worse = (costs[:, None] <= costs).all(axis=2)
    smaller = (costs[:, None] < costs).any(axis=2)
    return np.logical_not((not_worse & smaller).any(axis=0))
