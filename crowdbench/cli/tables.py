"""What the command line prints: tables."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from rich.table import Table
from rich.text import Text

from crowdbench.bench.measurement import Measurement, VariantComparison
from crowdbench.evaluate.check import Point
from crowdbench.evaluate.compare import Comparison
from crowdbench.evaluate.formats import Grid
from crowdbench.evaluate.metrics import METRICS, Metric, unit_of
from crowdbench.evaluate.prediction_errors import Errors
from crowdbench.evaluate.results import Episodes
from crowdbench.evaluate.summary import Estimate
from crowdbench.types import Outcome

BOARD_COLUMNS = {
    "collisions, %": "collision_rate",
    "time-outs, %": "timeout_rate",
    "SCT": "sct",
    "time, s": "navigation_time",
    "within 0.45 m": "intimate_zone",
    "jerk": "jerk",
}
"""What is shown of a planner on a board beside its success: headings, and the metrics under them."""


def result_table(title: str, result: Mapping[str, Any], metrics: Mapping[str, Metric]) -> Table:
    """The metrics of a run with their intervals.

    Args:
        title: Title of the table.
        result: The estimates of the metrics and which of them are rates, as in `result.json`.
        metrics: Their functions, whose docstrings name the units.
    """
    table = _table(
        title, ("metric", "left"), ("mean", "right"), ("95 % interval", "left"), ("max", "right"), ("n", "right")
    )
    for name, estimate in result["metrics"].items():
        if estimate["n"]:
            share = name in result["rates"]
            unit = "%" if share else unit_of(metrics[name])
            interval = f"{_number(estimate['low'], share)} to {_number(estimate['high'], share)}"
            largest = "" if share else _number(estimate["max"])
            table.add_row(name, f"{_number(estimate['mean'], share)} {unit}", interval, largest, str(estimate["n"]))
    return table


def board_table(title: str, found: Mapping[str, Mapping[str, Estimate]]) -> Table:
    """The scenarios of a board and, in the last row, the board as a whole.

    Args:
        title: Title of the table.
        found: By row, the metrics that boards show; none where a planner cannot drive.
    """
    table = _table(title, ("", "left"), *((name, "right") for name in ("success, %", "95 % interval", *BOARD_COLUMNS)))
    for row, figures in found.items():
        if not figures:
            table.add_row(row, "0.0")
            continue
        success = figures["success_rate"]
        interval = f"{_number(success.low, True)} to {_number(success.high, True)}"
        others = (_number(figures[name].mean, name.endswith("_rate")) for name in BOARD_COLUMNS.values())
        table.add_row(row, _number(success.mean, True), interval, *others)
    return table


def episodes_table(cases: int, episodes: Episodes) -> Table:
    """The episodes of a recording that lacks some: no means, which would be biased.

    Args:
        cases: The number of cases of the run.
        episodes: The recorded ones.
    """
    title = f"{len(episodes)} of {cases} cases are recorded; rates over these alone would be biased"
    shown = ["navigation_time", "path_length", "minimum_gap", "discomfort", "max_velocity_change", "jerk"]
    shown += [name for name in episodes.columns if name not in METRICS]
    table = _table(title, ("case", "right"), ("outcome", "left"), *((name, "right") for name in shown))
    for row, case in enumerate(episodes.case.tolist()):
        values = (episodes.columns[name][row] for name in shown)
        table.add_row(str(case), Outcome(episodes.outcome[row]).label, *map(_number, values))
    return table


def comparison_table(found: Comparison) -> Table:
    """Two runs side by side, with their paired differences."""
    a, b = found.names
    title = f"{a} and {b}: {found.cases} shared cases, {found.both_solved} solved by both"
    table = _table(
        title,
        ("metric", "left"),
        (a, "right"),
        (b, "right"),
        ("difference", "right"),
        ("95 % interval", "left"),
        ("p", "right"),
    )
    for name, row in found.rows.items():
        if row.difference.n:
            share = row.p is not None
            low, high = _number(row.difference.low, share), _number(row.difference.high, share)
            p = "" if row.p is None else f"{row.p:.2g}"
            a, b = (_number(value, share) + (" %" if share else "") for value in (row.a, row.b))
            table.add_row(name, a, b, _number(row.difference.mean, share), f"{low} to {high}", p)
    return table


def grid_table(title: str, grid: Grid) -> Table:
    """A table that is also written in other formats.

    Args:
        title: Title of the table.
        grid: The table.
    """
    table = _table(title, *((name, "left" if column < 2 else "right") for column, name in enumerate(grid.header)))
    for row in grid.rows:
        table.add_row(*row)
    return table


def changed_cases(found: Comparison) -> str:
    """A line for each pair of different outcomes, with the cases that ended so."""
    groups: dict[tuple[int, int], list[int]] = {}
    for case, one, two in found.changed:
        groups.setdefault((one, two), []).append(case)
    lines = []
    for (one, two), cases in sorted(groups.items()):
        labels = f"{found.names[0]} {Outcome(one).label}, {found.names[1]} {Outcome(two).label}"
        lines.append(f"{labels} ({len(cases)}): {', '.join(map(str, cases))}")
    return "\n".join(lines)


def check_table(name: str, points: list[Point]) -> Table:
    """What a planner keeps of its contract, and what was seen.

    Args:
        name: The planner's name.
        points: The points of the contract.
    """
    table = _table(f"The contract, as {name} keeps it", ("", "left"), ("point", "left"), ("seen", "left"))
    verdicts = {True: Text("kept", "green"), False: Text("broken", "red"), None: Text("?", "yellow")}
    for point in points:
        table.add_row(verdicts[point.kept], point.name, point.seen)
    return table


def prediction_table(title: str, dt: float, measured: Mapping[str, Errors]) -> Table:
    """ADE and FDE in metres of one predictor at every horizon, with their intervals.

    Args:
        title: Title of the table.
        dt: Length of a step in seconds.
        measured: The predictor's errors on each dataset.
    """
    intervals = [(name, "left") for name in ("ADE [m]", "95 % interval", "FDE [m]", "95 % interval")]
    table = _table(title, ("", "left"), ("steps", "right"), ("time [s]", "right"), *intervals)
    for dataset, errors in measured.items():
        for choice, curves in errors.choices().items():
            label = dataset if errors.modes == 1 else f"{dataset}, {choice}"
            for steps, pair in enumerate(zip(curves.ade, curves.fde, strict=True), 1):
                values = [(_number(e.mean), f"{_number(e.low)} to {_number(e.high)}") for e in pair]
                table.add_row(label if steps == 1 else "", str(steps), f"{steps * dt:.2f}", *values[0], *values[1])
            table.add_section()
    return table


def predictors_table(
    title: str, columns: Mapping[str, tuple[str, int]], predictors: Mapping[str, Mapping[str, Errors]]
) -> Table:
    """ADE / FDE in metres of several predictors.

    Args:
        title: Title of the table.
        columns: Dataset and horizon in steps of each column, by its heading.
        predictors: The errors of each predictor on each dataset.
    """
    table = _table(title, ("predictor", "left"), ("", "left"), *((heading, "right") for heading in columns))
    for name, measured in predictors.items():
        curves = {dataset: errors.choices() for dataset, errors in measured.items()}
        for row, choice in enumerate(curves[next(iter(curves))]):
            cells = [
                f"{_number(curves[dataset][choice].ade[steps - 1].mean)} / "
                f"{_number(curves[dataset][choice].fde[steps - 1].mean)}"
                for dataset, steps in columns.values()
            ]
            table.add_row(name if row == 0 else "", choice, *cells)
    return table


def bench_table(measured: list[Measurement]) -> Table:
    """Measured speeds; the ratio says how many times less time crowdbench takes than CrowdNav's code."""
    columns = ("crowdbench", "right"), ("CrowdNav, recorded", "right"), ("ratio", "right")
    table = _table("Speed", ("work", "left"), *columns)
    for one in measured:
        recorded = "" if one.crowdnav is None else f"{one.crowdnav:.3g} {one.unit}"
        ratio = "" if one.ratio is None else f"{one.ratio:.1f}x"
        table.add_row(one.work, f"{one.value:.3g} {one.unit}", recorded, ratio)
    return table


