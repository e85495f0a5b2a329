"""The commands `crowdbench submit` and `crowdbench verify`."""

from __future__ import annotations

import dataclasses
import json
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from crowdbench import InputError
from crowdbench.cli import (
    ThreadsOption,
    WorkersOption,
    announce_compilation,
    assignments,
    exit_on_interrupt,
    progress,
    say,
    use_threads,
)
from crowdbench.isolation import one_line
from crowdbench.utils import command

if TYPE_CHECKING:
    from crowdbench import Episodes
    from crowdbench_leaderboards.board import Board
    from crowdbench_leaderboards.entry import Entry
    from crowdbench_leaderboards.verdict import Verification

ROOT = Path("leaderboards")
WORK = Path("runs/boards")


def submit(
    planner: str,
    board: Annotated[str, typer.Option()],
    card: Annotated[Path | None, typer.Option(show_default="card.toml beside the planner")] = None,
    name: Annotated[str | None, typer.Option(show_default="the planner's name")] = None,
    option: list[str] | None = None,
    network: list[str] | None = None,
    data: Path | None = None,
    root: Path = ROOT,
    work: Path = WORK,
    dry_run: bool = False,
    threads: ThreadsOption = None,
) -> None:
    """Make an entry of a leaderboard: check the planner, copy its files, run the public cases with the copy.

    Args:
        planner: Name of a planner, or a file of your own: ./mine.py, ./mine.py:factory or policy.onnx.
        board: The name of a board: one in the folder of boards, or one that ships.
        card: Card that describes the planner. Its `account` is the account that enters it.
        name: The name of the entry.
        network: Another network of the same method: key=value, such as weights=b.safetensors. Repeatable.
        root: The folder of boards and entries.
        work: Folder that keeps finished runs until an entry or a verdict is made.
        dry_run: Check planner and card, and estimate the time for the public cases, but make no entry.
    """
    use_threads(threads)
    from crowdbench import PLANNERS
    from crowdbench.plugins import file_and_function, plugin_name, program
    from crowdbench_leaderboards.board import find_board
    from crowdbench_leaderboards.submission import Submission, rehearse
    from crowdbench_leaderboards.submission import submit as submit_planner

    rules = find_board(board, root).with_data(data)
    options = assignments(option or [], "--option")
    if Path(planner).is_dir():
        raise InputError(f"{planner} is a folder: name the file of the planner")
    is_file = file_and_function(planner)[0] is not None
    if not is_file and program(planner) is None:
        PLANNERS.find(planner)
    card = card or Path(planner).parent / "card.toml"
    networks = [assignments([text], "--network") for text in network or []]
    submission = Submission(rules, plugin_name(planner) if name is None else name, planner, options, networks, card)
    submission.check(root)
    announce_compilation()
    if is_file:
        say("checking the contract")
        _check_contract(planner, option or [])
    cases = len(rules.public_cases) * len(rules.scenarios)
    if dry_run:
        seconds = rehearse(submission, root)
        say(f"no fault is found, and no entry made; {cases} public cases will take about {seconds:.0f} s here")
        return
    message = f"finished batches are kept in {work}, with which the same command goes on"
    with exit_on_interrupt(message), progress(cases, f"of {cases} public cases") as update:
        entry, failures = submit_planner(submission, root, work, update)
    _say_entry(entry, failures, rules, data)


def _say_entry(entry: Entry, failures: Mapping[str, str], board: Board, data: Path | None) -> None:
    """Print what an entry reports, and the next commands.

    Args:
        entry: The entry that was made.
        failures: The error of each scenario that cannot be driven.
        board: Its board.
        data: The folder with recorded tracks, if the board needs it.
    """
    for scenario, reason in failures.items():
        say(f"{scenario}: counts 0, because it cannot be driven: {reason}")
    if entry.spec.privileged:
        say("the planner is privileged: it is shown, and has no rank")
    from crowdbench_leaderboards.entry import PUBLIC
    from crowdbench_leaderboards.episode_table import read_table

    for scenario, episodes in read_table(entry.directory / PUBLIC, board, board.public_cases).items():
        say(f"{scenario}: {_means(episodes)} in {len(board.public_cases)} public cases")
    given = [] if data is None else ["--data", data]
    say(
        f"made {entry.directory}, which is verified in the next season of its board. Next:\n"
        f"  {command('verify', entry.directory, *given)}   re-runs it on held-out cases\n"
        "  then open a pull request with this folder: see docs/boards.md"
    )


def _means(episodes: Episodes) -> str:
    score, success = (float(episodes.columns[name].mean()) for name in ("score", "success_rate"))
    return f"score {score:.3f}, success {100 * success:.1f} %"


