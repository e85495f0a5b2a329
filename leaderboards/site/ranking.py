"""Ranks entries by score. Entries whose order may be due to chance share a rank.

The score of an entry is U = S + 0.005 g. S is the success rate, and g = clip((Q - a) / (b - a), 0, 1) rewards short
times: Q is success weighted by completion time (SCT), and a and b are fixed by the board. Half a point of success
outweighs any difference in time.

An entry beats one of lower score if the difference of their scores, paired by case, is above 0 with a confidence of
97.5 %. Entries are processed from the highest score down. An entry starts a new tier if a member of the present tier
beats it. Its rank is 1 plus the number of entries in higher tiers. The interval of a rank has a confidence of 95 % for
all entries of the board together (Mogstad, Romano, Shaikh and Wilhelm 2024).
"""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from paired_bootstrap import Differences, studentise

from crowdbench.metrics.summary import Scale
from crowdbench.utils.errors import InputError

SUCCESS, SCT = "success_rate", "sct"
"""The metrics that rank."""

CONFIDENCE = 0.95
"""Of the intervals of all ranks of a board together. Pairwise comparisons use a one-sided 97.5 % bound."""

NORMAL = 1.96
"""The least number of standard errors of a significant difference. Where few cases differ, that of a bootstrap is
smaller, because it draws from no other cases."""

Columns = Mapping[str, Float[np.ndarray, "scenario case"]]
"""The metrics that rank in each case."""

Weights = Float[np.ndarray, "scenario"]


@dataclass(frozen=True)
class Pair:
    """Two entries, compared case by case.

    Attributes:
        higher: The name of the entry of higher score.
        lower: The name of the other entry.
        difference: The difference of the scores.
        bound: The lower 97.5 % bound of the difference.
        is_sure: Whether the simultaneous bound for all pairs of the board is above 0 too.
    """

    higher: str
    lower: str
    difference: float
    bound: float
    is_sure: bool

    @property
    def is_decided(self) -> bool:
        """Check if the higher entry beats the lower one."""
        return self.bound > 0.0


@dataclass(frozen=True)
class Rank:
    """The rank of an entry.

    Attributes:
        rank: 1 plus the number of entries in higher tiers.
        first: 1 plus the number of entries that are surely better.
        last: The number of entries minus those that are surely worse.
    """

    rank: int
    first: int
    last: int


def scores(columns: Mapping[str, Columns], weights: Weights, scale: Scale) -> dict[str, float]:
    """Return the scores of entries by name, the highest first.

    Args:
        columns: The metrics of each entry by its name.
        weights: The weight of each scenario; the sum is 1.
        scale: The scale of the board.

    Raises:
        InputError: An entry has no value of a metric in some case.
    """
    for values in columns.values():
        if missing := [metric for metric in (SUCCESS, SCT) if np.isnan(values[metric]).any()]:
            raise InputError(f"entries cannot be compared: {missing[0]} has no value in some case")
    unsorted = {
        name: scale.score(*(float(weights @ values[metric].mean(axis=1)) for metric in (SUCCESS, SCT)))
        for name, values in columns.items()
    }
    return dict(sorted(unsorted.items(), key=lambda item: (-item[1], item[0])))


def compare_all(
    columns: Mapping[str, Columns],
    weights: Weights,
    scale: Scale,
    blocks: Sequence[Int[np.ndarray, "case"]] | None = None,
) -> list[Pair]:
    """Compare each entry with all entries of lower score.

    Args:
        columns: The metrics of each entry by its name, in the same cases.
        weights: The weight of each scenario; the sum is 1.
        scale: The scale of the board.
        blocks: The block of each case of each scenario, where those of the same block are not independent: then the
            bootstrap resamples blocks.

    Raises:
        InputError: An entry has no value of a metric in some case.
    """
    score = scores(columns, weights, scale)
    pairs = list(itertools.combinations(score, 2))
    if not pairs:
        return []
    difference = np.array([score[a] - score[b] for a, b in pairs])
    success, sct = (np.array([columns[a][name] - columns[b][name] for a, b in pairs]) for name in (SUCCESS, SCT))
    value = success + scale.slope * sct  # rather too much where g is cut off at 0 or 1
    scenarios = [Differences(value[:, i], success[:, i] != 0.0) for i in range(len(weights))]
    error, deviations = studentise(scenarios, weights, blocks)
    single = np.maximum(np.quantile(deviations, (1.0 + CONFIDENCE) / 2.0, axis=0), NORMAL)
    # The largest studentised deviation of all pairs, of either sign; it is no smaller than that of the pair alone.
    joint = np.maximum(np.quantile(np.abs(deviations).max(axis=1), CONFIDENCE), single)
    figures = zip(difference.tolist(), (difference - single * error).tolist(), difference > joint * error, strict=True)
    return [Pair(*pair, gain, bound, bool(sure)) for pair, (gain, bound, sure) in zip(pairs, figures, strict=True)]


def ranks(score: Mapping[str, float], pairs: Sequence[Pair]) -> dict[str, Rank]:
    """Return the rank of each entry, by name.

    Args:
        score: The scores, the highest first.
        pairs: The result of `compare_all`.
    """
    beaten = {(pair.higher, pair.lower) for pair in pairs if pair.is_decided}
    better = Counter(pair.lower for pair in pairs if pair.is_sure)
    worse = Counter(pair.higher for pair in pairs if pair.is_sure)
    result: dict[str, Rank] = {}
    tier: list[str] = []
    for _, group in itertools.groupby(score, key=lambda name: score[name]):
        # Entries of the same score have the same rank.
        equal = list(group)
        if any((member, name) in beaten for member in tier for name in equal):
            tier = []
        tier += equal
        rank = 1 + len(result) - (len(tier) - len(equal))
        result |= {name: Rank(rank, 1 + better[name], len(score) - worse[name]) for name in equal}
    return result


def rank_by_bounds(score: Mapping[str, float], error: Mapping[str, float]) -> dict[str, int]:
    """Return the ranks of entries without their cases: tiers as in `ranks`, by differences that are not paired.

    Args:
        score: Their scores, by name.
        error: The half widths of the 95 % intervals of these.
    """
    order = dict(sorted(score.items(), key=lambda item: (-item[1], item[0])))
    pairs = [
        Pair(a, b, order[a] - order[b], order[a] - order[b] - float(np.hypot(error[a], error[b])), is_sure=False)
        for a, b in itertools.combinations(order, 2)
    ]
    return {name: rank.rank for name, rank in ranks(order, pairs).items()}


def pareto(costs: Float[np.ndarray, "entry cost"]) -> Bool[np.ndarray, "entry"]:
    """Return which entries are in the Pareto set: no other entry is better in a cost and worse in none.

    Args:
        costs: Quantities to minimise, such as failures and time.
    """
    not_worse = (costs[:, None] <= costs).all(axis=2)
    smaller = (costs[:, None] < costs).any(axis=2)
    return np.logical_not((not_worse & smaller).any(axis=0))
