"""The tables of Li et al. (2020) and more, as `reproduce.toml` describes them, in full or for a quick look."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from crowdbench.study.claims import tally
from crowdbench.study.file import read_study
from crowdbench.study.filled_planner_table import FilledPlannerTable
from crowdbench.study.planner_table import PlannerTable
from crowdbench.study.tables import page

FILE = Path(__file__).with_name("reproduce.toml")

QUICK = (
    "A quick look: the first network of each row alone, on few cases. Intervals are wide, and a single network has no "
    "verdict on a claim: the full command has five."
)


def tables(number: int | None, quick: bool) -> list[PlannerTable]:
    """The tables of `FILE`.

    Args:
        number: Which of the paper's tables is wanted, both readings of it where there are two; None for all.
        quick: Whether they are for a quick look.

    Raises:
        InputError: As `read_study` does.
    """
    found = [table for table in read_study(FILE).tables if isinstance(table, PlannerTable)]
    chosen = [table for table in found if number is None or re.match(rf"Table {number}\b", table.spec.title)]
    return [table.quick_look() for table in chosen] if quick else chosen


@dataclass(frozen=True)
class Report:
    """The tables with their figures, and the full references of what they lean on."""

    quick: bool
    tables: list[FilledPlannerTable]
    sources: list[str]

    def markdown(self) -> str:
        """All tables, how many claims hold, and the references."""
        claims = [claim for table in self.tables for claim in table.claims]
        head = [QUICK] if self.quick else []
        return "\n\n".join([*head, page(self.tables, self.sources), tally(claims)])


def report(tables: Sequence[PlannerTable], quick: bool, out: Path) -> Report:
    """Fill tables from the runs in a folder.

    Args:
        tables: The tables.
        quick: Whether they are for a quick look.
        out: The folder.

    Returns:
        The report.

    Raises:
        InputError: One of the runs is not there.
    """
    return Report(quick, [table.fill(out) for table in tables], read_study(FILE).sources)
