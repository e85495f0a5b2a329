"""Enters every planner that ships on every board that it can run on, and verifies all of them.

Which planners these are is in `leaderboards/shipped.toml`, what their authors say of them in `leaderboards/cards/`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from crowdbench.boards.board import Board
from crowdbench.boards.driving import Progress
from crowdbench.boards.entry import Entry
from crowdbench.boards.rerun import cases_of
from crowdbench.boards.season import Season, freeze, read_season
from crowdbench.boards.standings import MAINTAINERS, read_entries
from crowdbench.boards.submission import ENTRIES, Submission, submit
from crowdbench.boards.verification import verify
from crowdbench.toml_file import Location, Name, TomlTable, parsed, read_toml

SHIPPED = "shipped.toml"
CARDS = "cards"


class ShippedSpec(TomlTable):
    """One of `shipped` in `shipped.toml`: the name of the entry and of its card, and what it runs.

    `weights` are other networks of the same method, which its method is judged by on the boards `method_on`. `not_on`
    lists the boards that it cannot run on, and `only_on` the only ones that it is entered on.
    """

    name: Name
    planner: Name
    options: Annotated[dict[str, Any], Field(description="a table of options")] = Field(default_factory=dict)
    weights: Annotated[list[Name], Field(description="a list of weights")] = Field(default_factory=list)
    method_on: Annotated[list[Name], Field(description="a list of boards")] = Field(default_factory=list)
    not_on: Annotated[list[Name], Field(description="a list of boards")] = Field(default_factory=list)
    only_on: Annotated[list[Name], Field(description="a list of boards")] = Field(default_factory=list)

    def is_for(self, board: str) -> bool:
        """Whether it is entered on a board."""
        return board not in self.not_on and (not self.only_on or board in self.only_on)


class ShippedFile(TomlTable):
    """The whole of `shipped.toml`."""

    shipped: Annotated[list[ShippedSpec], Field(min_length=1, description="tables [[shipped]]")]


@dataclass(frozen=True)
class Job:
    """A piece of work of `fill`.

    Attributes:
        title: What it is, for people.
        cases: How many cases it drives or replays.
        do: Does it.
    """

    title: str
    cases: int
    do: Callable[[Progress], object]


def read_shipped(root: Path) -> list[ShippedSpec]:
    """The planners that ship. Raises InputError where `shipped.toml` is missing or wrong."""
    return parsed(ShippedFile, read_toml(root / SHIPPED, "list"), Location(SHIPPED)).shipped


def to_submit(board: Board, root: Path, work: Path) -> list[Job]:
    """Entries of planners that ship which a board does not have yet.

    Args:
        board: The board.
        root: The folder of boards.
        work: The folder that keeps finished runs until an entry is made.
    """
    return [
        _submission(board, spec, root, work)
        for spec in read_shipped(root)
        if spec.is_for(board.name) and not (root / board.name / ENTRIES / spec.name).exists()
    ]


def _submission(board: Board, spec: ShippedSpec, root: Path, work: Path) -> Job:
    networks = [{"weights": name} for name in spec.weights] if board.name in spec.method_on else []
    card = root / CARDS / f"{spec.name}.toml"
    wanted = Submission(board, spec.name, spec.planner, spec.options, networks, card, MAINTAINERS)
    cases = len(board.public_cases) * len(board.scenarios)
    return Job(f"{spec.name} on {board.name}", cases, lambda tell: submit(wanted, root, work, tell))


def freeze_entries(board: Board, root: Path) -> Season:
    """Freeze all entries of a board, if those of the season are not frozen yet.

    Args:
        board: The board.
        root: The folder of boards.

    Returns:
        The season.
    """
    entries = read_entries(board, root, check_files=False)
    return freeze(
        root, board.name, {each.name: each.digest for each in entries if each.spec.board_digest == board.digest}
    )


def to_verify(board: Board, root: Path, work: Path) -> list[Job]:
    """Entries of a board that take part in the season and were not verified in it yet.

    Args:
        board: The board.
        root: The folder of boards.
        work: The folder that keeps finished runs until the verdict.
    """
    season = read_season(root)
    return [
        _verification(board, entry, season, work)
        for entry in read_entries(board, root, check_files=False)
        if season.takes_part(board.name, entry.name, entry.digest)
        and not any(each.season == season.spec.name for each in entry.spec.verifications)
    ]


def _verification(board: Board, entry: Entry, season: Season, work: Path) -> Job:
    return Job(
        f"{entry.name} on {board.name}",
        cases_of(entry, board),
        lambda tell: verify(entry, board, by=MAINTAINERS, work=work, season=season, progress=tell),
    )
