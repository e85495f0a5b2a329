"""Failures of an entry in the public cases, simulated again from the recorded commands, and the replays."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from standings import PENDING

from crowdbench.boards.board import Board
from crowdbench.boards.board_runs import read_episodes
from crowdbench.boards.entry import Entry, is_pending
from crowdbench.boards.verification import read_public_run
from crowdbench.core.types import Outcome, Trace
from crowdbench.record.verdict import describe_failure
from crowdbench.runs.pages import export_page
from crowdbench.runs.replay import traces
from crowdbench.runs.results import Episodes
from crowdbench.runs.store import RunResult
from crowdbench.utils.errors import InputError

MOST = 10
"""The most failures of an entry that are listed."""


@dataclass(frozen=True)
class Failures:
    """Failures on the page of an entry.

    Attributes:
        number: How many public cases it failed in.
        examples: Some of them, see `_failure`.
        problem: Why nothing is shown; empty if something is, or there is no failure.
    """

    number: int = 0
    examples: Sequence[Mapping[str, Any]] = ()
    problem: str = ""


def failures(board: Board, entry: Entry) -> Failures:
    """Simulate some failures of an entry again."""
    if is_pending(entry, board):
        return Failures(problem=PENDING)
    if board.spec.recorded:
        return Failures(problem="Recorded people are not shown here: the tracks are not ours to publish.")
    examples: list[dict[str, Any]] = []
    try:
        episodes = read_episodes(board, entry.public)
        cases = _choose(episodes)
        for scenario in (each for each in board.load(None) if each.name in cases):
            name = scenario.name
            parts = traces(read_public_run(entry, board, scenario), scenario, cases[name])
            examples += [_failure(part, row, name, episodes[name]) for part in parts for row in range(len(part))]
    except InputError as error:
        return Failures(problem=f"They cannot be simulated again: {error}")
    number = sum(int((each.outcome != Outcome.SUCCESS).sum()) for each in episodes.values())
    return Failures(number, examples)


def write_replay(board: Board, entries: Sequence[Entry], folder: Path) -> None:
    """Write the page that plays the public cases of entries, which can be simulated again."""
    scenarios = {scenario.name: scenario for scenario in board.load(None)}
    runs = [
        _named(entry, read_public_run(entry, board, scenario))
        for entry in entries
        for scenario in scenarios.values()
        if (entry.public / scenario.name).is_dir()
    ]
    folder.mkdir()
    export_page(runs, lambda run: scenarios[run.directory.name], folder)


def _named(entry: Entry, run: RunResult) -> RunResult:
    """Return a run whose planner has the name of an entry."""
    planner = {"name": entry.name, "options": entry.spec.options}
    return dataclasses.replace(
        run, result={**run.result, "run": {**run.result["run"], "planner": planner, "replanning": {}}}
    )


def _choose(episodes: dict[str, Episodes]) -> dict[str, list[int]]:
    """The cases that are shown, by scenario: of each scenario and each kind of failure one, then a second one, ..."""
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


def _failure(trace: Trace, row: int, scenario: str, reported: Episodes) -> dict[str, Any]:
    """A failure: how it ends when it is simulated again, and how it ended in the entry's own run."""
    case, seconds = int(trace.case[row]), int(trace.steps[row]) * trace.rules.dt
    return {
        "scenario": scenario,
        "case": case,
        "name": f"{trace.split}/{case}",
        "outcome": _word(trace.outcome[row]),
        "reported": _word(reported.outcome[reported.case == case][0]),
        "seconds": seconds,
        "verdict": describe_failure(trace, row),
    }


def _word(number: int) -> str:
    outcome = Outcome(int(number))
    return {Outcome.TIMEOUT: "time-out", Outcome.WALL_COLLISION: "collision with a wall"}.get(outcome, outcome.label)
