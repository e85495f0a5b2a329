"""Checks what a metric keeps of its contract, on the trace of real episodes."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Int, Shaped

from crowdbench.evaluate.check.again import EXACT, Replay
from crowdbench.evaluate.check.point import Findings, Point, changed
from crowdbench.evaluate.check.trial import trial
from crowdbench.evaluate.measured import answer, bounded, measure, shaped
from crowdbench.evaluate.metrics import Metric
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.scenario import Scenario
from crowdbench.types import Trace

MISSING = "not examined: the metric returned no values"


def check_metric(make: Callable[[], Metric], name: str, scenario: Scenario, cases: Cases) -> list[Point]:
    """Let a metric measure some cases and examine each point of its contract by itself.

    Args:
        make: Loads the metric.
        name: What the metric is called in errors.
        scenario: The scenario of the cases.
        cases: The cases.

    Raises:
        InputError: Something other than the metric breaks its contract.
    """
    trace, _ = trial(scenario, cases)
    metric, findings = make(), Findings("episodes", MISSING)
    # A scenario whose pedestrians do not see the vehicle has traces of the second kind.
    traces = (trace, dataclasses.replace(trace, undisturbed=None))
    measured = [_measured(metric, name, each, findings) for each in traces]
    shown = [(each, values) for each, values in measured if values is not None]
    again = Replay("values", shown, _take, lambda: _measuring(make(), name), EXACT, MISSING)
    return [
        findings.point("exceptions", "none"),
        findings.point("one value", "one number or boolean per episode"),
        findings.point("finite", "none is infinite or huge"),
        findings.point("trace", "unchanged"),
        again.deterministic(_measuring(metric, name)),
        again.batch(),
    ]


def _measured(
    metric: Metric, name: str, trace: Trace, findings: Findings
) -> tuple[Trace, Shaped[np.ndarray, "world"] | None]:
    """The trace, and the metric's values; None where it breaks its contract."""
    shown = _take(trace, np.arange(len(trace)))
    values = findings.examine(
        len(trace),
        {
            "exceptions": lambda _: answer(name, metric, shown),
            "one value": lambda given: shaped(given, name, trace),
            "finite": lambda numbers: bounded(numbers, name, trace),
        },
    )
    found = changed("trace", trace, shown)
    findings.note("trace", len(trace), found and f"changes {found[0]} (case {trace.case[found[1]]})")
    return trace, values


def _measuring(metric: Metric, name: str) -> Callable[[Trace], Shaped[np.ndarray, "world"]]:
    return lambda trace: measure(name, metric, trace)


def _take(trace: Trace, rows: Int[np.ndarray, "row"]) -> Trace:
    """A copy of the given episodes."""
    parts: dict[str, Any] = {field.name: getattr(trace, field.name) for field in dataclasses.fields(trace)}
    arrays = {name: part[rows] for name, part in parts.items() if isinstance(part, np.ndarray)}
    logs = {name: values[rows] for name, values in trace.logs.items()}
    return dataclasses.replace(trace, logs=logs, **arrays)
