"""What the tables of a study have in common: their life, and how they are written in Markdown and JSON."""

from __future__ import annotations

import abc
import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from crowdbench.evaluate.summary import Estimate
from crowdbench.study.planned import Run


class Filled(abc.ABC):
    """A table with its numbers. A dataclass, whose fields are what `--json` prints."""

    @abc.abstractmethod
    def markdown(self) -> str:
        """The table as GitHub shows it, with its heading and notes."""


class Table(abc.ABC):
    """A table of a study: which runs it needs, and what it makes of them."""

    @property
    @abc.abstractmethod
    def runs(self) -> list[Run]:
        """All that it needs."""

    @abc.abstractmethod
    def fill(self, out: Path) -> Filled:
        """Its numbers, from runs in `out`. Raises InputError where one of them is not there."""


@dataclass(frozen=True)
class Measure:
    """How a metric is shown: in which unit, how many of them one is, to how many digits; `sign` is 1 where more is
    better and -1 where less is.
    """

    metric: str
    word: str
    unit: str
    sign: int
    digits: int
    scale: float = 1.0

    def number(self, value: float) -> str:
        """`99.7 %`, or a dash where there is no number."""
        return f"{self._digits(value)} {self.unit}" if math.isfinite(value) else "-"

    def given(self, value: float | None) -> str:
        """`99.2 %`: a number of somebody else's, to as many digits as they gave; nothing where they gave none."""
        return "" if value is None else f"{self.scale * value:.6g} {self.unit}"

    def estimate(self, estimate: Estimate) -> str:
        """`99.7 % (99.3 to 99.9)`: the mean and its 95 % interval."""
        if not math.isfinite(estimate.mean):
            return "-"
        return f"{self.number(estimate.mean)} ({self._digits(estimate.low)} to {self._digits(estimate.high)})"

    def _digits(self, value: float) -> str:
        return f"{self.scale * value:.{self.digits}f}"


SUCCESS = Measure("success_rate", "success", "%", sign=1, digits=1, scale=100.0)
TIME = Measure("navigation_time", "time", "s", sign=-1, digits=2)
DISCOMFORT = Measure("discomfort", "discomfort", "%", sign=-1, digits=2, scale=100.0)
JERK = Measure("jerk", "jerk", "m/s³", sign=-1, digits=2)
VELOCITY_CHANGE = Measure("max_velocity_change", "largest change of velocity", "m/s", sign=-1, digits=2)
GAP = Measure("minimum_gap", "gap", "m", sign=1, digits=3)

LEAST_SHARED = 6
"""Cases that both must solve before their differences can tell two planners apart.

With fewer even a difference of one sign throughout is likely by chance, 2 * 0.5**5 > 0.05, and a bootstrap, which
resamples nothing else, would not notice.
"""

PRIVILEGED = r"\* sees where the pedestrians will step next, which no vehicle could: shown, never ranked."


def marked(planner: str, privileged: bool) -> str:
    """A planner's name, marked where `PRIVILEGED` holds of it."""
    return f"{planner} *" if privileged else planner


def grid(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", r"\|") for cell in line) + " |" for line in lines)


def plain(value: Any) -> Any:
    """A dataclass and what is in it as JSON knows it: undefined numbers become null."""
    if dataclasses.is_dataclass(value):
        return {field.name: plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, list):
        return [plain(item) for item in value]
    return None if isinstance(value, float) and math.isnan(value) else value
