"""The option `--shard` of studies, and the functions that execute their runs and print their tables.

Slow modules are imported when a function is called, after the number of threads is set.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from crowdbench.cli import announce_compilation, exit_on_interrupt, progress, say
from crowdbench.utils import Format, Grid, format_tables, plain

if TYPE_CHECKING:
    from crowdbench.runs import Run

ShardOption = Annotated[
    str | None,
    typer.Option(help="Make one share of the runs, such as 2/8; the last shard to finish prints the tables."),
]


def make_runs(runs: Sequence[Run], out: Path, shard: str | None) -> None:
    """Execute the runs that the folder `out` lacks. Exit after an interrupt, or if runs of other shards are missing.

    Args:
        runs: The runs, possibly with duplicates.
        out: The folder.
        shard: The share of the runs to execute, such as 2/8.
    """
    from crowdbench.runs import Shard, make_in_folder, run_directory
    from studies.folder import missing_runs

    announce_compilation()
    lacking = missing_runs(runs, out, Shard.parse(shard))
    with exit_on_interrupt(f"the same command goes on with the runs that are kept in {out}"):
        for number, run in enumerate(lacking, 1):
            changes = "".join(f", {key}={value}" for key, value in run.spec.overrides.items())
            named = f"{run.label} on {run.scenario.name}{changes}, cases {run.spec.cases}"
            say(f"run {number} of {len(lacking)}: {named}")
            # The remaining time is given per run: a case of another planner may take a hundred times as long.
            cases = len(run.spec.cases)
            with progress(cases, f"of {cases} cases of run {number}") as report:
                make_in_folder(run, out, report)
    if missing := missing_runs(runs, out):
        number = len({run_directory(run, out) for run in runs})
        finished = f"crowdbench: {number - len(missing)} of {number} runs are in {out}"
        say(f"{finished}; the last process to finish, or the same command without --shard, prints the tables")
        raise typer.Exit


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
