"""Enters the shipped planners on boards, freezes the entries of a season and verifies them; for maintainers.

`leaderboards/shipped.toml` lists the planners, and `leaderboards/cards/` has their cards:
python -m crowdbench_leaderboards.fill --key ~/.ssh/boards
"""

from __future__ import annotations

import functools
import shutil
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer
from pydantic import Field

from crowdbench import InputError
from crowdbench.cli import announce_compilation, exit_on_interrupt, help_from_docstring, main, progress, say
from crowdbench.runs import Progress
from crowdbench.utils import Location, Name, TomlTable, find_named, parse_table, read_toml
from crowdbench_leaderboards.board import Board, read_boards
from crowdbench_leaderboards.board_runs import InUse
from crowdbench_leaderboards.cli import ROOT, WORK
from crowdbench_leaderboards.entry import (
    ENTRY,
    MAINTAINERS,
    is_pending,
    read_entries,
    read_entry,
)
from crowdbench_leaderboards.season import Season, TooEarly, freeze, read_season
from crowdbench_leaderboards.signature import find_signer
from crowdbench_leaderboards.submission import Submission, submit
from crowdbench_leaderboards.verification import count_cases, is_verified, verify_in_season

SHIPPED = "shipped.toml"
CARDS = "cards"

Boards = Annotated[list[Name], Field(description="a list of boards")]


class ShippedSpec(TomlTable):
    """An item of `shipped` in `shipped.toml`: the name of an entry and of its card, and its planner.

    `weights` are other networks of the same method, which are run on the boards `method_on`. `not_on` lists the boards
    that the planner cannot run on, and `only_on` the only ones that it is entered on.
    """

    name: Name
    planner: Name
    options: Annotated[dict[str, Any], Field(description="a table of options")] = Field(default_factory=dict)
    weights: Annotated[list[Name], Field(description="a list of weights")] = Field(default_factory=list)
    method_on: Boards = Field(default_factory=list)
    not_on: Boards = Field(default_factory=list)
    only_on: Boards = Field(default_factory=list)


class ShippedFile(TomlTable):
    """The contents of `shipped.toml`."""

    shipped: Annotated[list[ShippedSpec], Field(min_length=1, description="tables [[shipped]]")]


@dataclass(frozen=True)
class Job:
    """A missing entry or verification.

    Attributes:
        title: Its name in messages.
        cases: Number of cases that it drives or replays.
        do: Function that creates it; takes `progress`, see `submit` and `verify`.
    """

    title: str
    cases: int
    do: Callable[..., object]


@help_from_docstring
def fill(
    boards: Annotated[list[str] | None, typer.Argument(show_default="all")] = None,
    key: Path | None = None,
    data: Path | None = None,
    root: Path = ROOT,
    work: Path = WORK,
) -> None:
    """Enter every shipped planner on boards, freeze the entries once the season has closed, and verify them in it.

    Boards are filled one after the other; boards of recorded pedestrians need --data. Finished work is kept, and the
    same command continues after it. Several processes can share the work.

    Args:
        boards: Names of boards.
        key: The private key of a maintainer, from ssh-keygen, to sign verdicts. Without it no entry is verified.
        root: The folder of boards and entries.
        work: Folder that keeps finished runs until an entry or a verdict is made.
    """
    if key is not None:
        find_signer(key, root)
    by_name = {board.name: board for board in read_boards(root)}
    chosen = [find_named("board", name, by_name) for name in boards or by_name]
    if data is not None and not any(board.spec.recorded for board in chosen):
        raise InputError(f"--data goes with boards of recorded people, unlike {chosen[0].name}")
    announce_compilation()
    with exit_on_interrupt(f"the same command goes on with what is kept in {root} and {work}"):
        for board in chosen:
            if board.spec.recorded and data is None:
                say(f"{board.name}: left out, because its people were recorded: give their tracks, --data DIR")
                continue
            _fill_board(board.with_data(data) if board.spec.recorded else board, root, work, key)


def _fill_board(board: Board, root: Path, work: Path, key: Path | None) -> None:
    """Create the missing entries of a board, freeze them, and verify them if there is a key."""
    if not do_all(functools.partial(to_submit, board, root, work), "entry"):
        say(f"{board.name}: other processes are making the last entries")
        return
    try:
        freeze_entries(board, root).seed(board.name)
    except TooEarly as error:
        say(f"{board.name}: no entry is verified: {error}")
        return
    if key is None:
        say(f"{board.name}: no entry is verified: give the key of a maintainer, --key FILE")
        return
    do_all(functools.partial(to_verify, board, root, work, key), "verification")


def do_all(missing: Callable[[], Sequence[Job]], what: str) -> bool:
    """Run the jobs that no other process runs; return False if other processes are still running jobs at the end."""
    skipped: set[str] = set()
    while jobs := [job for job in missing() if job.title not in skipped]:
        job = jobs[0]
        say(f"{what}: {job.title}, the first of {len(jobs)}")
        start = time.monotonic()
        try:
            with progress(job.cases) as tell:
                job.do(progress=tell)
            say(f"{what}: {job.title} took {(time.monotonic() - start) / 60:.1f} minutes")
        except InUse:
            skipped.add(job.title)
    return not missing()


def to_submit(board: Board, root: Path, work: Path) -> list[Job]:
    """List the shipped planners without an entry for the board's digest.

    Raises:
        InputError: `shipped.toml` is missing or wrong, or an entry is damaged.
    """
    jobs, cases = [], len(board.public_cases) * len(board.scenarios)
    current = {entry.name for entry in read_entries(board, root) if not is_pending(entry, board)}
    for spec in parse_table(ShippedFile, read_toml(root / SHIPPED, "list"), Location(SHIPPED)).shipped:
        is_elsewhere = board.name in spec.not_on or (spec.only_on and board.name not in spec.only_on)
        if is_elsewhere or spec.name in current:
            continue
        networks = [{"weights": name} for name in spec.weights] if board.name in spec.method_on else []
        card = root / CARDS / f"{spec.name}.toml"
        submission = Submission(board, spec.name, spec.planner, spec.options, networks, card, MAINTAINERS)
        do = functools.partial(_submit, submission, root, work)
        jobs.append(Job(f"{spec.name} on {board.name}", cases, do))
    return jobs


def _submit(submission: Submission, root: Path, work: Path, progress: Progress) -> None:
    """Submit a shipped planner, and replace its entry if that is pending."""
    folder = submission.directory(root)
    if (folder / ENTRY).is_file() and is_pending(read_entry(folder), submission.board):
        shutil.rmtree(folder)
    submit(submission, root, work, progress)


def freeze_entries(board: Board, root: Path) -> Season:
    """Freeze the entries of a board, if its season is not frozen yet."""
    entries = read_entries(board, root)
    return freeze(root, board.name, {entry.name: entry.digest for entry in entries if not is_pending(entry, board)})


def to_verify(board: Board, root: Path, work: Path, key: Path) -> list[Job]:
    """List the entries of a board that take part in the season and have no valid verification."""
    season, jobs = read_season(root), []
    for entry in read_entries(board, root):
        takes_part = season.takes_part(board.name, entry.name, entry.digest) and not is_pending(entry, board)
        if takes_part and not is_verified(entry, board, season):
            do = functools.partial(verify_in_season, entry, board, work, season, key)
            jobs.append(Job(f"{entry.name} on {board.name}", count_cases(entry, board, board.cases), do))
    return jobs


if __name__ == "__main__":
    main(fill)
