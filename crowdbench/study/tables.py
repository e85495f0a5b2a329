"""What the tables of a study have in common: from the runs that they need to the page that they are printed on."""

from __future__ import annotations

import abc
import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from crowdbench.study.planned import PlannedRun


class FilledTable(abc.ABC):
    """A table with its figures. A dataclass, whose fields are what `--json` prints."""

    @abc.abstractmethod
    def markdown(self) -> str:
        """The table as GitHub shows it, under its heading."""

    @abc.abstractmethod
    def notes(self) -> list[str]:
        """What a page says below its tables, once for all that say the same."""


class PlannedTable(abc.ABC):
    """A table of a study: which runs it needs, and what it makes of them."""

    @property
    @abc.abstractmethod
    def runs(self) -> list[PlannedRun]:
        """All runs that it needs, some perhaps twice."""

    @abc.abstractmethod
    def fill(self, out: Path) -> FilledTable:
        """The table with the figures of the runs in the folder `out`.

        Raises InputError where one of the runs is not there.
        """


def page(tables: Sequence[FilledTable], sources: Sequence[str] = ()) -> str:
    """A page of a study.

    Args:
        tables: Its tables.
        sources: The full references of what it leans on, in Markdown.

    Returns:
        The tables in Markdown, then their notes, then the references.
    """
    notes = dict.fromkeys(note for table in tables for note in table.notes())
    return "\n\n".join([*(table.markdown() for table in tables), *notes, *sources])


PRIVILEGED = (
    r"\* uses the pedestrians' next velocities, which no vehicle could know: shown for comparison, never ranked."
)
"""A note on planners that are `marked`."""


def marked(planner: str, privileged: bool) -> str:
    """A planner's name as tables show it.

    Args:
        planner: The name.
        privileged: Whether the planner is privileged.

    Returns:
        The name, with an asterisk where it is.
    """
    return f"{planner} *" if privileged else planner


def grid(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Write a table in Markdown.

    Args:
        header: The headings of the columns.
        rows: The cells of each row.

    Returns:
        The table in Markdown.
    """
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", r"\|") for cell in line) + " |" for line in lines)


def plain(value: Any) -> Any:
    """A dataclass and what is in it as JSON knows it: undefined numbers become null."""
    if dataclasses.is_dataclass(value):
        return {field.name: plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, list):
        return [plain(item) for item in value]
    return None if isinstance(value, float) and math.isnan(value) else value
