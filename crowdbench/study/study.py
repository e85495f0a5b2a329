"""A study: the tables that a TOML file asks for, the runs that they need, and the page that they are printed on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from crowdbench.runs.run import Run
from crowdbench.study.crowds import CrowdsTable
from crowdbench.study.planners import PlannersTable
from crowdbench.study.schema import StudySpec
from crowdbench.utils.errors import InputError
from crowdbench.utils.tables import Grid, printed_by
from crowdbench.utils.toml import Location, parse_table, read_toml


class FilledTable(Protocol):
    """A table with its figures."""

    def markdown(self) -> str:
        """Return the table as GitHub shows it, under its heading."""

    def grids(self) -> list[Grid]:
        """Return its parts, for LaTeX and CSV."""

    def notes(self) -> list[str]:
        """Return the notes that a page has below its tables."""


class Table(Protocol):
    """A table of a study, and the runs that it needs."""

    @property
    def runs(self) -> list[Run]:
        """The runs that it needs, some perhaps twice."""

    def fill(self, out: Path) -> FilledTable:
        """Fill the table from the runs in the folder `out`. Raises InputError where one is not there."""


FILE = "study.toml"
"""The name of a file that has a folder of its own, whose name is that of the study."""

KINDS = ("[[tables]]", "[[crowds]]")
"""The kinds of tables that a study may have."""


@dataclass(frozen=True)
class Study:
    """What a file asks for.

    Attributes:
        name: The name of the file without its ending, or of its folder if it is called study.toml.
        description: What the study is about, in Markdown; it stands at the top of the page.
        tables: Its tables, with the runs that they need.
        sources: The full references of what its page leans on, in Markdown.
    """

    name: str
    description: str
    tables: Sequence[Table]
    sources: list[str]

    @property
    def runs(self) -> list[Run]:
        """All runs that its tables need, some perhaps twice."""
        return [run for table in self.tables for run in table.runs]

    def fill(self, out: Path) -> list[FilledTable]:
        """Its tables with the figures of the runs in the folder `out`.

        Raises InputError where one of the runs is not there.
        """
        return [table.fill(out) for table in self.tables]

    def page(self, tables: Sequence[FilledTable], command: str) -> str:
        """The study's page in Markdown: its filled tables, then their notes, then the references.

        Args:
            tables: What `fill` gives.
            command: The command that prints the page.
        """
        head = [printed_by(command), *([self.description] if self.description else [])]
        notes = dict.fromkeys(note for table in tables for note in table.notes())
        return "\n\n".join([*head, *(table.markdown() for table in tables), *notes, *self.sources])


def read_study(path: Path, data: Path | None = None) -> Study:
    """Read the study that a file describes.

    Args:
        path: The file.
        data: The folder with the recorded tracks that its scenarios need.

    Raises:
        InputError: It cannot be read, or something in it is wrong; the file and the key are named. That includes
            planners, weights and scenarios that do not exist, so that nobody learns of them hours later.
    """
    return _load(_read(path), path, data)


def _read(path: Path) -> StudySpec:
    return parse_table(StudySpec, read_toml(path, "study"), Location(path.name))


def _load(spec: StudySpec, path: Path, data: Path | None = None) -> Study:
    """Load the planners and scenarios of a study."""
    file = Location(path.name)
    tables: list[Table] = [
        *(PlannersTable.of(table, file.at("tables", i)) for i, table in enumerate(spec.tables)),
        *(CrowdsTable.of(table, file.at("crowds", i), data) for i, table in enumerate(spec.crowds)),
    ]
    if not tables:
        raise InputError(f"{path.name} has no table: a study needs one of {', '.join(KINDS)}")
    name = path.absolute().parent.name if path.name == FILE else path.stem
    study = Study(name, spec.description, tables, spec.sources)
    if data is not None and not any(run.scenario.tracks for run in study.runs):
        raise InputError(f"--data does not go with {path.name}, none of whose scenarios has a table [tracks]")
    return study