def variants_table(title: str, measured: VariantComparison) -> Table:
    """How long each variant of the lookahead takes, how many times faster than the first it is, and what it changes.

    Args:
        title: Title of the table.
        measured: The variants.
    """
    changes = ("outcomes that differ", "right"), ("commands that differ", "right")
    table = _table(title, ("variant", "left"), ("time", "right"), ("ratio", "right"), *changes)
    for variant in measured.variants:
        ratio = f"{measured.variants[0].seconds / variant.seconds:.1f}x"
        outcomes = f"{variant.changed_outcomes} of {measured.episodes:,}"
        commands = f"{variant.changed_commands} of {measured.decisions:,}"
        table.add_row(variant.name, f"{variant.seconds:.3g} s", ratio, outcomes, commands)
    return table


def listing_table(title: str, rows: Iterable[Sequence[str]], columns: Sequence[str] = ("name", "description")) -> Table:
    """Names and what is said of them.

    Args:
        title: Title of the table.
        rows: A text for each column.
        columns: Their headings.
    """
    table = _table(title, *((column, "left") for column in columns))
    for row in rows:
        table.add_row(*row)
    return table


def _table(title: str, *columns: tuple[str, Any]) -> Table:
    table = Table(title=title, title_justify="left", title_style="bold", box=None, pad_edge=False)
    for name, justify in columns:
        table.add_column(name, justify=justify)
    return table


def _number(value: float, share: bool = False) -> str:
    if value != value:
        return ""
    return f"{100 * value:.1f}" if share else f"{value:.3f}"
