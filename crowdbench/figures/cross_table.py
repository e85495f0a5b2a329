"""A table of one metric for a paper: planners in its rows, scenarios or values of an option in its columns."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from crowdbench.figures.table import with_interval
from crowdbench.metrics import MORE_IS_BETTER, heading, no_metric
from crowdbench.metrics.summary import Estimate
from crowdbench.runs.compare import compare
from crowdbench.runs.paired import holm
from crowdbench.runs.store import RunResult
from crowdbench.utils.errors import InputError
from crowdbench.utils.tables import Grid

SCENARIO = "scenario"

NOTE = "Bold: the best of a column. †: not distinguishable from it, paired by case ({test})."
RATES = "p ≥ 0.05 by McNemar's exact test, corrected for the runs of the column by Holm's method"
MEANS = "the 95 % interval of the difference, over the cases that both solve or over all, holds 0"


def cross_table(directories: Sequence[Path], columns: str, metric: str) -> tuple[Grid, str]:
    """A metric of runs with 95 % intervals, a row for each planner.

    Args:
        directories: Those of the runs.
        columns: What the columns are: `scenario`, or the name of an option of the planner or of a key of the scenario,
            such as `weights` or `seed`.
        metric: The name of the metric.

    Returns:
        The table, and what its marks mean.

    Raises:
        InputError: One of them is not a run, has no such metric, or is in the same place of the table as another.
    """
    runs = [RunResult.read(directory) for directory in directories]
    placed: dict[str, dict[str, RunResult]] = {}
    for run in runs:
        row, column = _place(run, columns)
        if column in placed.setdefault(row, {}):
            other = placed[row][column].directory
            raise InputError(f"{run.directory} and {other} are both of {row} and {column}: leave one of them out")
        placed[row][column] = run
    names = list(dict.fromkeys(column for row in placed.values() for column in row))
    is_rate = all(metric in run.episodes.rates for run in runs)
    found = {row: {name: _estimate(run, metric) for name, run in own.items()} for row, own in placed.items()}
    marks = {name: _mark({row: own[name] for row, own in placed.items() if name in own}, metric) for name in names}
    rows = [
        [row, *(_cell(found[row].get(name), marks[name].get(row, ""), is_rate) for name in names)] for row in placed
    ]
    records = [{"planner": row, **own} for row, own in found.items()]
    title = heading(metric, is_rate)
    grid = Grid(title, [title, *names], rows, records)
    return grid, NOTE.format(test=RATES if is_rate else MEANS)


def _place(run: RunResult, columns: str) -> tuple[str, str]:
    """The row and the column of a run. Raises InputError where it has no such option or key."""
    result = run.result
    if columns == SCENARIO:
        return run.label, result["scenario"]["name"]
    planner, overrides = result["run"]["planner"], result["stated"]["overrides"]
    values = {**overrides, **planner["options"]}
    if columns not in values:
        raise InputError(f"{run.directory} was made without {columns}: name an option or a key that all runs have set")
    options = {name: value for name, value in planner["options"].items() if name != columns}
    label = planner["name"] + (f" ({', '.join(f'{k}={v}' for k, v in options.items())})" if options else "")
    return label, f"{columns}={values[columns]}"


def _estimate(run: RunResult, metric: str) -> Estimate:
    found = run.episodes.summary()
    if metric not in found:
        raise InputError(f"{run.directory} {no_metric(metric, found)}")
    return found[metric]


def _mark(column: dict[str, RunResult], metric: str) -> dict[str, str]:
    """`best` for the best run of a column, and † for those that cannot be told from it."""
    means = {row: _estimate(run, metric).mean for row, run in column.items()}
    known = {row: mean for row, mean in means.items() if not math.isnan(mean)}
    if len(known) < 2:
        return {}
    best = (max if metric in MORE_IS_BETTER else min)(known, key=lambda row: known[row])
    others = [row for row in known if row != best]
    differences = [compare(column[best].directory, column[row].directory).rows[metric] for row in others]
    if all(each.p is not None for each in differences):
        same = holm(np.array([each.p for each in differences], float)) >= 0.05
    else:
        same = np.array([each.difference.low <= 0.0 <= each.difference.high for each in differences])
    return {best: "best", **{row: "†" for row, is_same in zip(others, same, strict=True) if is_same}}


def _cell(estimate: Estimate | None, mark: str, is_rate: bool) -> str:
    if estimate is None or math.isnan(estimate.mean):
        return ""
    factor, digits = (100.0, 1) if is_rate else (1.0, 2)
    mean, interval = with_interval(estimate, factor, digits).split(" ", 1)
    return f"{f'**{mean}**' if mark == 'best' else mean + mark} {interval}"
