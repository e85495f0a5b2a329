"""A table of several runs for a paper."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

from crowdbench.figures.series import runs
from crowdbench.metrics import heading, no_metric
from crowdbench.metrics.summary import Estimate
from crowdbench.runs.compare import Comparison
from crowdbench.runs.paired import MetricDifference
from crowdbench.runs.store import RunResult
from crowdbench.utils.errors import InputError
from crowdbench.utils.tables import Grid

DEFAULT = (
    "success_rate",
    "collision_rate",
    "at_fault_rate",
    "timeout_rate",
    "navigation_time",
    "minimum_gap",
    "jerk",
)
"""The metrics of a table where none are asked for."""


def table(directories: Sequence[Path], metrics: Sequence[str]) -> Grid:
    """The means of metrics of runs with 95 % intervals, a row for each run.

    Args:
        directories: Those of the runs.
        metrics: Names of metrics; the default ones if none are given.

    Raises:
        InputError: One of them is not a run, or has no such metric.
    """
    found = runs(directories)
    names = list(metrics or DEFAULT)
    rows = {label: _row(label, run, names) for label, run in found.items()}
    rates = {name for name in names if all(name in run.episodes.rates for run in found.values())}
    return Grid(
        "runs",
        ["planner", *(heading(name, name in rates) for name in names)],
        [[label, *_cells(row, rates)] for label, row in rows.items()],
        [{"planner": label, **row} for label, row in rows.items()],
    )


def comparison(found: Sequence[Comparison], metrics: Sequence[str]) -> Grid:
    """Runs beside the one that each was compared with, as `compare_to` does: a row for each metric, scenario and run.

    Args:
        found: What was found, of the same reference in each.
        metrics: Names of metrics; the default ones that the runs have if none are given.

    Raises:
        InputError: A run has no such metric.
    """
    first, *others = [one.rows for one in found]
    shared = [name for name in first if all(name in rows for rows in others)]
    if lacking := [name for name in metrics if name not in shared]:
        raise InputError(f"not all runs have a metric {lacking[0]}; they have {', '.join(shared)}")
    rows, records = [], []
    for name in metrics or [name for name in DEFAULT if name in shared]:
        is_rate = first[name].p is not None
        for one in found:
            row = one.rows[name]
            rows.append([heading(name, is_rate), one.scenario, one.names[1], *_compared(row, is_rate)])
            about = {"metric": name, "scenario": one.scenario, "reference": one.names[0], "run": one.names[1]}
            records.append({**about, "cases": one.cases, **vars(row)})
    reference, several = found[0].names[0], len({one.scenario for one in found}) > 1
    header = ["metric", "scenario", "run", reference, "the run", "difference (95 % interval)", "p", "p corrected"]
    shown = [number for number, name in enumerate(header) if _is_shown(name, several, len(found) > 1)]
    return Grid("comparison", [header[n] for n in shown], [[row[n] for n in shown] for row in rows], records)


def _is_shown(column: str, several_scenarios: bool, several_tests: bool) -> bool:
    return {"scenario": several_scenarios, "p corrected": several_tests}.get(column, True)


def _compared(row: MetricDifference, is_rate: bool) -> list[str]:
    """Both means, the difference with its interval, and the p-values."""
    if not row.difference.n:
        return [""] * 5
    factor, digits = (100.0, 1) if is_rate else (1.0, 3)
    means = [f"{factor * value:.{digits}f}" for value in (row.a, row.b)]
    tests = ["" if p is None else f"{p:.2g}" for p in (row.p, row.corrected)]
    return [*means, with_interval(row.difference, factor, digits), *tests]


def with_interval(estimate: Estimate, factor: float, digits: int) -> str:
    """A mean with its interval."""
    mean, low, high = (f"{factor * value:.{digits}f}" for value in (estimate.mean, estimate.low, estimate.high))
    return f"{mean} ({low} to {high})"


def _row(label: str, run: RunResult, names: Sequence[str]) -> dict[str, Estimate]:
    """The estimates of a run. Raises InputError where it lacks a metric."""
    found = run.episodes.summary()
    if lacking := [name for name in names if name not in found]:
        raise InputError(f"the run of {label} {no_metric(lacking[0], found)}")
    return {name: found[name] for name in names}


def _cells(row: Mapping[str, Estimate], rates: set[str]) -> list[str]:
    """The cells of a row."""
    formats = {name: (100.0, 1) if name in rates else (1.0, 2) for name in row}
    return ["" if math.isnan(one.mean) else with_interval(one, *formats[name]) for name, one in row.items()]
