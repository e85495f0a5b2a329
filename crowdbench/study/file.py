"""Reads a study from a TOML file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from crowdbench.errors import InputError
from crowdbench.study.crowds import Crowds
from crowdbench.study.measured import Measured
from crowdbench.study.planned import Run
from crowdbench.study.seeds import Seeds
from crowdbench.study.tables import Table
from crowdbench.toml_section import Section, read_toml

KINDS: dict[str, Callable[[Section], Table]] = {"seeds": Seeds.of, "crowds": Crowds.of, "measured": Measured.of}
"""What reads each kind of table; a file may have several of a kind."""


@dataclass(frozen=True)
class Study:
    """What a file asks for. Planners, options and scenarios are what one would give to `crowdbench run`."""

    name: str
    tables: list[Table]

    @property
    def runs(self) -> list[Run]:
        """All that its tables need, some perhaps twice."""
        return [run for table in self.tables for run in table.runs]


def read_study(path: Path) -> Study:
    """The study that a file describes.

    Raises InputError, naming the file and the key, where it cannot be read or something in it is wrong. That includes
    planners, weights and scenarios that do not exist, so that nobody learns of them hours later.
    """
    top = Section(read_toml(path, "study"), path.name)
    top.text("description")
    sections = [(read, section) for kind, read in KINDS.items() for section in top.tables(kind)]
    top.close()
    if not sections:
        known = " or ".join(f"[[{kind}]]" for kind in KINDS)
        raise InputError(f"{path.name} has no table: a study needs {known}")
    return Study(path.stem, [read(section) for read, section in sections])
