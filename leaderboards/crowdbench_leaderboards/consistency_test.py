"""Tests if an entry is significantly worse on held-out cases than on the public cases, as it reports them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from crowdbench import Episodes
from crowdbench.metrics import info_of
from crowdbench_leaderboards.means import case_means

ALPHA = 0.001
"""The largest probability that an honest entry is called lower than claimed."""

CRITERIA = ("success_rate", "collision_rate", "sct")
"""The metrics that are tested."""


def lower_than_claimed(public: Mapping[str, Episodes], held_out: Mapping[str, Episodes]) -> list[str]:
    """Return the scenarios and metrics in which a planner is significantly worse on held-out cases than on public ones.

    The test is one-sided, for each scenario and each metric of `CRITERIA`: Fisher's exact test for rates, and the test
    of Mann and Whitney (1947) for success weighted by completion time and for means over vehicles. `ALPHA` is divided
    by the number of tests (Bonferroni).

    Args:
        public: The episodes that the entry reports, by scenario.
        held_out: Episodes of held-out cases, by scenario.

    Returns:
        A sentence for each difference.
    """
    limit = ALPHA / (len(CRITERIA) * len(public))
    differences = []
    for name, reported in public.items():
        for metric in CRITERIA:
            info, before, after = info_of(metric), case_means(reported, metric), case_means(held_out[name], metric)
            p = p_value(info.sign * before, info.sign * after)
            if p < limit:
                differences.append(
                    f"{info.title} in {name} was {before.mean():.4g} as reported and is {after.mean():.4g} in "
                    f"{len(after)} other cases (p = {p:.1e})"
                )
    return differences


def p_value(public: Float[np.ndarray, "case"], held_out: Float[np.ndarray, "held_out_case"]) -> float:
    """Return the p-value of the one-sided test that public values are larger than held-out values.

    Args:
        public: Values of the public cases; larger ones are better.
        held_out: Values of held-out cases.
    """
    from scipy.stats import fisher_exact, mannwhitneyu

    both = np.unique(np.concatenate([public, held_out]))
    if len(both) == 1:
        return 1.0
    if len(both) == 2:
        worse, better = both
        table = [[int((values == better).sum()), int((values == worse).sum())] for values in (public, held_out)]
        return float(fisher_exact(table, alternative="greater").pvalue)
    return float(mannwhitneyu(public, held_out, alternative="greater", method="asymptotic").pvalue)
