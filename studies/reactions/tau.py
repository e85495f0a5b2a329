"""Kendall's tau of two rankings of planners, with an interval of a bootstrap over planners and cases.

Tau is the number of pairs of planners in the same order in both rankings minus those in opposite orders, as a share of
all pairs (Kendall 1938, tau-a): a tie counts as neither.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from crowdbench.metrics import Estimate, interval
from studies.orders import Means, differences


def kendall(a: Means, b: Means, times: Float[np.ndarray, "*resample pair"]) -> Float[np.ndarray, "*resample"]:
    """Return Kendall's tau of two rankings.

    Args:
        a: The means of one.
        b: The means of the other.
        times: The weight of each pair.

    Returns:
        From -1 to 1; NaN if no pair counts.
    """
    same = np.sign(differences(a)) * np.sign(differences(b))
    with np.errstate(invalid="ignore", divide="ignore"):
        return (times * same).sum(axis=-1) / times.sum(axis=-1)


def estimate_tau(tau: Float[np.ndarray, "resample"]) -> Estimate:
    """Return a tau, the first of its values, with the interval of the resampled ones."""
    drawn = tau[1:][np.isfinite(tau[1:])]
    return Estimate(float(tau[0]), *interval(drawn), n=len(drawn), max=float(drawn.max()))


def say_tau(tau: Estimate) -> str:
    """Return a tau with its interval in words."""
    return f"{tau.mean:+.2f} ({tau.low:+.2f} to {tau.high:+.2f})"
