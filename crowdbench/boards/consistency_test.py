"""Whether an entry does as well on cases that it cannot know as it reports of the public ones, up to chance."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from crowdbench.metrics import info_of
from crowdbench.runs.results import Episodes

ALPHA = 0.001
"""The probability, at most, with which an honest entry is called lower than claimed."""

CRITERIA = ("success_rate", "collision_rate", "sct")
"""The metrics that are tested."""


def lower_than_claimed(public: Mapping[str, Episodes], other: Mapping[str, Episodes]) -> list[str]:
    """The ways in which a planner does worse on unknown cases than on the public ones, beyond chance.

    In each scenario and each of three metrics, a one-sided test asks whether the public cases went better: Fisher's
    exact test for rates, the test of Mann and Whitney (1947) for success weighted by completion time. `ALPHA` is
    divided by the number of tests (Bonferroni).

    Args:
        public: The episodes that the entry reports, by scenario.
        other: Episodes of cases that it could not know, by scenario.

    Returns:
        A sentence for each; none for an entry that is believable.
    """
    limit = ALPHA / (len(CRITERIA) * len(public))
    return [
        f"{info_of(metric).title} in {name} was {_mean(public[name], metric):.4g} as reported and is "
        f"{_mean(other[name], metric):.4g} in {len(other[name])} other cases (p = {p:.1e})"
        for name in public
        for metric in CRITERIA
        if (p := p_value(*(info_of(metric).sign * run[name].columns[metric] for run in (public, other)))) < limit
    ]


def _mean(episodes: Episodes, metric: str) -> float:
    return float(episodes.columns[metric].mean())


def p_value(public: Float[np.ndarray, "case"], other: Float[np.ndarray, "another"]) -> float:
    """The probability that values of the same distribution are larger in the public cases by as much, or more.

    Args:
        public: Values of the public cases, of which larger ones are better.
        other: Values of other cases.
    """
    from scipy.stats import fisher_exact, mannwhitneyu

    both = np.unique(np.concatenate([public, other]))
    if len(both) == 1:
        return 1.0
    if len(both) == 2:
        table = [[int((values == best).sum()) for best in both[::-1]] for values in (public, other)]
        return float(fisher_exact(table, alternative="greater").pvalue)
    return float(mannwhitneyu(public, other, alternative="greater", method="asymptotic").pvalue)
