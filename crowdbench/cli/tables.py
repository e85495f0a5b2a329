"""How commands print tables."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from types import MappingProxyType

from crowdbench.utils.tables import Grid


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
