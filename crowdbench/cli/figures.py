"""The commands that make figures and tables for papers."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated, Literal

import typer

from crowdbench.cli.console import announce_compilation, say
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
    format: Format = Format.MARKDOWN,
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
    from crowdbench.results.result_file import STATED
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
    cases = str(runs.runs[0].cases)
    records = [{**record, "cases": cases} for record in grid.records]
    text = format_tables([dataclasses.replace(grid, records=records)], format)
    for run in runs.runs:
        for warning in run.warnings:
            say(f"crowdbench: {warning}")
    say(STATED)
    if caption or label:
        text = floating(text, caption, label)
    print(text)


def plot(
    kind: Literal["success", "metric", "training"],
    directories: list[Path],
    metric: str | None = None,
    out: Path = Path("figure.pdf"),
) -> None:
    """Draw a figure of runs, or of trainings, as wide as a column of a paper.

    Args:
        kind: success: cases solved over time. metric: the distribution of --metric. training: --metric over training,
            a column of curve.csv such as reward; by default success.
        directories: Directories of runs; for training, of trainings.
        metric: The metric of a figure of kind metric.
        out: The figure: a .pdf, .svg or .png file.
    """
    from crowdbench.figures import plots

    if kind == "metric" and metric is None:
        raise InputError("a figure of kind metric needs --metric NAME")
    if kind == "success" and metric is not None:
        raise InputError(f"a figure of kind {kind} takes no --metric: only metric and training do")
    if kind == "success":
        plots.success_over_time(directories, out)
    elif kind == "metric":
        plots.distribution(directories, str(metric), out)
    else:
        plots.learning_curves(directories, out, metric or "success")
    say(f"wrote {out}")


def render(
    what: list[str],
    case: str | None = None,
    worst: str | None = None,
    strip: Annotated[int | None, typer.Option(min=1, max=12)] = None,
    zoom: Annotated[float | None, typer.Option(min=1.0, max=100.0)] = None,
    out: Path = Path("case.png"),
    pedestrians: list[str] | None = None,
    layout: str | None = None,
    data: Path | None = None,
) -> None:
    """Draw a case of a run from above, as a figure or a film, or the start of a case of a scenario.

    Several runs are drawn side by side in the same case, which is simulated again from its commands. Predicted and
    planned paths are drawn in recorded cases. No viewer is needed.

    Args:
        what: Directories of runs, or one scenario: a name, or ./mine.toml.
        case: The case: val/37, or its number; else the first failure of a run, or the first test case of a scenario.
        worst: The case of the (first) run in which this metric, such as minimum_gap, is worst.
        strip: Number of moments of one run that are drawn side by side, instead of the whole path.
        zoom: Number of metres around the vehicle that are shown; a film and moments follow the vehicle.
        out: A figure (.pdf, .svg or .png) or a film (.gif, .webp, or .mp4 with ffmpeg).
        pedestrians: Your file of a pedestrian policy that the run used, ./mine.py. Repeatable.
        layout: Your file of a layout that the run used, ./mine.py.
    """
    from crowdbench.cli.cases import choose_case, make_loader
    from crowdbench.figures import episode_figure as episode
    from crowdbench.scenario.cases import parse_case

    if strip is not None and (out.suffix in episode.FILMS or len(what) > 1):
        raise InputError(
            "--strip draws a figure of one run: leave it out, or give one run and a .pdf, .svg or .png file"
        )
    if all(Path(each).is_dir() for each in what):
        from crowdbench.results.run_result import RunResult

        runs = [RunResult.read(Path(each), tables_only=True) for each in what]
        number = choose_case(runs, case, worst)
        announce_compilation()
        episodes = episode.stored_episodes(runs, number, make_loader(pedestrians, layout, data), zoom)
        episode.draw_episodes(episodes, out, strip)
    else:
        if len(what) > 1:
            raise InputError(f"{' '.join(what)} are not all runs: give directories of runs, or one scenario")
        for name, given in (("strip", strip), ("zoom", zoom), ("worst", worst)):
            if given is not None:
                raise InputError(f"--{name} is for a case of a run: a scenario has its start alone")
        from crowdbench.catalog import load_scenario

        scenario = load_scenario(what[0], data=data)
        scenario.check_data(data)
        episode.draw_start(scenario, *parse_case(case or "0", "test"), out)
    say(f"wrote {out}")
