"""Enters every planner that ships on every board that it can run on, and verifies all of them.

Which planners these are is in `leaderboards/shipped.toml`, what their authors say of them in `leaderboards/cards/`.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from crowdbench.boards.baselines import pack
from crowdbench.boards.board import Board
from crowdbench.boards.entry import MAINTAINERS
from crowdbench.boards.planner_files import describe_change, package_files
from crowdbench.boards.run_entry import EntryRun
from crowdbench.boards.season import Season, freeze, read_season
from crowdbench.boards.standings import read_entries
from crowdbench.boards.submission import Submission, submit
from crowdbench.boards.verification import count_cases, is_verified, measure_pace, verify
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
        seconds: About how long it takes on this machine.
    """

    title: str
    cases: int
    do: Callable[..., object]
    seconds: float


def to_submit(board: Board, root: Path, work: Path) -> list[Job]:
    """The planners that ship and are not on a board yet, or there with other files while its entries are not frozen.

    Args:
        board: The board.
        root: As for `submit`.
        work: As for `submit`.

    Raises:
        InputError: `shipped.toml` is missing or wrong, or an entry is not as it must be.
    """
    jobs, is_frozen = [], board.name in read_season(root).frozen
    entered = {each.name for each in read_entries(board, root) if is_frozen or not describe_change(each.spec)}
    for spec in parse_table(ShippedFile, read_toml(root / SHIPPED, "list"), Location(SHIPPED)).shipped:
        is_elsewhere = board.name in spec.not_on or (spec.only_on and board.name not in spec.only_on)
        if is_elsewhere or spec.name in entered:
            continue
        networks = [{"weights": name} for name in spec.weights] if board.name in spec.method_on else []
        card = root / CARDS / f"{spec.name}.toml"
        submission = Submission(board, spec.name, spec.planner, spec.options, networks, card, MAINTAINERS)
        cases = len(board.public_cases) * len(board.scenarios)
        run = EntryRun(board, root, spec.planner, spec.options, work, board.public_cases)
        pace = run.measure_pace(spec.name, package_files(spec.planner), board.scenarios)
        do = functools.partial(submit, submission, root, work)
        jobs.append(Job(f"{spec.name} on {board.name}", cases, do, pace * cases))
    return jobs


def freeze_entries(board: Board, root: Path) -> Season:
    """Freeze all entries of a board in a folder of boards, if those of the season are not frozen yet."""
    entries = read_entries(board, root)
    digests = {each.name: each.digest for each in entries if each.spec.board_digest == board.digest}
    return freeze(root, board.name, digests)


def to_verify(board: Board, root: Path, work: Path, key: Path) -> list[Job]:
    """Entries of a board that take part in the season and are still to verify in it; `work` and `key` as for `verify`.

    Those of which there is a verification that does not count, or one by earlier rules, are verified again.
    """
    season = read_season(root)
    jobs = []
    for entry in read_entries(board, root):
        if is_verified(entry, board, season) or not season.takes_part(board.name, entry.name, entry.digest):
            continue
        pace = measure_pace(entry, board, work)
        cases = board.cases_at(pace)
        number = count_cases(entry, board, cases)
        do = functools.partial(verify, entry, board, work=work, season=season, key=key, cases=cases)
        jobs.append(Job(f"{entry.name} on {board.name}", number, do, pace * number))
    return jobs


def pack_entries(board: Board, root: Path) -> None:
    """Move the entries of planners that ship, and what was found of them, into one file of a board."""
    pack(root / board.name, [each.name for each in read_entries(board, root) if each.spec.submitted_by == MAINTAINERS])
