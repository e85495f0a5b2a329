"""What a metric may return: one number or boolean per episode, without an end to sums. Every metric is called here."""

from __future__ import annotations

import numpy as np
from jaxtyping import Shaped

from crowdbench.errors import InputError, plugin_errors
from crowdbench.evaluate.metrics import Metric
from crowdbench.types import Trace

LARGEST = 1e150
"""Values of metrics are not beyond this, so that neither their sum nor a square overflows."""


def measure(name: str, metric: Metric, trace: Trace) -> Shaped[np.ndarray, "case"]:
    """A metric's values, one per episode.

    Args:
        name: What the metric is called in errors.
        metric: The metric.
        trace: What it measures.

    Returns:
        Booleans, or float64; NaN where the metric is undefined.

    Raises:
        InputError: The metric raises, or does not return one value per episode.
    """
    return bounded(shaped(answer(name, metric, trace), name, trace), name, trace)


def answer(name: str, metric: Metric, trace: Trace) -> object:
    """What a metric returns, whatever it is.

    Args:
        name: What the metric is called in errors.
        metric: The metric.
        trace: What it measures.

    Raises:
        InputError: The metric raises.
    """
    with plugin_errors(f"metric {name} raised"):
        values = metric(trace)
        # A subclass may answer otherwise than its numbers.
        return np.asarray(values) if isinstance(values, np.ndarray) else values


def shaped(values: object, name: str, trace: Trace) -> Shaped[np.ndarray, "case"]:
    """Check type and shape of what a metric returned.

    Args:
        values: What it returned.
        name: What it is called in errors.
        trace: What it measured.

    Returns:
        A copy: booleans, or float64.

    Raises:
        InputError: There is not one number or boolean per episode.
    """
    if not isinstance(values, np.ndarray) or values.shape != (len(trace),) or values.dtype.kind not in "bfiu":
        found = (
            f"shape {list(values.shape)} of {values.dtype}" if isinstance(values, np.ndarray) else type(values).__name__
        )
        raise InputError(
            f"metric {name} returned {found}, but must return one number or boolean per episode, [{len(trace)}]"
        )
    with np.errstate(over="ignore"):  # where float64 holds less than the metric's type
        return np.array(values, bool if values.dtype == bool else np.float64)


def bounded(values: Shaped[np.ndarray, "case"], name: str, trace: Trace) -> Shaped[np.ndarray, "case"]:
    """Check that no value is beyond `LARGEST`.

    Args:
        values: Booleans, or float64.
        name: What the metric is called in errors.
        trace: What it measured.

    Returns:
        The values.

    Raises:
        InputError: A value is infinite or huge.
    """
    large = np.abs(values) > LARGEST
    if large.any():
        row = int(large.argmax())
        raise InputError(
            f"metric {name} is {values[row]:g} in case {trace.case[row]}, but must not be beyond {LARGEST:g}: "
            "what is undefined is NaN"
        )
    return values