def _check_contract(planner: str, options: Sequence[str]) -> None:
    """Raise InputError if a planner breaks its contract, which is checked in another process."""
    flags = [word for option in options for word in ("--option", option)]
    check = subprocess.run(
        # -P: do not import a folder crowdbench/ of the current directory.
        [sys.executable, "-P", "-m", "crowdbench", "check", planner, *flags],
        capture_output=True,
        text=True,
        errors="replace",
    )
    if check.returncode != 0:
        if check.stdout:
            print(check.stdout, end="")
            raise InputError(f"planner {planner} breaks its contract: see above")
        _, is_error, error = check.stderr.rpartition("crowdbench: ")
        ended = f"planner {planner} ended the process of its check, with status {check.returncode}"
        raise InputError(error.strip() if is_error else ended)


def verify(
    entry: Path,
    season: bool = False,
    key: Path | None = None,
    cases: Annotated[int | None, typer.Option(min=1)] = None,
    data: Path | None = None,
    file: list[Path] | None = None,
    work: Path = WORK,
    workers: WorkersOption = None,
    threads: ThreadsOption = None,
    as_json: bool = False,
) -> None:
    """Verify an entry: replay its public cases, then drive held-out cases, isolated and one at a time.

    Args:
        entry: The folder of an entry.
        season: Drive the cases of the season, and record and sign the verdict.
        key: For --season, the private key of a maintainer, made by ssh-keygen.
        cases: Number of cases, if fewer than the board has; not with --season.
        file: A file that the entry names by its sha256, such as the weights of others. Repeatable.
        work: Folder that keeps finished runs until an entry or a verdict is made.
        workers: Number of scenarios that are driven at once, each on a core of its own.
    """
    use_threads(threads)
    from crowdbench import Cases
    from crowdbench.utils import open_executor
    from crowdbench_leaderboards.board import FILE, find_board, read_board
    from crowdbench_leaderboards.entry import read_entry
    from crowdbench_leaderboards.planner_files import external_files
    from crowdbench_leaderboards.season import read_season
    from crowdbench_leaderboards.verdict import Verdict
    from crowdbench_leaderboards.verification import Verifier

    if season and cases:
        raise InputError("--cases does not go with --season: the board defines the cases of a season")
    if season != (key is not None):
        raise InputError("--season and --key go together: a verdict of a season is signed by a maintainer")
    entry, work = entry.resolve(), work.absolute()
    submitted = read_entry(entry)
    if work.resolve().is_relative_to(entry):
        raise InputError(f"--work {work} lies in the entry: give another folder")
    folder = entry.parent.parent
    board = read_board(folder) if (folder / FILE).exists() else find_board(submitted.spec.board)
    board = board.with_data(data)
    if cases and cases > len(board.cases):
        raise InputError(f"--cases is {cases}, but the board {board.name} has {len(board.cases)} cases")
    announce_compilation()
    driven, message = Cases("test", 0, cases) if cases else board.cases, "nothing is kept"
    if key:
        message = f"finished cases are kept in {work}, with which the same command goes on"
    else:
        say(
            "public cases are replayed, and others driven that are drawn now; nothing of this is kept: what a board "
            "shows is verified in its season"
        )
    setting = Verifier(board, folder.parent, work, external_files(file or []))
    with (
        exit_on_interrupt(message),
        progress(setting.count_cases(submitted, driven)) as update,
        open_executor(None, workers, 1) as executor,
    ):
        setting = dataclasses.replace(setting, executor=executor, progress=update)
        episodes: dict[str, Episodes] = {}
        if key:
            verification = setting.verify_in_season(submitted, read_season(folder.parent), key)
        else:
            verification, episodes = setting.verify(submitted, driven)
    if as_json:
        print(json.dumps(verification.model_dump(mode="json"), indent=2))
    else:
        _print_verification(submitted, verification, episodes)
    if verification.verdict != Verdict.RERUN:
        raise typer.Exit(1)


def _print_verification(entry: Entry, verification: Verification, episodes: Mapping[str, Episodes]) -> None:
    from crowdbench_leaderboards.verdict import Verdict

    passes = verification.verdict == Verdict.RERUN
    verdict = f"passes, {verification.verdict}" if passes else verification.verdict
    print(
        f"{entry.name} on {verification.board}: {verdict} on seed {verification.seed}: {one_line(verification.reason)}"
    )
    for scenario, own in episodes.items():
        print(f"{scenario}: {_means(own)} in {len(set(own.case))} held-out cases")
    if speed := verification.decision_time:
        print(
            f"decisions in one world on one core: 99th percentile {speed.p99_ms:.1f} ms, {100 * speed.in_time:.1f} % "
            f"below the time step: {'real-time' if speed.is_real_time else 'slower than real time'}"
        )
    if entry.spec.privileged:
        print("The planner is privileged: it is shown, and has no rank.")
    print("Verification does not detect privileged information in training.")
    if not verification.season:
        print("Nothing of this is kept: until its season, the entry is shown with the figures that you report.")
