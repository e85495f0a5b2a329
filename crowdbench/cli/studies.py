"""The command that makes the runs of a study and prints its tables."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from crowdbench.cli.options import INTERRUPTED, JsonOption, use_threads

if TYPE_CHECKING:
    from crowdbench.study.runs import Run


def study(
    file: Annotated[Path, typer.Argument(help="A study, such as docs/studies/crowds.toml.")],
    out: Annotated[Path | None, typer.Option(help="Where its runs are kept, runs/study-<name> unless told.")] = None,
    threads: Annotated[int | None, typer.Option(min=1, help="Threads to use. All cores unless told.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Make the runs of a study that are not there yet, and print its tables in Markdown."""
    use_threads(threads)
    from crowdbench.console import announce_compilation, say
    from crowdbench.study.file import read_study
    from crowdbench.study.runs import missing
    from crowdbench.study.tables import plain

    announce_compilation()
    asked = read_study(file)
    directory = out or Path("runs") / f"study-{asked.name}"
    try:
        _make(missing(asked.runs, directory), directory)
        tables = [table.fill(directory) for table in asked.tables]
    except KeyboardInterrupt:
        say(f"crowdbench: interrupted: the same command goes on with the runs that are kept in {directory}")
        sys.exit(INTERRUPTED)
    if as_json:
        print(json.dumps({"study": asked.name, "tables": plain(tables)}, indent=2))
    else:
        print("\n\n".join(table.markdown() for table in tables))


def _make(runs: Sequence[Run], out: Path) -> None:
    from crowdbench.console import progress, say

    with progress(sum(len(run.cases) for run in runs), "cases") as tell:
        for number, run in enumerate(runs, 1):
            say(f"run {number} of {len(runs)}: {run.title}")
            run.make(out, tell)
