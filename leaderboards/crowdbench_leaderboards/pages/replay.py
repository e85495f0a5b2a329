"""The replay of the public cases of a board, simulated again from the recorded commands."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path

from crowdbench import InputError
from crowdbench.export import export_page
from crowdbench.results import RunResult
from crowdbench_leaderboards.board import Board
from crowdbench_leaderboards.entry import PUBLIC, Entry, is_pending
from crowdbench_leaderboards.episode_table import read_table
from crowdbench_leaderboards.pages.standings import PENDING
from crowdbench_leaderboards.verification import public_run, replay_public

RECORDED = "Recorded pedestrians are not shown: their tracks may not be redistributed."


def write_replay(board: Board, entries: Sequence[Entry], folder: Path) -> dict[str, str]:
    """Write the page that plays the public cases of entries, and return why some are left out, by name.

    Args:
        board: The board.
        entries: Its entries. An entry whose public cases cannot be simulated again, or end in another way, is left out.
        folder: The folder of the page, which is not created if no entry can be simulated again.
    """
    problems: dict[str, str] = {}
    scenarios = {} if board.spec.recorded else {scenario.name: scenario for scenario in board.load(None)}
    with tempfile.TemporaryDirectory() as temporary:
        runs: list[RunResult] = []
        for entry in entries:
            problem = PENDING if is_pending(entry, board) else RECORDED if board.spec.recorded else ""
            try:
                if not problem:
                    commands = Path(temporary) / entry.name
                    replay_public(entry, board)
                    episodes = read_table(entry.directory / PUBLIC, board, board.public_cases, commands)
                    for name, own in episodes.items():
                        runs.append(public_run(entry, board, scenarios[name], own, commands / name))
            except InputError as error:
                problem = f"They cannot be simulated again: {error}"
            if problem:
                problems[entry.name] = problem
        if runs:
            folder.mkdir()
            back = ("../index.html", board.spec.title)
            export_page(runs, lambda run: scenarios[run.directory.name], folder, back=back)
    return problems
