"""Failures of an entry in the public cases, simulated again from the recorded commands: pictures and recordings."""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from figures import trajectories
from standings import PENDING

from crowdbench.boards.board import Board
from crowdbench.boards.board_runs import read_episodes
from crowdbench.boards.entry import Entry, is_pending
from crowdbench.boards.verification import read_public_run
from crowdbench.core.types import Outcome, Trace
from crowdbench.metrics import Metric
from crowdbench.record.verdict import describe_failure
from crowdbench.record.write import Recorder
from crowdbench.runs.recording import units_of
from crowdbench.runs.replay import traces
from crowdbench.runs.results import Episodes
from crowdbench.scenario.scenario import Scenario
from crowdbench.utils.errors import InputError

MOST = 3
"""The most failures of an entry that are shown."""

LARGEST = 1_000_000
"""Bytes of the largest recording that the pages offer."""


@dataclass(frozen=True)
class Failures:
    """Failures on the page of an entry.

    Attributes:
        number: How many public cases it failed in.
        examples: Some of them, see `_failure`.
        recordings: The names of files with the same episodes, beside the page.
        problem: Why nothing is shown; empty if something is, or there is no failure.
    """

    number: int = 0
    examples: Sequence[Mapping[str, Any]] = ()
    recordings: Sequence[str] = ()
    problem: str = ""


def failures(board: Board, entry: Entry, folder: Path) -> Failures:
    """Simulate some failures of an entry again, and write their recordings into a folder."""
    if is_pending(entry, board):
        return Failures(problem=PENDING)
    if board.spec.recorded:
        return Failures(problem="Recorded people are not shown here: the tracks are not ours to publish.")
    examples: list[dict[str, Any]] = []
    recordings: list[str] = []
    try:
        episodes = read_episodes(board, entry.public)
        cases = _choose(episodes)
        for scenario in (each for each in board.load(None) if each.name in cases):
            name = scenario.name
            parts = list(traces(read_public_run(entry, board, scenario), scenario, cases[name]))
            examples += [_failure(part, row, name, episodes[name]) for part in parts for row in range(len(part))]
            path = folder / f"{entry.name}-{name}.rrd"
            recordings += _record(path, entry.name, scenario, parts, board.metrics)
    except InputError as error:
        return Failures(problem=f"They cannot be simulated again: {error}")
    number = sum(int((each.outcome != Outcome.SUCCESS).sum()) for each in episodes.values())
    return Failures(number, examples, recordings)


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
    outcome = _word(trace.outcome[row])
    return {
        "scenario": scenario,
        "case": case,
        "outcome": outcome,
        "reported": _word(reported.outcome[reported.case == case][0]),
        "seconds": seconds,
        "verdict": describe_failure(trace, row),
        "picture": trajectories(trace, row, f"{scenario}, case {case}: {outcome} after {seconds:g} s"),
    }


def _word(number: int) -> str:
    outcome = Outcome(int(number))
    return {Outcome.TIMEOUT: "time-out", Outcome.WALL_COLLISION: "collision with a wall"}.get(outcome, outcome.label)


def _record(
    path: Path, planner: str, scenario: Scenario, parts: Sequence[Trace], metrics: Mapping[str, Metric]
) -> list[str]:
    """Write episodes for the Rerun viewer, and return the name of the file; none if it would be too large."""
    with Recorder(
        path,
        planner=planner,
        scenario=scenario.name,
        scenario_digest=scenario.digest,
        cases=sum(map(len, parts)),
        units=units_of(metrics),
        identity=hashlib.sha256(f"{planner} {scenario.digest}".encode()).hexdigest()[:8],
    ) as recorder:
        for part in parts:
            recorder.add(part, np.arange(len(part)), Episodes.of(part, metrics).columns)
    if path.exists() and path.stat().st_size <= LARGEST:
        return [path.name]
    path.unlink(missing_ok=True)
    return []
