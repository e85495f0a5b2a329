"""The files of runs that boards keep: episodes and commands of public cases, outcomes and SCT of ranked cases."""

from __future__ import annotations

import dataclasses
import shutil
from pathlib import Path
from typing import Any

from crowdbench.boards.board import Board
from crowdbench.boards.entry import Entry
from crowdbench.boards.ranking import SCT
from crowdbench.runs.recording import COMMANDS
from crowdbench.runs.result_file import read_result
from crowdbench.runs.results import EPISODES, Episodes, to_json
from crowdbench.runs.store import RunResult
from crowdbench.scenario.scenario import Scenario
from crowdbench.utils.errors import InputError

DIGITS = 6
"""Decimal places of the SCT of ranked cases."""


def keep_public(runs: Path, out: Path, board: Board) -> None:
    """Copy the episodes and commands of the runs of a board into the folder of an entry."""
    for name in driven_scenarios(board, runs):
        (out / name).mkdir(parents=True)
        for file in (EPISODES, COMMANDS):
            shutil.copyfile(runs / name / file, out / name / file)


def keep_ranked(runs: Path, out: Path, board: Board) -> None:
    """Write outcome, steps and SCT of the cases of the runs of a board into the folder of a verification."""
    for name, episodes in read_episodes(board, runs).items():
        (out / name).mkdir()
        columns = {SCT: episodes.columns[SCT].round(DIGITS)}
        dataclasses.replace(episodes, columns=columns).write(out / name / EPISODES)


def driven_scenarios(board: Board, out: Path) -> list[str]:
    """Return the names of the scenarios of a board of which there is a run in a folder."""
    return [name for name in board.scenarios if (out / name).is_dir()]


def read_episodes(board: Board, out: Path) -> dict[str, Episodes]:
    """Read the episodes in a folder by scenario. Raises InputError where a file is damaged."""
    return {name: Episodes.read(out / name / EPISODES) for name in driven_scenarios(board, out)}


def read_figures(board: Board, out: Path) -> dict[str, dict[str, Any]]:
    """Read the estimates of runs by scenario and metric, see `to_json`. Raises InputError where a file is damaged."""
    return {name: read_result(out / name)["metrics"] for name in driven_scenarios(board, out)}


def read_public_run(entry: Entry, board: Board, scenario: Scenario) -> RunResult:
    """Read the run of an entry on the public cases of a scenario, in which nothing is checked yet.

    Raises:
        InputError: A file is missing or damaged, or has other metrics than the board.
    """
    folder = entry.public / scenario.name
    episodes = Episodes.read(folder / EPISODES)
    if episodes.columns.keys() != board.metrics.keys():
        raise InputError(f"{folder / EPISODES} must have the metrics {', '.join(board.metrics)}")
    result = {
        "run": {"scenario": scenario.digest, "cases": str(board.public_cases), "code": board.parts["code"]},
        "stated": {"versions": entry.spec.environment},
        "outcomes": episodes.counts(),
        "recorded": 0,
        "metrics": to_json(episodes.summary()),
    }
    return RunResult(folder, result, episodes)
