"""The commands of those who enter a leaderboard: write a planner, submit it, verify entries."""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from crowdbench.cli.console import announce_compilation, exit_on_interrupt, progress, say
from crowdbench.cli.options import ThreadsOption, assignments, help_from_docstring, use_threads
from crowdbench.utils.errors import InputError

if TYPE_CHECKING:
    from crowdbench.boards.entry import Entry
    from crowdbench.boards.verdict import Verification

ShardOption = Annotated[
    str | None, typer.Option(help="Run one share of the batches, such as 2/8; the last shard to finish goes on.")
]
ROOT = Path("leaderboards")
WORK = Path("runs/boards")


@help_from_docstring
def new_planner(name: str, out: Path = Path()) -> None:
    """Make the folder of a planner of your own: a planner that works, its test, and its card for leaderboards.

    Args:
        name: A name of lower-case letters, digits and underscores.
        out: Folder in which it gets a folder.
    """
    from crowdbench.boards.skeleton import write_skeleton

    folder = write_skeleton(name, out)
    file = folder / f"{name}.py"
    say(
        f"made {folder}: {name}.py drives, test_{name}.py tests it (with pytest), card.toml says what it is\n"
        f"  crowdbench check {file}\n"
        f"  crowdbench run --planner {file}\n"
        f"  crowdbench submit {file} --board five"
    )


@help_from_docstring
def submit(
    planner: str,
    board: Annotated[str, typer.Option()],
    card: Annotated[Path | None, typer.Option(show_default="card.toml beside the planner")] = None,
    by: Annotated[str | None, typer.Option(show_default="the first author that the card names")] = None,
    name: Annotated[str | None, typer.Option(show_default="the planner's name")] = None,
    option: list[str] | None = None,
    network: list[str] | None = None,
    data: Path | None = None,
    root: Path = ROOT,
    work: Path = WORK,
    dry_run: bool = False,
    shard: ShardOption = None,
    threads: ThreadsOption = None,
) -> None:
    """Make an entry of a leaderboard: check the planner, copy its files, run the public cases with the copy.

    Args:
        planner: Name of a planner, or a file of your own: ./mine.py or ./mine.py:factory.
        board: The name of a board: one in the folder of boards, or one that ships.
        card: The card that says what the planner is.
        by: Who submits it.
        name: The name of the entry.
        network: Another network of the same method: key=value, such as weights=b.safetensors. Repeatable.
        dry_run: Check planner and card, say how long the public cases will take, and make no entry.
    """
    use_threads(threads)
    from crowdbench.boards.board import find_board
    from crowdbench.boards.entry import MAINTAINERS
    from crowdbench.boards.submission import Submission, check_entry, read_card, rehearse
    from crowdbench.boards.submission import submit as submit_planner
    from crowdbench.catalog import PLANNERS
    from crowdbench.plugins.load import file_and_function, plugin_name, program
    from crowdbench.runs.shards import Shard

    own = Shard.parse(shard)
    rules = find_board(board, root).with_data(data)
    options = assignments(option or [], "--option")
    if Path(planner).is_dir():
        raise InputError(f"{planner} is a folder: name the file of the planner")
    if file_and_function(planner)[0] is None and program(planner) is None:
        PLANNERS.find(planner)
    card = card or Path(planner).parent / "card.toml"
    submitter = by or read_card(card).authors[0]
    if submitter.lower() == MAINTAINERS:
        raise InputError(
            f"{submitter} submits the planners that ship, by `crowdbench leaderboard fill`: give your name"
        )
    networks = [assignments([each], "--network") for each in network or []]
    submission = Submission(rules, name or plugin_name(planner), planner, options, networks, card, submitter)
    check_entry(submission, root)
    announce_compilation()
    if file_and_function(planner)[0] is not None:
        say("checking the contract")
        _check_contract(planner, option or [])
    cases = len(rules.public_cases) * len(rules.scenarios)
    if dry_run:
        minutes = rehearse(submission) / 60
        say(f"no fault is found, and no entry made; {cases} public cases will take about {minutes:.1f} minutes here")
        return
    message = f"finished batches are kept in {work}, with which the same command goes on"
    with exit_on_interrupt(message), _exit_on_unfinished(), progress(cases, f"of {cases} public cases") as tell:
        entry, failed = submit_planner(submission, root, work, tell, own)
    _say_entry(entry, failed, rules.spec.public_cases, root)


def _say_entry(entry: Entry, failed: Mapping[str, str], cases: int, root: Path) -> None:
    """Say what an entry reports, in which season it is verified, and what to do next.

    Args:
        entry: The entry that was made.
        failed: Why a scenario cannot be driven, by its name.
        cases: The public cases of each scenario.
        root: The folder of boards.
    """
    for scenario, reason in failed.items():
        say(f"{scenario}: counts 0, because it cannot be driven: {reason}")
    if entry.spec.privileged:
        say("the planner is privileged: it is shown, and has no rank")
    for scenario, metrics in entry.spec.reported.items():
        say(f"{scenario}: success {100 * (metrics['success_rate'] or 0.0):.1f} % in {cases} cases")
    say(
        f"made {entry.directory}. {_describe_season(entry.spec.board, root)} Next:\n"
        f"  crowdbench verify {entry.directory}   runs it again on cases that nobody knows\n"
        "  then open a pull request with this folder: see docs/boards.md"
    )


