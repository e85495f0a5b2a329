"""The mean of a metric over several scenarios, with its interval."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from crowdbench.metrics.summary import UNDEFINED, Estimate

FAILED = Estimate(0.0, 0.0, 0.0, 0, 0.0)
"""The estimate in a scenario that a planner cannot drive."""


def scenario_weights(families: Mapping[str, Sequence[str]]) -> Float[np.ndarray, "scenario"]:
    """Return the weights of scenarios, with sum 1: equal for all families, and equal for all scenarios of a family."""
    return np.array([1.0 / (len(families) * len(names)) for names in families.values() for _ in names])


def mean_over_scenarios(weights: Float[np.ndarray, "scenario"], estimates: Sequence[Estimate | None]) -> Estimate:
    """Return the weighted mean over scenarios with its interval by Zou and Donner (2008).

    Args:
        weights: The weight of each scenario.
        estimates: The estimate in each scenario; None counts as 0.

    Returns:
        The estimate, undefined if one of them is undefined.
    """
    defined = [estimate or FAILED for estimate in estimates]
    mean = float(weights @ [estimate.mean for estimate in defined])
    if np.isnan(mean):
        return UNDEFINED
    below = np.array([estimate.mean - estimate.low for estimate in defined])
    above = np.array([estimate.high - estimate.mean for estimate in defined])
    low = mean - float(np.sqrt(np.sum((weights * below) ** 2)))
    high = mean + float(np.sqrt(np.sum((weights * above) ** 2)))
    number = sum(estimate.n for estimate in defined)
    return Estimate(mean, low, high, number, max(estimate.max for estimate in defined))
