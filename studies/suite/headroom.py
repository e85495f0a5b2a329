"""Measure the best planners in the scenarios of the suite, as they are and at other levels of difficulty."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from pydantic import Field

sys.path.append(str(Path(__file__).parents[2]))

from crowdbench.cli import ThreadsOption, WorkersOption, help_from_docstring, main, use_threads
from crowdbench.runs import RunSpec
from crowdbench.utils import Format, Grid, Names, markdown, printed_by
from studies.command import EngineOption, ShardOption, Sharing, make_runs, print_study
from studies.folder import load_runs, read_episodes
from studies.pages import read_file
from studies.schema import CasesText, Planners, StudyHead

FILE = Path(__file__).with_suffix(".toml")
LOWEST, HIGHEST = 85.0, 93.0
"""Bounds of the success rate in % that the best planner should have."""

RATES = ("success_rate", "at_fault_rate", "struck_rate", "struck_noticed_rate")
"""The rates of the table: two of each planner, then two of the best one."""


class HeadroomSpec(StudyHead):
    """The TOML file of the study.

    Attributes:
        cases: The cases of each level.
        planners: The planners.
        scenarios: The scenarios to measure as they are.
        levels: By key of a scenario and by scenario, the levels, from easy to hard.
    """

    cases: CasesText
    planners: Planners
    scenarios: Names = Field(default=[])
    levels: dict[str, dict[str, list[float | int]]] = Field({}, description="a table [levels.KEY] of lists of numbers")


@help_from_docstring
def headroom(
    scenario: Annotated[list[str] | None, typer.Argument(show_default="all of the file")] = None,
    file: Path = FILE,
    out: Path = Path("runs/study-headroom"),
    shard: ShardOption = None,
    workers: WorkersOption = None,
    engine: EngineOption = None,
    threads: ThreadsOption = None,
    format: Format = Format.MARKDOWN,
) -> None:
    """Measure the success of planners in scenarios and at levels of their difficulty, on validation cases.

    Args:
        scenario: Scenarios of the file.
        file: The scenarios, the levels of keys of scenarios, and the planners.
        out: Folder for the runs.
    """
    use_threads(threads)
    spec = read_file(file, HeadroomSpec)
    places: list[tuple[str, dict[str, float]]] = [(name, {}) for name in spec.scenarios]
    for key, scenarios in spec.levels.items():
        places += [(name, {key: level}) for name, levels in scenarios.items() for level in levels]
    metrics = tuple(f"{Path(__file__).with_name('struck.py')}:{rate}" for rate in RATES[2:])
    rows = [
        load_runs(spec.planners, RunSpec("", name, spec.cases, overrides=level, metrics=metrics, record="none"))
        for name, level in places
        if not scenario or name in scenario
    ]
    make_runs([run for runs in rows for run in runs], out, Sharing(shard, workers, engine, threads))
    header = ["scenario", "level", *(run.label for run in rows[0]), "best", "struck", "struck though noticed"]
    cells, records = [], []
    for runs in rows:
        columns = [read_episodes(run, out).columns for run in runs]
        rates = {name: [100 * float(np.mean(each[name])) for each in columns] for name in RATES}
        success, fault, *others = rates.values()
        best = int(np.argmax(success))
        mark = "*" if LOWEST <= success[best] <= HIGHEST else ""
        level = ", ".join(f"{key} = {value:g}" for key, value in runs[0].spec.overrides.items())
        figures = [f"{share:.1f} ({blame:.1f})" for share, blame in zip(success, fault, strict=True)]
        figures += [f"{success[best]:.1f}{mark}", *(f"{each[best]:.1f}" for each in others)]
        cells.append([runs[0].scenario.name, level, *figures])
        records.append({"scenario": runs[0].scenario.name, "level": runs[0].spec.overrides, **rates})
    grid = Grid("Success, % (at fault, %)", header, cells, records, "ll" + "r" * (len(header) - 2))
    note = f"Cases {spec.cases}. A star marks levels at which the best succeeds in {LOWEST:g} to {HIGHEST:g} %."
    table = markdown(header, cells)
    command = f"python studies/suite/headroom.py{'' if file == FILE else f' --file {shlex.quote(str(file))}'}"
    page = "\n\n".join([printed_by(command), spec.description, table, note, *spec.sources])
    print_study(records, [grid], page, format)


if __name__ == "__main__":
    main(headroom)
