"""The power of the study, computed without runs: the share of tests that reject after Holm, by true rank correlation.

True means of planners are normal, with the standard deviation `SPREAD`. Those in each world have the requested rank
correlation with those in the suite (Spearman's of normal numbers, 6 / pi asin(r / 2)). Measured means have normal
errors of independent cases with the standard deviation `NOISE`; blocks of recorded time have less power. All worlds
are tested.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from crowdbench.results import holm
from studies.orders import CERTAIN, differences
from studies.transfer.permutation import Signs, p_value

CORRELATIONS = (0.0, 0.3, 0.5, 0.7, 0.9)

STUDIES, PERMUTATIONS = 400, 500
"""Studies that are simulated for each correlation, and permutations of each of their tests."""

SPREAD, NOISE = 0.08, 0.2
"""Approximately the deviation of mean scores over planners, and of scores over cases of a scenario, in the suite."""

LEVEL = 0.05
"""A world is rejected if its p-value after Holm is below it."""


def power(correlation: float, planners: int, cases: Sequence[int], studies: int = STUDIES) -> float:
    """Return the mean share of the worlds in which simulated studies reject.

    Args:
        correlation: The true rank correlation of the suite with each world.
        planners: Number of planners.
        cases: The number of cases in the suite, and in each world.
        studies: Number of simulated studies.
    """
    draws, rejected = np.random.default_rng(0), 0.0
    r = 2.0 * np.sin(np.pi * correlation / 6.0)
    for _ in range(studies):
        means = draws.normal(size=(len(cases), planners))
        means[1:] = r * means[0] + np.sqrt(1.0 - r**2) * means[1:]
        suite, *worlds = (_measure(draws, SPREAD * each, n) for each, n in zip(means, cases, strict=True))
        p = np.array([p_value(suite, world, draws, PERMUTATIONS) for world in worlds])
        rejected += (holm(p) < LEVEL).mean()
    return rejected / studies


def _measure(draws: np.random.Generator, means: np.ndarray, cases: int) -> Signs:
    """Return the decided order of pairs after so many cases."""
    error = NOISE / np.sqrt(cases)
    found = differences(draws.normal(means, error))
    return np.where(np.abs(found) > CERTAIN * np.sqrt(2.0) * error, np.sign(found), 0.0)
