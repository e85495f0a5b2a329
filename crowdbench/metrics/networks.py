"""The mean over networks of the same training, with an interval for other networks on other cases.

Networks and cases are both random samples, and all networks drive the same cases. A value is the sum of a mean, an
effect of the network, an effect of the case, and a residual. The variance of the mean is the sum of two parts, which
are estimated independently: from the variance of the networks' means, and from that of the cases' means. (The residual
counts in both, so the interval is too wide rather than too narrow.) There are few networks, so each part has its own
quantile of Student's t:

    mean +- sqrt((t_networks * error_networks)^2 + (t_cases * error_cases)^2)

With normal effects such an interval covers the true mean in 95 % or more, for any number of networks above 1 and any
ratio of the parts: Banerjee, "Approximate confidence interval for linear functions of means of k populations when the
population variances are not equal", Sankhya 22(3/4) (1960), 357-358. A bootstrap that resamples networks and cases does
not: with two networks its one-sided error is up to 14 % in place of 2.5 %.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy.stats import t as student

from crowdbench.metrics.summary import CONFIDENCE, UNDEFINED, Estimate, wilson

Values = Float[np.ndarray, "network case"]


def mean_over_networks(values: Values) -> Estimate:
    """Return the mean over networks of each network's mean over its cases, with its interval.

    Args:
        values: A metric of each network in each case; undefined values are NaN and ignored.

    Returns:
        The mean with its interval, which is only for other cases if there is one network; the bounds are NaN if there
        are fewer than two cases. `n` counts the values that are not NaN.
    """
    defined = values[~np.isnan(values)]
    return network_estimate(mean_of_means(values), [values], defined) if len(defined) else UNDEFINED


def network_estimate(
    mean: float, groups: Sequence[Float[np.ndarray, "_ _"]], of_cases: Float[np.ndarray, "_"]
) -> Estimate:
    """Return an estimate.

    Args:
        mean: The estimated value.
        groups: Values of independent groups of networks, by network and case. The sum of their means is `mean`.
    """
    half = _half_width(groups)
    defined = of_cases[~np.isnan(of_cases)]
    return Estimate(mean, mean - half, mean + half, len(defined), float(defined.max(initial=-np.inf)))


def _means(values: Values) -> Float[np.ndarray, "measured"]:
    """Return the means of the networks that have a value."""
    return np.array([np.nanmean(of_network) for of_network in values if not np.isnan(of_network).all()])


def mean_of_means(values: Values) -> float:
    """Return the mean over networks of their means over cases."""
    return float(_means(values).mean())


def _half_width(groups: Sequence[Float[np.ndarray, "_ _"]]) -> float:
    """Return half the width of the interval around the sum of the groups' `mean_of_means`; NaN below two cases."""
    squares = 0.0
    contributed = np.zeros(groups[0].shape[1])
    counted = np.zeros(groups[0].shape[1], bool)
    for group in groups:
        values = group[~np.isnan(group).all(axis=1)]
        means, defined = _means(values), ~np.isnan(values)
        networks = len(means)
        # The contribution of each case to the mean over networks.
        parts = np.where(defined, values - means[:, None], 0.0) / (networks * defined.sum(axis=1, keepdims=True))
        contributed += parts.sum(axis=0)
        counted |= defined.any(axis=0)
        if networks > 1:
            squares += student_quantile(networks) ** 2 * means.var(ddof=1) / networks
    cases = int(counted.sum())
    if cases < 2:
        return math.nan
    return math.sqrt(squares + student_quantile(cases) ** 2 * (contributed**2).sum() * cases / (cases - 1))


def student_quantile(n: int) -> float:
    """Return the quantile of Student's t for an interval that comes from `n` values."""
    return float(student.ppf(0.5 + CONFIDENCE / 2, n - 1))


def range_over_networks(shares: Float[np.ndarray, "network case"]) -> Estimate:
    """Return the mean of shares over networks, with its interval within 0 and 1."""
    # Equal values in all networks and cases do not imply certainty: use Wilson's interval for the cases of one network.
    is_constant = (shares == shares[0, 0]).all()
    estimate = wilson(shares[0].astype(bool)) if is_constant else mean_over_networks(shares)
    return Estimate(estimate.mean, max(estimate.low, 0.0), min(estimate.high, 1.0), estimate.n, estimate.max)
