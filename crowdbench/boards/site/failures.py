"""Failures of an entry in the public cases, simulated again from the recorded commands: pictures and recordings."""

from __future__ import annotations

import contextlib
import hashlib
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from markupsafe import Markup

from crowdbench.boards.board import Board
from crowdbench.boards.driving import made
from crowdbench.boards.entry import PUBLIC, Entry
from crowdbench.boards.site.trajectories import picture
from crowdbench.errors import InputError
from crowdbench.evaluate.metrics import Metric
from crowdbench.evaluate.recording import units_of
from crowdbench.evaluate.replay import RunFiles, traces
from crowdbench.evaluate.results import EPISODES, Episodes
from crowdbench.record.write import Recorder
from crowdbench.scenario.scenario import Scenario
from crowdbench.types import Outcome, Trace

MOST = 3
"""The most failures of an entry that are shown."""

LARGEST = 1_000_000
"""Bytes of the largest recording that the pages offer."""


@dataclass(frozen=True)
class Failure:
    """One failure.

    Attributes:
        scenario: The name of the scenario.
        case: The number of the public case.
        outcome: How the episode ends when it is simulated again.
        reported: How it ended in the entry's own run.
        seconds: How long it took.
        gap: The smallest gap to a pedestrian, in metres.
        picture: The trajectories.
    """

    scenario: str
    case: int
    outcome: str
    reported: str
    seconds: float
    gap: float
    picture: Markup


@dataclass(frozen=True)
class Failures:
    """What the page of an entry shows of its failures.

    Attributes:
        number: How many public cases it failed in.
        shown: Some of them.
        recordings: The names of files with the same episodes, beside the page.
        problem: Why nothing is shown; empty if something is, or there is no failure.
    """

    number: int
    shown: Sequence[Failure]
    recordings: Sequence[str]
    problem: str


def failures(board: Board, entry: Entry, folder: Path) -> Failures:
    """Simulate some failures of an entry again, and write their recordings.

    Args:
        board: The board.
        entry: The entry.
        folder: Where recordings are written.
    """
    if entry.spec.board_digest != board.digest:
        return Failures(0, [], [], "The entry was made for other rules of this board.")
    if board.spec.recorded:
        return Failures(0, [], [], "Who was recorded is not shown here: the tracks are not ours to publish.")
    runs = entry.directory / PUBLIC
    shown: list[Failure] = []
    recordings: list[str] = []
    try:
        episodes = {name: Episodes.read(runs / name / EPISODES) for name in made(board, runs)}
        chosen = _chosen(episodes)
        for where, scenario in board.load(None):
            if where.name not in chosen:
                continue
            files = RunFiles.read(runs / where.name)
            parts = list(traces(files, scenario, chosen[where.name]))
            own = episodes[where.name]
            shown += [_failure(part, row, where.name, own) for part in parts for row in range(len(part))]
            path = folder / f"{entry.name}-{where.name}.rrd"
            recordings += _recorded(path, entry.name, scenario, parts, board.metrics)
    except InputError as error:
        return Failures(0, [], [], f"They cannot be simulated again: {error}")
    return Failures(sum(len(_failed(each)) for each in episodes.values()), shown, recordings, "")


def _chosen(episodes: dict[str, Episodes]) -> dict[str, list[int]]:
    """The cases that are shown, by scenario: of each scenario and each kind of failure one, then a second one, ..."""
    kinds = [
        [(name, case) for case in each.case[each.outcome == outcome].tolist()]
        for outcome in (Outcome.COLLISION, Outcome.TIMEOUT, Outcome.WALL_COLLISION)
        for name, each in episodes.items()
    ]
    in_turn = [one for turn in itertools.zip_longest(*kinds) for one in turn if one is not None]
    chosen: dict[str, list[int]] = {}
    for name, case in in_turn[:MOST]:
        chosen.setdefault(name, []).append(case)
    return chosen


def _failed(episodes: Episodes) -> list[int]:
    return episodes.case[episodes.outcome != Outcome.SUCCESS].tolist()


def _failure(trace: Trace, row: int, scenario: str, reported: Episodes) -> Failure:
    case, steps = int(trace.case[row]), int(trace.steps[row])
    outcome = Outcome(int(trace.outcome[row]))
    before = Outcome(int(reported.outcome[reported.case == case][0]))
    return Failure(
        scenario=scenario,
        case=case,
        outcome=_word(outcome),
        reported=_word(before),
        seconds=steps * trace.rules.dt,
        gap=float(np.min(trace.gap[row, :steps])),
        picture=picture(trace, row, f"{scenario}, case {case}: {_word(outcome)} after {steps * trace.rules.dt:g} s"),
    )


def _word(outcome: Outcome) -> str:
    return {Outcome.TIMEOUT: "time-out", Outcome.WALL_COLLISION: "collision with a wall"}.get(outcome, outcome.label)


def _recorded(
    path: Path, planner: str, scenario: Scenario, parts: Sequence[Trace], metrics: Mapping[str, Metric]
) -> list[str]:
    """Write episodes for the Rerun viewer.

    Args:
        path: The file.
        planner: The planner's name.
        scenario: The scenario.
        parts: The episodes.
        metrics: What is measured of them.

    Returns:
        The name of the file; none if it would be too large.
    """
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
    with contextlib.suppress(FileNotFoundError):
        path.unlink()
    return []
