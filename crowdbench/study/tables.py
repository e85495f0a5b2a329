"""What the tables of a study have in common: from the runs that they need to the page that they are printed on."""

from __future__ import annotations

import abc
from collections.abc import Sequence
from pathlib import Path

from crowdbench.evaluate.formats import Grid
from crowdbench.study.planned import PlannedRun


class FilledTable(abc.ABC):
    """A table with its figures. A dataclass, whose fields are what `--format json` prints."""

    @abc.abstractmethod
    def markdown(self) -> str:
        """The table as GitHub shows it, under its heading."""

    @abc.abstractmethod
    def grids(self) -> list[Grid]:
        """The parts of it that have a row for each planner."""

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
