"""The mean over networks that were trained alike, with an interval for other networks on other cases."""

from __future__ import annotations

import math

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
    defined = values[~np.isnan(values)]
    if len(defined) == 0:
        return Estimate(math.nan, math.nan, math.nan, 0, math.nan)
    rng = np.random.default_rng(_STREAM)
    seeds, cases = values.shape
    resampled = np.empty(RESAMPLES)
    for i in range(RESAMPLES):
        drawn = values[rng.integers(seeds, size=seeds)]
        resampled[i] = _mean_of_means(drawn[:, rng.integers(cases, size=cases)])
    low, high = interval(resampled[~np.isnan(resampled)])
    return Estimate(_mean_of_means(values), low, high, len(defined), float(defined.max()))


def _mean_of_means(values: Float[np.ndarray, "seed case"]) -> float:
    """NaN where no seed has a value; seeds without one do not count."""
    defined = ~np.isnan(values)
    n = defined.sum(axis=1)
    sums = np.where(defined, values, 0.0).sum(axis=1)
    return float((sums[n > 0] / n[n > 0]).mean()) if n.any() else math.nan
