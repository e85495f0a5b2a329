"""Tables of stored runs: planners by metrics or scenarios, with 95 % intervals and paired tests."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

from crowdbench.metrics.registry import MAIN, METRICS, Metric, MetricInfo, info_of, no_metric
from crowdbench.metrics.summary import LEAST_CASES, UNDEFINED, Estimate
from crowdbench.results.compare import check_comparable, compare_results, correct
from crowdbench.results.episodes import planner_label
from crowdbench.results.run_result import RunResult
from crowdbench.utils.errors import InputError
from crowdbench.utils.tables import Grid

SCENARIO = "scenario"

Records = Sequence[Mapping[str, Any]]
"""The rows of a table, see `estimate_grid`."""

NOTE = "Bold: the best of a column. †: not distinguishable from it, paired by case ({test})."
BEST = "best"
FEWER = "[n]: a mean over n cases only, those in which it is defined."
RATES = "p ≥ 0.05 by McNemar's exact test, corrected for the runs of the column by Holm's method"
MEANS = (
    "the 95 % interval of the difference, over the cases that both solve or over all, holds 0, or these are fewer than "
    f"{LEAST_CASES}"
)
NO_INTERVAL = f"Intervals are left out where a mean is over fewer than {LEAST_CASES} independent cases."

PRIVILEGED = (
    r"\* is privileged: it uses the true next velocities of the pedestrians. Shown for comparison, never ranked."
)
"""A note on planners that are marked with an asterisk."""


@dataclass(frozen=True)
class RunTable:
    """Runs of the same cases, by column and planner. Runs in the same column have the same scenario.

    Attributes:
        columns: The runs by planner of each scenario, or of each value of an option of the planner or key of the
            scenario.
    """

    columns: Mapping[str, Mapping[str, RunResult]]

    @classmethod
    def read(cls, directories: Sequence[Path], columns: str = SCENARIO, names: Sequence[str] = ()) -> RunTable:
        """Read runs.

        Args:
            directories: Their directories.
            columns: `scenario`, or the name of an option of the planner or of a key of the scenario.
            names: Names of the runs. If empty: their planners, or their folders if one planner has several versions.

        Raises:
            InputError: A directory is not a run, lacks the option, or has the same row and column as another; runs have
                different cases, or runs in a column different scenarios; or the number of names is wrong.
        """
        table: dict[str, dict[str, RunResult]] = {}
        runs = [RunResult.read(directory, tables_only=True) for directory in directories]
        places = [_row_and_column(run, columns) for run in runs]
        if names and len(names) != len(runs):
            raise InputError(f"there are {len(names)} names of {len(runs)} runs: give one for each, in the same order")
        rows = names or _row_names(runs, places)
        for run, row, (_, column) in zip(runs, rows, places, strict=True):
            if run.cases != runs[0].cases:
                both = f"{runs[0].directory} has the cases {runs[0].cases} and {run.directory} has {run.cases}"
                raise InputError(f"{both}: make all runs with the same cases")
            of_column = table.setdefault(column, {})
            if row in of_column:
                both = f"{run.directory} and {of_column[row].directory}"
                raise InputError(f"{both} are both of {row} and {column}: leave one of them out")
            of_column[row] = run
            check_comparable(next(iter(of_column.values())), run)
        return cls(table)

    @property
    def cases(self) -> str:
        """The cases of every run, and their number."""
        return f"cases {self.runs[0].cases}, n = {len(self.runs[0].episodes)}"

    @property
    def runs(self) -> list[RunResult]:
        """All runs."""
        return [run for runs in self.columns.values() for run in runs.values()]

    @property
    def labelled(self) -> dict[str, RunResult]:
        """All runs by planner, and also by scenario if there are several."""
        several = len(self.columns) > 1
        return {
            f"{planner}, {column}" if several else planner: run
            for column, runs in self.columns.items()
            for planner, run in runs.items()
        }

    def infos(self, metrics: Sequence[str]) -> dict[str, MetricInfo]:
        """Return the descriptions of metrics. Raises InputError if a run lacks one of them."""
        for run in self.runs:
            for name in metrics:
                if name not in run.episodes.columns:
                    raise InputError(f"the run of {run.label} {no_metric(name, run.episodes.columns)}")
        return {name: info_of(name, all(name in run.episodes.rates for run in self.runs)) for name in metrics}

    def grid(self, metrics: Sequence[str], solved: bool = False) -> Grid:
        """Return a row for each run and a column for each metric.

        Args:
            metrics: Names of metrics.
            solved: True for means over the cases that the planner solves, except for metrics that count failures.

        Raises:
            InputError: A run lacks one of the metrics.
        """
        infos, records = self.infos(metrics), []
        for scenario, runs in self.columns.items():
            for planner, run in runs.items():
                labels = {SCENARIO: scenario} if len(self.columns) > 1 else {}
                labels["planner"] = _starred(planner, run)
                records.append({**labels, **estimates(run, infos, solved)})
        grid = estimate_grid(" and ".join(self.columns), records, infos, cases=len(self.runs[0].episodes))
        return self._with_note(grid)

    def all_metrics(self) -> Grid:
        """Return a row for each metric that all runs have, and a column for each run."""
        shared = [n for n in self.runs[0].episodes.columns if all(n in run.episodes.columns for run in self.runs)]
        infos, cases = self.infos(shared), len(self.runs[0].episodes)
        found = {label: estimates(run, infos) for label, run in self.labelled.items()}
        grid = estimate_grid("all metrics", list(found.values()), infos, cases=cases)
        records = [{"metric": name} | {label: of_run[name] for label, of_run in found.items()} for name in infos]
        rows = list(zip(grid.header, *grid.rows, strict=True))
        return self._with_note(Grid(grid.title, ["metric", *found], rows, records))

    def cross(self, metric: str) -> Grid:
        """Return one metric with a row for each planner, and a column for each scenario or value of an option.

        Raises InputError as `grid` does.
        """
        info, cases = self.infos([metric])[metric], len(self.runs[0].episodes)
        records: dict[str, dict[str, Any]] = {}
        cells: dict[str, dict[str, str]] = {}
        for column, runs in self.columns.items():
            means = {planner: estimates(run, {metric: info})[metric] for planner, run in runs.items()}
            marks = _mark(runs, means, metric, info)
            for planner, mean in means.items():
                row = _starred(planner, runs[planner])
                records.setdefault(row, {"planner": row})[column] = mean
                cells.setdefault(row, {})[column] = _cell(info, mean, cases, marks.get(planner, ""))
        missing = info.number(math.nan)
        rows = [[row, *(of_row.get(column, missing) for column in self.columns)] for row, of_row in cells.items()]
        marked = NOTE.format(test=RATES if all(metric in run.episodes.rates for run in self.runs) else MEANS)
        return self._with_note(Grid(info.heading, [info.heading, *self.columns], rows, list(records.values())), marked)

    def _with_note(self, grid: Grid, marks: str = "") -> Grid:
        """Return a table with a note on its cases, and on the marks of its cells."""
        has_fewer = any(" [" in cell for row in grid.rows for cell in row)
        shown = [value for record in grid.records for value in record.values() if isinstance(value, Estimate)]
        has_privileged = any(run.result["stated"]["privileged"] for run in self.runs)
        weak = _left_out(shown)
        notes = [f"{self.cases.capitalize()}.", marks, FEWER * has_fewer, weak, PRIVILEGED * has_privileged]
        return replace(grid, note=" ".join(filter(None, notes)))


def estimates(run: RunResult, infos: Mapping[str, MetricInfo], solved: bool = False) -> dict[str, Estimate]:
    """Return the means of metrics of a run with their intervals, unless they are over fewer than `LEAST_CASES` cases.

    See `RunTable.grid`.

    Args:
        run: The run.
        infos: The descriptions of the metrics, by name.
        solved: True for the mean over solved cases, except for rates and for metrics that include failures.
    """
    episodes = run.episodes
    chosen = episodes.take(episodes.columns["success_rate"]) if solved else episodes
    count_all = {name for name, info in infos.items() if name in episodes.rates or info.over_all}
    found = {name: (episodes if name in count_all else chosen).summary([name])[name] for name in infos}
    return {name: estimate.for_display(episodes.blocks.get("blocks")) for name, estimate in found.items()}


def _left_out(estimates: Iterable[Estimate]) -> str:
    """Return a note if the interval of an estimate is left out."""
    return NO_INTERVAL if any(estimate.n and math.isnan(estimate.low) for estimate in estimates) else ""


def estimate_grid(
    title: str, records: Records, infos: Mapping[str, MetricInfo], brief: Collection[str] = (), cases: int = 0
) -> Grid:
    """Return a table of estimates.

    Args:
        title: Its title.
        records: For each row, its labels (texts) by heading, and an `Estimate` by metric; a missing estimate is
            undefined.
        infos: The descriptions of the metrics in the columns.
        brief: Metrics to show without their intervals.
        cases: Number of cases of each row: estimates over fewer cases are marked.
    """
    labels = [name for name, value in records[0].items() if isinstance(value, str)]

    def cell(name: str, estimate: Estimate) -> str:
        return infos[name].number(estimate.mean) if name in brief else _cell(infos[name], estimate, cases)

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
    blocks: int | None = None,
) -> Grid:
    """Return the estimates of one run with a row for each metric.

    Args:
        title: Its title.
        estimates: The estimates by metric.
        rates: The metrics that are rates.
        functions: Metrics of a user by name, whose units are shown.
        all_metrics: True for all metrics, with their names in commands; False for only `MAIN` and the metrics of the
            user.
        blocks: The number of blocks of recorded time; None if no pedestrians are recorded.
    """
    estimates = {name: estimate.for_display(blocks) for name, estimate in estimates.items()}
    of_user = [name for name in estimates if name not in METRICS]
    names = list(estimates) if all_metrics else [*(name for name in MAIN if name in estimates), *of_user]
    rows = []
    for name in names:
        estimate, info = estimates[name], info_of(name, name in rates, functions.get(name))
        if estimate.n:
            largest = "" if name in rates else info.number(estimate.max)
            interval = "" if math.isnan(estimate.low) else info.interval(estimate.low, estimate.high)
            labels = (info.title, name) if all_metrics else (info.title,)
            rows.append((*labels, info.amount(estimate.mean), interval, largest, str(estimate.n)))
    labels = ("metric", "name") if all_metrics else ("metric",)
    header, note = (*labels, "mean", "95 % interval", "max", "n"), _left_out(estimates[name] for name in names)
    return Grid(title, header, rows, align="l" * len(labels) + "rlrr", note=note)


def _row_names(runs: Sequence[RunResult], places: Sequence[tuple[str, str]]) -> list[str]:
    """Return the row names of runs: their planners, or their folders if a planner has several versions in a column."""
    ids: dict[tuple[str, str], set[str]] = {}
    for run, place in zip(runs, places, strict=True):
        ids.setdefault(place, set()).add(run.result["id"])
    versions = {planner for (planner, _), different in ids.items() if len(different) > 1}
    folders = [run.directory.resolve().name for run in runs]
    if len(set(folders)) < len(folders):
        folders = [str(run.directory) for run in runs]
    return [folder if row in versions else row for folder, (row, _) in zip(folders, places, strict=True)]


def _starred(planner: str, run: RunResult) -> str:
    """Return the name of a planner, with an asterisk if it is privileged."""
    return f"{planner} *" if run.result["stated"]["privileged"] else planner


def _row_and_column(run: RunResult, columns: str) -> tuple[str, str]:
    """Return the row and the column of a run. Raises InputError if it has no such option or key."""
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
    """Return `BEST` for the best runs of a column, which have the same rounded mean, and † for runs without a
    significant difference from them."""
    known = {planner: info.sign * mean.mean for planner, mean in means.items() if not math.isnan(mean.mean)}
    if len(known) < 2 or not info.sign:
        return {}
    best = max(known, key=lambda planner: known[planner])
    shown = info.number(means[best].mean)
    marks = {planner: BEST for planner in known if info.number(means[planner].mean) == shown}
    others = [planner for planner in known if planner not in marks]
    comparisons = correct([compare_results(runs[best], runs[planner], [metric]) for planner in others])
    for planner, row in zip(others, (comparison.rows[metric] for comparison in comparisons), strict=True):
        if not row.is_significant:
            marks[planner] = "†"
    return marks


def _cell(info: MetricInfo, estimate: Estimate, cases: int, mark: str = "") -> str:
    """Return an estimate with its mark, and with the number of its cases in brackets if they are fewer."""
    mean, *interval = info.estimate(estimate).split(" ", 1)
    fewer = [f"[{estimate.n}]"] if 0 < estimate.n < cases else []
    return " ".join([f"**{mean}**" if mark == BEST else mean + mark, *interval, *fewer])
