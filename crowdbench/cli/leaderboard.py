"""`crowdbench leaderboard`, for maintainers: fill boards with the planners that ship."""

from __future__ import annotations

import functools
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from crowdbench.cli.boards import ROOT, WORK
from crowdbench.cli.console import announce_compilation, exit_on_interrupt, progress, say
from crowdbench.cli.options import ThreadsOption, help_from_docstring, use_threads
from crowdbench.utils.errors import InputError, find_named

if TYPE_CHECKING:
    from crowdbench.boards.board import Board
    from crowdbench.boards.shipped import Job

app = typer.Typer(help="Make the entries of the leaderboards.", no_args_is_help=True)


@app.command()
@help_from_docstring
def readme(root: Path = ROOT) -> None:
    """Write README.md of the folder of boards, with the standings of each board."""
    from crowdbench.boards.markdown import write_readme

    say(f"wrote {write_readme(root)}")


@app.command()
@help_from_docstring
def fill(
    boards: Annotated[list[str] | None, typer.Argument(show_default="all")] = None,
    key: Path | None = None,
    data: Path | None = None,
    root: Path = ROOT,
    work: Path = WORK,
    threads: ThreadsOption = None,
) -> None:
    """Enter every planner that ships on boards, freeze the entries once the season has closed, and verify them in it.

    Board by board; boards of recorded people only with --data. Finished work is kept, and the same command goes on
    after it. Several processes can share the work.

    Args:
        boards: Names of boards.
        key: The private key of a maintainer, made by ssh-keygen, that signs what is found. Without it no entry is
            verified.
    """
    use_threads(threads)
    from crowdbench.boards.board import read_boards
    from crowdbench.boards.signature import find_signer

    if key is not None:
        find_signer(key, root)
    by_name = {board.name: board for board in read_boards(root)}
    chosen = [find_named("board", name, by_name) for name in boards or by_name]
    if data is not None and not any(board.spec.recorded for board in chosen):
        raise InputError(f"--data goes with boards whose people were recorded, and those of {chosen[0].name} were not")
    announce_compilation()
    with exit_on_interrupt(f"the same command goes on with what is kept in {root} and {work}"):
        for board in chosen:
            if board.spec.recorded and data is None:
                say(f"{board.name}: left out, because its people were recorded: give their tracks, --data DIR")
                continue
            _fill_board(board.with_data(data) if board.spec.recorded else board, root, work, key)


def _fill_board(board: Board, root: Path, work: Path, key: Path | None) -> None:
    from crowdbench.boards.season import TooEarly
    from crowdbench.boards.shipped import freeze_entries, to_submit, to_verify

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
    """Do all work that no other process does; False where others are still at theirs when this one has nothing left."""
    from crowdbench.boards.run_entry import InUse

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
