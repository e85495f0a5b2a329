"""A studentised bootstrap of differences between planners over cases, paired by case (Efron 1979)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int, Shaped

RESAMPLES = 2000

_SEED = 0
"""Fixed, so that the same runs have the same ranks."""


class Studentised(NamedTuple):
    """The distribution of differences of means.

    Attributes:
        error: The standard error of each pair's difference.
        deviations: The deviation of a pair's difference in each resample from that of the sample, in standard errors of
            the resample.
    """

    error: Float[np.ndarray, "pair"]
    deviations: Float[np.ndarray, "resample pair"]


def studentise(
    scenarios: Float[np.ndarray, "scenario pair case"],
    weights: Float[np.ndarray, "scenario"],
    blocks: Sequence[Int[np.ndarray, "case"]] | None = None,
) -> Studentised:
    """Resample the cases of each scenario, the same ones for all pairs.

    A variance is at least the mean square of the differences and of one more, which is 1: if few cases differ, or none,
    as many others may differ by chance.

    Args:
        scenarios: The differences in each case of each scenario, from -1 to 1.
        weights: The weight of each scenario; the sum is 1.
        blocks: The block of each case of each scenario, if cases of the same block are not independent: then they are
            resampled together.
    """
    draws = np.random.default_rng(_SEED)
    shape = 1 + RESAMPLES, scenarios.shape[1]
    deviation, variance, least = np.zeros(shape), np.zeros(shape), np.zeros(shape)
    for number, (scenario, weight) in enumerate(zip(scenarios, weights, strict=True)):
        block = np.arange(scenario.shape[1]) if blocks is None else blocks[number]
        index, size = np.unique(block, return_inverse=True, return_counts=True)[1:]
        residual = _over_blocks(scenario - scenario.mean(axis=1, keepdims=True), index)
        # The sample itself comes first.
        times = np.ones((shape[0], len(residual)))
        times[1:] = draws.multinomial(len(residual), np.full(len(residual), 1.0 / len(residual)), size=RESAMPLES)
        cases = (times @ size)[:, None]
        off = times @ residual / cases
        squares = times @ residual**2 - 2.0 * off * (times @ (residual * size[:, None]))
        squares += off**2 * (times @ size**2)[:, None]
        deviation += weight * off
        variance += weight**2 * squares / cases**2 * len(size) / max(len(size) - 1, 1)
        one_more = times @ _over_blocks(scenario**2, index) + 1.0 / len(scenarios)
        least += weight**2 * one_more / cases**2
    error = np.sqrt(np.maximum(variance, least))
    return Studentised(error[0], deviation[1:] / error[1:])


def _over_blocks(
    values: Shaped[np.ndarray, "pair case"], block: Int[np.ndarray, "case"]
) -> Float[np.ndarray, "block pair"]:
    """Return the sums of values over each block."""
    sums = np.zeros((1 + int(block.max()), len(values)))
    np.add.at(sums, block, values.T.astype(float))
    return sums
