"""The command that makes the runs of a study, and the functions that it shares with the scripts of `studies/`."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from crowdbench.cli.console import announce_compilation, exit_on_interrupt, progress, say
from crowdbench.cli.options import ThreadsOption, use_threads
from crowdbench.utils.tables import Format, Grid, format_tables, plain

if TYPE_CHECKING:
    from crowdbench.runs.run import Run

ShardOption = Annotated[
    str | None,
    typer.Option(help="Make one share of the runs, such as 2/8; the last shard to finish prints the tables."),
]


def study(
    file: Path,
    out: Annotated[Path | None, typer.Option(show_default="runs/study-<name>")] = None,
    data: Path | None = None,
    shard: ShardOption = None,
    threads: ThreadsOption = None,
    format: Format = Format.MARKDOWN,
) -> None:
    """Make the runs of a study that are not there yet, and print its tables in Markdown.

    Args:
        file: A study, such as studies/crowds/study.toml.
        out: Folder that keeps its runs.
    """
    use_threads(threads)
    from crowdbench.study.study import read_study

    study = read_study(file, data.absolute() if data else None)
    directory = out or Path("runs") / f"study-{study.name}"
    make_runs(study.runs, directory, shard)
    grids = [table.grid(directory) for table in study.tables]
    tables = [{"title": grid.title, "rows": list(grid.records)} for grid in grids]
    page = study.page(grids, f"crowdbench study {file}{' --data DIR' if data else ''}")
    print_study({"study": study.name, "tables": tables}, grids, page, format)


def print_study(contents: object, grids: Sequence[Grid], page: str, format: Format) -> None:
    """Print the tables of a study.

    Args:
        contents: All of it, as JSON.
        grids: Its tables, for LaTeX and CSV.
        page: The page, in Markdown.
        format: How it is printed.
    """
    if format is Format.JSON:
        print(json.dumps(plain(contents), indent=2))
    elif format is Format.MARKDOWN:
        print(page)
    else:
        print(format_tables(grids, format))


def make_runs(runs: Sequence[Run], out: Path, shard: str | None) -> None:
    """Make the runs that the folder `out` lacks; exits after an interrupt, and where runs of others are missing.

    Args:
        runs: The runs, some perhaps twice.
        out: The folder.
        shard: Which share of them is made, such as 2/8.
    """
    from crowdbench.runs.shards import Shard
    from crowdbench.study.folder import describe_run, make_in_folder, missing_runs, run_directory

    announce_compilation()
    lacking = missing_runs(runs, out, Shard.parse(shard))
    with exit_on_interrupt(f"the same command goes on with the runs that are kept in {out}"):
        for number, run in enumerate(lacking, 1):
            say(f"run {number} of {len(lacking)}: {describe_run(run)}")
            # The time left is that of this run: a case of another planner may take a hundred times as long.
            cases = len(run.spec.cases)
            with progress(cases, f"of {cases} cases of run {number}") as report:
                make_in_folder(run, out, report)
    if missing := missing_runs(runs, out):
        number = len({run_directory(run, out) for run in runs})
        finished = f"crowdbench: {number - len(missing)} of {number} runs are in {out}"
        say(f"{finished}; the last process to finish, or the same command without --shard, prints the tables")
        raise typer.Exit
