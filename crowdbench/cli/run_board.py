"""`crowdbench run --board`: drive a planner through the public cases of every scenario of a board."""

from __future__ import annotations

import json
from dataclasses import replace
from math import nan
from pathlib import Path

import typer

from crowdbench.cli.boards import ROOT
from crowdbench.cli.console import announce_compilation, exit_on_interrupt, print_table, progress, say
from crowdbench.cli.options import assignments
from crowdbench.utils.errors import InputError, MachineFault
from crowdbench.utils.tables import plain

OPTIONS = ("--board", "--planner", "--option", "--cases", "--data", "--out", "--threads", "--json")
"""The options of `crowdbench run` that a run of a board has."""


def refuse_other_options(context: typer.Context) -> None:
    """Raise InputError if an option was given that a run of a board does not have.

    Args:
        context: The call of `crowdbench run`.
    """
    for parameter in context.command.params:
        source, flag = context.get_parameter_source(parameter.name or ""), parameter.opts[0]
        if flag not in OPTIONS and source is not None and source.name == "COMMANDLINE":
            raise InputError(f"{flag} does not go with --board; the options that do are {', '.join(OPTIONS[1:])}")


def run_board(
    board: str, planner: str, option: list[str], cases: str | None, data: Path | None, out: Path | None, as_json: bool
) -> None:
    """Drive a planner through all scenarios of a board by its rules, and print its figures.

    Make only the runs that are missing.

    Args:
        board: The name of a board.
        planner: The name or file of the planner.
        option: Its options, key=value.
        cases: The cases of each scenario; the public cases of the board if None.
        data: Folder with recorded tracks.
        out: Folder that keeps the runs; `runs/board-BOARD` if None.
        as_json: True to print JSON.
    """
    from crowdbench.boards.board import find_board
    from crowdbench.boards.board_runs import make_each
    from crowdbench.boards.means import board_figures
    from crowdbench.metrics.registry import MAIN, info_of
    from crowdbench.metrics.summary import Estimate
    from crowdbench.results.episodes import read_estimate
    from crowdbench.results.result_file import read_result
    from crowdbench.results.table import estimate_grid
    from crowdbench.runs.folder import make_in_folder, run_directory
    from crowdbench.runs.loading import load_run
    from crowdbench.runs.spec import RunSpec
    from crowdbench.scenario.cases import Cases

    rules = find_board(board, ROOT).with_data(data)
    driven_cases = Cases.parse(cases) if cases else rules.public_cases
    options, overrides = assignments(option, "--option"), rules.overrides(None)
    base = RunSpec(planner, "", driven_cases, options, overrides, replanning=rules.replanning, record="none", data=data)
    runs = {name: load_run(replace(base, scenario=name)) for name in rules.scenarios}
    announce_compilation()
    directory = out or Path("runs") / f"board-{rules.name}"

    def make(name: str) -> None:
        say(f"{name}, cases {driven_cases}")
        with progress(len(driven_cases)) as update:
            if not make_in_folder(runs[name], directory, update):
                raise MachineFault(f"another process is making the run of {name}: try again when it has ended")

    with exit_on_interrupt():
        failures = make_each(runs, make)
    for name, reason in failures.items():
        say(f"{name} counts 0, because it cannot be driven: {reason}")
    figures: dict[str, dict[str, Estimate]] = {}
    for scenario, run in runs.items():
        measured = {} if scenario in failures else read_result(run_directory(run, directory))["metrics"]
        figures[scenario] = {name: read_estimate(measured[name]) for name in rules.metrics if name in measured}
    figures[f"board {rules.name}"] = board_figures(rules, dict(figures))
    if as_json:
        print(json.dumps(plain({"board": rules.name, "cases": str(driven_cases), "metrics": figures}), indent=2))
        return
    # A scenario that a planner cannot drive counts 0.
    failed = {"success_rate": Estimate(0.0, nan, nan, 0, nan)}
    rows = [{"scenario": name, **(estimates or failed)} for name, estimates in figures.items()]
    infos = {name: info_of(name) for name in (*MAIN, "intimate_zone")}
    driver = runs[rules.scenarios[0]].driver.name
    title = f"{driver} on board {rules.name}, cases {driven_cases} of each scenario"
    print_table(estimate_grid(title, rows, infos, brief=[*infos][1:]))
    print(f"\nKept in {directory}")
