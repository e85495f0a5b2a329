"""Formats tables as Markdown, LaTeX, CSV or JSON."""

from __future__ import annotations

import csv
import dataclasses
import io
import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any


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
    """Return the first line of a page that a command prints: it warns against editing the page by hand."""
    return f"Printed by `{command}`. Do not edit this page: the command overwrites it."


def format_tables(grids: Sequence[Grid], kind: Format) -> str:
    """Return tables as a text.

    Titles are printed if there are several tables: above them in Markdown and LaTeX, in the first column in CSV. LaTeX
    needs the package booktabs. Intervals are indices in LaTeX, so that some metrics fit a column of a paper.
    """
    if kind is Format.JSON:
        records = {grid.title: plain(list(grid.records)) for grid in grids}
        return json.dumps(records if len(grids) > 1 else plain(list(grids[0].records)), indent=2)
    if kind is Format.CSV:
        titles = [{"table": grid.title} if len(grids) > 1 else {} for grid in grids]
        pairs = zip(titles, grids, strict=True)
        return _csv([{**title, **flatten(plain(record))} for title, grid in pairs for record in grid.records])
    title = "### " if kind is Format.MARKDOWN else "% "
    below = [f"\n\n{grid.note}" if grid.note else "" for grid in grids]
    pages = [markdown(grid.header, grid.rows) + note for grid, note in zip(grids, below, strict=True)]
    texts = pages if kind is Format.MARKDOWN else list(map(_latex, grids))
    if len(grids) == 1:
        return texts[0]
    return "\n\n".join(f"{title}{grid.title}\n\n{text}" for grid, text in zip(grids, texts, strict=True))


def markdown(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table in Markdown.

    Args:
        header: The headings of the columns.
        rows: The cells of each row.
    """
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", r"\|") for cell in line) + " |" for line in lines)


def plain(value: Any) -> Any:
    """Return a value, such as a dataclass, in the types of JSON: undefined and infinite numbers become null."""
    if dataclasses.is_dataclass(value):
        return {field.name: plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, list):
        return [plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def floating(table: str, caption: str | None, label: str | None) -> str:
    """Return a LaTeX table in a floating environment with a caption and a label, both as LaTeX."""
    head = [rf"\caption{{{caption}}}"] if caption else []
    head += [rf"\label{{{label}}}"] if label else []
    return "\n".join([r"\begin{table}", r"\centering", *head, table, r"\end{table}"])


def _latex(grid: Grid) -> str:
    """Return a table with the rules of the package booktabs, and its note below, in a group of smaller type."""
    align = grid.align or "l".ljust(len(grid.header), "r")
    heads, *rows = ([*map(_escaped, cells)] for cells in (grid.header, *grid.rows))
    heads = [rf"\shortstack{{{cell}}}".replace(", ", r"\\") if ", " in cell else cell for cell in heads]
    top, *below = (" & ".join(cells) + r" \\" for cells in (heads, *rows))
    lines = [rf"\begin{{tabular}}{{{align}}}", r"\toprule", top, r"\midrule", *below, r"\bottomrule", r"\end{tabular}"]
    note = [rf"\\[1ex] Indices: 95 \% interval. {_escaped(grid.note)}"] if grid.note else []
    return "\n".join([r"{\footnotesize\setlength{\tabcolsep}{3pt}", *lines, *note, r"\par}"])


def _escaped(text: str) -> str:
    """Return a text in LaTeX: intervals of estimates become indices, and bold Markdown becomes bold LaTeX."""
    plain = re.sub(r"\^(\d)", r"$^\1$", re.sub(r"([%&_#{}])", r"\\\1", text.replace(r"\*", "*")))
    plain = re.sub(r" \((-?[\d.]+) to (-?[\d.]+)\)", r"$_{\1}^{\2}$", plain)
    return re.sub(r"\*\*(.+?)\*\*", r"\\textbf{\1}", plain).replace("†", r"$^\dagger$").replace("≥", r"$\geq$")


def _csv(records: Sequence[Mapping[str, Any]]) -> str:
    """Return CSV with a row for each record, and a column for each name in any record."""
    text = io.StringIO()
    names = dict.fromkeys(name for record in records for name in record)
    writer = csv.DictWriter(text, list(names), lineterminator="\n")
    writer.writeheader()
    for record in records:
        writer.writerow(
            {name: json.dumps(value) if isinstance(value, list) else value for name, value in record.items()}
        )
    return text.getvalue().rstrip("\n")


def flatten(record: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return the values of a record, which may contain other records, by their dotted names."""
    flat: dict[str, Any] = {}
    for name, value in record.items():
        flat |= flatten(value, f"{prefix}{name}.") if isinstance(value, Mapping) else {f"{prefix}{name}": value}
    return flat
