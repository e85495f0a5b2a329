"""The power of the study, computed without runs: the share of simulated studies that meet its criterion, by true tau.

Log-odds of success are normal over planners, of mean 1 and standard deviation `SPREAD`, and correlated between the
suite and each world so that the expected tau is the requested one (Kendall's tau of normal numbers, 2 / pi asin(rho)).
Successes are binomial. The interval is that of the study: families and cases are drawn with replacement.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from studies.transfer.kendall import Rates, draw_families, kendall

TRUE_TAUS = (0.3, 0.5, 0.7, 0.9)

STUDIES, RESAMPLES = 200, 500
"""Studies that are simulated for each tau, and resamples of each."""

SPREAD = 1.2
"""Approximately the spread of the shipped planners in the suite."""


def power(
    tau: float,
    family: Int[np.ndarray, "planner"],
    cases: Sequence[int],
    criterion: float,
    studies: int = STUDIES,
) -> float:
    """Return the share of simulated studies that meet the criterion.

    Args:
        tau: The true tau of the suite's order with that of each world.
        family: The number of each planner's family.
        cases: The number of cases in the suite, and in each world.
        criterion: The bound that the lower end of the interval of the mean tau is to exceed.
        studies: Number of simulated studies.
    """
    draws, times = np.random.default_rng(0), draw_families(family)[: 1 + RESAMPLES]
    rho = np.sin(0.5 * np.pi * tau)
    met = 0
    for _ in range(studies):
        skill = draws.normal(size=(len(cases), len(family)))
        skill[1:] = rho * skill[0] + np.sqrt(1.0 - rho**2) * skill[1:]
        suite, *worlds = (draw_rates(draws, each, n) for each, n in zip(skill, cases, strict=True))
        taus = np.mean([kendall(suite, world, times) for world in worlds], axis=0)
        met += np.nanquantile(taus[1:], 0.025) > criterion
    return float(met / studies)


def draw_rates(draws: np.random.Generator, skill: Float[np.ndarray, "planner"], cases: int) -> Rates:
    """Return the success rates of planners in a number of cases, and in resamples of them."""
    rate = draws.binomial(cases, 1.0 / (1.0 + np.exp(-1.0 - SPREAD * skill))) / cases
    return np.vstack([rate, draws.binomial(cases, rate, size=(RESAMPLES, len(skill))) / cases])
