"""Ranks of planners by the mean of a value over scenarios. A rank is an interval.

The differences between all planners have simultaneous bounds, paired by case: over cases, all of them hold together
with a confidence of 95 %. A planner is surely better than another if the bounds of their difference are above 0. Its
rank goes from 1 plus the number of planners that are surely better to the number of planners minus those that are
surely worse (Mogstad, Romano, Shaikh and Wilhelm 2024).
"""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from crowdbench.metrics.networks import student_quantile
from crowdbench.metrics.paired_bootstrap import studentise
from crowdbench.metrics.summary import CONFIDENCE, wilson

NORMAL = 1.96
"""The least number of standard errors of a significant difference. If few cases differ, the number of a bootstrap is
smaller, because it draws from no other cases."""

FAULT, FAULT_IN_SCENARIO = 0.05, 0.10
"""Largest rates of collisions at fault of a competent planner, see `is_competent`."""

Values = Float[np.ndarray, "network scenario case"]
"""A value in each case, by network; planners without networks, or with one, have one."""

Weights = Float[np.ndarray, "scenario"]


@dataclass(frozen=True)
class Pair:
    """Two planners, compared case by case.

    Attributes:
        higher: The name of the planner of the higher mean.
        lower: The name of the other planner.
        difference: The difference of their means.
        error: The half width of its simultaneous interval.
        is_sure: True if the higher planner is surely better.
    """

    higher: str
    lower: str
    difference: float
    error: float
    is_sure: bool


@dataclass(frozen=True)
class Rank:
    """The rank of a planner, an interval.

    Attributes:
        first: 1 plus the number of planners that are surely better.
        last: The number of planners minus those that are surely worse.
    """

    first: int
    last: int

    def __str__(self) -> str:
        """Return the interval, or a single rank."""
        return f"{self.first} to {self.last}" if self.last > self.first else f"{self.first}"


def compare_all(
    values: Mapping[str, Values], weights: Weights, blocks: Sequence[Int[np.ndarray, "case"]] | None = None
) -> list[Pair]:
    """Compare each planner with all planners of a lower mean.

    Planners with several networks are compared by the mean over them. The error of a difference is then larger by the
    error of this mean, with the quantile of Student's t for the number of networks, as in `mean_over_networks`.

    Args:
        values: The values of each planner by its name, between 0 and 1, in the same cases.
        weights: The weight of each scenario; the sum is 1.
        blocks: The block of each case of each scenario, if cases of the same block are not independent: then the
            bootstrap resamples blocks.
    """
    of_networks = {name: own.mean(axis=2) @ weights for name, own in values.items()}
    mean = {name: float(means.mean()) for name, means in of_networks.items()}
    names = sorted(mean, key=lambda name: (-mean[name], name))
    if len(names) < 2:
        return []
    higher, lower = np.triu_indices(len(names), 1)
    every = np.array([values[name].mean(axis=0) for name in names])
    error, deviations = studentise((every[higher] - every[lower]).swapaxes(0, 1), weights, blocks)
    # The largest studentised deviation of all pairs, of either sign.
    error = error * max(float(np.quantile(np.abs(deviations).max(axis=1), CONFIDENCE)), NORMAL)
    squares = np.array([_network_error(of_networks[name]) ** 2 for name in names])
    error = np.sqrt(error**2 + squares[higher] + squares[lower])
    difference = np.array([mean[names[a]] - mean[names[b]] for a, b in zip(higher, lower, strict=True)])
    sure = np.zeros((len(names), len(names)), bool)
    sure[higher, lower] = difference > error
    for k in range(len(names)):
        # Bounds that hold together also imply the order of the first and the last of three.
        sure |= sure[:, k, None] & sure[k]
    figures = zip(difference.tolist(), error.tolist(), sure[higher, lower].tolist(), strict=True)
    return [Pair(*pair, *each) for pair, each in zip(itertools.combinations(names, 2), figures, strict=True)]


def _network_error(means: Float[np.ndarray, "network"]) -> float:
    """Return half the width of the interval around the mean over networks; 0 for one network."""
    number = len(means)
    return student_quantile(number) * float(means.std(ddof=1)) / number**0.5 if number > 1 else 0.0


def ranks(names: Sequence[str], pairs: Iterable[Pair]) -> dict[str, Rank]:
    """Return the rank of each planner, by name.

    Args:
        names: The names of the planners.
        pairs: The result of `compare_all`.
    """
    sure = [pair for pair in pairs if pair.is_sure]
    better, worse = Counter(pair.lower for pair in sure), Counter(pair.higher for pair in sure)
    return {name: Rank(1 + better[name], len(names) - worse[name]) for name in names}


def fault_bound(at_fault: Values) -> float:
    """Return Wilson's upper 95 % bound of a rate of collisions over all scenarios, the largest one of the networks.

    Args:
        at_fault: 1 for each case that ends in a collision at fault, 0 elsewhere.
    """
    return max(wilson(of_network.astype(bool).reshape(-1)).high for of_network in at_fault)


def is_competent(at_fault: Values) -> bool:
    """Return whether a planner causes few collisions over all scenarios, and in each of them.

    `fault_bound` is at most 5 %, and no network has a rate above 10 % in a scenario. Argument as for `fault_bound`.
    """
    return fault_bound(at_fault) <= FAULT and float(at_fault.mean(axis=2).max()) <= FAULT_IN_SCENARIO
