"""The order of ranked entries, and their tiers.

Success is the primary endpoint, and the only one that ranks, see `crowdbench.metrics.ranks`. Two entries are equivalent
if the bounds of their difference are within `MARGIN` of 0. A tier begins at an entry if each entry before it is surely
better than it and than each following one. Entries of the same rank are listed by success weighted by completion time
(SCT), which is an order and no rank.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Bool, Float

from crowdbench.metrics import Pair, Rank

MARGIN = 0.02
"""The difference in success that is too small to matter."""


def is_equivalent(pair: Pair) -> bool:
    """Return whether two entries surely differ by less than `MARGIN`."""
    return pair.difference + pair.error < MARGIN


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
