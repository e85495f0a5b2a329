"""Prints tables that fit the terminal: only texts break, at spaces, and a table that is too wide becomes a list."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from crowdbench.utils.tables import Grid
from crowdbench.utils.terminal import width, write

if TYPE_CHECKING:
    from rich.text import Text

LONG = 12
"""Number of characters that a column of broken texts has at least; twice as many in a table of two columns."""

OF_FILES = 200
"""Number of columns of a table in a file or a pipe."""


def print_table(table: Grid, color: Callable[[int, str], str] = lambda row, cell: "") -> None:
    """Print a table under its title, and its note below.

    Args:
        table: The table. Its cells may contain the bold text of Markdown.
        color: Returns the colour of a cell on a terminal, by the number of its row and its text; empty for none.
    """
    from rich.console import Console
    from rich.table import Table

    write(table.title)
    columns, align = width(sys.stdout) or OF_FILES, table.align or "l".ljust(len(table.header), "r")
    console = Console(width=columns, markup=False, highlight=False, emoji=False)
    rows = [[_styled(cell, color(number, cell)) for cell in row] for number, row in enumerate(table.rows)]
    widths = _fit([table.header, *([cell.plain for cell in row] for row in rows)], align, columns)
    if widths is None:
        for first, *cells in rows:
            console.print(first, style="bold", soft_wrap=True)
            for heading, cell in zip(table.header[1:], cells, strict=True):
                if cell.plain:
                    write(f"  {heading}: {cell.plain}", str(cell.style))
    else:
        printed = Table(box=None, pad_edge=False)
        for heading, alignment, most in zip(table.header, align, widths, strict=True):
            printed.add_column(heading, justify="left" if alignment == "l" else "right", width=most)
        for row in rows:
            printed.add_row(*row)
        console.print(printed)
    if table.note:
        write(f"\n{table.note}")


def _styled(cell: str, color: str) -> Text:
    """Return a cell with its colour, and with the bold text of Markdown in bold."""
    from rich.text import Text

    text = Text(style=color)
    for number, part in enumerate(re.split(r"\*\*(.+?)\*\*", cell)):
        text.append(part.replace(r"\*", "*"), "bold" if number % 2 else "")
    return text


def _fit(rows: Sequence[Sequence[str]], align: str, most: int) -> list[int] | None:
    """Return the widths of columns that fit `most` characters in total; None if no widths do.

    Headings may break, and long texts, which are at the left; numbers do not.
    """
    long = 2 * LONG if len(align) == 2 else LONG
    widths, least = [], []
    for alignment, (heading, *cells) in zip(align, zip(*rows, strict=True), strict=True):
        longest = max(map(len, cells), default=0)
        widths.append(max(len(heading), longest))
        if alignment == "l" and longest > long:
            longest = max(long, *(len(word) for cell in cells for word in re.findall(r"^\s*\S+|\S+", cell)))
        least.append(max(longest, *map(len, heading.split()), 0))
    gaps = 2 * (len(widths) - 1)
    while sum(widths) + gaps > most:
        spare = [(wide, column) for column, wide in enumerate(widths) if wide > least[column]]
        if not spare:
            return None
        widths[max(spare)[1]] -= 1
    return widths
