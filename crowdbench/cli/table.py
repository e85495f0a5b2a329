"""The command that prints a table of runs."""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path
from typing import Annotated

import typer

from crowdbench.cli.console import print_table, say
from crowdbench.utils.errors import InputError
from crowdbench.utils.tables import Format, floating, format_tables

METRIC = "metric"

OF_A_COLUMN = ("success_rate", "collision_rate", "navigation_time", "jerk")
"""The default metrics of a LaTeX table: they fit a column of a paper."""


def table(
    directories: list[Path],
    columns: str = METRIC,
    metric: list[str] | None = None,
    all_metrics: bool = False,
    names: str | None = None,
    caption: str | None = None,
    label: str | None = None,
    format: Annotated[Format | None, typer.Option(show_default="markdown in files, else for the terminal")] = None,
) -> None:
    """Print a table of runs of the same cases: means with 95 % intervals, a row for each planner.

    Args:
        directories: Directories of runs.
        columns: metric: a column for each metric. scenario, or an option or key such as weights: a column for each
            scenario or value, with one metric in the cells. The best value of a column is bold, and values that do not
            differ significantly from it are marked.
        metric: A metric. Repeatable if metrics are columns. By default, the metrics of most papers (in LaTeX, those
            that fit a column of a paper), or success_rate.
        all_metrics: Print all metrics, a row for each; the runs are columns.
        names: Names of the runs, such as "old,new". By default, the names of their planners, or of their folders for
            versions of one planner.
        caption: With --format latex, the caption of a floating table.
        label: With --format latex, its label.
    """
    from crowdbench.metrics.registry import MAIN
    from crowdbench.results.table import SCENARIO, RunTable

    if (caption or label) and format is not Format.LATEX:
        raise InputError("--caption and --label go with --format latex")
    if all_metrics and (metric or columns != METRIC):
        raise InputError("--all-metrics shows all metrics in rows: leave out --metric and --columns")
    if columns != METRIC and len(metric or []) > 1:
        raise InputError(f"a table with --columns {columns} shows one metric: give --metric once")
    column = SCENARIO if columns == METRIC else columns
    runs = RunTable.read(directories, column, names.split(",") if names else [])
    if all_metrics:
        grid = runs.all_metrics()
    elif columns == METRIC:
        grid = runs.grid(metric or (OF_A_COLUMN if format is Format.LATEX else MAIN))
    else:
        grid = runs.cross((metric or ["success_rate"])[0])
    for run in runs.runs:
        for warning in run.warnings:
            say(f"crowdbench: {warning}")
    if format is None and sys.stdout.isatty():
        print_table(grid)
        return
    cases = str(runs.runs[0].cases)
    records = [{**record, "cases": cases} for record in grid.records]
    text = format_tables([dataclasses.replace(grid, records=records)], format or Format.MARKDOWN)
    if caption or label:
        text = floating(text, caption, label)
    print(text)
