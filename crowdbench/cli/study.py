"""The commands that print pages: the tables of a study."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from crowdbench.cli.console import announce_compilation, exit_on_interrupt, progress, say
from crowdbench.cli.options import OnOption, ThreadsOption, help_from_docstring, is_on_ray, use_threads
from crowdbench.utils.tables import Format, format_tables, plain

if TYPE_CHECKING:
    from crowdbench.runs.run import Run
    from crowdbench.study.study import FilledTable

ShardOption = Annotated[
    str | None,
    typer.Option(help="Make one share of the runs, such as 2/8; the last shard to finish prints the tables."),
]


@help_from_docstring
def study(
    file: Path,
    out: Annotated[Path | None, typer.Option(show_default="runs/study-<name>")] = None,
    data: Path | None = None,
    shard: ShardOption = None,
    on: OnOption = None,
    threads: ThreadsOption = None,
    format: Format = Format.MARKDOWN,
) -> None:
    """Make the runs of a study that are not there yet, and print its tables in Markdown.

    Args:
        file: A study, such as studies/crowds/study.toml.
        out: Folder that keeps its runs.
    """
    use_threads(None if is_on_ray(on) else threads)
    from crowdbench.study.study import read_study

    study = read_study(file, data.absolute() if data else None)
    directory = out or Path("runs") / f"study-{study.name}"
    make_runs(study.runs, directory, shard, on, threads)
    tables = study.fill(directory)
    command = f"crowdbench study {file}{' --data DIR' if data else ''}"
    print_tables({"study": study.name, "tables": tables}, tables, study.page(tables, command), format)


def print_tables(found: object, tables: Sequence[FilledTable], page: str, format: Format) -> None:
    """Print what a study found.

    Args:
        found: All of it, as JSON.
        tables: Its tables, for LaTeX and CSV.
        page: The page, in Markdown.
        format: How it is printed.
    """
    if format is Format.JSON:
        print(json.dumps(plain(found), indent=2))
    elif format is Format.MARKDOWN:
        print(page)
    else:
        print(format_tables([grid for table in tables for grid in table.grids()], format))


def make_runs(runs: Sequence[Run], out: Path, shard: str | None, on: str | None, threads: int | None) -> None:
    """Make the runs that the folder `out` lacks; exits after an interrupt, and where other shards are missing."""
    from crowdbench.runs.shards import Shard
    from crowdbench.study.folder import describe_run, make_in_folder, missing_runs, run_directory

    announce_compilation()
    lacking = missing_runs(runs, out, Shard.parse(shard))
    with exit_on_interrupt(f"the same command goes on with the runs that are kept in {out}"):
        left = _make_on_ray(lacking, out, threads or 1) if is_on_ray(on) and lacking else _make_here(lacking, out)
        for run in left:
            say(f"another process is making {describe_run(run)}")
            make_in_folder(run, out)
    if shard and (missing := missing_runs(runs, out)):
        number = len({run_directory(run, out) for run in runs})
        finished = f"{number - len(missing)} of {number} runs are in {out}"
        say(f"crowdbench: {finished}; the shard that ends last, or the same command without --shard, prints the tables")
        raise typer.Exit


def _make_here(lacking: Sequence[Run], out: Path) -> list[Run]:
    """Make runs, and return those that other processes are making."""
    from crowdbench.study.folder import describe_run, make_in_folder

    left = []
    for number, run in enumerate(lacking, 1):
        say(f"run {number} of {len(lacking)}: {describe_run(run)}")
        # The time left is that of this run: a case of another planner may take a hundred times as long.
        cases = len(run.spec.cases)
        with progress(cases, f"of {cases} cases of run {number}") as tell:
            if not make_in_folder(run, out, tell, wait=False):
                left.append(run)
    return left


def _make_on_ray(lacking: Sequence[Run], out: Path, cpus: int) -> list[Run]:
    """Have the workers of a Ray cluster make runs, and return those that other processes are making."""
    from crowdbench.runs.on_ray import make_parts
    from crowdbench.runs.shards import Parts
    from crowdbench.study.folder import make_in_folder, run_directory

    left = []

    def put_together(number: int) -> None:
        if not make_in_folder(lacking[number], out, wait=False):
            left.append(lacking[number])

    cases = sum(len(run.spec.cases) for run in lacking)
    with progress(cases, f"of {cases} cases of {len(lacking)} runs") as tell:
        runs = [Parts.of(run, run_directory(run, out)) for run in lacking]
        make_parts(runs, cpus=cpus, finished=put_together, progress=tell)
    return left
