"""The command that lets planners meet each other in the vehicles of a scenario, and prints a matrix of scores."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from crowdbench.cli.console import announce_compilation, exit_on_interrupt, print_table, progress, say
from crowdbench.cli.options import ThreadsOption, WorkersOption, use_threads
from crowdbench.cli.suite import SCORE
from crowdbench.utils.errors import InputError
from crowdbench.utils.tables import Format, Grid, format_tables

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from crowdbench.results.run_result import RunResult
    from crowdbench.runs.run import Run
    from crowdbench.utils.executors import Executor

STRANGERS = "strangers"
"""The column of the mean over all other planners."""

NOTE = (
    "Score of the planner of a row, in the first vehicle, among vehicles that the planner of the column drives; on the "
    "diagonal it drives all vehicles, and all are scored. strangers: the mean of the other columns. 95 % intervals "
    "over cases."
)


def cross(
    planners: list[str],
    scenario: str = "fleet_4",
    cases: Annotated[int, typer.Option(min=1)] = 100,
    out: Path = Path("runs/cross"),
    picture: Path | None = None,
    workers: WorkersOption = None,
    engine: str | None = None,
    format: Annotated[Format | None, typer.Option(show_default="for the terminal")] = None,
    threads: ThreadsOption = None,
) -> None:
    """Score each planner among vehicles of each planner, and print the matrix.

    The same command makes only the runs that are missing.

    Args:
        planners: Names of planners, or files of your own: ./mine.py.
        scenario: A scenario with several vehicles.
        cases: Number of test cases.
        out: Folder that keeps the runs.
        picture: A file for a picture of the matrix: .pdf, .svg or .png.
    """
    use_threads(threads)
    from crowdbench.catalog import load_scenario
    from crowdbench.results.run_result import RunResult
    from crowdbench.runs.folder import run_directory
    from crowdbench.runs.loading import load_run
    from crowdbench.runs.spec import RunSpec
    from crowdbench.scenario.cases import Cases
    from crowdbench.utils.executors import open_executor

    if len(set(planners)) < max(2, len(planners)):
        raise InputError(f"the planners are {', '.join(planners)}, but must be two or more different ones")
    if load_scenario(scenario).rules.vehicles == 1:
        raise InputError(f"{scenario} has one vehicle, but planners meet in a scenario with several, such as fleet_4")
    announce_compilation()
    runs = {
        (planner, others): load_run(
            RunSpec(
                planner,
                scenario,
                Cases("test", 0, cases),
                others=None if others == planner else others,
                record="none",
            )
        )
        for planner, others in itertools.product(planners, repeat=2)
    }
    message = f"finished batches are kept in {out}, with which the same command goes on"
    with (
        exit_on_interrupt(message),
        open_executor(engine, workers, threads) as executor,
        progress(cases * len(runs)) as report,
    ):
        _make_runs(list(runs.values()), out, executor, report)
    results: dict[str, dict[str, RunResult]] = {planner: {} for planner in planners}
    for (planner, others), run in runs.items():
        results[planner][others] = RunResult.read(run_directory(run, out))
    grid = _grid(f"Score in {scenario}, {cases} cases", results)
    if picture is not None:
        from crowdbench.figures.plots import draw_matrix

        draw_matrix(grid.records, picture)
        say(f"wrote {picture}")
    if format is None:
        print_table(grid)
    else:
        print(format_tables([grid], format))


def _make_runs(runs: Sequence[Run], out: Path, executor: Executor | None, report: Callable[[float], None]) -> None:
    """Make the runs that the folder lacks, with workers if there are any."""
    from crowdbench.runs.folder import make_in_folder, make_in_folder_with

    if executor is None:
        for run in runs:
            make_in_folder(run, out, report)
        return
    for made in make_in_folder_with(executor, runs, out, report):
        if made.error is not None:
            raise made.error


def _grid(title: str, runs: Mapping[str, Mapping[str, RunResult]]) -> Grid:
    """Return the matrix of scores, from the runs by planner and by the planner of the other vehicles."""
    import numpy as np

    from crowdbench.metrics.registry import info_of
    from crowdbench.metrics.summary import bootstrap
    from crowdbench.results.table import estimates

    info, rows, records = info_of(SCORE), [], []
    for planner, row in runs.items():
        scores = {others: estimates(run, {SCORE: info})[SCORE] for others, run in row.items()}
        columns = [run.episodes.columns[SCORE] for others, run in row.items() if others != planner]
        mean = np.mean(columns, axis=0)
        scores[STRANGERS] = bootstrap(mean, np.ones(len(mean))).for_display()
        rows.append([planner, *map(info.estimate, scores.values())])
        records.append({"planner": planner, **scores})
    return Grid(title, list(records[0]), rows, records, note=NOTE)
