"""Figures of runs and trainings: success over time, distributions of a metric, learning curves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from crowdbench.core.types import Outcome
from crowdbench.drawing import FONT_SIZE
from crowdbench.figures.style import COLOURS, DASHES, FIGURE_HEIGHT, axes, canvas
from crowdbench.metrics.summary import LEAST_CASES, bootstrap, rate
from crowdbench.results.table import RunTable
from crowdbench.utils import files
from crowdbench.utils.errors import InputError

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from crowdbench.results.run_result import RunResult

CURVE, CARD = "curve.csv", "weights.json"
"""The files of a training with the data for figures."""

_POWERS = str.maketrans({"^": "", "2": "²", "3": "³"})

MOMENTS = 60
"""Number of times at which the interval of a success curve is computed."""


def success_over_time(directories: Sequence[Path], out: Path) -> None:
    """Draw the share of solved cases over time, with 95 % intervals from the first success on.

    Args:
        out: The figure's file.

    Raises:
        InputError: One of them is not a run, they are too many, or the file cannot be written.
    """
    table, ends = RunTable.read(directories), {}
    limit = max(map(_last_time, table.labelled.values()))
    with axes(out, caption=table.cases) as ax:
        for number, (label, run) in enumerate(table.labelled.items()):
            dt = float(run.result["scenario"]["dt"])
            episodes, line = run.episodes, _line(number)
            solved = np.where(episodes.outcome == Outcome.SUCCESS, episodes.steps * dt, np.inf)
            moments = np.linspace(min(solved.min(), limit), limit, MOMENTS + 1)
            rates = [rate(solved <= moment, episodes.block) for moment in moments]
            low, high = 100 * np.array([(estimate.low, estimate.high) for estimate in rates]).T
            times = np.unique(np.append(solved[np.isfinite(solved)], (0.0, limit)))
            share = [100 * float((solved <= time).mean()) for time in times]
            if episodes.blocks.get("blocks", len(episodes)) >= LEAST_CASES:
                ax.fill_between(moments, low, high, color=line["color"], alpha=0.15, linewidth=0)
            ax.plot(times, share, drawstyle="steps-post", **line)
            ends[label] = share[-1], line["color"]
        ax.set(xlabel="time, s", ylabel="cases solved, %", ylim=(0, 102), xlim=(0, limit))
        _label_ends(ax, ends)


def _last_time(run: RunResult) -> float:
    """Return the time limit of a run in seconds, or the duration of its longest episode if each case has a limit."""
    scenario = run.result["scenario"]
    is_common = "time_limit_factor" not in scenario
    return float(scenario["time_limit"] if is_common else scenario["dt"] * run.episodes.steps.max())


def _label_ends(ax: Axes, ends: Mapping[str, tuple[float, str]]) -> None:
    """Write names at the right of lines, below each other if lines end close together.

    Args:
        ax: The axes, whose values begin at 0.
        ends: The value at the end of each line, and its colour, by name.
    """
    line, top = FONT_SIZE / (72.0 * 0.7 * FIGURE_HEIGHT) * ax.get_ylim()[1], np.inf
    for below, (name, (value, color)) in enumerate(sorted(ends.items(), key=lambda end: -end[1][0])):
        top = max(min(value, top - line), line * (len(ends) - 1 - below))
        ax.plot([1.0, 1.04], [value, top], color=color, transform=ax.get_yaxis_transform(), clip_on=False)
        ax.text(1.05, top, name, transform=ax.get_yaxis_transform(), va="center")


def distribution(directories: Sequence[Path], metric: str, out: Path) -> None:
    """Draw a metric over the cases of runs: quartiles, 5th and 95th percentile, and the mean with its 95 % interval.

    Args:
        metric: The metric's name.
        out: The figure's file.

    Raises:
        InputError: One of them is not a run, or has no such metric, or the file cannot be written.
    """
    table = RunTable.read(directories)
    runs, info = table.labelled, table.infos([metric])[metric]
    values, means, names = [], [], []
    for label, run in runs.items():
        column = info.factor * run.episodes.columns[metric].astype(float)
        defined = column[np.isfinite(column)]
        if len(defined) == 0:
            raise InputError(f"{metric} is not defined in any case of the run of {label}")
        values.append(defined)
        mean = bootstrap(column, np.ones(len(column)), run.episodes.block)
        means.append(mean.for_display(run.episodes.blocks.get("blocks")))
        names.append(label if len(defined) == len(column) else f"{label} [{len(defined)}]")
    with axes(out, 0.8 + 0.35 * len(runs), table.cases) as ax:
        rows = list(range(len(runs), 0, -1))
        look: dict[str, Any] = {name: {"color": COLOURS[0]} for name in ("boxprops", "whiskerprops", "capprops")}
        look |= {"orientation": "horizontal", "showfliers": False, "medianprops": {"color": COLOURS[-1]}}
        ax.boxplot(values, positions=rows, whis=(5.0, 95.0), widths=0.5, **look)
        for row, mean in zip(rows, means, strict=True):
            ends = [[mean.mean - mean.low], [mean.high - mean.mean]]
            ax.errorbar([mean.mean], [row], xerr=ends, fmt="D", ms=3, color=COLOURS[5], capsize=2, zorder=3)
        ax.set_yticks(rows, names)
        ax.set(xlabel=info.heading.translate(_POWERS))
        ax.grid(visible=False, axis="y")


def draw_matrix(records: Sequence[Mapping[str, Any]], out: Path) -> None:
    """Draw the scores of planners (rows) among vehicles of other planners (columns), see `crowdbench cross`.

    Args:
        records: For each planner its name, and an `Estimate` by column.
        out: The figure's file.
    """
    columns = list(records[0])[1:]
    means = np.array([[record[column].mean for column in columns] for record in records])
    # The names of files are too long beside cells of the size of a number.
    names = [name.rpartition("/")[2] for name in (*columns, *(record["planner"] for record in records))]
    middle = (means.min() + means.max()) / 2.0
    with canvas(out, 1.5 + 0.34 * len(columns), 1.5 + 0.25 * len(records)) as figure:
        ax = figure.add_subplot()
        ax.imshow(means, "cividis", aspect="auto")
        ax.grid(visible=False)
        ax.set_xticks(range(len(columns)), names[: len(columns)], rotation=45, ha="right")
        ax.set_yticks(range(len(records)), names[len(columns) :])
        ax.set(xlabel="planner of the other vehicles", ylabel="planner")
        for (row, column), mean in np.ndenumerate(means):
            ink = "#101010" if mean > middle else "#f8f8f8"  # colours that no theme replaces
            ax.text(column, row, f"{mean:.2f}", ha="center", va="center", color=ink)


def learning_curves(directories: Sequence[Path], out: Path, quantity: str = "success") -> None:
    """Draw the curves of trainings: a thin line for each, a thick one for the mean over seeds.

    Args:
        directories: Directories of the trainings. Trainings of the same network in the same scenario form a group.
        out: The figure's file.
        quantity: A column of their curves, such as `reward`.

    Raises:
        InputError: One of them is not a training or has no such quantity, they are too many, or the file cannot be
            written.
    """
    from crowdbench.train.driving import VALIDATION_CASES

    groups = _read_trainings(directories, quantity)
    with axes(out, caption=f"cases {VALIDATION_CASES} of each validation scenario") as ax:
        from matplotlib.ticker import EngFormatter

        for number, (label, curves) in enumerate(groups.items()):
            axis, line = next(iter(curves[0])), _line(number)
            scale = 100.0 if quantity == "success" else 1.0
            end = min(float(curve[axis][-1]) for curve in curves)
            along = np.linspace(0.0, end, 100)
            mean = np.mean([np.interp(along, curve[axis], scale * curve[quantity]) for curve in curves], axis=0)
            if len(curves) > 1:
                label = f"{label}, {len(curves)} seeds"
                for curve in curves:
                    ax.plot(curve[axis], scale * curve[quantity], lw=0.5, alpha=0.5, color=line["color"])
            ax.plot(along, mean, label=label, **line)
            ax.set_xlabel(axis)
        ax.xaxis.set_major_formatter(EngFormatter(sep=""))
        ax.set(ylabel=quantity.replace("_", " "), xlim=(0, None))
        if quantity == "success":
            ax.set(ylabel="success on validation cases, %", ylim=(0, 102))
        ax.legend(loc="best")


def _read_trainings(
    directories: Sequence[Path], quantity: str
) -> dict[str, list[Mapping[str, Float[np.ndarray, "validation"]]]]:
    """Read the curves of trainings, grouped by network and scenario.

    Args:
        quantity: A column that all of them must have.

    Returns:
        The columns of each curve by name, by network and scenario.

    Raises:
        InputError: One of them is not a training, has no validation yet, or has no such column.
    """
    groups: dict[str, list[Mapping[str, np.ndarray]]] = {}
    for directory in directories:
        try:
            head, *rows = [line.split(",") for line in files.read_text(directory / CURVE).splitlines()]
            table = np.array(rows, float).reshape(len(rows), len(head))
        except (OSError, ValueError):
            raise InputError(f"{directory} is no directory of a training: it has no {CURVE} that can be read") from None
        if not rows:
            raise InputError(f"{directory / CURVE} has no validation yet")
        if quantity not in head:
            raise InputError(f"the training in {directory} has no {quantity}; it has {', '.join(head)}")
        groups.setdefault(_training_label(directory), []).append(dict(zip(head, table.T, strict=True)))
    return groups


def _training_label(directory: Path) -> str:
    """Return the network and the scenario of a finished training, or else the name of the directory."""
    try:
        card = files.read_json(directory / CARD)
        return f"{card['network']}, {card['training']['scenario']['name']}"
    except (OSError, ValueError, KeyError, TypeError):
        return directory.name


def _line(number: int) -> dict[str, Any]:
    """Return the style of the line of a series. Raises InputError if there are more series than colours."""
    if number >= len(COLOURS):
        raise InputError(f"more than {len(COLOURS)} series cannot be told apart in one figure")
    return {"color": COLOURS[number], "linestyle": DASHES[number % len(DASHES)]}
