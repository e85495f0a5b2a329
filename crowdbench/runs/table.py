"""One table of runs on disk: planners by metrics or scenarios, with 95 % intervals and paired tests."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

from crowdbench.metrics import MAIN, METRICS, Metric, MetricInfo, info_of, no_metric
from crowdbench.metrics.summary import UNDEFINED, Estimate
from crowdbench.runs.compare import check_comparable, compare_results, correct
from crowdbench.runs.results import planner_label
from crowdbench.runs.store import RunResult
from crowdbench.utils.errors import InputError
from crowdbench.utils.tables import Grid

SCENARIO = "scenario"

NOTE = "Bold: the best of a column. †: not distinguishable from it, paired by case ({test})."
RATES = "p ≥ 0.05 by McNemar's exact test, corrected for the runs of the column by Holm's method"
MEANS = "the 95 % interval of the difference, over the cases that both solve or over all, holds 0"

PRIVILEGED = (
    r"\* uses the pedestrians' next velocities, which no vehicle could know: shown for comparison, never ranked."
)
"""A note on planners that are marked with an asterisk."""


@dataclass(frozen=True)
class RunTable:
    """Runs by column and planner. Runs in the same column have the same scenario and cases.

    Attributes:
        columns: The runs by planner of each scenario, or of each value of an option of the planner or key of the
            scenario.
    """

    columns: Mapping[str, Mapping[str, RunResult]]

    @classmethod
    def read(cls, directories: Sequence[Path], columns: str = SCENARIO) -> RunTable:
        """Read runs.

        Args:
            directories: Their directories.
            columns: `scenario`, or the name of an option of the planner or of a key of the scenario.

        Raises:
            InputError: A directory is not a run, was made without the option, or is in the same place as another; or
                runs in the same column have different scenarios or cases.
        """
        table: dict[str, dict[str, RunResult]] = {}
        for run in map(RunResult.read, directories):
            row, column = _row_and_column(run, columns)
            runs = table.setdefault(column, {})
            if row in runs:
                both = f"{run.directory} and {runs[row].directory}"
                raise InputError(f"{both} are both of {row} and {column}: leave one of them out")
            runs[row] = run
            first = next(iter(runs.values()))
            check_comparable(first, run)
            if first.cases != run.cases:
                raise InputError(
                    f"{first.directory} has the cases {first.cases} and {run.directory} has {run.cases}: "
                    "make both runs with the same cases"
                )
        return cls(table)

    @property
    def runs(self) -> list[RunResult]:
        """All runs."""
        return [run for runs in self.columns.values() for run in runs.values()]

    @property
    def labelled(self) -> dict[str, RunResult]:
        """All runs by planner, and by scenario too where there are several."""
        several = len(self.columns) > 1
        return {
            f"{planner}, {column}" if several else planner: run
            for column, runs in self.columns.items()
            for planner, run in runs.items()
        }

    def infos(self, metrics: Sequence[str]) -> dict[str, MetricInfo]:
        """Return the descriptions of metrics. Raises InputError where a run lacks one of them."""
        for run in self.runs:
            for name in metrics:
                if name not in run.episodes.columns:
                    raise InputError(f"the run of {run.label} {no_metric(name, run.episodes.columns)}")
        return {name: info_of(name, all(name in run.episodes.rates for run in self.runs)) for name in metrics}

    def grid(self, metrics: Sequence[str], solved: bool = False) -> Grid:
        """Return a row for each run and a column for each metric.

        Args:
            metrics: Names of metrics.
            solved: True for means over the cases that the planner itself solves, but for metrics that count failures.

        Raises:
            InputError: A run lacks one of the metrics.
        """
        infos, records = self.infos(metrics), []
        for scenario, runs in self.columns.items():
            for planner, run in runs.items():
                labels = {SCENARIO: scenario} if len(self.columns) > 1 else {}
                labels["planner"] = f"{planner} *" if run.result["stated"]["privileged"] else planner
                records.append({**labels, **estimates(run, infos, solved)})
        return estimate_grid(" and ".join(self.columns), records, infos)

    def cross(self, metric: str) -> tuple[Grid, str]:
        """Return one metric with a row for each planner, and what its marks mean. Raises InputError as `grid` does."""
        info = self.infos([metric])[metric]
        records: dict[str, dict[str, Any]] = {}
        cells: dict[str, dict[str, str]] = {}
        for column, runs in self.columns.items():
            means = {planner: estimates(run, {metric: info})[metric] for planner, run in runs.items()}
            marks = _mark(runs, means, metric, info)
            for planner, mean in means.items():
                records.setdefault(planner, {"planner": planner})[column] = mean
                cells.setdefault(planner, {})[column] = _cell(mean, marks.get(planner, ""), info)
        rows = [
            [planner, *(row.get(column, info.estimate(UNDEFINED)) for column in self.columns)]
            for planner, row in cells.items()
        ]
        note = NOTE.format(test=RATES if all(metric in run.episodes.rates for run in self.runs) else MEANS)
        return Grid(info.heading, [info.heading, *self.columns], rows, list(records.values())), note


def estimates(run: RunResult, infos: Mapping[str, MetricInfo], solved: bool = False) -> dict[str, Estimate]:
    """Return the means of metrics of a run with their intervals, see `RunTable.grid`."""
    episodes = run.episodes
    chosen = episodes.take(episodes.columns["success_rate"]) if solved else episodes
    count_all = {name for name, info in infos.items() if name in episodes.rates or info.over_all}
    return {name: (episodes if name in count_all else chosen).summary([name])[name] for name in infos}


def estimate_grid(
    title: str, records: Sequence[Mapping[str, Any]], infos: Mapping[str, MetricInfo], brief: Collection[str] = ()
) -> Grid:
    """Return a table of estimates.

    Args:
        title: Its title.
        records: For each row its labels by their headings, which are texts, and an `Estimate` by metric; one that is
            missing is undefined.
        infos: The descriptions of the metrics in the columns.
        brief: Metrics without their intervals.
    """
    labels = [name for name, value in records[0].items() if isinstance(value, str)]

    def cell(name: str, estimate: Estimate) -> str:
        return infos[name].number(estimate.mean) if name in brief else infos[name].estimate(estimate)

    rows = [
        [*(record[label] for label in labels), *(cell(name, record.get(name, UNDEFINED)) for name in infos)]
        for record in records
    ]
    header = [*labels, *(info.heading for info in infos.values())]
    return Grid(title, header, rows, records, align=("l" * len(labels)).ljust(len(header), "r"))


def metric_grid(
    title: str,
    estimates: Mapping[str, Estimate],
    rates: Collection[str],
    functions: Mapping[str, Metric] = MappingProxyType({}),
    all_metrics: bool = True,
) -> Grid:
    """Return the estimates of one run with a row for each metric, by the name that commands take.

    Args:
        title: Its title.
        estimates: The estimates by metric.
        rates: The metrics that are rates.
        functions: Metrics of a user by name, whose units are shown.
        all_metrics: False for those in `MAIN` and those of a user alone.
    """
    of_user = [name for name in estimates if name not in METRICS]
    rows = []
    for name in estimates if all_metrics else [*(name for name in MAIN if name in estimates), *of_user]:
        estimate, info = estimates[name], info_of(name, name in rates, functions.get(name))
        if estimate.n:
            largest = "" if name in rates else info.number(estimate.max)
            interval = info.interval(estimate.low, estimate.high)
            rows.append((name, info.amount(estimate.mean), interval, largest, str(estimate.n)))
    return Grid(title, ("metric", "mean", "95 % interval", "max", "n"), rows, align="lrlrr")


def _row_and_column(run: RunResult, columns: str) -> tuple[str, str]:
    """The row and the column of a run. Raises InputError where it has no such option or key."""
    planner, overrides = run.result["run"]["planner"], run.result["stated"]["overrides"]
    if columns == SCENARIO:
        return run.label, ", ".join([run.result["scenario"]["name"], *(f"{k}={v}" for k, v in overrides.items())])
    values = {**overrides, **planner["options"]}
    if columns not in values:
        raise InputError(f"{run.directory} was made without {columns}: name an option or a key that all runs have set")
    options = {name: value for name, value in planner["options"].items() if name != columns}
    return planner_label(planner["name"], options), f"{columns}={values[columns]}"


def _mark(
    runs: Mapping[str, RunResult], means: Mapping[str, Estimate], metric: str, info: MetricInfo
) -> dict[str, str]:
    """`best` for the best run of a column, and † for those that cannot be told from it."""
    known = {planner: info.sign * mean.mean for planner, mean in means.items() if not math.isnan(mean.mean)}
    if len(known) < 2 or not info.sign:
        return {}
    best = max(known, key=lambda planner: known[planner])
    others = [planner for planner in known if planner != best]
    comparisons = correct([compare_results(runs[best], runs[planner], [metric]) for planner in others])
    marks = {best: "best"}
    for planner, row in zip(others, (comparison.rows[metric] for comparison in comparisons), strict=True):
        if row.difference.low <= 0.0 <= row.difference.high if row.corrected is None else row.corrected >= 0.05:
            marks[planner] = "†"
    return marks


def _cell(estimate: Estimate, mark: str, info: MetricInfo) -> str:
    mean, *interval = info.estimate(estimate).split(" ", 1)
    return " ".join([f"**{mean}**" if mark == "best" else mean + mark, *interval])