def _describe_season(board: str, root: Path) -> str:
    """In which season an entry that is made now is verified."""
    from crowdbench.boards.season import SEASON, read_season

    if not (root / SEASON).exists():
        return "It is verified in the next season of the board."
    season = read_season(root)
    if board in season.frozen:
        return f"The entries of the season {season.spec.name} are frozen: it is verified in the next season."
    return f"It is verified in the season {season.spec.name}, which closes on {season.spec.closes}."


def _check_contract(planner: str, options: Sequence[str]) -> None:
    """Refuse a planner that breaks its contract. In a process of its own, which it may end."""
    flags = [word for each in options for word in ("--option", each)]
    check = subprocess.run(
        # Not a folder crowdbench/ that happens to be here.
        [sys.executable, "-P", "-m", "crowdbench", "check", planner, *flags],
        capture_output=True,
        text=True,
        errors="replace",
    )
    if check.returncode != 0:
        print(check.stdout or check.stderr, end="")
        raise InputError(f"planner {planner} breaks its contract: see above")


@help_from_docstring
def verify(
    entry: Path,
    season: bool = False,
    key: Path | None = None,
    cases: Annotated[int | None, typer.Option(min=1)] = None,
    data: Path | None = None,
    work: Path = WORK,
    shard: ShardOption = None,
    threads: ThreadsOption = None,
    as_json: bool = False,
) -> None:
    """Verify an entry: replay its public cases, then run its planner, isolated, on cases that it cannot know.

    Args:
        entry: The folder of an entry.
        season: Drive the cases of the season, and record and sign what is found.
        key: For --season, the private key of a maintainer, made by ssh-keygen.
        cases: Fewer cases than the board has, without --season.
    """
    use_threads(threads)
    from crowdbench.boards.board import FILE, find_board, read_board
    from crowdbench.boards.entry import read_entry
    from crowdbench.boards.season import read_season
    from crowdbench.boards.verdict import Verdict
    from crowdbench.boards.verification import count_cases
    from crowdbench.boards.verification import verify as verify_entry
    from crowdbench.runs.shards import Shard
    from crowdbench.scenario.cases import Cases

    own = Shard.parse(shard)
    if shard and not season:
        raise InputError("--shard goes with --season: without it, each verification draws another seed")
    if season and cases:
        raise InputError("--cases does not go with --season, whose cases the board says")
    if season != (key is not None):
        raise InputError("--season and --key go together: what is found in a season is signed by a maintainer")
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
    if not season:
        say(
            "public cases are replayed, and others driven that are drawn now; nothing of this is kept: what a board "
            "shows is verified in its season"
        )
    driven = Cases("test", 0, cases) if cases else board.cases
    total = count_cases(submitted, board, driven)
    message = f"finished batches are kept in {work}, with which the same command goes on"
    with exit_on_interrupt(message if season else "nothing is kept"), _exit_on_unfinished(), progress(total) as tell:
        drawn = read_season(folder.parent) if season else None
        result = verify_entry(
            submitted, board, work=work, season=drawn, key=key, cases=driven, shard=own, progress=tell
        )
    if as_json:
        print(json.dumps(result.model_dump(mode="json"), indent=2))
    else:
        _print_verification(submitted, board.name, result)
    if result.verdict != Verdict.RERUN:
        raise typer.Exit(1)


def _print_verification(entry: Entry, board: str, result: Verification) -> None:
    from crowdbench.boards.verdict import Verdict

    where = f" on seed {result.seed}" if result.figures else ""
    passes = result.verdict == Verdict.RERUN
    print(f"{entry.name} on {board}: {'passes, ' * passes}{result.verdict}{where}: {result.reason}")
    for scenario, metrics in result.figures.items():
        measured = metrics["success_rate"].mean or 0.0
        reported = entry.spec.reported.get(scenario, {}).get("success_rate") or 0.0
        print(f"{scenario}: success {100 * measured:.2f} %, reported {100 * reported:.2f} %")
    if passes:
        print("Where it is lower than reported, chance explains it.")
    if result.decision_time:
        speed = result.decision_time
        timely = "real-time" if speed.is_real_time else "slower than real time"
        print(
            f"decisions in one world on one core: 99th percentile {speed.p99_ms:.1f} ms here, "
            f"{speed.calibrated_p99_ms:.1f} ms on the machine of reference, {timely}"
        )
    if result.untimed:
        print(result.untimed)
    if entry.spec.privileged:
        print("The planner is privileged: it is shown, and has no rank.")
    print("This does not tell whether the planner knew more than a vehicle can see while it was trained.")
    if not result.season:
        print("Nothing of this is kept: until its season, the entry is shown with the figures that you report.")


@contextlib.contextmanager
def _exit_on_unfinished() -> Iterator[None]:
    """Exit where other shards are missing, and say so."""
    from crowdbench.boards.run_entry import Unfinished

    try:
        yield
    except Unfinished as error:
        say(f"crowdbench: {error}")
        raise typer.Exit from None
