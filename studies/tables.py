"""The tables of a study's TOML file: `[[tables]]` of the package, and `[[networks]]`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from pydantic import Field

from crowdbench.study.schema import StudyHead, StudySpec
from crowdbench.study.study import StudyTable, check_data_used
from crowdbench.utils.errors import InputError
from crowdbench.utils.toml import Location
from studies.networks import NetworksSpec, NetworksTable
from studies.pages import Table, read_file
from studies.side_by_side import SideBySide


class PageSpec(StudySpec):
    """The whole file."""

    networks: list[NetworksSpec] = Field(default=[], description="a list of tables [[networks]]")


def read_tables(file: Path, data: Path | None = None) -> tuple[StudyHead, Sequence[Table]]:
    """Read the description of a study and its tables, with the runs that they need.

    Args:
        file: The file.
        data: The folder with the recorded tracks that its scenarios need.

    Raises:
        InputError: It cannot be read, or something in it is wrong.
    """
    spec, location = read_file(file, PageSpec), Location(file.name)
    tables: list[Table] = [
        *(NetworksTable.of(table, location.at("networks", i)) for i, table in enumerate(spec.networks)),
        *(
            SideBySide(
                StudyTable.load(table, location.at("tables", i), data), [len(row.choices) for row in table.planners]
            )
            for i, table in enumerate(spec.tables)
        ),
    ]
    if not tables:
        raise InputError(f"{file.name} has no table: a study needs [[tables]] or [[networks]]")
    check_data_used([run for table in tables for run in table.runs], file, data)
    return spec, tables
