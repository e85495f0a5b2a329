"""The mean over networks that were trained alike, with an interval for other networks on other cases."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from crowdbench.summary import RESAMPLES, Estimate, interval

_STREAM = 0
"""Seed of the bootstrap: fixed, so that the same episodes have the same interval."""


def two_level(values: Float[np.ndarray, "seed case"]) -> Estimate:
    """The mean over seeds of each one's mean over its cases, NaN left out, and its percentile interval.

    Seeds are drawn with replacement, and cases with replacement, the same ones for all seeds: all have driven the
    same cases, so that a hard one is hard for all of them. `n` counts the values that are not NaN.
    """
    return _estimate(values, _mean_of_means, values)


def two_level_reduction(ours: Float[np.ndarray, "seed case"], theirs: Float[np.ndarray, "seed case"]) -> Estimate:
    """By which share the mean of `ours` is smaller than that of `theirs`, resampled together as `two_level` does.

    Only values that both have count, so that the two means are over the same cases. `max` is the largest reduction
    in any one of them.
    """
    undefined = np.isnan(ours + theirs)
    both = np.where(undefined, np.nan, np.stack([ours, theirs]))

    def reduction(pair: Float[np.ndarray, "2 seed case"]) -> float:
        mean = _mean_of_means(pair[1])
        return 1.0 - _mean_of_means(pair[0]) / mean if mean else math.nan

    each = 1.0 - np.divide(both[0], both[1], where=both[1] != 0.0, out=np.full_like(ours, np.nan))
    return _estimate(both, reduction, each)


def _estimate(
    values: Float[np.ndarray, "*planner seed case"],
    statistic: Callable[[Float[np.ndarray, "*planner seed case"]], float],
    each: Float[np.ndarray, "seed case"],
) -> Estimate:
    """A statistic of the values, its interval over resampled seeds and cases; `each` is what it is in one case."""
    defined = each[~np.isnan(each)]
    if len(defined) == 0:
        return Estimate(math.nan, math.nan, math.nan, 0, math.nan)
    rng = np.random.default_rng(_STREAM)
    *_, seeds, cases = values.shape
    resampled = np.empty(RESAMPLES)
    for i in range(RESAMPLES):
        drawn = values[..., rng.integers(seeds, size=seeds), :]
        resampled[i] = statistic(drawn[..., rng.integers(cases, size=cases)])
    low, high = interval(resampled[~np.isnan(resampled)])
    return Estimate(statistic(values), low, high, len(defined), float(defined.max()))


def _mean_of_means(values: Float[np.ndarray, "seed case"]) -> float:
    """NaN where no seed has a value; seeds without one do not count."""
    defined = ~np.isnan(values)
    n = defined.sum(axis=1)
    sums = np.where(defined, values, 0.0).sum(axis=1)
    return float((sums[n > 0] / n[n > 0]).mean()) if n.any() else math.nan
