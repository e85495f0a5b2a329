"""The measures in the tables of a study: their words, their units, and which way is better."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from crowdbench.metrics.summary import Estimate
from crowdbench.runs.results import Episodes
from crowdbench.runs.run import Run
from crowdbench.study.folder import read_episodes


@dataclass(frozen=True)
class Measure:
    """A metric, and how it is shown.

    Attributes:
        metric: The name of the metric.
        word: What tables call it.
        unit: The unit in which it is shown.
        sign: 1 where more is better, -1 where less is.
        digits: Digits after the decimal point.
        scale: What a value is multiplied by to be in the unit: 100 for shares shown in per cent.
    """

    metric: str
    word: str
    unit: str
    sign: int
    digits: int
    scale: float = 1.0

    def of(self, runs: Iterable[Episodes]) -> Float[np.ndarray, "network case"]:
        """The values in several runs of the same cases."""
        return np.stack([episodes.columns[self.metric].astype(float) for episodes in runs])

    def number(self, value: float) -> str:
        """`99.7 %`, or a dash where there is no number."""
        return f"{self._digits(value)} {self.unit}" if math.isfinite(value) else "-"

    def reported(self, value: float | None) -> str:
        """`99.2 %`: a number that somebody reports, with as many digits as they give; nothing where they give none."""
        return "" if value is None else f"{self.scale * value:.6g} {self.unit}"

    def estimate(self, estimate: Estimate) -> str:
        """`99.7 % (99.3 to 99.9)`: the mean and its 95 % interval, if it has one."""
        if not math.isfinite(estimate.mean):
            return "-"
        if not math.isfinite(estimate.high - estimate.low):
            return self.number(estimate.mean)
        return f"{self.number(estimate.mean)} ({self._digits(estimate.low)} to {self._digits(estimate.high)})"

    def _digits(self, value: float) -> str:
        return f"{self.scale * value:.{self.digits}f}"


SUCCESS = Measure("success_rate", "success", "%", sign=1, digits=1, scale=100.0)
TIME = Measure("navigation_time", "time", "s", sign=-1, digits=2)
DISCOMFORT = Measure("discomfort", "discomfort", "%", sign=-1, digits=2, scale=100.0)
JERK = Measure("jerk", "jerk", "m/s³", sign=-1, digits=2)
VELOCITY_CHANGE = Measure("max_velocity_change", "largest change of velocity", "m/s", sign=-1, digits=2)
GAP = Measure("minimum_gap", "gap", "m", sign=1, digits=3)


def read_successes(run: Run, out: Path) -> Bool[np.ndarray, "case"]:
    """In which cases a run in the folder `out` succeeds. Raises InputError where it is not there."""
    return np.asarray(read_episodes(run, out).columns[SUCCESS.metric], bool)


PLANNER_MEASURES = {each.metric: each for each in (SUCCESS, TIME, VELOCITY_CHANGE, JERK)}
"""What a table of planners may show, by metric."""

BAR = 20
"""Characters of the bar of a success rate of 1."""


def draw_bar(rate: float) -> str:
    """A bar as long as a rate is high."""
    return "█" * round(BAR * rate)


LEAST_SHARED = 6
"""Cases that both planners must solve before a difference over these cases counts.

With fewer, even a difference of the same sign in every case is likely by chance (2 * 0.5**5 > 0.05), and a bootstrap,
which draws from nothing but these cases, would not notice.
"""

PRIVILEGED = (
    r"\* uses the pedestrians' next velocities, which no vehicle could know: shown for comparison, never ranked."
)
"""A note on planners that are marked with an asterisk."""


@dataclass(frozen=True)
class Row:
    """A planner in a table; `privileged` says whether it uses what no vehicle could know."""

    planner: str
    privileged: bool

    @property
    def name(self) -> str:
        """The planner, with an asterisk where it is privileged."""
        return f"{self.planner} *" if self.privileged else self.planner
