"""The commands that turn a dial up until a planner fails, and that ask why planners fail in a scenario."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from crowdbench.cli.options import OnOption, ThreadsOption, assignments, help_from_docstring, is_on_ray, use_threads
from crowdbench.cli.study import make_runs
from crowdbench.cli.tables import print_table
from crowdbench.utils.tables import plain


@help_from_docstring
def dial(
    name: str,
    planner: Annotated[str, typer.Option()],
    option: list[str] | None = None,
    out: Path = Path("runs/dials"),
    on: OnOption = None,
    threads: ThreadsOption = None,
    as_json: bool = False,
) -> None:
    """Find the level of a dial up to which a planner succeeds in 90 % of the cases.

    Drives 30 cases at each level, then 240 others at each of the three around the figure.

    Args:
        name: A dial (`crowdbench list dials`), or a file: ./mine.toml.
        planner: A planner, or a rung of the ladder, on 30 cases a level: P2 and C say where the world itself ends.
        out: Folder that keeps the runs, and a file for `crowdbench plot dial`.
    """
    use_threads(None if is_on_ray(on) else threads)
    from crowdbench.study.dials.dial import load_dial
    from crowdbench.study.dials.table import FilledDial, Measurement

    asked = Measurement.of(load_dial(name), planner, assignments(option or [], "--option"))
    make_runs(asked.first, out, None, on, threads)
    make_runs(list(asked.second(out).values()), out, None, on, threads)
    found = FilledDial.of([asked], out)
    (row,) = found.rows
    file = out / f"{asked.name}.json"
    _write(found, file)
    if as_json:
        print(json.dumps(plain(found), indent=2))
        return
    print(f"{found.sentence(row)}\n")
    print_table(found.curve(row))
    print(f"\nKept in {file}")


@help_from_docstring
def ladder(
    scenarios: list[str],
    planner: Annotated[list[str] | None, typer.Option(show_default="the strongest of each kind")] = None,
    cases: str = "100",
    out: Path = Path("runs/ladders"),
    on: OnOption = None,
    threads: ThreadsOption = None,
    as_json: bool = False,
) -> None:
    """Say what failures in a scenario are due to: perception, prediction, luck, or the planner.

    The same search drives with ever more foresight. Finished runs are kept, and the same command goes on after them.

    Args:
        scenarios: Scenarios.
        planner: A planner; the best of those that are named is measured beside. Repeatable.
        cases: 100 (the first 100 test cases), 2000:2100, val:100 (validation cases).
        out: Folder that keeps the runs, and a file for `crowdbench plot ladder` for each scenario.
    """
    use_threads(None if is_on_ray(on) else threads)
    from crowdbench.study.ladder.table import CANDIDATES, LaddersTable
    from crowdbench.study.schema import LaddersSpec
    from crowdbench.utils.toml import Location, parse_table

    planners = [{"planner": name} for name in planner] if planner else CANDIDATES
    asked = {"title": "Ladders", "planners": planners, "scenarios": scenarios, "cases": cases}
    table = LaddersTable.of(parse_table(LaddersSpec, asked, Location("ladder")), Location("ladder"))
    make_runs(table.runs, out, None, on, threads)
    make_runs(table.second(out), out, None, on, threads)
    found = table.fill(out).ladders
    for each in found:
        _write(each, out / f"{each.scenario}.json")
        if not as_json:
            print_table(each.bars())
            print(f"\nKept in {out / each.scenario}.json\n")
    if as_json:
        print(json.dumps(plain(found), indent=2))


def _write(found: Any, file: Path) -> None:
    """Keep what was found for a figure."""
    from crowdbench.utils import files

    with files.whole(file) as partial:
        partial.write_text(json.dumps(plain(found), indent=2), encoding="utf-8")
