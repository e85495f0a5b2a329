"""The mean over networks that were trained alike, with an interval for other networks on other cases.

Networks and cases are both drawn with replacement, the cases for all networks alike, as all networks drive the same
cases: the pigeonhole bootstrap of Owen, "The pigeonhole bootstrap", The Annals of Applied Statistics 1(2) (2007),
386-411, doi:10.1214/07-AOAS122. With few networks its intervals are too narrow. Where all values are the same,
an interval has no width.
"""

from __future__ import annotations

import functools

import numpy as np
from jaxtyping import Float

from crowdbench.evaluate.summary import NOTHING, RESAMPLES, Estimate, interval

_SEED = 0
"""Of the bootstrap: fixed, so that the same episodes have the same interval."""


def two_level(values: Float[np.ndarray, "network case"]) -> Estimate:
    """The mean over networks of each network's mean over its cases.

    Args:
        values: A metric of each network in each case; NaN where it is not defined, which is left out.

    Returns:
        The mean with its percentile interval; `n` counts the values that are not NaN.
    """
    return _estimate(values, _means(values, _once(values)), _means(values, _draws(*values.shape)))


def two_level_reduction(ours: Float[np.ndarray, "network case"], theirs: Float[np.ndarray, "network case"]) -> Estimate:
    """By which share one mean is smaller than another, as `two_level` takes them; both are resampled together.

    Args:
        ours: A metric of each network in each case.
        theirs: The same metric of the same networks under another planner. Only values that both have count, so that
            the two means are over the same cases.

    Returns:
        The share with its percentile interval, NaN where the mean of `theirs` is 0; `max` is the largest in any case.
    """
    both = np.where(np.isnan(ours + theirs), np.nan, np.stack([ours, theirs]))

    def reductions(draws: Draws) -> Float[np.ndarray, "draw"]:
        return _reduction(_means(both[0], draws), _means(both[1], draws))

    return _estimate(_reduction(*both), reductions(_once(ours)), reductions(_draws(*ours.shape)))


Draws = tuple[Float[np.ndarray, "draw network"], Float[np.ndarray, "draw case"]]
"""How often each network, and each case, is in each resample."""


@functools.cache
def _draws(networks: int, cases: int) -> Draws:
    rng = np.random.default_rng(_SEED)
    drawn = np.empty((RESAMPLES, networks)), np.empty((RESAMPLES, cases))
    for i in range(RESAMPLES):
        for counts, size in zip(drawn, (networks, cases), strict=True):
            counts[i] = np.bincount(rng.integers(size, size=size), minlength=size)
    return drawn


def _once(values: Float[np.ndarray, "network case"]) -> Draws:
    """Each network and case once: no resample."""
    networks, cases = values.shape
    return np.ones((1, networks)), np.ones((1, cases))


def _means(values: Float[np.ndarray, "network case"], draws: Draws) -> Float[np.ndarray, "draw"]:
    """The mean over networks of their means: networks without a value do not count; NaN where no network has one."""
    networks, cases = draws
    defined = ~np.isnan(values)
    n = cases @ defined.T
    means = _ratio(cases @ np.where(defined, values, 0.0).T, n)
    counts = networks * (n > 0)
    return _ratio((counts * np.where(n > 0, means, 0.0)).sum(axis=1), counts.sum(axis=1))


def _reduction(ours: Float[np.ndarray, "*of"], theirs: Float[np.ndarray, "*of"]) -> Float[np.ndarray, "*of"]:
    return 1.0 - _ratio(ours, theirs)


def _ratio(over: Float[np.ndarray, "*of"], under: Float[np.ndarray, "*of"]) -> Float[np.ndarray, "*of"]:
    return np.divide(over, under, where=under != 0.0, out=np.full_like(over, np.nan))


def _estimate(
    each: Float[np.ndarray, "network case"], found: Float[np.ndarray, "1"], resampled: Float[np.ndarray, "draw"]
) -> Estimate:
    """A figure with the interval of what it is in each resample; `each` is what it is in each case."""
    defined = each[~np.isnan(each)]
    if len(defined) == 0:
        return NOTHING
    low, high = interval(resampled[~np.isnan(resampled)])
    return Estimate(float(found[0]), low, high, len(defined), float(defined.max()))
