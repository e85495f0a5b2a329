"""What a rank means: entries stand in the order of their scores, and share a rank where chance may have ordered them.

The score of an entry is U = S + 0.005 g. S is its success rate, and g = clip((Q - a) / (b - a), 0, 1) says how quick it
is: Q is its success weighted by completion time (SCT), and a and b are the board's. So whoever succeeds more often by
more than half a point stands higher, however long it takes.

An entry beats one that stands lower if the difference of their scores, paired by case, is above 0 with a confidence of
97.5 %. From the top, an entry starts a new tier where some member of the present tier beats it. Its rank is 1 plus the
number of entries in higher tiers. The interval of a rank says which places the entry may have, with a confidence of
95 % for all entries of the board together (Mogstad, Romano, Shaikh and Wilhelm 2024).
"""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from paired_bootstrap import Differences, studentise

from crowdbench.metrics.score import Scale
from crowdbench.utils.errors import InputError

SUCCESS, SCT = "success_rate", "sct"
"""The metrics that rank."""

CONFIDENCE = 0.95
"""Of the intervals of all ranks of a board together; a single entry beats another one with half of the doubt."""

NORMAL = 1.96
"""The least number of standard errors that a difference has to have: where few cases differ, a bootstrap asks for less,
since it draws from no others."""

Columns = Mapping[str, Float[np.ndarray, "scenario case"]]
"""The metrics that rank in each case."""

Weights = Float[np.ndarray, "scenario"]


@dataclass(frozen=True)
class Pair:
    """Two entries, compared case by case.

    Attributes:
        higher: The name of the one that stands higher.
        lower: The name of the other one.
        difference: By how much its score is higher.
        bound: The lower 97.5 % bound of the difference.
        is_sure: Whether it is above 0 also with regard to all other pairs of the board.
    """

    higher: str
    lower: str
    difference: float
    bound: float
    is_sure: bool

    @property
    def is_decided(self) -> bool:
        """Whether the higher one beats the lower one."""
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
    """The scores of entries by their names, the highest first.

    Args:
        columns: The metrics of each entry by its name.
        weights: How much each scenario counts; the sum is 1.
        scale: What the board fixes.

    Raises:
        InputError: An entry has no value of a metric in some case.
    """
    found = {name: _score(own, weights, scale) for name, own in columns.items()}
    return dict(sorted(found.items(), key=lambda each: (-each[1], each[0])))


def _score(own: Columns, weights: Weights, scale: Scale) -> float:
    for metric in (SUCCESS, SCT):
        if np.isnan(own[metric]).any():
            raise InputError(f"entries cannot be compared: {metric} has no value in some case")
    return scale.score(*(float(weights @ own[metric].mean(axis=1)) for metric in (SUCCESS, SCT)))


def compare_all(
    columns: Mapping[str, Columns],
    weights: Weights,
    scale: Scale,
    blocks: Sequence[Int[np.ndarray, "case"]] | None = None,
) -> list[Pair]:
    """Compare each entry with each one that stands lower.

    Args:
        columns: The metrics of each entry by its name, in the same cases.
        weights: How much each scenario counts; the sum is 1.
        scale: What the board fixes.
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
    one = np.maximum(np.quantile(deviations, (1.0 + CONFIDENCE) / 2.0, axis=0), NORMAL)
    # Student's largest of all pairs, of either sign; no pair needs less for itself.
    every = np.maximum(np.quantile(np.abs(deviations).max(axis=1), CONFIDENCE), one)
    figures = zip(difference.tolist(), (difference - one * error).tolist(), difference > every * error, strict=True)
    return [Pair(*pair, gain, bound, bool(sure)) for pair, (gain, bound, sure) in zip(pairs, figures, strict=True)]


def ranks(score: Mapping[str, float], pairs: Sequence[Pair]) -> dict[str, Rank]:
    """The rank of each entry, by name.

    Args:
        score: The scores, the highest first.
        pairs: What `compare_all` gives.
    """
    beaten = {(pair.higher, pair.lower) for pair in pairs if pair.is_decided}
    better = Counter(pair.lower for pair in pairs if pair.is_sure)
    worse = Counter(pair.higher for pair in pairs if pair.is_sure)
    found: dict[str, Rank] = {}
    tier: list[str] = []
    for _, group in itertools.groupby(score, key=lambda name: score[name]):
        # Entries of the same score are never parted.
        equal = list(group)
        if any((member, name) in beaten for member in tier for name in equal):
            tier = []
        tier += equal
        rank = 1 + len(found) - (len(tier) - len(equal))
        found |= {name: Rank(rank, 1 + better[name], len(score) - worse[name]) for name in equal}
    return found


def rank_by_bounds(score: Mapping[str, float], error: Mapping[str, float]) -> dict[str, int]:
    """The ranks of entries of which no cases are at hand: tiers as in `ranks`, by differences that are not paired.

    Args:
        score: Their scores, by name.
        error: The half widths of the 95 % intervals of these.
    """
    order = dict(sorted(score.items(), key=lambda each: (-each[1], each[0])))
    pairs = [
        Pair(a, b, order[a] - order[b], order[a] - order[b] - float(np.hypot(error[a], error[b])), is_sure=False)
        for a, b in itertools.combinations(order, 2)
    ]
    return {name: rank.rank for name, rank in ranks(order, pairs).items()}


def pareto(costs: Float[np.ndarray, "entry cost"]) -> Bool[np.ndarray, "entry"]:
    """Which entries no other one beats in one cost without being worse in another.

    Args:
        costs: What is to be small, such as failures and time.
    """
    not_worse = (costs[:, None] <= costs).all(axis=2)
    smaller = (costs[:, None] < costs).any(axis=2)
    return np.logical_not((not_worse & smaller).any(axis=0))
