"""The mean over networks that were trained alike, with an interval for other networks on other cases."""

from __future__ import annotations

import functools
import math

import numpy as np
from jaxtyping import Float

from crowdbench.evaluate.summary import RESAMPLES, Estimate, interval

_STREAM = 0
"""Seed of the bootstrap: fixed, so that the same episodes have the same interval."""


def two_level(values: Float[np.ndarray, "seed case"]) -> Estimate:
    """The mean over seeds of each one's mean over its cases, NaN left out, and its percentile interval.

    Seeds are drawn with replacement, and cases with replacement, the same ones for all seeds: all have driven the
    same cases, so that a hard one is hard for all of them. `n` counts the values that are not NaN.
    """
    return _estimate(values, _means(values, _once(values)), _means(values, _draws(*values.shape)))


def two_level_reduction(ours: Float[np.ndarray, "seed case"], theirs: Float[np.ndarray, "seed case"]) -> Estimate:
    """By which share the mean of `ours` is smaller than that of `theirs`, resampled together as `two_level` does.

    Only values that both have count, so that the two means are over the same cases; no share is defined of a mean
    of 0. `max` is the largest reduction in any one case.
    """
    both = np.where(np.isnan(ours + theirs), np.nan, np.stack([ours, theirs]))

    def reductions(draws: Draws) -> Float[np.ndarray, "draw"]:
        return _reduction(_means(both[0], draws), _means(both[1], draws))

    return _estimate(_reduction(*both), reductions(_once(ours)), reductions(_draws(*ours.shape)))


Draws = tuple[Float[np.ndarray, "draw seed"], Float[np.ndarray, "draw case"]]
"""How often each seed, and each case, is in each resample."""


@functools.cache
def _draws(seeds: int, cases: int) -> Draws:
    rng = np.random.default_rng(_STREAM)
    drawn = np.empty((RESAMPLES, seeds)), np.empty((RESAMPLES, cases))
    for i in range(RESAMPLES):
        for counts, size in zip(drawn, (seeds, cases), strict=True):
            counts[i] = np.bincount(rng.integers(size, size=size), minlength=size)
    return drawn


def _once(values: Float[np.ndarray, "seed case"]) -> Draws:
    """Each seed and case once: no resample."""
    seeds, cases = values.shape
    return np.ones((1, seeds)), np.ones((1, cases))


def _means(values: Float[np.ndarray, "seed case"], draws: Draws) -> Float[np.ndarray, "draw"]:
    """The mean over seeds of their means: seeds without a value do not count, and NaN is where no seed has one."""
    seeds, cases = draws
    defined = ~np.isnan(values)
    n = cases @ defined.T
    means = _ratio(cases @ np.where(defined, values, 0.0).T, n)
    counts = seeds * (n > 0)
    return _ratio((counts * np.where(n > 0, means, 0.0)).sum(axis=1), counts.sum(axis=1))


def _reduction(ours: Float[np.ndarray, "*of"], theirs: Float[np.ndarray, "*of"]) -> Float[np.ndarray, "*of"]:
    return 1.0 - _ratio(ours, theirs)


def _ratio(over: Float[np.ndarray, "*of"], under: Float[np.ndarray, "*of"]) -> Float[np.ndarray, "*of"]:
    return np.divide(over, under, where=under != 0.0, out=np.full_like(over, np.nan))


def _estimate(
    each: Float[np.ndarray, "seed case"], found: Float[np.ndarray, "1"], resampled: Float[np.ndarray, "draw"]
) -> Estimate:
    """A figure with the interval of what it is in each resample; `each` is what it is in each case."""
    defined = each[~np.isnan(each)]
    if len(defined) == 0:
        return Estimate(math.nan, math.nan, math.nan, 0, math.nan)
    low, high = interval(resampled[~np.isnan(resampled)])
    return Estimate(float(found[0]), low, high, len(defined), float(defined.max()))
