"""A table of several runs for a paper: Markdown, LaTeX, CSV or JSON."""

from __future__ import annotations

import csv
import io
import json
import math
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from crowdbench.errors import InputError
from crowdbench.evaluate.metrics import METRICS, unit_of
from crowdbench.evaluate.summary import Estimate
from crowdbench.figures.series import Labelled, runs

DEFAULT = ("success_rate", "collision_rate", "timeout_rate", "navigation_time", "minimum_gap", "jerk")
"""The metrics of a table where none are asked for."""

Row = Mapping[str, Estimate]


def table(directories: Sequence[Path], metrics: Sequence[str], kind: str) -> str:
    """The means of metrics of runs with 95 % intervals, a row for each run.

    Args:
        directories: Those of the runs.
        metrics: Names of metrics; the default ones if none are given.
        kind: One of `KINDS`.

    Returns:
        The table.

    Raises:
        InputError: One of them is not a run, or has no such metric.
    """
    shown = runs(directories)
    names = list(metrics or DEFAULT)
    rows = {one.label: _row(one, names) for one in shown}
    rates = {name for name in names if all(name in one.run.episodes.rates for one in shown)}
    return KINDS[kind](rows, names, rates)


def _row(one: Labelled, names: Sequence[str]) -> Row:
    """The estimates of a run. Raises InputError where it lacks a metric."""
    found = one.run.episodes.summary()
    if lacking := [name for name in names if name not in found]:
        raise InputError(f"the run of {one.label} has no metric {lacking[0]}; it has {', '.join(found)}")
    return {name: found[name] for name in names}


def _markdown(rows: Mapping[str, Row], names: Sequence[str], rates: set[str]) -> str:
    lines = [["planner", *(_heading(name, name in rates) for name in names)], ["---"] + ["---:"] * len(names)]
    lines += [[label, *_cells(row, rates)] for label, row in rows.items()]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)


def _latex(rows: Mapping[str, Row], names: Sequence[str], rates: set[str]) -> str:
    """With the rules of the package booktabs."""
    head = ["planner", *(_heading(name, name in rates) for name in names)]
    body = [[label, *_cells(row, rates)] for label, row in rows.items()]
    first, *others = (" & ".join(map(_escaped, cells)) + r" \\" for cells in (head, *body))
    lines = [rf"\begin{{tabular}}{{l{'r' * len(names)}}}", r"\toprule", first, r"\midrule", *others]
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}"])


def _csv(rows: Mapping[str, Row], names: Sequence[str], rates: set[str]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["planner", *(f"{name}{end}" for name in names for end in ("", "_low", "_high", "_n"))])
    for label, row in rows.items():
        each = ((row[name].mean, row[name].low, row[name].high, row[name].n) for name in names)
        writer.writerow([label, *(value for values in each for value in values)])
    return text.getvalue().rstrip("\n")


def _json(rows: Mapping[str, Row], names: Sequence[str], rates: set[str]) -> str:
    def plain(value: float) -> float | None:
        return None if math.isnan(value) else value

    found = {
        label: {
            name: {"mean": plain(one.mean), "low": plain(one.low), "high": plain(one.high), "n": one.n}
            for name, one in row.items()
        }
        for label, row in rows.items()
    }
    return json.dumps(found, indent=2)


KINDS: Mapping[str, Callable[[Mapping[str, Row], Sequence[str], set[str]], str]] = {
    "markdown": _markdown,
    "latex": _latex,
    "csv": _csv,
    "json": _json,
}
"""The formats of a table by name."""


def _heading(name: str, is_rate: bool) -> str:
    """What a column is called, with its unit."""
    unit = "%" if is_rate else unit_of(METRICS[name]) if name in METRICS else ""
    words = name.removesuffix("_rate").replace("_", " ")
    return f"{words}, {unit}" if unit else words


def _cells(row: Row, rates: set[str]) -> list[str]:
    """The cells of a row."""
    cells = []
    for name, one in row.items():
        factor, digits = (100.0, 1) if name in rates else (1.0, 2)
        mean, low, high = (f"{factor * value:.{digits}f}" for value in (one.mean, one.low, one.high))
        cells.append("" if math.isnan(one.mean) else f"{mean} ({low} to {high})")
    return cells


def _escaped(text: str) -> str:
    """A text as LaTeX writes it."""
    return re.sub(r"\^(\d)", r"$^\1$", re.sub(r"([%&_#{}])", r"\\\1", text))
