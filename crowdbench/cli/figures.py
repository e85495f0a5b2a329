"""The commands that draw figures for papers."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from crowdbench.errors import InputError


class Kind(StrEnum):
    """What a figure shows."""

    SUCCESS = "success"
    METRIC = "metric"
    DENSITY = "density"
    TRAINING = "training"


def plot(
    kind: Annotated[
        Kind,
        typer.Argument(
            help="success: cases solved over time. metric: the distribution of --metric. density: success over the "
            "number of pedestrians. training: success on validation cases."
        ),
    ],
    directories: Annotated[list[Path], typer.Argument(help="Directories of runs; for training, of trainings.")],
    metric: Annotated[str | None, typer.Option(help="The metric of a figure of kind metric.")] = None,
    out: Annotated[Path, typer.Option(help="The figure: a .pdf, .svg or .png file.")] = Path("figure.pdf"),
) -> None:
    """Draw a figure of runs, or of trainings, as wide as a column of a paper."""
    from crowdbench.cli.console import say
    from crowdbench.figures import plots

    if (kind is Kind.METRIC) != (metric is not None):
        raise InputError("a figure of kind metric needs --metric NAME, and no other one takes it")
    if kind is Kind.SUCCESS:
        plots.success_over_time(directories, out)
    elif kind is Kind.DENSITY:
        plots.success_over_density(directories, out)
    elif kind is Kind.TRAINING:
        plots.learning_curves(directories, out)
    else:
        plots.distribution(directories, str(metric), out)
    say(f"wrote {out}")
