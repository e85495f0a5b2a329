"""What holds of a method, and not of one network alone: its mean over networks that were trained with other seeds."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from crowdbench.boards.board import Board
from crowdbench.boards.driving import Entrant, Progress, check_finished, drive, episodes
from crowdbench.boards.entry import Method, Range
from crowdbench.boards.ranking import CRITERIA
from crowdbench.evaluate.shard import WHOLE, Shard
from crowdbench.evaluate.summary import wilson
from crowdbench.scenario.cases import Cases
from crowdbench.study.intervals import mean_over_networks

LEAST = 5
"""Fewer networks say nothing of their method."""

MOST_CASES = 250
"""Cases that each network drives, at most."""


def method_cases(cases: Cases) -> Cases:
    """Those of an entry's cases that each network of its method drives: the first ones."""
    return Cases(cases.split, cases.start, min(cases.stop, cases.start + MOST_CASES))


def claims(board: Board, networks: Sequence[Mapping[str, Any]]) -> bool:
    """Whether an entry with these other networks claims something of its method: on boards of one scenario only.

    Args:
        board: The board.
        networks: The options of each other network.
    """
    return len(networks) + 1 >= LEAST and len(board.scenarios) == 1


def drive_others(
    board: Board,
    entrant: Entrant,
    networks: Sequence[Mapping[str, Any]],
    kept: Path,
    *,
    cases: Cases,
    seed: int,
    hidden: Sequence[Path],
    shard: Shard = WHOLE,
    progress: Progress | None = None,
) -> None:
    """Drive the other networks of a method.

    Args:
        board: The board, of one scenario.
        entrant: The planner of the entry.
        networks: The options in which each other network differs.
        kept: The folder of runs.
        cases: As `method_cases` chose them.
        seed: The seed of the cases.
        hidden: Folders that the planner must not read.
        shard: Which share of the batches is run.
        progress: Called after each step with what it added to the episodes, in parts of an episode.

    Raises:
        InputError: The planner breaks its contract or a limit.
        Unfinished: Runs are missing that other shards make.
        KeyboardInterrupt: Somebody interrupted it. What is finished is kept.
    """
    folders = _folders(kept, networks)
    for number, (folder, options) in enumerate(zip(folders, networks, strict=True), start=1):
        other = dataclasses.replace(entrant, options={**entrant.options, **options})
        own = shard.rotated(number)
        drive(board, other, folder, cases=cases, seed=seed, hidden=hidden, shard=own, progress=progress)
    for folder in folders:
        check_finished(board, folder, {})


def measured(board: Board, networks: Sequence[Mapping[str, Any]], kept: Path, cases: Cases) -> Method:
    """What holds of a method whose networks have all driven.

    Args:
        board: The board, of one scenario.
        networks: The options in which each other network differs.
        kept: The folder of the entry's own run and of theirs.
        cases: As `method_cases` chose them.

    Returns:
        The means over all networks, with intervals for other networks on other cases.
    """
    folders = [kept, *_folders(kept, networks)]
    (scenario,) = board.scenarios
    runs = [episodes(board, folder)[scenario.name].columns for folder in folders]
    found = {}
    for metric in CRITERIA:
        values = np.array([run[metric][: len(cases)] for run in runs], float)
        found[metric] = _range(values)
    return Method(networks=len(folders), cases=len(cases), metrics=found)


def _folders(kept: Path, networks: Sequence[Mapping[str, Any]]) -> list[Path]:
    return [kept / "networks" / str(number) for number in range(len(networks))]


def _range(values: Float[np.ndarray, "network case"]) -> Range:
    """The mean of shares over networks, with its interval within 0 and 1."""
    # Where neither networks nor cases differ, which is no certainty, it is Wilson's for the cases of one network.
    is_one = (values == values[0, 0]).all()
    estimate = wilson(values[0].astype(bool)) if is_one else mean_over_networks(values)
    return Range(mean=estimate.mean, low=max(estimate.low, 0.0), high=min(estimate.high, 1.0))
