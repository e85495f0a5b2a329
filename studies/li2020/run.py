"""Print the tables of Li et al. (2020), measured beside reported: README.md beside this file."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

sys.path.append(str(Path(__file__).parents[2]))

from crowdbench.cli import ThreadsOption, WorkersOption, help_from_docstring, main, use_threads
from crowdbench.utils import Format
from studies.command import EngineOption, ShardOption, Sharing, make_runs


@help_from_docstring
def reproduce(
    table: Annotated[int | None, typer.Option(min=1, max=4)] = None,
    quick: bool = False,
    out: Path = Path("runs/li2020"),
    shard: ShardOption = None,
    workers: WorkersOption = None,
    engine: EngineOption = None,
    threads: ThreadsOption = None,
    format: Format = Format.MARKDOWN,
) -> None:
    """Make the tables of Li et al. (2020), measured beside reported, with a verdict on each of the paper's claims.

    Table 1 has five pedestrians, 2 ten pedestrians, 3 eight commands per observation, 4 KCE. A quick look takes some
    minutes and has no verdicts, all tables take one to two hours. Finished runs are kept, and the same command
    continues after them.

    Args:
        table: Make only one of the paper's four tables.
        quick: A quick look: one network per row, few cases.
        out: Folder for the runs.
    """
    use_threads(threads)
    from studies.li2020.claims import tally
    from studies.li2020.table import FilledClaimedTable, read_reproduction
    from studies.pages import print_filled

    study = read_reproduction(table, quick)
    make_runs(study.runs, out, Sharing(shard, workers, engine, threads))
    tables = [table for table in study.fill(out) if isinstance(table, FilledClaimedTable)]
    claims = [claim for each in tables for claim in each.claims]
    command = f"python studies/li2020/run.py{f' --table {table}' if table else ''}{' --quick' if quick else ''}"
    page = f"{study.markdown(tables, command)}\n\n{tally(claims)}"
    print_filled({"quick": quick, "tables": tables, "sources": study.sources}, tables, page, format)


if __name__ == "__main__":
    main(reproduce)
