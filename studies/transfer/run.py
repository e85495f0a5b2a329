"""Measure whether the order of planners in the suite holds in other worlds. Prints README.md beside this file."""

from __future__ import annotations

import functools
import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parents[2]))

from crowdbench.cli import ThreadsOption, WorkersOption, help_from_docstring, main, use_threads
from crowdbench.utils import Format, Location, markdown
from studies.command import EngineOption, ShardOption, Sharing, make_runs

FILE = Path(__file__).with_name("study.toml")


@help_from_docstring
def transfer(
    file: Path = FILE,
    out: Path = Path("runs/study-transfer"),
    data: Path | None = None,
    shard: ShardOption = None,
    workers: WorkersOption = None,
    engine: EngineOption = None,
    threads: ThreadsOption = None,
    power: bool = False,
    reliability: bool = False,
    format: Format = Format.MARKDOWN,
) -> None:
    """Measure whether the order of planners in a suite of scenarios holds in other worlds. Run it in the clone's root.

    Args:
        file: The planners, the suite and the worlds.
        out: Folder for the runs.
        power: Print the power of the study, and make no runs.
        reliability: Print the reliability of the suite and of each world alone, without a comparison.
    """
    use_threads(threads)
    from studies.pages import print_page, read_file
    from studies.transfer.table import RankingsTable, TransferStudy

    spec, location = read_file(file, TransferStudy), Location(file.name)
    folder = data.absolute() if data else None
    tables = [RankingsTable.of(each, location.at("rankings", i), folder) for i, each in enumerate(spec.rankings)]
    make = functools.partial(make_runs, out=out, sharing=Sharing(shard, workers, engine, threads))
    if power:
        for table in tables:
            print(f"{table.spec.title}. {table.power()}")
    elif reliability:
        make([run for table in tables for run in table.runs])
        for table in tables:
            grid = table.reliability(out)
            print(f"{table.spec.title}. {grid.title}.\n\n{markdown(grid.header, grid.rows)}")
    else:
        command = f"python studies/transfer/run.py{' --data DIR' if data else ''}"
        print_page(spec, tables, command, out, make, format)


if __name__ == "__main__":
    main(transfer)
