"""What the tables of a study show."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from jaxtyping import Float

from crowdbench.metrics import info_of
from crowdbench.runs.results import Episodes

SUCCESS_RATE = "success_rate"
SUCCESS = info_of(SUCCESS_RATE)

PLANNER_MEASURES = {name: info_of(name) for name in (SUCCESS_RATE, "navigation_time", "max_velocity_change", "jerk")}
"""What a table of planners may show, by metric."""


def values_of(metric: str, runs: Iterable[Episodes]) -> Float[np.ndarray, "network case"]:
    """Return the values of a metric in several runs of the same cases."""
    return np.stack([episodes.columns[metric].astype(float) for episodes in runs])
