"""Agreement of two rankings of planners, with an interval: Kendall's tau, with a bootstrap over families and time.

Tau is the number of pairs of planners in the same order in both rankings minus those in opposite orders, as a share of
all pairs (Kendall 1938, tau-a): a tie counts as neither.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

RESAMPLES = 2000

CERTAIN = 1.96
"""A pair is decided if its rates differ by more than this number of standard errors."""

Rates = Float[np.ndarray, "*resample planner"]
"""The success rates or mean scores of planners; in resamples, of cases that were drawn with replacement."""


@dataclass(frozen=True)
class Cases:
    """Outcomes of planners in the cases of a scenario.

    Attributes:
        source: Source of its pedestrians: scenarios of the same recording have it in common. Their blocks are drawn
            together.
        value: The score of a planner in a case, or 1 if it succeeds and 0 otherwise.
        block: The block of each case. Cases of the same block are drawn together.
    """

    source: str
    value: Float[np.ndarray, "planner case"]
    block: Int[np.ndarray, "case"]

    def resample(self) -> Rates:
        """Return the mean value of each planner in the cases, which comes first, and in `RESAMPLES` resamples."""
        _, number = np.unique(self.block, return_inverse=True)
        blocks = int(number.max()) + 1
        # Seeded by the source: the same hours are drawn for two scenarios of one recording.
        draws = np.random.default_rng([*self.source.encode()])
        times = np.ones((1 + RESAMPLES, blocks))
        times[1:] = draws.multinomial(blocks, np.full(blocks, 1.0 / blocks), size=RESAMPLES)
        sums = np.zeros((blocks, len(self.value)))
        np.add.at(sums, number, self.value.T)
        return times @ sums / (times @ np.bincount(number))[:, None]


def mean_rates(scenarios: list[Cases]) -> Rates:
    """Return the mean rates over equally weighted scenarios, first of all cases and then of the resamples."""
    return np.mean([each.resample() for each in scenarios], axis=0)


def draw_families(family: Int[np.ndarray, "planner"]) -> Float[np.ndarray, "resample pair"]:
    """Return the weight of each pair of planners, first in the sample and then in resamples of families.

    A family that is drawn twice counts as two families: its pairs count twice, and there is no pair between the two.

    Args:
        family: The number of each planner's family.
    """
    one, other = np.triu_indices(len(family), 1)
    families = int(family.max()) + 1
    draws = np.random.default_rng(0)
    times = np.ones((1 + RESAMPLES, families))
    times[1:] = draws.multinomial(families, np.full(families, 1.0 / families), size=RESAMPLES)
    of_one, of_other = times[:, family[one]], times[:, family[other]]
    return np.where(family[one] == family[other], of_one, of_one * of_other)


def kendall(a: Rates, b: Rates, times: Float[np.ndarray, "*resample pair"]) -> Float[np.ndarray, "*resample"]:
    """Return Kendall's tau of two rankings.

    Args:
        a: The rates of one.
        b: The rates of the other.
        times: The weight of each pair.

    Returns:
        From -1 to 1; NaN if no pair counts.
    """
    same = _signs(a) * _signs(b)
    pairs = times.sum(axis=-1)
    with np.errstate(invalid="ignore", divide="ignore"):
        return (times * same).sum(axis=-1) / pairs


def decided(rates: Rates) -> Bool[np.ndarray, "pair"]:
    """Return which pairs differ by more than `CERTAIN` standard errors; `rates` is a result of `mean_rates`."""
    one, other = np.triu_indices(rates.shape[-1], 1)
    differences = rates[:, one] - rates[:, other]
    return np.abs(differences[0]) > CERTAIN * differences[1:].std(axis=0)


def agreement(a: Rates, b: Rates) -> tuple[int, int]:
    """Return the number of pairs with the same order in two rankings, and the number of pairs that are decided in both.

    Args:
        a: The rates of one, a result of `mean_rates`.
        b: The rates of the other.
    """
    both = decided(a) & decided(b)
    same = _signs(a[0]) == _signs(b[0])
    return int((both & same).sum()), int(both.sum())


def _signs(rates: Rates) -> Float[np.ndarray, "*resample pair"]:
    one, other = np.triu_indices(rates.shape[-1], 1)
    return np.sign(rates[..., one] - rates[..., other])
