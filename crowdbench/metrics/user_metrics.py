"""Load metrics by name or from a file, call them, and check their values: one number or boolean per episode."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from jaxtyping import Shaped

from crowdbench.core.types import Trace
from crowdbench.metrics.registry import METRICS, OF_FLEETS, Metric
from crowdbench.plugins.kind import Kind, file_and_function
from crowdbench.utils.defaults import START_LIMIT
from crowdbench.utils.errors import InputError
from crowdbench.utils.resources import plugin_in_time

METRIC = Kind("metric", "metric", METRICS)

RESERVED = ("case", "outcome", "steps", "block", "vehicle")
"""Names of columns in every table of episodes, which a metric cannot have."""


def load_metrics(specs: Iterable[str], vehicles: int = 1) -> dict[str, Metric]:
    """Return the built-in metrics and the metrics of a user by name.

    Args:
        specs: For each metric of the user: `file.py`, whose function is `metric`, or `file.py:function`.
        vehicles: Number of vehicles in a world.

    Returns:
        Functions of a trace. A metric of the user has the name of its file or function.

    Raises:
        InputError: There is no such function, or its name is taken.
    """
    metrics = METRICS | (OF_FLEETS if vehicles > 1 else {})
    for spec in specs:
        if file_and_function(spec)[0] is None:
            raise InputError(f"{spec!r} is no metric of your own: give a file, ./mine.py or ./mine.py:function")
        name, metric = METRIC.load(spec)
        if name in metrics or name in RESERVED:
            raise InputError(f"{spec}: a column {name} exists already: give the metric another name")
        metrics[name] = metric
    return metrics


LARGEST = 1e150
"""Values of metrics are not beyond this, so that neither their sum nor a square overflows."""


def measure(name: str, metric: Metric, trace: Trace) -> Shaped[np.ndarray, "case"]:
    """Return a metric's values, one per episode.

    Args:
        name: Name of the metric in errors.

    Returns:
        Booleans, or float64; NaN where the metric is undefined.

    Raises:
        InputError: The metric raises an exception, or does not return one value per episode up to `LARGEST`.
    """
    with plugin_in_time(f"metric {name} raised", seconds=START_LIMIT * len(trace)):
        returned = metric(trace)
        # A subclass may override methods of ndarray.
        array = np.asarray(returned) if isinstance(returned, np.ndarray) else None
    if array is None or array.shape != (len(trace),) or array.dtype.kind not in "bfiu":
        kind = type(returned).__name__ if array is None else f"shape {list(array.shape)} of {array.dtype}"
        raise InputError(
            f"metric {name} returned {kind}, but must return one number or boolean per episode, [{len(trace)}]"
        )
    with np.errstate(over="ignore"):  # if float64 has a smaller range than the metric's type
        values = np.array(array, bool if array.dtype == bool else np.float64)
    large = np.abs(values) > LARGEST
    if large.any():
        row = int(large.argmax())
        raise InputError(
            f"metric {name} is {values[row]:g} in case {trace.case[row]}, but must not be beyond {LARGEST:g}: "
            "what is undefined is NaN"
        )
    return values
