"""How commands print tables, and the tables of runs. Other tables are beside the command that prints them."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from crowdbench.utils.tables import Grid

if TYPE_CHECKING:
    from crowdbench.metrics import Metric
    from crowdbench.metrics.summary import Estimate

BOARD_COLUMNS = {
    "collisions, %": "collision_rate",
    "at fault, %": "at_fault_rate",
    "time-outs, %": "timeout_rate",
    "SCT": "sct",
    "time, s": "navigation_time",
    "within 0.45 m": "intimate_zone",
    "jerk": "jerk",
}
"""What is shown of a planner on a board beside its success: headings, and the metrics under them."""

MAIN_METRICS = (
    "success_rate",
    "collision_rate",
    "at_fault_rate",
    "timeout_rate",
    "navigation_time",
    "sct",
    "jerk",
    "minimum_gap",
)
"""What is shown of a run where not all metrics are asked for, beside those of one's own."""


def print_table(table: Grid, colours: Mapping[str, str] = MappingProxyType({})) -> None:
    """Print a table under its title.

    Args:
        table: The table.
        colours: The colours of cells on a terminal, by their text.
    """
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    # On a line of its own, because rich wraps a title at the table's width.
    print(table.title)
    printed = Table(box=None, pad_edge=False)
    for heading, alignment in zip(table.header, table.align, strict=True):
        printed.add_column(heading, justify="left" if alignment == "l" else "right")
    for row in table.rows:
        printed.add_row(*(Text(cell, colours[cell]) if cell in colours else cell for cell in row))
    # A file or a pipe has no width to fit. Brackets are units, not rich's markup.
    Console(width=None if sys.stdout.isatty() else 200, markup=False).print(printed)


def result_table(
    title: str, result: Mapping[str, Any], metrics: Mapping[str, Metric], all_metrics: bool = False
) -> Grid:
    """The metrics of a run with their intervals.

    Args:
        title: Title of the table.
        result: The estimates of the metrics and which of them are rates, as in `result.json`.
        metrics: Their functions, whose docstrings name the units.
        all_metrics: Whether all are shown, and not only the main ones and those of one's own.
    """
    from crowdbench.metrics import METRICS, unit_of

    found = result["metrics"]
    own = [name for name in found if name not in METRICS]
    rows = []
    for name in found if all_metrics else [*(name for name in MAIN_METRICS if name in found), *own]:
        estimate = found[name]
        if estimate["n"]:
            share = name in result["rates"]
            mean = f"{number(estimate['mean'], share)} {'%' if share else unit_of(metrics[name])}"
            largest = "" if share else number(estimate["max"])
            rows.append((name, mean, interval(estimate["low"], estimate["high"], share), largest, str(estimate["n"])))
    return Grid(title, ("metric", "mean", "95 % interval", "max", "n"), rows, align="lrlrr")


def board_table(title: str, found: Mapping[str, Mapping[str, Estimate]]) -> Grid:
    """The scenarios of a board and, in the last row, the board as a whole.

    Args:
        title: Title of the table.
        found: By row, the metrics that boards show; none where a planner cannot drive.
    """
    rows: list[tuple[str, ...]] = []
    for row, figures in found.items():
        if not figures:
            rows.append((row, "0.0"))
            continue
        success = figures["success_rate"]
        others = (number(figures[name].mean, name.endswith("_rate")) for name in BOARD_COLUMNS.values())
        rows.append((row, number(success.mean, True), interval(success.low, success.high, True), *others))
    header = ("", "success, %", "95 % interval", *BOARD_COLUMNS)
    return Grid(title, header, rows, align="l".ljust(len(header), "r"))


def number(value: float, share: bool = False) -> str:
    """A number as tables show it, empty where it is undefined; a share in per cent."""
    if value != value:
        return ""
    return f"{100 * value:.1f}" if share else f"{value:.3f}"


def interval(low: float, high: float, share: bool = False) -> str:
    """A confidence interval as tables show it."""
    return f"{number(low, share)} to {number(high, share)}"
