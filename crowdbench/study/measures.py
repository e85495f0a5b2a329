"""What the tables of a study show."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from crowdbench.metrics import info_of
from crowdbench.runs.results import Episodes
from crowdbench.runs.run import Run
from crowdbench.study.folder import read_episodes

SUCCESS_RATE = "success_rate"
SUCCESS = info_of(SUCCESS_RATE)

PLANNER_MEASURES = {name: info_of(name) for name in (SUCCESS_RATE, "navigation_time", "max_velocity_change", "jerk")}
"""What a table of planners may show, by metric."""


def values_of(metric: str, runs: Iterable[Episodes]) -> Float[np.ndarray, "network case"]:
    """Return the values of a metric in several runs of the same cases."""
    return np.stack([episodes.columns[metric].astype(float) for episodes in runs])


def read_successes(run: Run, out: Path) -> Bool[np.ndarray, "case"]:
    """In which cases a run in the folder `out` succeeds. Raises InputError where it is not there."""
    return np.asarray(read_episodes(run, out).columns[SUCCESS_RATE], bool)


BAR = 20
"""Characters of the bar of a success rate of 1."""


def draw_bar(rate: float) -> str:
    """A bar as long as a rate is high."""
    return "█" * round(BAR * rate)
