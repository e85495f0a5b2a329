"""The tables of the study: planners on the cases of one scenario, and claims about them."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from pydantic import Field

from crowdbench import Cases
from crowdbench.utils import Location
from studies.li2020.claims import NOTES, Assessment, ClaimSpec, assess, check_claim, claims_table
from studies.networks import FilledNetworksTable, NetworksSpec, NetworksTable
from studies.pages import Page, read_file
from studies.schema import CasesText, StudyHead

FILE = Path(__file__).with_name("study.toml")
"""The tables of Li et al. (2020) and more."""

QUICK = (
    "A quick look: the first network of each row alone, on few cases. Intervals are wide, and a single network has no "
    "verdict on a claim: the full command has five."
)


class ClaimedSpec(NetworksSpec):
    """`[[tables]]`: planners on the cases of one scenario, and claims about them.

    `quick` are the cases for a quick look.
    """

    quick: CasesText = Cases.parse("test:40")
    claims: list[ClaimSpec] = Field(default=[], description="a list of tables")

    def quick_look(self) -> ClaimedSpec:
        """Return the same table with only the first network of each row, on the cases for a quick look."""
        rows = [row.model_copy(update={"weights": row.weights[:1], "second_reading": None}) for row in self.rows]
        return self.model_copy(update={"rows": rows, "cases": self.quick})


class ReproductionSpec(StudyHead):
    """The whole file."""

    tables: list[ClaimedSpec] = Field(min_length=1, description="one table [[tables]] or more")


@dataclass(frozen=True)
class ClaimedTable(NetworksTable):
    """Planners on the same cases, the runs of each, and claims about them."""

    spec: ClaimedSpec

    @classmethod
    def plan(cls, spec: ClaimedSpec, location: Location) -> ClaimedTable:
        """Plan the runs; raises InputError as `NetworksTable.of` does, and if a claim cannot be assessed."""
        rows = NetworksTable.of(spec, location).rows
        networks = {row.label: row.networks for row in rows}
        for i, claim in enumerate(spec.claims):
            check_claim(claim, networks, location.at("claims", i))
        return cls(spec, rows)

    def fill(self, out: Path) -> FilledClaimedTable:
        """Fill the table from the runs in the folder `out`; raises InputError if one is missing."""
        episodes = {row.label: row.episodes(out) for row in self.rows}
        claims = [assess(claim, episodes) for claim in self.spec.claims]
        return FilledClaimedTable(**vars(super().fill(out)), claims=claims)


@dataclass(frozen=True)
class FilledClaimedTable(FilledNetworksTable):
    """A table with its figures, and a verdict on each claim. `--format json` prints its fields."""

    with_maximum = ("max_velocity_change",)
    claims: list[Assessment]

    def markdown(self) -> str:
        """Return the table and the claims in GitHub's Markdown, under the heading."""
        planners = super().markdown()
        return f"{planners}\n\n{claims_table(self.claims)}" if self.claims else planners

    def notes(self) -> list[str]:
        """Return the notes of a page, once for all tables with the same ones."""
        return [*super().notes(), *([NOTES] if self.claims else [])]


def read_reproduction(number: int | None, quick: bool, file: Path | None = None) -> Page:
    """Read the study, or a part of it.

    Args:
        number: The number of a table of the paper, both readings of it if there are two; None for all.
        quick: True if the tables are for a quick look.
        file: Another file with such tables.

    Raises:
        InputError: Something in the file is wrong, or a planner, weights or a scenario do not exist.
    """
    path = file or FILE
    spec = read_file(path, ReproductionSpec)
    specs = [table for table in spec.tables if number is None or re.match(rf"Table {number}\b", table.title)]
    if quick:
        specs = [table.quick_look() for table in specs]
    location = Location(path.name)
    tables = [ClaimedTable.plan(table, location.at("tables", i)) for i, table in enumerate(specs)]
    return Page(path.stem, QUICK if quick else spec.description, tables, spec.sources)
