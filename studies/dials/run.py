"""Increase the level of a dial until the score of planners is below 0.3. Prints README.md beside this file."""

from __future__ import annotations

import functools
import sys
from pathlib import Path
from typing import Annotated

import typer

sys.path.append(str(Path(__file__).parents[2]))

from crowdbench import InputError
from crowdbench.cli import ThreadsOption, WorkersOption, assignments, help_from_docstring, main, use_threads
from crowdbench.utils import Format, Location, markdown
from studies.command import EngineOption, ShardOption, Sharing, make_runs, print_study

COMMAND = "python studies/dials/run.py"
FILE = Path(__file__).with_name("study.toml")
"""The dials and planners of the page."""


@help_from_docstring
def dial(
    name: Annotated[str | None, typer.Argument(show_default="as on the page")] = None,
    planner: str | None = None,
    option: list[str] | None = None,
    file: Path = FILE,
    out: Annotated[Path | None, typer.Option(show_default="runs/dials, or runs/study-dials for the page")] = None,
    shard: ShardOption = None,
    workers: WorkersOption = None,
    engine: EngineOption = None,
    threads: ThreadsOption = None,
    format: Format = Format.MARKDOWN,
) -> None:
    """Find the level of a dial up to which a planner has a mean score of 0.3. Without a dial print the page.

    Drives 30 cases at each level, then 240 others at each of the three around the figure.

    Args:
        name: A dial of scenarios/dials, or a file: ./mine.toml.
        planner: A planner, or a rung of the ladder on 30 cases per level: P2 and P3 show the limit of the search.
        file: The dials and planners of the page.
        out: Folder for the runs, and a file for plot.py.
    """
    use_threads(threads)
    from studies.dials.dial import load_dial
    from studies.dials.table import DialsTable, DialStudy, FilledDial, Measurement
    from studies.pages import keep, print_two_steps, read_file

    if (name is None) != (planner is None):
        raise InputError("a dial needs a planner: give NAME and --planner, or neither for the page")
    folder = out or Path("runs/study-dials" if name is None else "runs/dials")
    make = functools.partial(make_runs, out=folder, sharing=Sharing(shard, workers, engine, threads))
    if name is None or planner is None:
        spec, location = read_file(file, DialStudy), Location(file.name)
        tables = [DialsTable.of(each, location.at("dials", i)) for i, each in enumerate(spec.dials)]
        print_two_steps(spec, tables, COMMAND, folder, make, format)
        return
    asked = Measurement.of(load_dial(name), planner, assignments(option or [], "--option"))
    make(asked.first)
    make(list(asked.second(folder).values()))
    found = FilledDial.of([asked], folder)
    (row,) = found.rows
    kept, curve = folder / f"{asked.name}.json", found.curve(row)
    keep(found, kept)
    text = "\n\n".join([found.sentence(row), markdown(curve.header, curve.rows), f"Kept in {kept}"])
    print_study(found, [curve], text, format)


if __name__ == "__main__":
    main(dial)
