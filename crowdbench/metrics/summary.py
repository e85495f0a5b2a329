"""Means of one value per episode, with 95 % intervals."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from crowdbench.metrics.registry import info_of, is_rate

Column = Shaped[np.ndarray, "case"]
Values = Float[np.ndarray, "case"]
BlockValues = Float[np.ndarray, "block"]
Resampled = Float[np.ndarray, "*resample case"]

CONFIDENCE = 0.95
RESAMPLES = 2000

_SEED = 0
"""Of the bootstrap: fixed, so that the same episodes have the same interval."""

_MOST_DRAWN = 2_000_000
"""Rows drawn at once: all resamples of many episodes together would take gigabytes."""


LEAST_CASES = 6
"""Smallest number of independent cases for which tables and figures show an interval.

With fewer cases, even a difference of the same sign in every case is likely by chance (2 * 0.5**5 > 0.05), and a
bootstrap, which resamples only these cases, is far too narrow. Cases of one block of recorded time are not independent.
"""


@dataclass(frozen=True)
class Estimate:
    """A mean over episodes, its 95 % interval, how many episodes have a value, and the largest value.

    If no episode has a value, `n` is 0 and all other fields are NaN.
    """

    mean: float
    low: float
    high: float
    n: int
    max: float

    def for_display(self, blocks: int | None = None) -> Estimate:
        """Return the estimate without its interval if that is over fewer than `LEAST_CASES` cases or blocks.

        Args:
            blocks: The number of blocks of recorded time; None if no pedestrians are recorded.
        """
        if (self.n if blocks is None else min(self.n, blocks)) >= LEAST_CASES:
            return self
        return dataclasses.replace(self, low=math.nan, high=math.nan)


UNDEFINED = Estimate(np.nan, np.nan, np.nan, 0, np.nan)
"""The estimate if no episode has a value."""


def summarize(columns: Mapping[str, Column], steps: Column, block: Column | None = None) -> dict[str, Estimate]:
    """Return an estimate for each metric: Wilson's interval for rates, a bootstrap's for means.

    Args:
        columns: The values of each metric, by its name; booleans are rates.
        steps: The number of steps of each episode, the weight of pooled metrics.
        block: The block of each episode, if episodes of the same block are not independent.
    """
    estimates = {}
    for name, values in columns.items():
        if is_rate(values):
            estimates[name] = rate(values, block)
        else:
            estimates[name] = bootstrap(values.astype(float), weigh(name, steps), block)
    return estimates


def weigh(metric: str, steps: Column) -> Values:
    """Return the weight of each episode in the mean of a metric, from the number of steps of each."""
    return steps.astype(float) if info_of(metric).pooled else np.ones(len(steps))


def rate(values: Bool[np.ndarray, "case"], block: Column | None) -> Estimate:
    """Return a rate with its interval.

    Args:
        values: One per episode.
        block: The block of each episode, if episodes of the same block are not independent: then the interval is that
            of a bootstrap over blocks. If all values are the same, it would have no width; then the interval is
            Wilson's, with the number of blocks as number of episodes.
    """
    if block is None:
        return wilson(values)
    if values.any() and not values.all():
        return bootstrap(values.astype(float), np.ones(len(values)), block)
    return dataclasses.replace(wilson(values[: len(np.unique(block))]), n=len(values))


def wilson(values: Bool[np.ndarray, "case"]) -> Estimate:
    """Return a rate with the score interval of Wilson (1927)."""
    from scipy.special import ndtri  # scipy.stats takes half a second to import

    n, mean, z = len(values), float(values.mean()), float(ndtri(0.5 + CONFIDENCE / 2))
    scale = 2.0 * (n + z**2)
    middle = (2.0 * n * mean + z**2) / scale
    half = z / scale * math.sqrt(4.0 * n * mean * (1.0 - mean) + z**2)
    low = middle - half if values.any() else 0.0
    high = 1.0 if values.all() else middle + half
    return Estimate(mean, *include_mean(mean, low, high), n, float(values.max()))


def bootstrap(values: Values, weights: Values, block: Column | None = None) -> Estimate:
    """Return a weighted mean with its percentile interval over resampled episodes (Efron 1979), or resampled blocks of
    them.

    Args:
        values: One per episode; those that are NaN are left out.
        weights: How much each episode counts.
        block: The block of each episode, if episodes of the same block are not independent.
    """
    defined = ~np.isnan(values)
    values, weights = values[defined], weights[defined]
    if len(values) == 0:
        return UNDEFINED
    mean = float(weighted_mean(values, weights))
    if block is not None:
        block = block[defined]
    means, counts = by_block(values, weights, block)
    if (counts == 1.0).all():  # `np.mean` returns the same bits in a fifth of the time
        resampled = bootstrap_distribution(np.mean, means)
    else:
        resampled = bootstrap_distribution(weighted_mean, means, counts)
    low, high = include_mean(mean, *interval(resampled))
    return Estimate(mean, low, high, len(values), float(values.max()))


def by_block(values: Values, weights: Values, block: Column | None) -> tuple[BlockValues, BlockValues]:
    """Return the weighted mean of each block, and its weight: their weighted mean is that of the cases.

    Args:
        values: One per case.
        weights: How much each case counts.
        block: The block of each case; None if each case is a separate block.
    """
    if block is None:
        return values, weights
    _, number = np.unique(block, return_inverse=True)
    weight = np.bincount(number, weights)
    return np.bincount(number, values * weights) / weight, weight


def weighted_mean(values: Resampled, weights: Resampled, axis: int = -1) -> Float[np.ndarray, "*resample"]:
    """Return the weighted mean over cases.

    Args:
        weights: How much each value counts.
        axis: The axis of the cases.
    """
    return np.asarray((values * weights).sum(axis=axis) / weights.sum(axis=axis))


def bootstrap_distribution(
    statistic: Callable[..., Float[np.ndarray, "*resample"]], *columns: Values
) -> Float[np.ndarray, "resample"]:
    """Return a statistic of `RESAMPLES` samples of the episodes, drawn with replacement.

    The resamples depend only on the number of episodes.

    Args:
        statistic: A function of the columns `[resample, case]` and `axis`, over which it is taken.
        columns: Arguments of the statistic, one value per episode in each; they are resampled together.
    """
    n = len(columns[0])
    batches = [_draw(n)] if n * RESAMPLES <= _MOST_DRAWN else _draw_in_batches(n)
    values = []
    for rows in batches:
        resampled = [column.take(rows) for column in columns]
        values.append(statistic(*resampled, axis=-1))
    return np.concatenate(values)


@functools.lru_cache(maxsize=4)  # metrics of the same episodes are resampled alike
def _draw(n: int) -> Int[np.ndarray, "resample case"]:
    """Return the rows of all resamples of `n` episodes."""
    return np.concatenate(list(_draw_in_batches(n)))


def _draw_in_batches(n: int) -> Iterator[Int[np.ndarray, "resample case"]]:
    random = np.random.default_rng(_SEED)
    batch = max(1, _MOST_DRAWN // n)
    for start in range(0, RESAMPLES, batch):
        yield random.integers(0, n, (min(batch, RESAMPLES - start), n))


def include_mean(mean: float, low: float, high: float) -> tuple[float, float]:
    """Return bounds that contain the mean, which may be outside the interval because of rounding.

    Args:
        low: The lower bound.
        high: The upper bound.
    """
    return min(low, mean), max(high, mean)


def interval(values: Float[np.ndarray, "resample"]) -> tuple[float, float]:
    """Return the bounds between which 95 % of the resampled values lie."""
    low, high = np.quantile(values, [0.5 - CONFIDENCE / 2, 0.5 + CONFIDENCE / 2])
    return float(low), float(high)
