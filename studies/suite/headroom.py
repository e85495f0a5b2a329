"""Turn the scenarios of the suite up until the best planner fails. Prints a table with a row for each level."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from pydantic import Field

sys.path.append(str(Path(__file__).parents[2]))

from crowdbench.cli import main
from crowdbench.cli.options import OnOption, ThreadsOption, help_from_docstring, is_on_ray, use_threads
from crowdbench.cli.study import ShardOption, make_runs, print_study
from crowdbench.runs.spec import RunSpec
from crowdbench.study.folder import read_episodes
from crowdbench.study.schema import CasesText, Planners, StudyHead
from crowdbench.study.study import load_runs
from crowdbench.utils.tables import Format, Grid, markdown, printed_by
from studies.pages import read_file

FILE = Path(__file__).with_suffix(".toml")
LOWEST, HIGHEST = 0.85, 0.93
"""Bounds of the success rate that the best planner should have."""


class HeadroomSpec(StudyHead):
    """The TOML file of the study.

    Attributes:
        cases: The cases of each level.
        planners: The planners.
        levels: By key of a scenario and by scenario, the levels, from easy to hard.
    """

    cases: CasesText
    planners: Planners
    levels: dict[str, dict[str, list[float | int]]] = Field(description="a table [levels.KEY] of lists of numbers")


@help_from_docstring
def headroom(
    scenario: Annotated[list[str] | None, typer.Argument(show_default="all of the file")] = None,
    file: Path = FILE,
    out: Path = Path("runs/study-headroom"),
    shard: ShardOption = None,
    on: OnOption = None,
    threads: ThreadsOption = None,
    format: Format = Format.MARKDOWN,
) -> None:
    """Measure the success of planners at several levels of difficulty, on validation cases.

    Args:
        scenario: Scenarios of the file.
        file: Scenarios with the key that is changed and its levels, and the planners.
        out: Folder that keeps the runs.
    """
    use_threads(None if is_on_ray(on) else threads)
    spec = read_file(file, HeadroomSpec)
    rows = {
        (name, key, level): load_runs(spec.planners, RunSpec("", name, spec.cases, {}, {key: level}, record="none"))
        for key, scenarios in spec.levels.items()
        for name, levels in scenarios.items()
        if not scenario or name in scenario
        for level in levels
    }
    make_runs([run for runs in rows.values() for run in runs], out, shard, on, threads)
    header = ["scenario", "key", "level", *(run.label for run in next(iter(rows.values()))), "best"]
    cells, records = [], []
    for (name, key, level), runs in rows.items():
        episodes = [read_episodes(run, out).columns for run in runs]
        success, fault = (
            [float(np.mean(each[rate])) for each in episodes] for rate in ("success_rate", "at_fault_rate")
        )
        mark = "*" if LOWEST <= max(success) <= HIGHEST else ""
        figures = [f"{100 * share:.0f} ({100 * blame:.0f})" for share, blame in zip(success, fault, strict=True)]
        cells.append([name, key, f"{level:g}", *figures, f"{100 * max(success):.0f}{mark}"])
        records.append({"scenario": name, "key": key, "level": level, "success": success, "at_fault": fault})
    grid = Grid("Success, % (at fault, %)", header, cells, records, "ll" + "r" * (len(header) - 2))
    note = f"Cases {spec.cases}. A star marks levels at which the best succeeds in {LOWEST:.0%} to {HIGHEST:.0%}."
    table = markdown(header, cells)
    page = "\n\n".join([printed_by("python studies/suite/headroom.py"), spec.description, table, note])
    print_study(records, [grid], page, format)


if __name__ == "__main__":
    main(headroom)
