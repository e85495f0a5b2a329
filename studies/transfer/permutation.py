"""Agreement of the orders of planners in the suite and in a world: an interval, a test, and their reliability."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy.stats import rankdata

from crowdbench.metrics import Estimate, interval
from studies.orders import Cases, Means, decided_signs, draw_pairs

SPLITS, PERMUTATIONS = 1000, 10_000
"""Random halves of the cases of a world, and permutations of planners."""

Signs = Float[np.ndarray, "pair"]
"""The order of each pair of planners: 1, -1, or 0 if it is not decided."""


def share(suite: Means, world: Means) -> Estimate:
    """Return the share of the pairs decided in both that agree, with the interval over planners and cases.

    Args:
        suite: The means in the suite, a result of `resample_means`.
        world: The means in the world.
    """
    same = decided_signs(suite) * decided_signs(world) * draw_pairs(suite.shape[1])
    with np.errstate(invalid="ignore"):
        shares = same.clip(min=0.0).sum(axis=1) / np.abs(same).sum(axis=1)
    drawn = shares[1:][np.isfinite(shares[1:])]
    bounds = interval(drawn) if len(drawn) else (np.nan, np.nan)
    return Estimate(float(shares[0]), *bounds, n=int(np.count_nonzero(same[0])), max=1.0)


def p_value(suite: Signs, world: Signs, draws: np.random.Generator, permutations: int = PERMUTATIONS) -> float:
    """Return the p-value of a one-sided permutation test of independent orders.

    The statistic is the number of pairs that agree, less the number of pairs that disagree. Planners of the world are
    permuted.
    """
    ahead, there = _matrix(suite), _matrix(world)
    planners = np.arange(len(ahead))
    permuted = draws.permuted(np.broadcast_to(planners, (permutations, len(planners))), axis=1)
    found = (ahead * there[permuted[:, :, None], permuted[:, None, :]]).sum(axis=(1, 2))
    return float((1 + (found >= (ahead * there).sum()).sum()) / (1 + permutations))


def _matrix(signs: Signs) -> Float[np.ndarray, "planner planner"]:
    """Return the signs of all pairs of planners, each in both directions."""
    planners = round((1.0 + np.sqrt(1.0 + 8.0 * len(signs))) / 2.0)
    matrix = np.zeros((planners, planners))
    matrix[np.triu_indices(planners, 1)] = signs
    return matrix - matrix.T


def reliability(scenarios: Sequence[Cases]) -> float:
    """Return the split-half reliability of an order of planners by their means over equally weighted scenarios.

    It is the mean of Spearman's rank correlation between random halves of the cases, or of their blocks, stepped up to
    all cases (Spearman 1910, Brown 1910).
    """
    first, second = rankdata(np.mean([each.halves(SPLITS) for each in scenarios], axis=0), axis=2)
    first, second = (ranks - ranks.mean(axis=1, keepdims=True) for ranks in (first, second))
    with np.errstate(invalid="ignore"):
        correlation = (first * second).sum(axis=1) / np.sqrt((first**2).sum(axis=1) * (second**2).sum(axis=1))
    mean = float(np.nan_to_num(correlation).mean())  # NaN: a half has no order
    return 2.0 * mean / (1.0 + mean)
