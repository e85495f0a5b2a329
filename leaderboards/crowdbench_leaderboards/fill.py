"""Enters the shipped planners on boards, freezes the entries of a season and verifies them; for maintainers.

`leaderboards/shipped.toml` lists the planners, and `leaderboards/cards/` has their cards:
python -m crowdbench_leaderboards.fill --key ~/.ssh/boards
"""

from __future__ import annotations

import functools
import shutil
import time
from collections.abc import Callable, Sequence
from concurrent.futures import as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer
from pydantic import Field

from crowdbench import InputError
from crowdbench.cli import (
    WorkersOption,
    announce_compilation,
    exit_on_interrupt,
    help_from_docstring,
    main,
    progress,
    say,
)
from crowdbench.runs import Progress
from crowdbench.utils import Executor, Location, Name, TomlTable, find_named, open_executor, parse_table, read_toml
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
    workers: WorkersOption = None,
    engine: str | None = None,
) -> None:
    """Enter every shipped planner on boards, freeze the entries once the season has closed, and verify them in it.

    Boards are filled one after the other; boards of recorded pedestrians need --data. Finished work is kept, and the
    same command continues after it. Several processes can share the work, each entry being made by one of them.

    Args:
        boards: Names of boards.
        key: The private key of a maintainer, from ssh-keygen, to sign verdicts. Without it no entry is verified.
        root: The folder of boards and entries.
        work: Folder that keeps finished runs until an entry or a verdict is made.
    """
    root, work = root.absolute(), work.absolute()  # workers may start in another folder
    key = key and key.absolute()
    if key is not None:
        find_signer(key, root)
    by_name = {board.name: board for board in read_boards(root)}
    chosen = [find_named("board", name, by_name) for name in boards or by_name]
    if data is not None and not any(board.spec.recorded for board in chosen):
        raise InputError(f"--data goes with boards of recorded people, unlike {chosen[0].name}")
    announce_compilation()
    with (
        exit_on_interrupt(f"the same command goes on with what is kept in {root} and {work}"),
        open_executor(engine, workers, None) as executor,
    ):
        for board in chosen:
            if board.spec.recorded and data is None:
                say(f"{board.name}: left out, because its people were recorded: give their tracks, --data DIR")
                continue
            with_tracks = board.with_data(data) if board.spec.recorded else board
            _fill_board(with_tracks, root, work, key, executor)


def _fill_board(board: Board, root: Path, work: Path, key: Path | None, executor: Executor | None) -> None:
    """Create the missing entries of a board, freeze them, and verify them if there is a key."""
    if not do_all(functools.partial(to_submit, board, root, work), "entry", executor):
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
    do_all(functools.partial(to_verify, board, root, work, key), "verification", executor)


def do_all(missing: Callable[[], Sequence[Job]], what: str, executor: Executor | None = None) -> bool:
    """Run the jobs that no other process runs; return False if other processes are still running jobs at the end.

    Args:
        missing: Returns the jobs that are not done.
        what: The kind of their results, in messages.
        executor: Workers that run the jobs, if any.
    """
    if executor is not None:
        _hand_out(missing(), what, executor)
        return not missing()
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


def _hand_out(jobs: Sequence[Job], what: str, executor: Executor) -> None:
    """Run jobs on workers. Raises the first error of a job after the others are finished."""
    errors = []
    with progress(sum(job.cases for job in jobs), f"of {len(jobs)} jobs") as tell:
        futures = {executor.submit(_do, job): job for job in jobs}
        for future in as_completed(futures):
            job, outcome = futures[future], future.result()
            tell(job.cases)
            if isinstance(outcome, float):
                say(f"{what}: {job.title} took {outcome / 60:.1f} minutes")
            elif not isinstance(outcome, InUse):
                errors.append(outcome)
    if errors:
        raise errors[0]


def _do(job: Job) -> float | InputError:
    """Run a job on a worker, and return the seconds that it took, or its error."""
    start = time.monotonic()
    try:
        job.do(progress=lambda done: None)
    except InputError as error:
        return error
    return time.monotonic() - start


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
