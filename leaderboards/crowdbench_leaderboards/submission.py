"""Makes an entry: copies the files of a planner, and drives the public cases of the board with the copy."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from crowdbench import Cases, InputError
from crowdbench.plugins import CARD, TEMPLATE
from crowdbench.results import read_result
from crowdbench.runs import Progress, read_versions
from crowdbench.utils import new_directory
from crowdbench_leaderboards.board import Board
from crowdbench_leaderboards.board_runs import (
    CaseSet,
    EntryPlanner,
    InUse,
    drive,
    driven_scenarios,
    lock_runs,
    read_episodes,
)
from crowdbench_leaderboards.entries import check_free_name, check_identity, read_entries
from crowdbench_leaderboards.entry import (
    ENTRIES,
    ENTRY,
    NAMES,
    NAMING,
    PUBLIC,
    SCHEMA,
    Entry,
    EntrySpec,
    check_networks,
    files_digest,
    read_card,
    read_entry,
    write_record,
)
from crowdbench_leaderboards.episode_table import write_table
from crowdbench_leaderboards.planner_files import Files, check_files, check_planner, copy_named_files

REHEARSED = 20
"""Cases of a rehearsal, over all scenarios of a board; one of each scenario at least."""


@dataclass(frozen=True)
class Submission:
    """A planner that is submitted to a board.

    Attributes:
        board: The board.
        name: The name of the entry.
        planner: Name or file of the planner, as for `crowdbench run --planner`.
        options: The planner's options.
        networks: The options in which other networks of the same method differ.
        card: The file of the card.
        external: The files outside of the entry that options name.
    """

    board: Board
    name: str
    planner: str
    options: Mapping[str, Any]
    networks: Sequence[Mapping[str, Any]]
    card: Path
    external: Files = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not NAMES.fullmatch(self.name):
            raise InputError(f"{self.name!r} cannot be an entry: {NAMING}")

    @property
    def cases(self) -> CaseSet:
        """The public cases of the board."""
        return CaseSet(self.board, self.board.public_cases)

    def directory(self, root: Path) -> Path:
        """Return the folder of the entry in a folder of boards."""
        return root / self.board.name / ENTRIES / self.name

    def check(self, root: Path) -> None:
        """Check the card, and that there is no such entry.

        Raises:
            InUse: The entry exists.
            InputError: The card is missing or wrong, or still has a text of the template.
        """
        card, template = read_card(self.card), read_card(TEMPLATE / CARD)
        fields = "authors", "contact", "description"
        if left := [key for key in fields if getattr(card, key) == getattr(template, key)]:
            as_made = f"has {', '.join(left)} as `new-planner` wrote it"
            raise InputError(f"{self.card} {as_made}: say who you are, and what it does")
        if (directory := self.directory(root)).exists():
            raise InUse(f"{directory} exists already: choose another name, or remove it")
        check_identity(self.name, self.planner, [self.options, *self.networks], card, root)
        check_free_name(self.name, card, read_entries(self.board, root).good)

    def copy_to(self, folder: Path) -> tuple[EntryPlanner, list[dict[str, Any]]]:
        """Copy the card, the planner's files and the files that its options name into the folder of an entry.

        Returns:
            The planner and the options of the other networks, with the paths in the entry.

        Raises:
            InputError: A file cannot be read or is not allowed, or a network is entered twice.
        """
        shutil.copyfile(self.card, folder / CARD)
        planner = copy_named_files(self.planner, folder)
        check_planner(planner)
        options = copy_named_files(self.options, folder)
        networks = [{**options, **copy_named_files(network, folder)} for network in self.networks]
        check_files(folder)
        check_networks(options, networks, folder)
        return EntryPlanner(folder, planner, options, self.external), networks


def submit(
    submission: Submission, root: Path, work: Path, progress: Progress | None = None
) -> tuple[Entry, dict[str, str]]:
    """Make an entry.

    Args:
        submission: The entry to make.
        root: The folder of boards, in which the entry gets its folder.
        work: The folder that keeps finished runs until the entry is made.
        progress: Called after each step with the progress of the step, as a fractional number of episodes.

    Returns:
        The entry, and the errors by scenario that its planner cannot drive.

    Raises:
        InputError: The entry exists, the card is wrong, or the planner cannot be loaded or breaks its contract.
        KeyboardInterrupt: The user interrupted it. The same call goes on with finished batches.
    """
    directory = submission.directory(root)
    runs = work / f"submit-{submission.board.name}-{submission.name}"
    submission.check(root)
    with lock_runs(runs):
        submission.check(root)  # another process may have made it
        directory.parent.mkdir(parents=True, exist_ok=True)
        with new_directory(directory, overwrite=False) as folder:
            planner, networks = submission.copy_to(folder)
            failures = drive(planner, submission.cases, runs, progress)
            write_table(folder / PUBLIC, read_episodes(submission.board, runs), runs)
            spec = _make_spec(submission, planner, networks, runs)
            write_record(folder / ENTRY, spec)
        shutil.rmtree(runs)
    return read_entry(directory), failures


def _make_spec(submission: Submission, planner: EntryPlanner, networks: list[dict[str, Any]], runs: Path) -> EntrySpec:
    """Return the contents of `entry.json` for an entry whose other files are written."""
    board, folder = submission.board, planner.folder
    results = {name: read_result(runs / name) for name in driven_scenarios(board, runs)}
    return EntrySpec(
        format=SCHEMA,
        board=board.name,
        board_digest=board.digest,
        planner=planner.planner,
        options=dict(planner.options),
        networks=networks,
        facts={name: result["run"]["planner"]["facts"] for name, result in results.items()},
        privileged=any(result["stated"]["privileged"] for result in results.values()),
        raw=any(result["stated"]["raw"] for result in results.values()),
        environment=read_versions(),
        files=files_digest(folder),
    )


def rehearse(submission: Submission, root: Path) -> float:
    """Drive a few cases without making an entry, and estimate the seconds of the public cases on this machine.

    Raises:
        InputError: As `submit`.
    """
    submission.check(root)
    board = submission.board
    count = min(max(REHEARSED // len(board.scenarios), 1), board.spec.public_cases)
    with tempfile.TemporaryDirectory() as temporary:
        folder, runs = Path(temporary, "entry"), Path(temporary, "runs")
        folder.mkdir()
        planner, _ = submission.copy_to(folder)
        drive(planner, CaseSet(board, Cases("test", 0, count)), runs)
        timing = [read_result(runs / name)["stated"]["timing"] for name in driven_scenarios(board, runs)]
    return sum(float(seconds["seconds"]) for seconds in timing) * board.spec.public_cases / count
