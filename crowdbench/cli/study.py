"""The commands that make the runs of a study and print its tables."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from crowdbench.cli.options import (
    INTERRUPTED,
    DataOption,
    FormatOption,
    OnOption,
    ThreadsOption,
    is_on_ray,
    use_threads,
)
from crowdbench.evaluate.formats import Format

if TYPE_CHECKING:
    from crowdbench.study.planned import PlannedRun
    from crowdbench.study.tables import FilledTable

ShardOption = Annotated[
    str | None,
    typer.Option(help="Make one share of the runs, such as 2/8; whoever ends last prints the tables."),
]


def study(
    file: Annotated[Path, typer.Argument(help="A study, such as docs/studies/crowds.toml.")],
    out: Annotated[
        Path | None, typer.Option(help="Folder that keeps its runs.", show_default="runs/study-<name>")
    ] = None,
    data: DataOption = None,
    shard: ShardOption = None,
    on: OnOption = None,
    threads: ThreadsOption = None,
    format: FormatOption = Format.MARKDOWN,
) -> None:
    """Make the runs of a study that are not there yet, and print its tables in Markdown."""
    use_threads(None if is_on_ray(on) else threads)
    from crowdbench.study.file import read_study
    from crowdbench.study.tables import page

    asked = read_study(file, data.absolute() if data else None)
    directory = out or Path("runs") / f"study-{asked.name}"
    _make(asked.runs, directory, shard, on, threads)
    tables = [table.fill(directory) for table in asked.tables]
    _print({"study": asked.name, "tables": tables}, tables, page(tables, asked.sources), format)


def reproduce(
    table: Annotated[int | None, typer.Option(min=1, max=4, help="One of the paper's four tables alone.")] = None,
    quick: Annotated[bool, typer.Option("--quick", help="A quick look: one network per row, few cases.")] = False,
    out: Annotated[Path, typer.Option(help="Folder that keeps the runs.")] = Path("runs/reproduce"),
    shard: ShardOption = None,
    on: OnOption = None,
    threads: ThreadsOption = None,
    format: FormatOption = Format.MARKDOWN,
) -> None:
    """Make the tables of Li et al. (2020), measured beside reported, and say which of the paper's claims hold.

    Table 1 is of five pedestrians, 2 of ten, 3 of eight commands per observation, 4 of KCE. A quick look takes some
    minutes and has no verdicts, all tables take one to two hours. Finished runs are kept, and the same command goes on
    after them.
    """
    use_threads(None if is_on_ray(on) else threads)
    from crowdbench.study import reproduction

    asked = reproduction.tables(table, quick)
    _make([run for each in asked for run in each.runs], out, shard, on, threads)
    report = reproduction.report(asked, quick, out)
    _print(report, report.tables, report.markdown(), format)


def _print(found: object, tables: Sequence[FilledTable], page: str, format: Format) -> None:
    """Print what a study found.

    Args:
        found: All of it, as JSON.
        tables: Its tables, for LaTeX and CSV.
        page: The page, in Markdown.
        format: How it is printed.
    """
    from crowdbench.evaluate.formats import plain, written

    if format is Format.JSON:
        print(json.dumps(plain(found), indent=2))
    elif format is Format.MARKDOWN:
        print(page)
    else:
        print(written([grid for table in tables for grid in table.grids()], format))


def _make(runs: Sequence[PlannedRun], out: Path, shard: str | None, on: str | None, threads: int | None) -> None:
    """Make the runs that the folder `out` lacks; exits after an interrupt, and where other shards are missing."""
    from crowdbench.cli.console import announce_compilation, say
    from crowdbench.evaluate.shard import WHOLE, Shard
    from crowdbench.study.planned import missing

    announce_compilation()
    lacking = missing(runs, out, Shard.parse(shard) if shard else WHOLE)
    try:
        left = _make_on_ray(lacking, out, threads or 1) if is_on_ray(on) and lacking else _make_here(lacking, out)
        for run in left:
            say(f"another process is making {run.title}")
            run.make(out)
    except KeyboardInterrupt:
        say(f"crowdbench: interrupted: the same command goes on with the runs that are kept in {out}")
        sys.exit(INTERRUPTED)
    if shard and (others := missing(runs, out)):
        number = len({run.directory for run in runs})
        there = f"{number - len(others)} of {number} runs are in {out}"
        say(f"crowdbench: {there}; the shard that ends last, or the same command without --shard, prints the tables")
        raise typer.Exit


def _make_here(lacking: Sequence[PlannedRun], out: Path) -> list[PlannedRun]:
    """Make runs, and return those that other processes are making."""
    from crowdbench.cli.console import progress, say

    left = []
    for number, run in enumerate(lacking, 1):
        say(f"run {number} of {len(lacking)}: {run.title}")
        # The time left is that of this run: a case of another planner may take a hundred times as long.
        with progress(len(run.cases), f"of {len(run.cases)} cases of run {number}") as tell:
            if not run.make(out, tell, wait=False):
                left.append(run)
    return left


def _make_on_ray(lacking: Sequence[PlannedRun], out: Path, cpus: int) -> list[PlannedRun]:
    """Have the workers of a Ray cluster make runs, and return those that other processes are making."""
    from crowdbench import cluster
    from crowdbench.cli.console import progress

    left = []

    def put_together(number: int) -> None:
        if not lacking[number].make(out, wait=False):
            left.append(lacking[number])

    jobs = [cluster.Job(run.spec, parts, parts.cases) for run in lacking for parts in [run.parts(out)]]
    cases = sum(len(run.cases) for run in lacking)
    with progress(cases, f"of {cases} cases of {len(lacking)} runs") as tell:
        cluster.make_parts(jobs, cpus=cpus, made=put_together, progress=tell)
    return left
