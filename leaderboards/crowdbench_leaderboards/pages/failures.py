"""The replay of the public cases of a board, simulated again from the recorded commands, and the failures in it."""

from __future__ import annotations

import itertools
import json
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from crowdbench import Episodes, InputError, Outcome, Scenario
from crowdbench.export import export_page
from crowdbench.results import RunResult
from crowdbench_leaderboards.board import Board
from crowdbench_leaderboards.entry import PUBLIC, Entry, is_pending
from crowdbench_leaderboards.episode_table import read_table
from crowdbench_leaderboards.pages.standings import PENDING
from crowdbench_leaderboards.verification import public_run, replay_public

MOST = 10
"""The most failures of an entry that are listed."""

RECORDED = "Recorded pedestrians are not shown: their tracks may not be redistributed."

WORDS = {Outcome.TIMEOUT: "time-out", Outcome.WALL_COLLISION: "collision with a wall"}
"""Names of outcomes that differ from their labels."""


@dataclass(frozen=True)
class Failures:
    """Failures on the page of an entry.

    Attributes:
        number: Number of public cases in which it failed.
        examples: Some of them, see `_read_failures`.
        problem: Reason why no failure is shown; empty if failures are shown, or if there are none.
    """

    number: int = 0
    examples: Sequence[Mapping[str, Any]] = ()
    problem: str = ""


def write_replay(board: Board, entries: Sequence[Entry], folder: Path) -> dict[str, Failures]:
    """Write the page that plays the public cases of entries, and return their failures by the name of the entry.

    Args:
        board: The board.
        entries: Its entries. Those whose public cases cannot be simulated again, or end in another way, are left out.
        folder: The folder of the page, which is not created if no entry can be simulated again.
    """
    found: dict[str, Failures] = {}
    played: dict[str, dict[str, Episodes]] = {}
    scenarios = {} if board.spec.recorded else {scenario.name: scenario for scenario in board.load(None)}
    with tempfile.TemporaryDirectory() as temporary:
        runs: list[RunResult] = []
        for entry in entries:
            problem = PENDING if is_pending(entry, board) else RECORDED if board.spec.recorded else ""
            try:
                if not problem:
                    played[entry.name] = replay_public(entry, board)
                    commands = Path(temporary) / entry.name
                    read_table(entry.directory / PUBLIC, board, board.public_cases, commands)
                    for name, own in played[entry.name].items():
                        runs.append(public_run(entry, board, scenarios[name], own, commands / name))
            except InputError as error:
                problem = f"They cannot be simulated again: {error}"
            found[entry.name] = Failures(problem=problem)
        if runs:
            folder.mkdir()
            export_page(runs, lambda run: scenarios[run.directory.name], folder)
    return found | {name: _read_failures(board, name, own, scenarios, folder) for name, own in played.items()}


def _read_failures(
    board: Board, entry: str, episodes: dict[str, Episodes], scenarios: Mapping[str, Scenario], folder: Path
) -> Failures:
    """Return the failures of an entry, with the results of its replay."""
    examples = []
    for name, cases in _choose(episodes).items():
        for case in cases:
            data = (folder / f"data/{name}/{board.public_cases.split}-{case}.js").read_text()
            played = json.loads(data.partition(",")[2].removesuffix(")\n"))[entry]
            outcome = next(each for each in Outcome if each.label[0] == played["outcome"])
            examples.append(
                {
                    "scenario": name,
                    "case": case,
                    "name": f"{board.public_cases.split}/{case}",
                    "outcome": WORDS.get(outcome, outcome.label),
                    "seconds": played["steps"] * scenarios[name].rules.dt,
                    "verdict": played["verdict"],
                }
            )
    number = sum(int((each.outcome != Outcome.SUCCESS).sum()) for each in episodes.values())
    return Failures(number, examples)


def _choose(episodes: dict[str, Episodes]) -> dict[str, list[int]]:
    """Return the shown cases by scenario: one of each scenario and kind of failure, then the next of each."""
    kinds = [
        [(name, case) for case in each.case[each.outcome == outcome].tolist()]
        for outcome in (Outcome.COLLISION, Outcome.TIMEOUT, Outcome.WALL_COLLISION)
        for name, each in episodes.items()
    ]
    in_turn = [one for turn in itertools.zip_longest(*kinds) for one in turn if one is not None]
    cases: dict[str, list[int]] = {}
    for name, case in in_turn[:MOST]:
        cases.setdefault(name, []).append(case)
    return cases
