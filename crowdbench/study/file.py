"""Reads a study from a TOML file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from crowdbench.errors import InputError
from crowdbench.study.crowds import CrowdsTable
from crowdbench.study.planned import PlannedRun
from crowdbench.study.planner_table import PlannerTable
from crowdbench.study.schema import StudySpec
from crowdbench.study.tables import PlannedTable
from crowdbench.toml_file import Location, parsed, read_toml


@dataclass(frozen=True)
class Study:
    """What a file asks for.

    Attributes:
        name: The file's name without its ending.
        tables: Its tables, with the runs that they need.
        sources: The full references of what its pages lean on, in Markdown.
    """

    name: str
    tables: list[PlannedTable]
    sources: list[str]

    @property
    def runs(self) -> list[PlannedRun]:
        """All runs that its tables need, some perhaps twice."""
        return [run for table in self.tables for run in table.runs]


def read_study(path: Path, data: Path | None = None) -> Study:
    """Read the study that a file describes.

    Args:
        path: The file.
        data: The folder with the recorded tracks that its scenarios need.

    Returns:
        The study.

    Raises:
        InputError: It cannot be read, or something in it is wrong; the file and the key are named. That includes
            planners, weights and scenarios that do not exist, so that nobody learns of them hours later.
    """
    file = Location(path.name)
    spec = parsed(StudySpec, read_toml(path, "study"), file)
    tables: list[PlannedTable] = [
        *(PlannerTable.of(table, file.at("tables", i)) for i, table in enumerate(spec.tables)),
        *(CrowdsTable.of(table, file.at("crowds", i), data) for i, table in enumerate(spec.crowds)),
    ]
    if not tables:
        raise InputError(f"{path.name} has no table: a study needs [[tables]] or [[crowds]]")
    return Study(path.stem, tables, spec.sources)
