"""Enters the shipped planners on boards, freezes the entries of a season and verifies them; for maintainers.

`leaderboards/shipped.toml` lists the planners, and `leaderboards/cards/` has their cards:
python -m crowdbench_leaderboards.fill --key ~/.ssh/boards --workers 2
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import shutil
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

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
from crowdbench.utils import find_named, open_executor
from crowdbench_leaderboards.board import Board, read_boards
from crowdbench_leaderboards.board_runs import CaseSet, InUse
from crowdbench_leaderboards.cli import ROOT, WORK
from crowdbench_leaderboards.entries import read_entries
from crowdbench_leaderboards.entry import Entry, is_pending
from crowdbench_leaderboards.planner_files import external_files, named_externals
from crowdbench_leaderboards.ranked_run import drive_all
from crowdbench_leaderboards.season import Season, TooEarly, freeze, read_season
from crowdbench_leaderboards.shipped import CARDS
from crowdbench_leaderboards.signature import find_signer
from crowdbench_leaderboards.submission import Submission, submit
from crowdbench_leaderboards.verification import Verifier, is_verified


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
    file: list[Path] | None = None,
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
        file: A file that is not in an entry, such as the weights of others. Repeatable.
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
    external = external_files(file or [])
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
            _fill_board(Verifier(with_tracks, root, work, external, executor), key)


def _fill_board(setting: Verifier, key: Path | None) -> None:
    """Create the missing entries of a board, freeze them, and verify them if there is a key."""
    board, root = setting.board, setting.root
    if not do_all(functools.partial(to_submit, setting), "entry"):
        say(f"{board.name}: other processes are making the last entries")
        return
    try:
        season = freeze_entries(board, root)
        season.seed(board.name)
    except TooEarly as error:
        say(f"{board.name}: no entry is verified: {error}")
        return
    if key is None:
        say(f"{board.name}: no entry is verified: give the key of a maintainer, --key FILE")
        return
    if setting.executor is not None:
        _drive_missing(setting, season)
    do_all(functools.partial(to_verify, setting, key), "verification")


def _drive_missing(setting: Verifier, season: Season) -> None:
    """Drive the ranked cases of all entries that are not verified, on workers, scenario by scenario."""
    case_set = CaseSet(setting.board, setting.board.cases, season.seed(setting.board.name))
    entries = missing_verdicts(setting, season)
    tasks = [task for entry in entries for task in setting.tasks(entry, case_set, setting.runs(entry))]
    say(f"{setting.board.name}: {len(tasks)} ranked runs of {len(case_set.cases)} cases")
    with progress(len(tasks) * len(case_set.cases)) as tell, contextlib.suppress(InUse):
        drive_all(tasks, tell, setting.executor)


def do_all(missing: Callable[[], Sequence[Job]], what: str) -> bool:
    """Run the jobs that no other process runs; return False if other processes are still running jobs at the end.

    Args:
        missing: Returns the jobs that are not done.
        what: The kind of their results, in messages.
    """
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


def to_submit(setting: Verifier) -> list[Job]:
    """List the planners of `shipped.toml` without an entry for the board's digest.

    Raises InputError if `shipped.toml` is missing or wrong.
    """
    board, root, jobs = setting.board, setting.root, []
    found = read_entries(board, root)
    for name, why in found.bad.items():
        say(f"{board.name}: {name} is left out: {why}")
    current = {entry.name for entry in found.good if not is_pending(entry, board)}
    for spec in found.shipped.values():
        if spec.name in current or not spec.is_on(board.name):
            continue
        if absent := [name for name in named_externals(spec.options) if name not in setting.external]:
            say(f"{board.name}: {spec.name} is not entered: give its weights, --file, {absent[0]}")
            continue
        card = root / CARDS / f"{spec.name}.toml"
        submission = Submission(
            board, spec.name, spec.planner, spec.options, spec.networks(board.name), card, setting.external
        )
        do = functools.partial(_submit, submission, root, setting.work)
        jobs.append(Job(f"{spec.name} on {board.name}", len(board.public_cases) * len(board.scenarios), do))
    return jobs


def _submit(submission: Submission, root: Path, work: Path, progress: Progress) -> None:
    """Submit a listed planner, and replace its entry if that is pending or damaged."""
    folder = submission.directory(root)
    if folder.exists() and submission.name not in {
        entry.name for entry in read_entries(submission.board, root).good if not is_pending(entry, submission.board)
    }:
        shutil.rmtree(folder)
    submit(submission, root, work, progress)


def freeze_entries(board: Board, root: Path) -> Season:
    """Freeze the entries of a board, if its season is not frozen yet."""
    return freeze(root, board.name, [each for each in read_entries(board, root).good if not is_pending(each, board)])


def missing_verdicts(setting: Verifier, season: Season) -> list[Entry]:
    """Return the entries of a board that rank in the season and have no valid verdict."""
    board = setting.board
    return [
        entry
        for entry in read_entries(board, setting.root).good
        if season.takes_part(board.name, entry.name, entry.digest)
        and season.ranks(board.name, entry.name)
        and not is_pending(entry, board)
        and not is_verified(entry, board, season)
        and all(name in setting.external for name in named_externals(entry.spec.options))
    ]


def to_verify(setting: Verifier, key: Path) -> list[Job]:
    """List the verifications that are missing, see `missing_verdicts`."""
    board, season, jobs = setting.board, read_season(setting.root), []
    for entry in missing_verdicts(setting, season):
        do = functools.partial(_verify, setting, entry, season, key)
        jobs.append(Job(f"{entry.name} on {board.name}", setting.count_cases(entry, board.cases), do))
    return jobs


def _verify(setting: Verifier, entry: Entry, season: Season, key: Path, progress: Progress) -> None:
    dataclasses.replace(setting, executor=None, progress=progress).verify_in_season(entry, season, key)


if __name__ == "__main__":
    main(fill)
