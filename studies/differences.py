"""Differences between planners with several networks each, see `crowdbench.metrics.networks`."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float

from crowdbench.metrics import UNDEFINED, Estimate, Values, mean_of_means, mean_over_networks, network_estimate


def gain_in_success(ours: Values, theirs: Float[np.ndarray, "their_network case"], paired: bool) -> Estimate:
    """Return the difference in success, with an interval that has a width even if both succeed in the same cases.

    One discordant case is added to each side, one that only `ours` solves and one that only `theirs` solve, as in
    Bonett and Price, "Adjusted Wald confidence interval for a difference of binomial proportions based on paired data",
    Journal of Educational and Behavioral Statistics 37(4) (2012), 479-488, doi:10.3102/1076998611411915. Theirs is an
    adjusted Wald interval of one pair of samples; here the cases of every network are completed in this way.
    """
    won, lost = (np.tile(pair, (len(row), 1)) for pair, row in (([1.0, 0.0], ours), ([0.0, 1.0], theirs)))
    guarded = difference_over_networks(np.hstack([ours, won]), np.hstack([theirs, lost]), paired)
    found = difference_over_networks(ours, theirs, paired)
    return dataclasses.replace(found, low=guarded.low, high=guarded.high)


def difference_over_networks(ours: Values, theirs: Float[np.ndarray, "their_network case"], paired: bool) -> Estimate:
    """Return the difference of two means over networks.

    Args:
        ours: A metric of each network in each case, NaN where it is not defined.
        theirs: The same metric of other networks, or of the same ones under another planner, in the same cases.
        paired: True if the networks are the same ones in the same order. Networks of two trainings are not, and their
            parts of the variance are added.

    Returns:
        The difference with its interval; `n` counts the values of paired networks, and otherwise the cases.
    """
    if paired:
        return mean_over_networks(ours - theirs)
    if np.isnan(ours).all() or np.isnan(theirs).all():
        return UNDEFINED
    return network_estimate(
        mean_of_means(ours) - mean_of_means(theirs), [ours, -theirs], case_means(ours) - case_means(theirs)
    )


def case_means(values: Values) -> Float[np.ndarray, "case"]:
    """Return the mean over networks in each case; NaN where none of them has a value."""
    number = (~np.isnan(values)).sum(axis=0)
    return np.where(number > 0, np.nansum(values, axis=0) / np.maximum(number, 1), np.nan)
