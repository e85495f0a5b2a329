"""Formats tables as Markdown, LaTeX, CSV or JSON."""

from __future__ import annotations

import csv
import io
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from pydantic_core import to_jsonable_python


class Format(StrEnum):
    """Format of a table."""

    MARKDOWN = "markdown"
    LATEX = "latex"
    CSV = "csv"
    JSON = "json"


@dataclass(frozen=True)
class Grid:
    """A table.

    Attributes:
        title: Its title.
        header: The headings of its columns.
        rows: Its cells, as text for readers.
        records: Content of each row for programs: dataclasses, or values by name.
        align: Alignment of each column: `l` for left, `r` for right.
        note: Text below it, in Markdown.
    """

    title: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    records: Sequence[Any] = ()
    align: str = ""
    note: str = ""


def printed_by(command: str) -> str:
    """Return the first line of a page that a command prints."""
    return f"Printed by `{command}`."


def format_tables(grids: Sequence[Grid], kind: Format) -> str:
    """Return tables as a text.

    Titles are printed if there are several tables: above them in Markdown and LaTeX, in the first column in CSV. LaTeX
    needs the package booktabs. Intervals are indices in LaTeX, so that some metrics fit a column of a paper.
    """
    is_single = len(grids) == 1
    if kind is Format.JSON:
        tables = {grid.title: plain(list(grid.records)) for grid in grids}
        return json.dumps(tables[grids[0].title] if is_single else tables, indent=2)
    if kind is Format.CSV:
        records = []
        for grid in grids:
            title = {} if is_single else {"table": grid.title}
            records += [title | flatten(plain(record)) for record in grid.records]
        return _csv(records)
    if kind is Format.LATEX:
        texts, mark = [_latex(grid) for grid in grids], "%"
    else:
        texts, mark = [_page(grid) for grid in grids], "###"
    if is_single:
        return texts[0]
    return "\n\n".join(f"{mark} {grid.title}\n\n{text}" for grid, text in zip(grids, texts, strict=True))


def _page(grid: Grid) -> str:
    """Return a table in Markdown with its note below."""
    table = markdown(grid.header, grid.rows)
    return f"{table}\n\n{grid.note}" if grid.note else table


def markdown(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table in Markdown.

    Args:
        header: The headings of the columns.
        rows: The cells of each row.
    """
    lines = []
    for row in (header, ["---"] * len(header), *rows):
        cells = [cell.replace("|", r"\|") for cell in row]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def plain(value: Any) -> Any:
    """Return a value, such as a dataclass, in the types of JSON: undefined and infinite numbers become null."""
    return to_jsonable_python(value, inf_nan_mode="null")


def floating(table: str, caption: str | None, label: str | None) -> str:
    """Return a LaTeX table in a floating environment with a caption and a label, both as LaTeX."""
    lines = [r"\begin{table}", r"\centering"]
    if caption:
        lines.append(rf"\caption{{{caption}}}")
    if label:
        lines.append(rf"\label{{{label}}}")
    return "\n".join([*lines, table, r"\end{table}"])


def _latex(grid: Grid) -> str:
    """Return a table with the rules of the package booktabs, and its note below, in a group of smaller type."""
    align = grid.align or "l".ljust(len(grid.header), "r")
    lines = [r"{\footnotesize\setlength{\tabcolsep}{3pt}", rf"\begin{{tabular}}{{{align}}}", r"\toprule"]
    lines += [_latex_row(_stacked(_escaped(heading)) for heading in grid.header), r"\midrule"]
    lines += [_latex_row(map(_escaped, row)) for row in grid.rows]
    lines += [r"\bottomrule", r"\end{tabular}"]
    if grid.note:
        lines.append(rf"\\[1ex] Indices: 95 \% interval. {_escaped(grid.note)}")
    return "\n".join([*lines, r"\par}"])


def _latex_row(cells: Iterable[str]) -> str:
    return " & ".join(cells) + r" \\"


def _stacked(heading: str) -> str:
    """Return a heading in LaTeX with a line for each part between commas."""
    if ", " not in heading:
        return heading
    lines = heading.replace(", ", r"\\")
    return rf"\shortstack{{{lines}}}"


def _escaped(text: str) -> str:
    """Return a text in LaTeX: intervals of estimates become indices, and bold Markdown becomes bold LaTeX."""
    plain = re.sub(r"([%&_#{}])", r"\\\1", text.replace(r"\*", "*"))
    plain = re.sub(r"\^(\d)", r"$^\1$", plain)
    plain = re.sub(r" \((-?[\d.]+) to (-?[\d.]+)\)", r"$_{\1}^{\2}$", plain)
    return re.sub(r"\*\*(.+?)\*\*", r"\\textbf{\1}", plain).replace("†", r"$^\dagger$").replace("≥", r"$\geq$")


def _csv(records: Sequence[Mapping[str, Any]]) -> str:
    """Return CSV with a row for each record, and a column for each name in any record."""
    text = io.StringIO()
    names = dict.fromkeys(name for record in records for name in record)
    writer = csv.DictWriter(text, list(names), lineterminator="\n")
    writer.writeheader()
    for record in records:
        lists = {name: json.dumps(value) for name, value in record.items() if isinstance(value, list)}
        writer.writerow({**record, **lists})
    return text.getvalue().rstrip("\n")


def flatten(record: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return the values of a record, which may contain other records, by their dotted names."""
    flat: dict[str, Any] = {}
    for name, value in record.items():
        if isinstance(value, Mapping):
            flat |= flatten(value, f"{prefix}{name}.")
        else:
            flat[f"{prefix}{name}"] = value
    return flat
