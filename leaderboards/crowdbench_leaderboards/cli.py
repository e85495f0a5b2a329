"""The commands `crowdbench submit` and `crowdbench verify`."""

from __future__ import annotations

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
        card: Card that describes the planner. Its first author is the submitter of the entry.
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
    from crowdbench_leaderboards.entry import MAINTAINERS, fold, read_card
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
    submitter = read_card(card).authors[0]
    if fold(submitter) == MAINTAINERS:
        raise InputError(f"{submitter} submits the planners that ship, by crowdbench_leaderboards.fill: give your name")
    networks = [assignments([text], "--network") for text in network or []]
    submission = Submission(
        rules, plugin_name(planner) if name is None else name, planner, options, networks, card, submitter
    )
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
    _say_entry(entry, failures, rules.spec.public_cases, root, data)


def _say_entry(entry: Entry, failures: Mapping[str, str], cases: int, root: Path, data: Path | None) -> None:
    """Print what an entry reports, the season in which it is verified, and the next commands.

    Args:
        entry: The entry that was made.
        failures: The error of each scenario that cannot be driven.
        cases: The public cases of each scenario.
        root: The folder of boards.
        data: The folder with recorded tracks, if the board needs it.
    """
    for scenario, reason in failures.items():
        say(f"{scenario}: counts 0, because it cannot be driven: {reason}")
    if entry.spec.privileged:
        say("the planner is privileged: it is shown, and has no rank")
    for scenario, metrics in entry.spec.reported.items():
        say(f"{scenario}: success {100 * (metrics['success_rate'] or 0.0):.1f} % in {cases} cases")
    given = [] if data is None else ["--data", data]
    say(
        f"made {entry.directory}. {_describe_season(entry.spec.board, root)} Next:\n"
        f"  {command('verify', entry.directory, *given)}   re-runs it on held-out cases\n"
        "  then open a pull request with this folder: see docs/boards.md"
    )


def _describe_season(board: str, root: Path) -> str:
    """Return a sentence with the season in which a new entry is verified."""
    from crowdbench_leaderboards.season import SEASON, read_season

    if not (root / SEASON).exists():
        return "It is verified in the next season of the board."
    season = read_season(root)
    if board in season.frozen:
        return f"The entries of the season {season.spec.name} are frozen: it is verified in the next season."
    return f"It is verified in the season {season.spec.name}, which closes on {season.spec.closes}."


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
    work: Path = WORK,
    threads: ThreadsOption = None,
    as_json: bool = False,
) -> None:
    """Verify an entry: replay its public cases, then run its planner, isolated, on held-out cases.

    Args:
        entry: The folder of an entry.
        season: Drive the cases of the season, and record and sign the verdict.
        key: For --season, the private key of a maintainer, made by ssh-keygen.
        cases: Number of cases, if fewer than the board has; not with --season.
        work: Folder that keeps finished runs until an entry or a verdict is made.
    """
    use_threads(threads)
    from crowdbench import Cases
    from crowdbench_leaderboards.board import FILE, find_board, read_board
    from crowdbench_leaderboards.entry import read_entry
    from crowdbench_leaderboards.season import read_season
    from crowdbench_leaderboards.verdict import Verdict
    from crowdbench_leaderboards.verification import count_cases, verify_in_season
    from crowdbench_leaderboards.verification import verify as verify_entry

    if season and cases:
        raise InputError("--cases does not go with --season: the board defines the cases of a season")
    if season != (key is not None):
        raise InputError("--season and --key go together: a verdict of a season is signed by a maintainer")
    entry = entry.resolve()
    submitted = read_entry(entry)
    if work.resolve().is_relative_to(entry):
        raise InputError(f"--work {work} lies in the entry: give another folder")
    folder = entry.parent.parent
    board = read_board(folder) if (folder / FILE).exists() else find_board(submitted.spec.board)
    board = board.with_data(data)
    if cases and cases > len(board.cases):
        raise InputError(f"--cases is {cases}, but the board {board.name} has {len(board.cases)} cases")
    announce_compilation()
    driven = Cases("test", 0, cases) if cases else board.cases
    total, message = count_cases(submitted, board, driven), "nothing is kept"
    if key:
        message = f"finished batches are kept in {work}, with which the same command goes on"
    else:
        say(
            "public cases are replayed, and others driven that are drawn now; nothing of this is kept: what a board "
            "shows is verified in its season"
        )
    with exit_on_interrupt(message), progress(total) as update:
        if key:
            verification = verify_in_season(submitted, board, work, read_season(folder.parent), key, update)
        else:
            verification = verify_entry(submitted, board, work, driven, update)
    if as_json:
        print(json.dumps(verification.model_dump(mode="json"), indent=2))
    else:
        _print_verification(submitted, board.name, verification)
    if verification.verdict != Verdict.RERUN:
        raise typer.Exit(1)


def _print_verification(entry: Entry, board: str, verification: Verification) -> None:
    from crowdbench_leaderboards.verdict import Verdict

    where = f" on seed {verification.seed}" if verification.figures else ""
    passes = verification.verdict == Verdict.RERUN
    verdict = f"passes, {verification.verdict}" if passes else verification.verdict
    print(f"{entry.name} on {board}: {verdict}{where}: {one_line(verification.reason)}")
    for scenario, metrics in verification.figures.items():
        measured = metrics["success_rate"].mean or 0.0
        reported = entry.spec.reported.get(scenario, {}).get("success_rate") or 0.0
        print(f"{scenario}: success {100 * measured:.2f} %, reported {100 * reported:.2f} %")
    if passes:
        print("Where it is lower than reported, chance explains it.")
    if speed := verification.decision_time:
        print(
            f"decisions in one world on one core: 99th percentile {speed.p99_ms:.1f} ms here, "
            f"{speed.calibrated_p99_ms:.1f} ms on the machine of reference, "
            f"{'real-time' if speed.is_real_time else 'slower than real time'}"
        )
    if verification.untimed:
        print(verification.untimed)
    if entry.spec.privileged:
        print("The planner is privileged: it is shown, and has no rank.")
    print("Verification does not detect privileged information in training.")
    if not verification.season:
        print("Nothing of this is kept: until its season, the entry is shown with the figures that you report.")
