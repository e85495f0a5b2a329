"""The replay of the public cases of a board, simulated again from the recorded commands, and the failures in it."""

from __future__ import annotations

import dataclasses
import itertools
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from crowdbench import Episodes, InputError, Outcome, Scenario
from crowdbench.export import export_page
from crowdbench.results import RunResult
from crowdbench_leaderboards.board import Board
from crowdbench_leaderboards.board_runs import read_episodes
from crowdbench_leaderboards.entry import Entry, is_pending
from crowdbench_leaderboards.pages.standings import PENDING
from crowdbench_leaderboards.verification import read_public_run

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
        entries: Its entries. Those that cannot be simulated again are left out of the page.
        folder: The folder of the page, which is not created if no entry can be simulated again.
    """
    scenarios = {} if board.spec.recorded else {scenario.name: scenario for scenario in board.load(None)}
    found, runs = {}, []
    for entry in entries:
        problem = PENDING if is_pending(entry, board) else RECORDED if board.spec.recorded else ""
        try:
            runs += [] if problem else _public_runs(board, entry, scenarios)
        except InputError as error:
            problem = f"They cannot be simulated again: {error}"
        found[entry.name] = Failures(problem=problem)
    if runs:
        folder.mkdir()
        export_page(runs, lambda run: scenarios[run.directory.name], folder)
    played = [entry for entry in entries if not found[entry.name].problem]
    return found | {entry.name: _read_failures(board, entry, scenarios, folder) for entry in played}


def _public_runs(board: Board, entry: Entry, scenarios: Mapping[str, Scenario]) -> list[RunResult]:
    """Return the runs of an entry, each with its name. Raises InputError if cases are missing."""
    runs = []
    for scenario in scenarios.values():
        if (entry.public / scenario.name).is_dir():
            run = read_public_run(entry, board, scenario)
            run.check(rows_only=True)
            runs.append(_described(run, entry, scenario))
    return runs


def _read_failures(board: Board, entry: Entry, scenarios: Mapping[str, Scenario], folder: Path) -> Failures:
    """Return the failures of an entry, with the results of its replay."""
    episodes, examples = read_episodes(board, entry.public), []
    for name, cases in _choose(episodes).items():
        for case in cases:
            data = (folder / f"data/{name}/{board.public_cases.split}-{case}.js").read_text()
            played = json.loads(data.partition(",")[2].removesuffix(")\n"))[entry.name]
            outcome = next(each for each in Outcome if each.label[0] == played["outcome"])
            reported = Outcome(int(episodes[name].outcome[episodes[name].case == case][0]))
            examples.append(
                {
                    "scenario": name,
                    "case": case,
                    "name": f"{board.public_cases.split}/{case}",
                    "outcome": WORDS.get(outcome, outcome.label),
                    "reported": WORDS.get(reported, reported.label),
                    "seconds": played["steps"] * scenarios[name].rules.dt,
                    "verdict": played["verdict"],
                }
            )
    number = sum(int((each.outcome != Outcome.SUCCESS).sum()) for each in episodes.values())
    return Failures(number, examples)


def _described(run: RunResult, entry: Entry, scenario: Scenario) -> RunResult:
    """Return a run with its scenario, and with the name of an entry as planner."""
    planner = {"name": entry.name, "options": entry.spec.options}
    stated = {**run.result["run"], "planner": planner, "replanning": {}, "scenario": scenario.digest}
    result = {**run.result, "run": stated, "scenario": {**scenario.table, "name": scenario.name}}
    return dataclasses.replace(run, result=result)


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
