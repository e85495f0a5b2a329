"""Sums of metrics: one step after the other, so that an episode's value does not depend on its batch."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float


def total(values: Float[np.ndarray, "*batch time"]) -> Float[np.ndarray, "*batch"]:
    """The sum over the last axis, from left to right; NaN counts as 0."""
    # np.sum groups its terms by the shape of the array, which depends on the batch.
    if values.shape[-1] == 0:
        return np.zeros(values.shape[:-1])
    return np.cumsum(np.where(np.isnan(values), 0.0, values), axis=-1)[..., -1]
