"""The command that turns a dial up until a planner fails."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

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
        out: Folder that keeps the runs, and a file for `crowdbench plot dial`.
    """
    use_threads(None if is_on_ray(on) else threads)
    from crowdbench.study.dials.dial import load_dial
    from crowdbench.study.dials.table import FilledDial, Measurement
    from crowdbench.utils import files

    asked = Measurement.of(load_dial(name), planner, assignments(option or [], "--option"))
    make_runs(asked.first, out, None, on, threads)
    make_runs(list(asked.second(out).values()), out, None, on, threads)
    found = FilledDial.of([asked], out)
    (row,) = found.rows
    file = out / f"{asked.name}.json"
    text = json.dumps(plain(found), indent=2)
    with files.whole(file) as partial:
        partial.write_text(text, encoding="utf-8")
    if as_json:
        print(text)
        return
    print(f"{found.sentence(row)}\n")
    print_table(found.curve(row))
    print(f"\nKept in {file}")
