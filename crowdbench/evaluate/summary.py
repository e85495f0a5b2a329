"""From one value per episode to means with intervals."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
from jaxtyping import Bool, Float, Shaped

from crowdbench.evaluate.metrics import POOLED

CONFIDENCE = 0.95
RESAMPLES = 2000
_STREAM = 0
"""Seed of the bootstrap: fixed, so that the same episodes have the same interval."""


@dataclass(frozen=True)
class Estimate:
    """A mean over episodes, its 95 % interval, how many episodes have a value, and the largest value.

    NaN throughout where no episode has one.
    """

    mean: float
    low: float
    high: float
    n: int
    max: float


def summarize(
    columns: Mapping[str, Shaped[np.ndarray, "case"]], steps: Shaped[np.ndarray, "case"]
) -> dict[str, Estimate]:
    """An estimate for each metric: Wilson's interval for rates (booleans), a bootstrap's for means."""
    summary = {name: wilson(values) for name, values in columns.items() if values.dtype == bool}
    means = {name: values.astype(float) for name, values in columns.items() if values.dtype != bool}
    for name in means:
        weights = steps.astype(float) if name in POOLED else np.ones(len(steps))
        summary[name] = bootstrap(means[name], weights)
    return {name: summary[name] for name in columns}


def wilson(values: Bool[np.ndarray, "case"]) -> Estimate:
    """A rate with its score interval (Wilson 1927)."""
    n = len(values)
    rate = float(values.mean())
    z = NormalDist().inv_cdf(0.5 + CONFIDENCE / 2)
    centre = (rate + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * np.sqrt(rate * (1 - rate) / n + z * z / (4 * n * n))
    return Estimate(rate, max(0.0, float(centre - half)), min(1.0, float(centre + half)), n, float(values.max()))


def bootstrap(values: Float[np.ndarray, "case"], weights: Float[np.ndarray, "case"]) -> Estimate:
    """A weighted mean over the episodes that have a value, with its percentile interval over resampled episodes."""
    defined = ~np.isnan(values)
    values, weights = values[defined], weights[defined]
    n = len(values)
    if n == 0:
        return Estimate(np.nan, np.nan, np.nan, 0, np.nan)
    mean = float((values * weights).sum() / weights.sum())
    return Estimate(mean, *interval(resampled_means(values, weights)), n, float(values.max()))


def interval(resampled: Float[np.ndarray, "resample"]) -> tuple[float, float]:
    """The bounds between which 95 % of the resampled values lie."""
    low, high = np.quantile(resampled, [0.5 - CONFIDENCE / 2, 0.5 + CONFIDENCE / 2])
    return float(low), float(high)


def resampled_means(
    values: Float[np.ndarray, "case"], weights: Float[np.ndarray, "case"]
) -> Float[np.ndarray, "resample"]:
    """The weighted means of `RESAMPLES` samples of the episodes, drawn with replacement from a fixed stream.

    The same number of episodes is always resampled alike, so that two runs of the same cases stay paired.
    """
    rng = np.random.default_rng(_STREAM)
    n = len(values)
    means = np.empty(RESAMPLES)
    # In blocks: all indices of all resamples at once would be gigabytes for many episodes.
    block = max(1, 2_000_000 // n)
    for start in range(0, RESAMPLES, block):
        rows = rng.integers(n, size=(min(block, RESAMPLES - start), n))
        means[start : start + block] = (values * weights)[rows].sum(axis=1) / weights[rows].sum(axis=1)
    return means
