"""The commands that make figures and tables for papers."""

from __future__ import annotations

import functools
from collections.abc import Callable
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from crowdbench.cli.console import say
from crowdbench.utils.errors import InputError
from crowdbench.utils.tables import Format, floating, format_tables

METRIC = "metric"


class Kind(StrEnum):
    """What a figure shows."""

    SUCCESS = "success"
    METRIC = "metric"
    DENSITY = "density"
    TRAINING = "training"


def table(
    directories: list[Path],
    columns: str = METRIC,
    metric: list[str] | None = None,
    caption: str | None = None,
    label: str | None = None,
    format: Format = Format.MARKDOWN,
) -> None:
    """Print a table of runs: means with 95 % intervals, a row for each planner.

    Args:
        directories: Directories of runs.
        columns: metric: a column for each metric. scenario, or an option or key such as weights: a column for each
            scenario or value, with one metric in the cells, the best of a column bold, and those marked that cannot be
            told from it.
        metric: A metric. Repeatable where metrics are columns; else those that most papers have, or success_rate.
        caption: With --format latex, the caption of a floating table.
        label: With --format latex, its label.
    """
    from crowdbench.metrics import MAIN
    from crowdbench.runs.table import PRIVILEGED, RunTable

    if (caption or label) and format is not Format.LATEX:
        raise InputError("--caption and --label go with --format latex")
    if columns == METRIC:
        runs = RunTable.read(directories)
        grid = runs.grid(metric or MAIN)
        note = PRIVILEGED if any(run.result["stated"]["privileged"] for run in runs.runs) else ""
    elif len(metric or []) > 1:
        raise InputError(f"a table with --columns {columns} shows one metric: give --metric once")
    else:
        grid, note = RunTable.read(directories, columns).cross((metric or ["success_rate"])[0])
    text = format_tables([grid], format)
    if format is Format.LATEX:
        text = floating(text, caption, label, note)
    elif format is Format.MARKDOWN and note:
        text = f"{text}\n\n{note}"
    print(text)


def plot(kind: Kind, directories: list[Path], metric: str | None = None, out: Path = Path("figure.pdf")) -> None:
    """Draw a figure of runs, or of trainings, as wide as a column of a paper.

    Args:
        kind: success: cases solved over time. metric: the distribution of --metric. density: success over the number
            of pedestrians. training: --metric, a column of their curve.csv such as reward, or else success, while they
            trained.
        directories: Directories of runs; for training, of trainings.
        metric: The metric of a figure of kind metric.
        out: The figure: a .pdf, .svg or .png file.
    """
    from crowdbench.figures import plots

    if kind is Kind.METRIC and metric is None:
        raise InputError("a figure of kind metric needs --metric NAME")
    if kind in (Kind.SUCCESS, Kind.DENSITY) and metric is not None:
        raise InputError(f"a figure of kind {kind} takes no --metric: only metric and training do")
    draw: dict[Kind, Callable[..., None]] = {
        Kind.SUCCESS: plots.success_over_time,
        Kind.METRIC: functools.partial(plots.distribution, metric=str(metric)),
        Kind.DENSITY: plots.success_over_density,
        Kind.TRAINING: functools.partial(plots.learning_curves, quantity=metric or "success"),
    }
    draw[kind](directories, out=out)
    say(f"wrote {out}")


def render(
    what: str,
    case: Annotated[str, typer.Option()],
    strip: Annotated[int | None, typer.Option(min=1, max=12)] = None,
    zoom: Annotated[float | None, typer.Option(min=1.0, max=100.0)] = None,
    out: Path = Path("case.png"),
    data: Path | None = None,
) -> None:
    """Draw a recorded case from above, as a figure or a film, or how a case of a scenario starts. No viewer is needed.

    Args:
        what: Directory of a run, an .rrd file, or a scenario: a name, or ./mine.toml.
        case: The recorded case or, of a scenario, any case: val/37, or a number (of a scenario: of a test case).
        strip: Draw so many moments side by side instead of the whole way.
        zoom: Show so many metres around the vehicle; a film and moments follow it.
        out: A figure (.pdf, .svg or .png) or a film (.gif, or .mp4 with ffmpeg).
    """
    from crowdbench.cli.results import recording_of
    from crowdbench.figures import episode
    from crowdbench.record.cases import find_case
    from crowdbench.scenario.cases import parse_case

    if strip is not None and out.suffix in episode.FILMS:
        raise InputError("--strip draws a figure: leave it out, or give a .pdf, .svg or .png file with --out")
    if Path(what).is_dir() or what.endswith(".rrd"):
        if data is not None:
            raise InputError("--data is for a scenario: a recording says where everybody walked")
        recording = recording_of(Path(what))
        episode.draw_case(recording, find_case(recording, case), out, strip, zoom)
    else:
        for name, given in (("strip", strip), ("zoom", zoom)):
            if given is not None:
                raise InputError(f"--{name} is for a recorded case: a scenario has its start alone")
        from crowdbench.catalog import load_scenario

        scenario = load_scenario(what, data=data)
        scenario.check_data(data)
        episode.draw_start(scenario, *parse_case(case, "test"), out)
    say(f"wrote {out}")
