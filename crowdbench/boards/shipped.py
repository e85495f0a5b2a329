"""Enters every planner that ships on every board that it can run on, and verifies all of them.

Which planners these are is in `leaderboards/shipped.toml`, what their authors say of them in `leaderboards/cards/`.
"""

from __future__ import annotations

import functools
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from crowdbench.boards.board import Board
from crowdbench.boards.entry import ENTRY, MAINTAINERS, Entry, read_entry
from crowdbench.boards.planner_files import describe_change
from crowdbench.boards.run_entry import Progress
from crowdbench.boards.season import Season, freeze, read_season
from crowdbench.boards.standings import is_pending, read_entries
from crowdbench.boards.submission import ENTRIES, Submission, submit
from crowdbench.boards.verification import count_cases, is_verified, verify
from crowdbench.utils.toml import Location, Name, TomlTable, parse_table, read_toml

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


class ShippedFile(TomlTable):
    """The whole of `shipped.toml`."""

    shipped: Annotated[list[ShippedSpec], Field(min_length=1, description="tables [[shipped]]")]


@dataclass(frozen=True)
class Job:
    """A piece of work of `fill`.

    Attributes:
        title: What it is, for people.
        cases: How many cases it drives or replays.
        do: Does it; takes `progress`, see `submit` and `verify`.
    """

    title: str
    cases: int
    do: Callable[..., object]


def to_submit(board: Board, root: Path, work: Path) -> list[Job]:
    """List the planners that ship and have no current entry on a board.

    An entry is not current where it was made for another digest of the board, or its planner has other files now; but
    once entries are frozen, files do not count.

    Args:
        board: The board.
        root: As for `submit`.
        work: As for `submit`.

    Raises:
        InputError: `shipped.toml` is missing or wrong, or an entry is not as it must be.
    """
    jobs, cases = [], len(board.public_cases) * len(board.scenarios)
    current = {each.name for each in read_entries(board, root) if _is_current(each, board, root)}
    for spec in parse_table(ShippedFile, read_toml(root / SHIPPED, "list"), Location(SHIPPED)).shipped:
        is_elsewhere = board.name in spec.not_on or (spec.only_on and board.name not in spec.only_on)
        if is_elsewhere or spec.name in current:
            continue
        networks = [{"weights": name} for name in spec.weights] if board.name in spec.method_on else []
        card = root / CARDS / f"{spec.name}.toml"
        submission = Submission(board, spec.name, spec.planner, spec.options, networks, card, MAINTAINERS)
        do = functools.partial(_submit_again, submission, root, work)
        jobs.append(Job(f"{spec.name} on {board.name}", cases, do))
    return jobs


def _is_current(entry: Entry, board: Board, root: Path) -> bool:
    is_frozen = board.name in read_season(root).frozen
    return entry.spec.board_digest == board.digest and (is_frozen or not describe_change(entry))


def _submit_again(submission: Submission, root: Path, work: Path, progress: Progress) -> None:
    """Submit a planner that ships, in the place of an entry that is not current."""
    folder = root / submission.board.name / ENTRIES / submission.name
    if (folder / ENTRY).is_file() and not _is_current(read_entry(folder), submission.board, root):
        shutil.rmtree(folder)
    submit(submission, root, work, progress)


def freeze_entries(board: Board, root: Path) -> Season:
    """Freeze all entries of a board in a folder of boards, if those of the season are not frozen yet."""
    entries = read_entries(board, root)
    digests = {each.name: each.digest for each in entries if not is_pending(board, each)}
    return freeze(root, board.name, digests)


def to_verify(board: Board, root: Path, work: Path, key: Path) -> list[Job]:
    """List the entries of a board that take part in the season and have no verification that counts.

    Args:
        board: The board.
        root: The folder of boards.
        work: As for `verify`.
        key: As for `verify`.
    """
    season, jobs = read_season(root), []
    for entry in read_entries(board, root):
        is_there = season.takes_part(board.name, entry.name, entry.digest) and not is_pending(board, entry)
        if is_there and not is_verified(entry, board, season):
            do = functools.partial(verify, entry, board, work=work, season=season, key=key)
            jobs.append(Job(f"{entry.name} on {board.name}", count_cases(entry, board, board.cases), do))
    return jobs
