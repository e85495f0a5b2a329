"""What `crowdbench run --board` does: a planner drives the public cases of every scenario of a board."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from crowdbench.cli.boards import ROOT
from crowdbench.cli.options import print_table
from crowdbench.errors import InputError, MachineFault

if TYPE_CHECKING:
    from crowdbench.study.planned import PlannedRun

GIVEN = {"board", "planner", "option", "cases", "data", "out", "threads", "as_json"}
"""The parameters of `crowdbench run` that a user may give beside `--board`."""


def is_given(context: typer.Context, parameter: str) -> bool:
    """Whether the user gave a parameter of the command, rather than its default."""
    source = context.get_parameter_source(parameter)
    return source is not None and source.name == "COMMANDLINE"  # typer's own enumeration is not public


def check_alone(context: typer.Context) -> None:
    """Refuse options that a board decides.

    Args:
        context: Of the command `run`.

    Raises:
        InputError: One of them was given.
    """
    for parameter in context.command.params:
        name = parameter.name or ""
        if name not in GIVEN and is_given(context, name):
            raise InputError(f"{parameter.opts[0]} does not go with --board: the board decides it")


def run_board(
    name: str,
    planner: str,
    options: Mapping[str, Any],
    cases: str | None,
    data: Path | None,
    out: Path | None,
    as_json: bool,
) -> None:
    """Drive a planner through all scenarios of a board by its rules, and print its figures.

    The runs are kept as a study's are: the same command makes only those that are missing.

    Args:
        name: The board's name.
        planner: As `crowdbench run --planner` takes it.
        options: The planner's options by name.
        cases: The cases of each scenario; None for the board's public ones.
        data: The folder with the recorded tracks that the board needs, if any.
        out: The folder of the runs; None for one of the board's name in `runs/`.
        as_json: Whether to print JSON.

    Raises:
        InputError: There is no such board, or the planner can drive in none of its scenarios.
    """
    from crowdbench.boards.board import find_board
    from crowdbench.boards.standings import board_figures, estimates
    from crowdbench.cli.console import announce_compilation
    from crowdbench.cli.tables import board_table
    from crowdbench.evaluate.formats import plain
    from crowdbench.scenario.cases import Cases
    from crowdbench.study.planned import PlannedRun

    board = find_board(name, ROOT).with_data(data)
    wanted = Cases.parse(cases) if cases else board.public_cases
    runs = {
        each.name: PlannedRun.of(
            planner,
            options,
            each.name,
            wanted,
            overrides=board.overrides(None),
            replanning=board.replanning,
            data=data,
        )
        for each in board.scenarios
    }
    announce_compilation()
    directory = out or Path("runs") / f"board-{board.name}"
    failed = _make(runs, directory)
    found = {
        each: {} if each in failed else estimates(directory / run.directory, board.metrics)
        for each, run in runs.items()
    }
    found[f"board {board.name}"] = board_figures(board, dict(found))
    if as_json:
        print(json.dumps(plain({"board": board.name, "cases": str(wanted), "metrics": found}), indent=2))
    else:
        driver = next(iter(runs.values())).driver.name
        print_table(board_table(f"{driver} on board {board.name}, cases {wanted} of each scenario", found))
        print(f"\nKept in {directory}")


def _make(runs: Mapping[str, PlannedRun], out: Path) -> dict[str, str]:
    """Make runs that are not there yet.

    Args:
        runs: The runs by scenario.
        out: Their folder.

    Returns:
        The scenarios that the planner cannot drive, with the reason.

    Raises:
        InputError: It can drive in none.
    """
    from crowdbench.cli.console import progress, say

    failed: dict[str, str] = {}
    for scenario, run in runs.items():
        say(f"{scenario}, cases {run.cases}")
        try:
            with progress(len(run.cases), f"of {len(run.cases)} cases") as tell:
                run.make(out, tell)
        except MachineFault:
            raise
        except InputError as error:
            if len(failed) == len(runs) - 1:
                raise
            failed[scenario] = str(error)
            say(f"{scenario} counts 0, because it cannot be driven: {error}")
    return failed
