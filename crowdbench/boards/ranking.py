"""What a rank means: which entries of a board are better than which, beyond what chance explains.

Two entries are compared on the cases that both drove, the first ones of each scenario: by success first, then by
collisions, then by success weighted by completion time. All comparisons of a board are tested together, so that with
probability 0.95 or more none of them finds a difference where there is none (Holm 1979). An entry's rank is 1 plus the
number of entries that are better.
"""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from crowdbench.runs.compare import holm, mcnemar
from crowdbench.utils.errors import InputError

ALPHA = 0.05
"""The probability, over all comparisons of a board, with which any of them finds a difference that is none."""

CRITERIA: Mapping[str, int] = {"success_rate": 1, "collision_rate": -1, "sct": 1}
"""The metrics that rank, in this order, and whether more of each is better (1) or worse (-1)."""


@dataclass(frozen=True)
class Comparison:
    """Two entries, compared.

    Attributes:
        entries: The names of both.
        differences: By metric, the mean of the first entry minus that of the second.
        p: By metric, the two-sided p-value, corrected for all comparisons of the board.
    """

    entries: tuple[str, str]
    differences: Mapping[str, float]
    p: Mapping[str, float]

    @property
    def criterion(self) -> str:
        """The first metric in which they differ significantly; empty where there is none."""
        return next((metric for metric in CRITERIA if self.p[metric] < ALPHA), "")

    @property
    def better(self) -> str | None:
        """The entry that is better; None where no difference is significant."""
        if not (criterion := self.criterion):
            return None
        return self.entries[0 if self.differences[criterion] * CRITERIA[criterion] > 0.0 else 1]

    @property
    def worse(self) -> str | None:
        """The other one; None likewise."""
        first, second = self.entries
        return None if self.better is None else second if self.better == first else first


@dataclass(frozen=True)
class Rank:
    """The rank of an entry.

    Attributes:
        rank: 1 plus the number of entries that are better.
        last: The number of entries minus those that are worse: with more cases the rank could be any from `rank` on to
            this one.
    """

    rank: int
    last: int


def compare_all(
    columns: Mapping[str, Mapping[str, Float[np.ndarray, "scenario _"]]],
    weights: Float[np.ndarray, "scenario"],
    blocks: Int[np.ndarray, "scenario _"] | None = None,
) -> list[Comparison]:
    """Compare each entry with each other one.

    Args:
        columns: By the name of each entry, the metrics of `CRITERIA` in the first cases of each scenario, as many as
            it drove.
        weights: How much each scenario counts, which is the same for all entries.
        blocks: The block of each case, where those of the same block are not independent.

    Returns:
        A comparison for each pair of entries.

    Raises:
        InputError: An entry has no value of a metric in a case.
    """
    for metric in CRITERIA:
        if any(np.isnan(entry[metric]).any() for entry in columns.values()):
            raise InputError(f"entries cannot be compared: {metric} has no value in some case")
    pairs = list(itertools.combinations(columns, 2))
    differences, raw = [], []
    for a, b in pairs:
        cases = min(columns[a]["sct"].shape[1], columns[b]["sct"].shape[1])
        weight, block = np.repeat(weights, cases), None if blocks is None else blocks[:, :cases].ravel()
        both = {metric: (columns[a][metric][:, :cases], columns[b][metric][:, :cases]) for metric in CRITERIA}
        differences.append({metric: float(weights @ (x - y).mean(axis=1)) for metric, (x, y) in both.items()})
        raw += [p_value(x.ravel(), y.ravel(), weight, block) for x, y in both.values()]
    corrected = holm(np.array(raw)).reshape(len(pairs), len(CRITERIA)).tolist()
    return [
        Comparison(pair, difference, dict(zip(CRITERIA, p, strict=True)))
        for pair, difference, p in zip(pairs, differences, corrected, strict=True)
    ]


def p_value(
    a: Float[np.ndarray, "case"],
    b: Float[np.ndarray, "case"],
    weights: Float[np.ndarray, "case"],
    block: Int[np.ndarray, "case"] | None = None,
) -> float:
    """The two-sided p-value of the hypothesis that two entries have the same mean, paired by case.

    McNemar's exact test (1947) where the values are 0 or 1, all cases count alike and are independent; otherwise
    Student's t test on the weighted differences, summed over each block (Liang and Zeger 1986).

    Args:
        a: A metric of one entry.
        b: The same of the other one.
        weights: How much each case counts.
        block: The block of each case, where those of the same block are not independent.

    Returns:
        The p-value; 1 where no case differs.
    """
    from scipy.stats import t as student

    differences = a - b
    if not differences.any():
        return 1.0
    if block is None and np.isin((a, b), (0.0, 1.0)).all() and (weights == weights[0]).all():
        return mcnemar(a.astype(bool), b.astype(bool))
    weighted = weights * differences / weights.sum()
    mean = weighted.sum()
    # The variance of a weighted mean of independent cases, with the correction of the sample variance.
    rest = weights * (differences - mean) / weights.sum()
    if block is not None:
        rest = np.bincount(np.unique(block, return_inverse=True)[1], rest)
    n = len(rest)
    error = np.sqrt((rest**2).sum() * n / (n - 1)) if n > 1 else np.inf
    if error == 0.0:
        return 0.0
    return float(2.0 * student.sf(abs(mean) / error, n - 1))


def ranks(entries: Collection[str], comparisons: Sequence[Comparison]) -> dict[str, Rank]:
    """The rank of each entry, by name.

    Args:
        entries: The names of the entries.
        comparisons: Those of all pairs.
    """
    better, worse = Counter(one.worse for one in comparisons), Counter(one.better for one in comparisons)
    return {entry: Rank(1 + better[entry], len(entries) - worse[entry]) for entry in entries}


def smallest_difference(cases: int, entries: int) -> float:
    """The smallest difference in success that a board can tell apart, as a share of its cases.

    It is that of two entries of which only one fails in these cases, and is found where no other comparison of the
    board is significant. Where both fail in cases of their own, the difference must be larger.

    Args:
        cases: The number of cases, which all count alike.
        entries: The number of entries that are ranked.

    Returns:
        The share; above 1 where nothing can be told apart.
    """
    tests = len(CRITERIA) * entries * (entries - 1) / 2
    # Of d cases that all speak for one of two equal entries, the exact test says p = 2 / 2^d.
    return float(np.floor(1.0 + np.log2(max(tests, 1.0) / ALPHA)) + 1.0) / cases


def pareto(costs: Float[np.ndarray, "entry cost"]) -> Bool[np.ndarray, "entry"]:
    """Which entries no other one beats in one cost without being worse in another.

    Args:
        costs: What is to be small, such as failures and time.
    """
    not_worse = (costs[:, None] <= costs).all(axis=2)
    smaller = (costs[:, None] < costs).any(axis=2)
    return np.logical_not((not_worse & smaller).any(axis=0))
