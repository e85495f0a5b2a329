"""The tables of the paper and more, as `reproduce.toml` describes them, in full or for a quick look."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from crowdbench.study.claims import tally
from crowdbench.study.file import read_study
from crowdbench.study.measured import FilledMeasured, Measured, notes

FILE = Path(__file__).with_name("reproduce.toml")

QUICK = (
    "A quick look: the first network of each row alone, on few cases. Intervals are wide, and many a claim stays "
    "undecided that the full command decides."
)


def tables(number: int | None, quick: bool) -> list[Measured]:
    """All tables of `FILE`, or the one of that number, counted from 1; for a `quick` look, or in full.

    Raises InputError like `read_study`.
    """
    found = [table for table in read_study(FILE).tables if isinstance(table, Measured)]
    chosen = found if number is None else [found[number - 1]]
    return [table.quickly() for table in chosen] if quick else chosen


@dataclass(frozen=True)
class Report:
    """What was found."""

    quick: bool
    tables: list[FilledMeasured]

    def markdown(self) -> str:
        """All tables, and how the claims fared."""
        claims = [claim for table in self.tables for claim in table.claims]
        head = [QUICK] if self.quick else []
        return "\n\n".join([*head, *(table.grids() for table in self.tables), *notes(self.tables), tally(claims)])
