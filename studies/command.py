"""The options of studies that share out their runs, and the functions that execute them and print their tables.

Slow modules are imported when a function is called, after the number of threads is set.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from crowdbench.cli import SHARED, announce_compilation, exit_on_interrupt, progress, say
from crowdbench.utils import Format, Grid, format_tables, plain

if TYPE_CHECKING:
    from crowdbench.runs import Run
    from crowdbench.utils import Executor

ShardOption = Annotated[
    str | None,
    typer.Option(help="Make one share of the runs, such as 2/8; the last shard to finish prints the tables."),
]


EngineOption = Annotated[str | None, typer.Option(help=SHARED["engine"])]


@dataclass(frozen=True)
class Sharing:
    """Options that share out the runs of a study.

    Attributes:
        shard: The share of the runs to execute, such as 2/8; None for all.
        workers: Number of worker processes, see `open_executor`.
        engine: The engine of a cluster.
        threads: Number of threads of each worker.
    """

    shard: str | None = None
    workers: int | None = None
    engine: str | None = None
    threads: int | None = None


def make_runs(runs: Sequence[Run], out: Path, sharing: Sharing = Sharing()) -> None:
    """Execute the runs that the folder `out` lacks. Exit after an interrupt, or if runs of other shards are missing.

    Workers execute the runs of planners that any process can load by name. The others are executed in this process.

    Args:
        runs: The runs, possibly with duplicates.
        out: The folder.
        sharing: The share of the runs to execute, and the workers.
    """
    from crowdbench.runs import Shard, run_directory
    from crowdbench.utils import open_executor
    from studies.folder import missing_runs

    announce_compilation()
    lacking = missing_runs(runs, out, Shard.parse(sharing.shard))
    with (
        exit_on_interrupt(f"the same command goes on with the runs that are kept in {out}"),
        open_executor(sharing.engine, sharing.workers, sharing.threads) as executor,
    ):
        if executor is not None:
            _make_with(executor, [run for run in lacking if run.is_named], out)
            lacking = [run for run in lacking if not run.is_named]
        _make_here(lacking, out)
    if missing := missing_runs(runs, out):
        number = len({run_directory(run, out) for run in runs})
        finished = f"crowdbench: {number - len(missing)} of {number} runs are in {out}"
        say(f"{finished}; the last process to finish, or the same command without --shard, prints the tables")
        raise typer.Exit


def _make_with(executor: Executor, runs: Sequence[Run], out: Path) -> None:
    """Execute runs with workers. Raises the first error of a run after the others are finished."""
    from crowdbench.runs import make_in_folder_with

    cases = sum(len(run.spec.cases) for run in runs)
    with progress(cases, f"of {cases} cases of {len(runs)} runs") as report:
        made = make_in_folder_with(executor, runs, out, report)
    for each in made:
        if each.error is not None:
            raise each.error


def _make_here(runs: Sequence[Run], out: Path) -> None:
    """Execute runs in this process, one after the other."""
    from crowdbench.runs import make_in_folder

    for number, run in enumerate(runs, 1):
        changes = "".join(f", {key}={value}" for key, value in run.spec.overrides.items())
        named = f"{run.label} on {run.scenario.name}{changes}, cases {run.spec.cases}"
        say(f"run {number} of {len(runs)}: {named}")
        # The remaining time is given per run: a case of another planner may take a hundred times as long.
        cases = len(run.spec.cases)
        with progress(cases, f"of {cases} cases of run {number}") as report:
            make_in_folder(run, out, report)


def print_study(contents: object, grids: Sequence[Grid], page: str, format: Format) -> None:
    """Print the tables of a study.

    Args:
        contents: All contents, for JSON.
        grids: Its tables, for LaTeX and CSV.
        page: The page, in Markdown.
        format: The output format.
    """
    if format is Format.JSON:
        print(json.dumps(plain(contents), indent=2))
    else:
        print(page if format is Format.MARKDOWN else format_tables(grids, format))
