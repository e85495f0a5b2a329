"""The tables of a study's TOML file: `[[tables]]` and `[[networks]]`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from pydantic import Field

from crowdbench import InputError
from crowdbench.utils import Location
from studies.networks import NetworksSpec, NetworksTable
from studies.pages import Table, read_file
from studies.schema import StudyHead, TableSpec
from studies.side_by_side import SideBySide


class StudySpec(StudyHead):
    """The whole file."""

    tables: list[TableSpec] = Field(default=[], description="a list of tables [[tables]]")
    networks: list[NetworksSpec] = Field(default=[], description="a list of tables [[networks]]")


def read_tables(file: Path, data: Path | None = None) -> tuple[StudyHead, Sequence[Table]]:
    """Read the description of a study and its tables, with the runs that they need.

    Args:
        file: The file.
        data: The folder with the recorded tracks that its scenarios need.

    Raises:
        InputError: It cannot be read, or something in it is wrong; the file and the key are named. That includes
            planners, weights and scenarios that do not exist, so that they do not fail hours later.
    """
    spec, location = read_file(file, StudySpec), Location(file.name)
    tables: list[Table] = [
        *(NetworksTable.of(table, location.at("networks", i)) for i, table in enumerate(spec.networks)),
        *(SideBySide.load(table, location.at("tables", i), data) for i, table in enumerate(spec.tables)),
    ]
    if not tables:
        raise InputError(f"{file.name} has no table: a study needs [[tables]] or [[networks]]")
    if data is not None and not any(run.scenario.tracks for table in tables for run in table.runs):
        raise InputError(f"--data does not go with {file.name}, none of whose scenarios has a table [tracks]")
    return spec, tables
