"""Print the page of a study: planners with several networks each, or planners side by side in several scenarios."""

from __future__ import annotations

import functools
import shlex
import sys
from pathlib import Path
from typing import Annotated

import typer

sys.path.append(str(Path(__file__).parents[1]))

from crowdbench.cli import ThreadsOption, WorkersOption, help_from_docstring, main, use_threads
from crowdbench.utils import Format
from studies.command import EngineOption, ShardOption, Sharing, make_runs


@help_from_docstring
def page(
    file: Path,
    out: Annotated[Path | None, typer.Option(show_default="runs/study-<name>")] = None,
    data: Path | None = None,
    shard: ShardOption = None,
    workers: WorkersOption = None,
    engine: EngineOption = None,
    threads: ThreadsOption = None,
    format: Format = Format.MARKDOWN,
) -> None:
    """Execute the missing runs of a study, and print its page.

    Args:
        file: A study, such as studies/crowds/study.toml.
        out: Folder for its runs.
    """
    use_threads(threads)
    from studies.pages import print_page
    from studies.tables import read_tables

    head, tables = read_tables(file, data.absolute() if data else None)
    # A file in a separate folder of its study is named study.toml.
    name = file.absolute().parent.name if file.name == "study.toml" else file.stem
    folder = out or Path("runs") / f"study-{name}"
    make = functools.partial(make_runs, out=folder, sharing=Sharing(shard, workers, engine, threads))
    command = f"python studies/run.py {shlex.quote(str(file))}{' --data DIR' if data else ''}"
    print_page(head, tables, command, folder, make, format, name)


if __name__ == "__main__":
    main(page)
