"""Helpers of several studies: read a TOML file of tables, make its runs, print its page, keep results for a figure."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Protocol, TypeVar

import numpy as np
from jaxtyping import Bool

from crowdbench.cli.study import print_tables
from crowdbench.runs.run import Run
from crowdbench.study.folder import read_episodes
from crowdbench.study.measures import SUCCESS_RATE
from crowdbench.study.schema import StudyHead
from crowdbench.study.study import Study, Table
from crowdbench.utils import files
from crowdbench.utils.errors import InputError
from crowdbench.utils.files import read_text
from crowdbench.utils.tables import Format, plain
from crowdbench.utils.toml import Location, parse_table, read_toml

Head = TypeVar("Head", bound=StudyHead)

MakeRuns = Callable[[Sequence[Run]], None]
"""Makes the runs that a folder lacks."""


class TwoSteps(Table, Protocol):
    """A table of a study, some of whose runs follow from others."""

    def second(self, out: Path) -> list[Run]:
        """Return the runs that follow from those in the folder `out`."""


def read_file(file: Path, spec: type[Head]) -> Head:
    """Read the TOML file of a study. Raises InputError where something in it is wrong."""
    return parse_table(spec, read_toml(file, "study"), Location(file.name))


def print_page(
    head: StudyHead, tables: Sequence[Table], command: str, out: Path, make: MakeRuns, format: Format
) -> None:
    """Make the runs of a study that are not there yet, and print its page.

    Args:
        head: The description and the references of the study.
        tables: Its tables.
        command: The command that prints the page.
        out: The folder that keeps the runs.
        make: Makes runs in that folder.
        format: How the tables are printed.
    """
    study = Study(out.name.removeprefix("study-"), head.description, tables, head.sources)
    make(study.runs)
    filled = study.fill(out)
    print_tables({"study": study.name, "tables": filled}, filled, study.page(filled, command), format)


def print_two_steps(
    head: StudyHead, tables: Sequence[TwoSteps], command: str, out: Path, make: MakeRuns, format: Format
) -> None:
    """Make the runs of both steps, and print the page; the arguments are those of `print_page`."""
    make([run for table in tables for run in table.runs])
    make([run for table in tables for run in table.second(out)])
    print_page(head, tables, command, out, make, format)


def keep(found: Any, file: Path) -> None:
    """Write results to a file, for a figure."""
    with files.whole(file) as partial:
        partial.write_text(json.dumps(plain(found), indent=2), encoding="utf-8")


def read_kept(path: Path, command: str, *keys: tuple[str | int, ...]) -> dict[str, Any]:
    """Read a file that `keep` wrote.

    Args:
        path: The file.
        command: The command that wrote it.
        keys: Where there must be something in it.

    Returns:
        Its content.

    Raises:
        InputError: It cannot be read, or was not written by the command.
    """
    try:
        found: dict[str, Any] = json.loads(read_text(path))
        for each in keys:
            inside: Any = found
            for key in each:
                inside = inside[key]
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from None
    except (ValueError, KeyError, TypeError, IndexError):
        right = "give the files that it says it kept"
        raise InputError(f"{path} is not what `{command}` writes: {right}") from None
    return found


def read_successes(run: Run, out: Path) -> Bool[np.ndarray, "case"]:
    """Return in which cases a run in the folder `out` succeeds; raises InputError where it is not there."""
    return np.asarray(read_episodes(run, out).columns[SUCCESS_RATE], bool)


BAR = 20
"""Characters of the bar of a success rate of 1."""


def draw_bar(rate: float) -> str:
    """Draw a bar as long as a rate is high."""
    return "█" * round(BAR * rate)
