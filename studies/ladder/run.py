"""Measure the gain of a search with increasing knowledge in scenarios. Prints README.md beside this file."""

from __future__ import annotations

import functools
import sys
from pathlib import Path
from typing import Annotated

import typer

sys.path.append(str(Path(__file__).parents[2]))

from crowdbench.cli import ThreadsOption, WorkersOption, help_from_docstring, main, use_threads
from crowdbench.utils import Format, Location, markdown, parse_table
from studies.command import EngineOption, ShardOption, Sharing, make_runs, print_study

COMMAND = "python studies/ladder/run.py"
FILE = Path(__file__).with_name("study.toml")
"""The scenarios and planners of the page."""


@help_from_docstring
def ladder(
    scenarios: Annotated[list[str] | None, typer.Argument(show_default="as on the page")] = None,
    planner: Annotated[list[str] | None, typer.Option(show_default="as on the page")] = None,
    cases: str = "val:50",
    out: Annotated[Path | None, typer.Option(show_default="runs/ladders, or runs/study-ladders for the page")] = None,
    shard: ShardOption = None,
    workers: WorkersOption = None,
    engine: EngineOption = None,
    threads: ThreadsOption = None,
    format: Format = Format.MARKDOWN,
) -> None:
    """Measure the gain of a search with increasing knowledge in scenarios. Without a scenario print the page.

    The same search drives with perception, goals, policies, attention and chance known, beside the best known scores of
    validation cases. Finished runs are kept, and the same command continues after them.

    Args:
        scenarios: Scenarios.
        planner: A planner; the best of the named planners is shown for comparison. Repeatable.
        cases: val:50 (validation cases), 100 (the first 100 test cases, without best known scores).
        out: Folder for the runs, and a file for plot.py for each scenario.
    """
    use_threads(threads)
    from studies.ladder.table import LaddersSpec, LaddersTable, LadderStudy
    from studies.pages import keep, print_page, read_file

    folder = out or Path("runs/ladders" if scenarios else "runs/study-ladders")
    make = functools.partial(make_runs, out=folder, sharing=Sharing(shard, workers, engine, threads))
    spec, location = read_file(FILE, LadderStudy), Location(FILE.name)
    if not scenarios:
        tables = [LaddersTable.of(each, location.at("ladders", i)) for i, each in enumerate(spec.ladders)]
        print_page(spec, tables, COMMAND, folder, make, format)
        return
    planners = [{"planner": name} for name in planner] if planner else spec.ladders[0].planners
    asked = {"title": "Ladders", "planners": planners, "scenarios": scenarios, "cases": cases}
    table = LaddersTable.of(parse_table(LaddersSpec, asked, Location("ladder")), Location("ladder"))
    make(table.runs)
    found = table.fill(folder).ladders
    for each in found:
        keep(each, folder / f"{each.scenario}.json")
    bars = [each.bars() for each in found]
    texts = [f"{bar.title}\n\n{markdown(bar.header, bar.rows)}" for bar in bars]
    print_study(found, bars, "\n\n".join([*texts, f"Kept in {folder}"]), format)


if __name__ == "__main__":
    main(ladder)
