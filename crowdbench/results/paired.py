"""A metric in two runs of the same cases, with tests that pair them by case."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from crowdbench.metrics.registry import info_of, is_rate
from crowdbench.metrics.summary import (
    CONFIDENCE,
    LEAST_CASES,
    RESAMPLES,
    UNDEFINED,
    Estimate,
    bootstrap_distribution,
    by_block,
    include_mean,
    interval,
    weigh,
    weighted_mean,
)
from crowdbench.results.episodes import Episodes

EXACT = 12
"""Largest number of blocks of cases for which the test of two rates enumerates all exchanges of the runs."""

LEAST_SHARED = LEAST_CASES
"""Smallest number of cases, solved by both planners, over which a difference has an interval and can be significant."""


@dataclass(frozen=True)
class MetricDifference:
    """One metric in two runs.

    Attributes:
        a: Its mean in run A.
        b: Its mean in run B.
        difference: B - A, paired by case. The interval of a rate contains 0 if its test is not significant. The bounds
            are NaN if a scenario has fewer than `LEAST_SHARED` such cases, or such blocks of recorded time.
        p: For rates, the p-value of McNemar's test, or of `sign_test` if cases come in blocks; None for other metrics.
        corrected: The p-value corrected for multiple testing (`holm`).
    """

    a: float
    b: float
    difference: Estimate
    p: float | None
    corrected: float | None

    @property
    def is_significant(self) -> bool:
        """True if the test, corrected if there are several, or else the 95 % interval shows a difference."""
        if self.p is not None:
            return (self.p if self.corrected is None else self.corrected) < 1.0 - CONFIDENCE
        difference = self.difference
        return difference.n >= LEAST_SHARED and (difference.low > 0.0 or difference.high < 0.0)


@dataclass(frozen=True)
class Paired:
    """The episodes of the runs A and B in their shared cases, such as `test:0:500`."""

    a: Episodes
    b: Episodes
    cases: str = ""

    @property
    def solved(self) -> Bool[np.ndarray, "case"]:
        """True for each case that both planners solved."""
        return np.asarray(self.a.columns["success_rate"] & self.b.columns["success_rate"])


def compare_metric(name: str, strata: Sequence[Paired]) -> MetricDifference:
    """Compare a metric over all cases if it is a rate or counts failures, otherwise over the cases that both solve.

    Before the interval of a rate is computed, one case per run is added in which the event occurs in this run only
    (Bonett and Price 2012, doi:10.3102/1076998611411915). Otherwise it is too narrow if few cases differ.

    Args:
        name: The name of the metric.
        strata: The episodes of both runs, in each scenario. Scenarios have equal weights.
    """
    columns = [(pair.a.columns[name], pair.b.columns[name]) for pair in strata]
    is_share = all(is_rate(column) for pair in columns for column in pair)
    p = _test(strata, columns) if is_share else None
    parts, least = [], LEAST_SHARED
    for pair, (x, y) in zip(strata, columns, strict=True):
        chosen = ~np.isnan(x.astype(float) + y) & (pair.solved | is_share | info_of(name).over_all)
        if chosen.any():
            parts.append(_compare_part(name, pair, chosen))
            least = min(least, int(chosen.sum()) if pair.a.block is None else len(np.unique(pair.a.block[chosen])))
    if not parts:
        return MetricDifference(math.nan, math.nan, UNDEFINED, p, None)
    a, b = (float(np.mean(means)) for means in zip(*(means for means, _, _ in parts), strict=True))
    low, high = include_mean(b - a, *interval(_mean_of([resampled for _, resampled, _ in parts])))
    if p is not None and p >= 1.0 - CONFIDENCE:
        low, high = min(low, 0.0), max(high, 0.0)
    differences = np.concatenate([difference for _, _, difference in parts])
    estimate = Estimate(b - a, low, high, len(differences), float(differences.max()))
    return MetricDifference(a, b, estimate.for_display(least), p, None)


def _test(
    strata: Sequence[Paired], columns: Sequence[tuple[Bool[np.ndarray, "case"], Bool[np.ndarray, "case"]]]
) -> float:
    """Return the p-value of a rate: runs are exchanged case by case, or block by block."""
    x, y = map(np.concatenate, zip(*columns, strict=True))
    if all(pair.a.block is None for pair in strata):
        return mcnemar(x, y)
    blocks = [np.arange(len(pair.a)) if pair.a.block is None else pair.a.block for pair in strata]
    scenario = np.repeat(np.arange(len(blocks)), list(map(len, blocks)))
    _, number = np.unique([scenario, np.concatenate(blocks)], axis=1, return_inverse=True)
    return sign_test(x, y, number.ravel())


def _compare_part(
    name: str, pair: Paired, chosen: Bool[np.ndarray, "case"]
) -> tuple[tuple[float, float], Float[np.ndarray, "resample"], Float[np.ndarray, "chosen"]]:
    """Compare a metric in the chosen cases of a scenario: means, resampled differences, and differences by case."""
    values = [table.columns[name][chosen].astype(float) for table in (pair.a, pair.b)]
    weights = [weigh(name, table.steps[chosen]) for table in (pair.a, pair.b)]
    a, b = (float(weighted_mean(x, w)) for x, w in zip(values, weights, strict=True))
    difference = values[1] - values[0]
    block = np.arange(len(difference)) if pair.a.block is None else pair.a.block[chosen]
    if all(is_rate(table.columns[name]) for table in (pair.a, pair.b)):
        values = [np.append(x, more) for x, more in zip(values, ((1.0, 0.0), (0.0, 1.0)), strict=True)]
        weights, block = [np.append(w, (1.0, 1.0)) for w in weights], np.append(block, block.max() + np.arange(1, 3))
    columns = [column for x, w in zip(values, weights, strict=True) for column in by_block(x, w, block)]
    return (a, b), bootstrap_distribution(_mean_difference, *columns), difference


def _mean_of(resampled: Sequence[Float[np.ndarray, "resample"]]) -> Float[np.ndarray, "resample"]:
    """Return the distribution of the mean over scenarios, whose cases are independent."""
    random = np.random.default_rng(0)
    first, *others = resampled  # equal numbers of cases get equal resamples, hence the permutation
    return np.asarray(np.mean([first, *map(random.permutation, others)], axis=0))


def _mean_difference(*columns: Float[np.ndarray, "*resample case"], axis: int = -1) -> Float[np.ndarray, "*resample"]:
    """Return the weighted mean of run B minus that of run A; the columns are values and weights of A, then of B."""
    x, x_weights, y, y_weights = columns
    return np.asarray(weighted_mean(y, y_weights, axis) - weighted_mean(x, x_weights, axis))


def mcnemar(a: Bool[np.ndarray, "case"], b: Bool[np.ndarray, "case"]) -> float:
    """Return the exact two-sided p-value of the test of McNemar (1947); 1 if no case differs.

    Args:
        a: True for each case that was solved in run A.
        b: The same in run B.
    """
    from scipy.stats import binomtest

    only_a, only_b = int((a & ~b).sum()), int((b & ~a).sum())
    return float(binomtest(only_a, only_a + only_b).pvalue) if only_a + only_b else 1.0


def holm(p: Float[np.ndarray, "test"]) -> Float[np.ndarray, "test"]:
    """Return the p-values corrected by Holm (1979) for the number of tests.

    Values below 0.05 are significant: the probability of one or more false positives among them is at most 0.05.
    """
    order = np.argsort(p, kind="stable")
    factors = len(p) - np.arange(len(p))
    corrected = np.empty_like(p)
    corrected[order] = np.minimum(np.maximum.accumulate(p[order] * factors), 1.0)
    return corrected


def sign_test(a: Bool[np.ndarray, "case"], b: Bool[np.ndarray, "case"], block: Int[np.ndarray, "case"]) -> float:
    """Return the two-sided p-value of a permutation test (Fisher 1935) that exchanges the runs block by block.

    It is exact for up to `EXACT` blocks, and from `RESAMPLES` random exchanges for more.

    Args:
        a: True for each case that was solved in run A.
        b: The same in run B.
        block: The block of each case; cases of the same block are not independent.
    """
    _, number = np.unique(block, return_inverse=True)
    sums = np.bincount(number, b.astype(float) - a)
    sums = sums[sums != 0.0]
    if len(sums) <= EXACT:
        signs = np.array(list(itertools.product((-1.0, 1.0), repeat=len(sums))))
    else:
        signs = np.random.default_rng(0).choice((-1.0, 1.0), (RESAMPLES, len(sums)))
    return float((np.abs(signs @ sums) >= abs(sums.sum()) - 1e-9).mean())
