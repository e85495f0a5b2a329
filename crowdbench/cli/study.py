"""The commands that make the runs of a study and print its tables."""

from __future__ import annotations

import contextlib
import json
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from crowdbench.cli.options import INTERRUPTED, JsonOption, ThreadsOption, use_threads

if TYPE_CHECKING:
    from crowdbench.study.planned import PlannedRun


def study(
    file: Annotated[Path, typer.Argument(help="A study, such as docs/studies/crowds.toml.")],
    out: Annotated[
        Path | None, typer.Option(help="Folder that keeps its runs.", show_default="runs/study-<name>")
    ] = None,
    threads: ThreadsOption = None,
    as_json: JsonOption = False,
) -> None:
    """Make the runs of a study that are not there yet, and print its tables in Markdown."""
    use_threads(threads)
    from crowdbench.study.file import read_study
    from crowdbench.study.tables import page, plain

    asked = read_study(file)
    with _made(asked.runs, out or Path("runs") / f"study-{asked.name}") as directory:
        tables = [table.fill(directory) for table in asked.tables]
    if as_json:
        print(json.dumps({"study": asked.name, "tables": plain(tables)}, indent=2))
    else:
        print(page(tables, asked.sources))


def reproduce(
    table: Annotated[int | None, typer.Option(min=1, max=4, help="One of the paper's four tables alone.")] = None,
    quick: Annotated[bool, typer.Option("--quick", help="A quick look: one network per row, few cases.")] = False,
    out: Annotated[Path, typer.Option(help="Folder that keeps the runs.")] = Path("runs/reproduce"),
    threads: ThreadsOption = None,
    as_json: JsonOption = False,
) -> None:
    """Make the tables of Li et al. (2020), measured beside reported, and say which of the paper's claims hold.

    Table 1 is of five pedestrians, 2 of ten, 3 of eight commands per observation, 4 of KCE. A quick look takes some
    minutes and has no verdicts, all tables take one to two hours. Finished runs are kept, and the same command goes on
    after them.
    """
    use_threads(threads)
    from crowdbench.study import reproduction
    from crowdbench.study.tables import plain

    asked = reproduction.tables(table, quick)
    with _made([run for each in asked for run in each.runs], out) as directory:
        report = reproduction.report(asked, quick, directory)
    print(json.dumps(plain(report), indent=2) if as_json else report.markdown())


@contextlib.contextmanager
def _made(runs: Iterable[PlannedRun], out: Path) -> Iterator[Path]:
    """Make the runs that the folder `out` lacks; exits after an interrupt."""
    from crowdbench.cli.console import announce_compilation, progress, say
    from crowdbench.study.planned import missing

    announce_compilation()
    try:
        lacking = missing(runs, out)
        for number, run in enumerate(lacking, 1):
            say(f"run {number} of {len(lacking)}: {run.title}")
            # The time left is that of this run: a case of another planner may take a hundred times as long.
            with progress(len(run.cases), f"of {len(run.cases)} cases of run {number}") as tell:
                run.make(out, tell)
        yield out
    except KeyboardInterrupt:
        say(f"crowdbench: interrupted: the same command goes on with the runs that are kept in {out}")
        sys.exit(INTERRUPTED)
