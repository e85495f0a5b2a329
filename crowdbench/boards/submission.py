"""Makes an entry: copies what the planner consists of, and drives the public cases of the board with the copy."""

from __future__ import annotations

import contextlib
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from crowdbench.boards.board import Board
from crowdbench.boards.entry import (
    CARD,
    NAMES,
    NAMING,
    PLANNER,
    PUBLIC,
    SCHEMA,
    CardSpec,
    Entry,
    EntrySpec,
    check_networks,
    check_submitter,
    file_digests,
    join_facts,
    read_entry,
    write_entry,
)
from crowdbench.boards.kept_runs import driven_scenarios, keep_public
from crowdbench.boards.planner_files import check_size, copy_named_files, imported_code, package, package_files
from crowdbench.boards.run_entry import EntryRun, InUse, Progress, lock_runs
from crowdbench.boards.skeleton import CARD as CARD_TEXT
from crowdbench.runs.result_file import read_result
from crowdbench.runs.run import read_versions
from crowdbench.runs.shards import WHOLE, Shard
from crowdbench.utils.errors import InputError
from crowdbench.utils.files import new_directory
from crowdbench.utils.toml import Location, parse_table, read_toml, toml

ENTRIES = "entries"


@dataclass(frozen=True)
class Submission:
    """What somebody wants to enter.

    Attributes:
        board: The board.
        name: The name of the entry.
        planner: As `crowdbench run --planner` takes it.
        options: The planner's options.
        networks: The options in which other networks of the same method differ.
        card: The file of the card.
        by: Who submits it.
    """

    board: Board
    name: str
    planner: str
    options: Mapping[str, Any]
    networks: Sequence[Mapping[str, Any]]
    card: Path
    by: str

    def __post_init__(self) -> None:
        if not NAMES.fullmatch(self.name):
            raise InputError(f"{self.name!r} cannot be an entry: {NAMING}")


def submit(
    submission: Submission, root: Path, work: Path, progress: Progress | None = None, shard: Shard = WHOLE
) -> tuple[Entry, dict[str, str]]:
    """Make an entry.

    Args:
        submission: What is entered.
        root: The folder of boards, in which the entry gets its folder.
        work: The folder that keeps finished runs until the entry is made.
        progress: Called after each step with what it added to the episodes, in parts of an episode.
        shard: Which share of the batches is run. The last one makes the entry.

    Returns:
        The entry, and the scenarios that its planner cannot drive, with the reason.

    Raises:
        Unfinished: Runs are missing that other shards make.
        InputError: The entry exists, the card is wrong, or the planner cannot be loaded or breaks its contract.
        KeyboardInterrupt: Somebody interrupted it. The same call goes on with what is finished.
    """
    board, directory = submission.board, check_entry(submission, root)
    name = f"submit-{board.name}-{submission.name}"
    with contextlib.ExitStack() as lock:
        if shard == WHOLE:
            lock.enter_context(lock_runs(work / name))
        _check_free(directory)
        directory.parent.mkdir(parents=True, exist_ok=True)
        with new_directory(directory, overwrite=False) as folder:
            planner, options, networks = _copy(submission, folder)
            check_submitter(submission.by, package(planner))
            run = EntryRun(board, folder, planner, options, work, board.public_cases, shard=shard, progress=progress)
            run = replace(run, out=work / f"{name}-{run.digest(package_files(planner))}")
            failed = run.drive()
            if shard != WHOLE:
                lock.enter_context(lock_runs(work / name))
                _check_free(directory)  # another shard may have been the last one
            run.check_finished(failed)
            keep_public(run.out, folder / PUBLIC, board)
            if (folder / PLANNER).exists():  # what is built in is known to be quick enough
                run.time_decisions()
            write_entry(folder, _spec(submission, run, networks))
    shutil.rmtree(run.out)
    return read_entry(directory), failed


def check_entry(submission: Submission, root: Path) -> Path:
    """Refuse what needs no planner to be refused: a card that is wrong, and an entry that exists.

    Returns:
        The folder that the entry gets in the folder of boards, `root`.

    Raises:
        InputError: It is so.
    """
    check_card(submission.card)
    directory = root / submission.board.name / ENTRIES / submission.name
    _check_free(directory)
    return directory


def _check_free(directory: Path) -> None:
    if directory.exists():
        raise InUse(f"{directory} exists already: choose another name, or remove it")


def read_card(path: Path) -> CardSpec:
    """Read the card of an entry. Raises InputError where it is missing or wrong."""
    if not path.exists():
        raise InputError(f"there is no card {path}, which says what the planner is: `crowdbench new-planner` makes one")
    return parse_table(CardSpec, read_toml(path, "card"), Location(path.name))


def check_card(path: Path) -> None:
    """Read a card, and refuse one that still says what `new-planner` wrote.

    Raises InputError where it does, is missing or is wrong.
    """
    card, template = read_card(path), parse_table(CardSpec, toml(CARD_TEXT), Location(path.name))
    for key in ("authors", "contact", "description"):
        if getattr(card, key) == getattr(template, key):
            raise InputError(f"{path} has {key} as `new-planner` wrote it: say who you are, and what the planner does")


def rehearse(submission: Submission) -> float:
    """Check a submission without making an entry, and return the seconds that its public cases will take here.

    Raises:
        InputError: As `submit`.
    """
    board = submission.board
    check_card(submission.card)
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        planner, options, _ = _copy(submission, folder)
        check_submitter(submission.by, package(planner))
        run = EntryRun(board, folder, planner, options, folder, board.public_cases)
        return run.seconds_per_case() * len(board.public_cases) * len(board.scenarios)


def _copy(submission: Submission, folder: Path) -> tuple[str, dict[str, Any], list[dict[str, Any]]]:
    """Copy the card, and the files of the planner and those that its options name, into the folder of an entry.

    Returns:
        The planner, its options and the other networks, as the entry has them.

    Raises:
        InputError: A file cannot be read, they are too large, or a network is entered twice.
    """
    shutil.copyfile(submission.card, folder / CARD)
    planner = copy_named_files(submission.planner, folder)
    package_files(planner)  # refuses one that does not exist
    options = copy_named_files(submission.options, folder)
    networks = [{**options, **copy_named_files(each, folder)} for each in submission.networks]
    check_networks(options, networks)
    check_size(folder)
    return planner, options, networks


def _spec(submission: Submission, run: EntryRun, networks: list[dict[str, Any]]) -> EntrySpec:
    """The contents of `entry.json` for an entry whose other files are there."""
    board, folder = run.board, run.folder
    results = {name: read_result(run.out / name) for name in driven_scenarios(board, run.out)}
    means = {name: {metric: each["mean"] for metric, each in own["metrics"].items()} for name, own in results.items()}
    return EntrySpec(
        format=SCHEMA,
        board=board.name,
        board_digest=board.digest,
        submitted_by=submission.by,
        planner=run.planner,
        package=package(run.planner),
        package_files=package_files(run.planner),
        code=imported_code(run.planner, run.options, folder),
        facts=join_facts({name: result["run"]["planner"]["facts"] for name, result in results.items()}),
        options=dict(run.options),
        networks=networks,
        privileged=any(result["stated"]["privileged"] for result in results.values()),
        environment=read_versions(),
        files=file_digests(folder),
        reported=means,
    )
