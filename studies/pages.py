"""Helpers of several studies: read a TOML file of tables, execute its runs, print its page, store results."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, TypeVar

import numpy as np
from jaxtyping import Bool, Float

from crowdbench import Episodes, InputError
from crowdbench.metrics import info_of
from crowdbench.runs import Run
from crowdbench.utils import Format, Grid, Location, parse_table, plain, printed_by, read_text, read_toml, write_whole
from studies.command import print_study
from studies.folder import read_episodes
from studies.schema import StudyHead

SUCCESS_RATE = "success_rate"
SUCCESS, SCORE = info_of(SUCCESS_RATE), info_of("score")

NOTES = {
    name: " ".join(text.split()) for name, text in read_toml(Path(__file__).with_name("notes.toml"), "file").items()
}
"""Notes below the tables of pages."""

Head = TypeVar("Head", bound=StudyHead)

MakeRuns = Callable[[Sequence[Run]], None]
"""Function that executes the runs that a folder lacks."""


class FilledTable(Protocol):
    """A table with its figures."""

    def markdown(self) -> str:
        """Return the table in GitHub's Markdown, under its heading."""

    def grids(self) -> list[Grid]:
        """Return its parts, for LaTeX and CSV."""

    def notes(self) -> list[str]:
        """Return the notes for a page, below its tables."""


class Table(Protocol):
    """A table of a study, and the runs that it needs."""

    @property
    def runs(self) -> list[Run]:
        """The runs that it needs, possibly with duplicates."""

    def fill(self, out: Path) -> FilledTable:
        """Fill the table from the runs in the folder `out`. Raises InputError if one is missing."""


class TwoSteps(Table, Protocol):
    """A table of a study with a second step of runs, which depend on the results of the first."""

    def second(self, out: Path) -> list[Run]:
        """Return the runs of the second step, which depend on the runs in the folder `out`."""


@dataclass(frozen=True)
class Page:
    """The page of a study.

    Attributes:
        name: The name of the study.
        description: The subject of the study, in Markdown; it stands at the top of the page.
        tables: Its tables, with the runs that they need.
        sources: The full references of its page, in Markdown.
    """

    name: str
    description: str
    tables: Sequence[Table]
    sources: list[str]

    @property
    def runs(self) -> list[Run]:
        """All runs that its tables need, possibly with duplicates."""
        return [run for table in self.tables for run in table.runs]

    def fill(self, out: Path) -> list[FilledTable]:
        """Fill the tables from the runs in the folder `out`. Raises InputError if one is missing."""
        return [table.fill(out) for table in self.tables]

    def markdown(self, tables: Sequence[FilledTable], command: str) -> str:
        """Return the page in Markdown: the filled tables, then their notes, then the references.

        Args:
            tables: The return value of `fill`.
            command: The command that prints the page.
        """
        head = [printed_by(command), *([self.description] if self.description else [])]
        notes = dict.fromkeys(note for table in tables for note in table.notes())
        return "\n\n".join([*head, *(table.markdown() for table in tables), *notes, *self.sources])


def read_file(file: Path, spec: type[Head]) -> Head:
    """Read the TOML file of a study. Raises InputError if something in it is wrong."""
    return parse_table(spec, read_toml(file, "study"), Location(file.name))


def print_page(
    head: StudyHead, tables: Sequence[Table], command: str, out: Path, make: MakeRuns, format: Format, name: str = ""
) -> None:
    """Execute the missing runs of a study, and print its page.

    Args:
        head: The description and the references of the study.
        tables: Its tables.
        command: The command that prints the page.
        out: The folder for the runs.
        make: Executes runs in that folder.
        format: The output format of the tables.
        name: The name of the study, if not that of the folder.
    """
    page = Page(name or out.name.removeprefix("study-"), head.description, tables, head.sources)
    make(page.runs)
    filled = page.fill(out)
    print_filled({"study": page.name, "tables": filled}, filled, page.markdown(filled, command), format)


def print_filled(found: object, tables: Sequence[FilledTable], page: str, format: Format) -> None:
    """Print filled tables; see `print_study` for the other arguments."""
    print_study(found, [grid for table in tables for grid in table.grids()], page, format)


def print_two_steps(
    head: StudyHead, tables: Sequence[TwoSteps], command: str, out: Path, make: MakeRuns, format: Format
) -> None:
    """Execute the runs of both steps, and print the page; see `print_page` for the arguments."""
    make([run for table in tables for run in table.runs])
    make([run for table in tables for run in table.second(out)])
    print_page(head, tables, command, out, make, format)


def keep(found: Any, file: Path) -> None:
    """Write results to a file, for a figure."""
    with write_whole(file) as partial:
        partial.write_text(json.dumps(plain(found), indent=2), encoding="utf-8")


def read_kept(path: Path, command: str, *keys: tuple[str | int, ...]) -> dict[str, Any]:
    """Read a file that `keep` wrote.

    Args:
        path: The file.
        command: The command that wrote it.
        keys: Paths of keys that the content must have.

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
    """Return the successes of a run in the folder `out`, by case; raises InputError if the run is missing."""
    return np.asarray(read_episodes(run, out).columns[SUCCESS_RATE], bool)


def read_scores(run: Run, out: Path) -> Float[np.ndarray, "case"]:
    """Return the scores of a run in the folder `out`, by case; raises InputError if the run is missing."""
    return read_episodes(run, out).columns["score"].astype(float)


def values_of(metric: str, runs: Iterable[Episodes]) -> Float[np.ndarray, "network case"]:
    """Return the values of a metric in several runs of the same cases."""
    return np.stack([episodes.columns[metric].astype(float) for episodes in runs])


BAR = 20
"""Characters of the bar of a success rate or a score of 1."""


def draw_bar(rate: float) -> str:
    """Draw a bar with a length proportional to a rate or a score."""
    return "█" * round(BAR * rate)
