"""Tools for metrics: their description, a sum that does not depend on the batch, and a distance.

The description contains the title, unit and direction of a metric, and its costly inputs. Tables and runs read nothing
else.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, TypeVar, cast

import numpy as np
from jaxtyping import Bool, Float

from crowdbench.core.types import Outcome, Trace

if TYPE_CHECKING:
    from crowdbench.metrics.summary import Estimate

Metric = Callable[[Trace], Bool[np.ndarray, "world"] | Float[np.ndarray, "world"]]
M = TypeVar("M", bound=Callable[..., Any])

UNDISTURBED = "undisturbed"
"""The input of a metric that reads `Trace.undisturbed`: the crowd is simulated a second time, without the vehicle."""

UNDEFINED = "-"
"""Text of an undefined value."""


@dataclass(frozen=True)
class MetricInfo:
    """The description of a metric.

    Attributes:
        title: Its title in every table.
        unit: The SI unit of its values; empty for a number without a unit.
        better: Which values are better; empty if neither more nor less is better.
        share: True for a share, which tables show in per cent.
        digits: Digits of its values after the decimal point; a share in per cent has two fewer.
        needs: Costly inputs of the metric: `UNDISTURBED`.
        over_all: True if it counts failures: planners are compared in all cases, not only in cases that both solve.
        of_successes: True if it is undefined in failures, because an early end would improve it.
        pooled: True if it is averaged over the steps of all episodes, and not over episodes.
        among_all: True if other vehicles count as pedestrians.
        source: The paper that defines it; empty for a definition of this benchmark.
    """

    title: str
    unit: str = ""
    better: Literal["more", "less", ""] = ""
    share: bool = False
    digits: int = 3
    needs: frozenset[str] = frozenset()
    over_all: bool = False
    of_successes: bool = False
    pooled: bool = False
    among_all: bool = False
    source: str = ""

    @property
    def sign(self) -> int:
        """1 if more is better, -1 if less is better, 0 otherwise."""
        return {"more": 1, "less": -1, "": 0}[self.better]

    @property
    def factor(self) -> float:
        """Factor of shown values."""
        return 100.0 if self.share else 1.0

    @property
    def places(self) -> int:
        """Digits after the decimal point, as shown."""
        return self.digits - 2 if self.share else self.digits

    @property
    def shown_unit(self) -> str:
        """The unit that tables show."""
        return "%" if self.share and not self.unit else self.unit

    @property
    def heading(self) -> str:
        """The title with the unit, such as `time, s`: the heading of a column."""
        return f"{self.title}, {self.shown_unit}" if self.shown_unit else self.title

    def number(self, value: float) -> str:
        """Return a value without its unit, such as `99.7`."""
        return f"{self.factor * value:z.{self.places}f}" if math.isfinite(value) else UNDEFINED

    def amount(self, value: float) -> str:
        """Return a value with its unit, such as `99.7 %`."""
        return f"{self.number(value)} {self.shown_unit}".strip() if math.isfinite(value) else UNDEFINED

    def interval(self, low: float, high: float) -> str:
        """Return the bounds of an interval, such as `99.3 to 99.9`."""
        return f"{self.number(low)} to {self.number(high)}"

    def estimate(self, estimate: Estimate, with_unit: bool = False) -> str:
        """Return a mean with its interval, such as `99.7 (99.3 to 99.9)` or `99.7 % (99.3 to 99.9)`.

        The interval is left out if it is undefined, or over fewer than `LEAST_CASES` cases.
        """
        estimate = estimate.for_display()
        mean = self.amount(estimate.mean) if with_unit else self.number(estimate.mean)
        if mean == UNDEFINED or not math.isfinite(estimate.high - estimate.low):
            return mean
        return f"{mean} ({self.interval(estimate.low, estimate.high)})"


def describe(title: str, better: Literal["more", "less", ""] = "", **facts: Any) -> Callable[[M], M]:
    """Attach a description to a metric. Its unit is the one in brackets on the first line of the docstring.

    Args:
        title: Its title in every table.
        better: Which values are better.
        facts: Other fields of `MetricInfo`.
    """

    def attach(metric: M) -> M:
        info = MetricInfo(title, read_unit(metric), better, **facts)

        @functools.wraps(metric)
        def measure(trace: Trace) -> Bool[np.ndarray, "world"] | Float[np.ndarray, "world"]:
            is_whole = info.among_all or trace.rules.vehicles == 1
            values = metric(trace if is_whole else trace.of_pedestrians)
            return np.where(trace.outcome == Outcome.SUCCESS, values, np.nan) if info.of_successes else values

        vars(measure)["info"] = info
        return cast(M, measure)

    return attach


def read_unit(metric: object) -> str:
    """Return the unit in brackets at the end of the first line of a docstring; empty for `[1]` and without brackets."""
    first = str(metric.__doc__ or "").partition("\n")[0]
    unit = first.rpartition("[")[2].rstrip("].") if "[" in first else ""
    return "" if unit == "1" else unit


def total(values: Float[np.ndarray, "*batch time"]) -> Float[np.ndarray, "*batch"]:
    """Return the sum over the last axis, one term after the other; NaN counts as 0."""
    # np.sum groups its terms by the shape of the array, which depends on the batch.
    if values.shape[-1] == 0:
        return np.zeros(values.shape[:-1])
    return np.cumsum(np.where(np.isnan(values), 0.0, values), axis=-1)[..., -1]


def finite_or_nan(values: Float[np.ndarray, "world"]) -> Float[np.ndarray, "world"]:
    """Return the finite values, and NaN instead of the others: a metric is undefined there."""
    return np.where(np.isfinite(values), values, np.nan)
