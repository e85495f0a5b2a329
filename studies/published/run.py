"""Run published networks and ours on the same cases. Prints README.md beside this file."""

from __future__ import annotations

import functools
import sys
from pathlib import Path
from typing import Annotated

import typer

sys.path.append(str(Path(__file__).parents[2]))

from crowdbench.cli import ThreadsOption, WorkersOption, help_from_docstring, main, use_threads
from crowdbench.utils import Format
from studies.command import EngineOption, ShardOption, Sharing, make_runs


@help_from_docstring
def published(
    networks: Path,
    cases: Annotated[str | None, typer.Option(show_default="as in study.toml")] = None,
    out: Path = Path("runs/study-published"),
    shard: ShardOption = None,
    workers: WorkersOption = None,
    engine: EngineOption = None,
    threads: ThreadsOption = None,
    format: Format = Format.MARKDOWN,
) -> None:
    """Execute the missing runs of published networks, and print the page.

    Args:
        networks: Folder with their weights: SCENE__NETWORK_on_PEOPLE.safetensors, and dsrnn.safetensors.
        cases: Other cases of each scenario, such as val:20.
        out: Folder for the runs.
    """
    use_threads(threads)
    from crowdbench import Cases
    from studies.pages import print_page, read_file
    from studies.published.table import PublishedSpec, PublishedTable

    spec = read_file(Path(__file__).with_name("study.toml"), PublishedSpec)
    specs = [each.model_copy(update={"cases": Cases.parse(cases)}) if cases else each for each in spec.tables]
    tables = [PublishedTable.load(each, networks) for each in specs]
    command = f"python studies/published/run.py NETWORKS{f' --cases {cases}' if cases else ''}"
    make = functools.partial(make_runs, out=out, sharing=Sharing(shard, workers, engine, threads))
    print_page(spec, tables, command, out, make, format)


if __name__ == "__main__":
    main(published)
