"""Checks what a metric keeps of its contract, on the trace of real episodes."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Int

from crowdbench.check.examination import Examination
from crowdbench.check.inputs import drive_trial
from crowdbench.check.result import CheckResult
from crowdbench.core.types import Trace
from crowdbench.metrics import Metric
from crowdbench.metrics.load import check_bounds, check_shape, query_metric
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.scenario import Scenario


def check_metric(make: Callable[[], Metric], name: str, scenario: Scenario, cases: Cases) -> list[CheckResult]:
    """Let a metric measure some cases and examine each part of its contract by itself.

    Args:
        make: Loads the metric.
        name: What the metric is called in errors.
        scenario: The scenario of the cases.
        cases: The cases.

    Raises:
        InputError: Something other than the metric breaks its contract.
    """
    trace, _ = drive_trial(scenario, cases)
    examination = _MetricExamination(make, name)
    # A scenario whose pedestrians do not see the vehicle has traces of the second kind.
    for each in (trace, dataclasses.replace(trace, undisturbed=None)):
        examination.ask(examination.copy(each))
    findings = examination.findings
    return [
        findings.result("exceptions", "none"),
        findings.result("one value", "one number or boolean per episode"),
        findings.result("finite", "none is infinite or huge"),
        findings.result("trace", "unchanged"),
        examination.check_deterministic(),
        examination.check_batch(),
    ]


class _MetricExamination(Examination[Metric, Trace]):
    units = "episodes"
    answers = "values"
    missing = "not examined: the metric returned no values"
    batch_names = "trace", "trace"

    def query(self, plugin: Metric, batch: Trace) -> object:
        return query_metric(self.name, plugin, batch)

    def validators(self, batch: Trace) -> dict[str, Callable[[Any], Any]]:
        return {
            "one value": lambda values: check_shape(values, self.name, batch),
            "finite": lambda values: check_bounds(values, self.name, batch),
        }

    def take(self, batch: Trace, rows: Int[np.ndarray, "row"]) -> Trace:
        parts: dict[str, Any] = {field.name: getattr(batch, field.name) for field in dataclasses.fields(batch)}
        arrays = {name: part[rows] for name, part in parts.items() if isinstance(part, np.ndarray)}
        logs = {name: values[rows] for name, values in batch.logs.items()}
        return dataclasses.replace(batch, logs=logs, **arrays)
