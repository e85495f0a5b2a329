"""Print how levels of the suite's scenarios spread the scores of planners, on validation cases."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from pydantic import Field

sys.path.append(str(Path(__file__).parents[2]))

from crowdbench.cli import ThreadsOption, WorkersOption, help_from_docstring, main, use_threads
from crowdbench.metrics import info_of
from crowdbench.utils import Format, Grid, markdown, printed_by
from studies.command import EngineOption, Sharing, make_runs, print_study
from studies.folder import read_episodes
from studies.pages import read_file
from studies.schema import StudyHead
from studies.suite.driven import DrivenPlanner

FILE = Path(__file__).with_suffix(".toml")
KNOB = "pedestrians.number"
SCORE = info_of("score")


class LevelsSpec(StudyHead):
    """The TOML file of the study.

    Attributes:
        planners: The planners.
        levels: The numbers of pedestrians by scenario, from easy to hard.
    """

    planners: list[DrivenPlanner] = Field(min_length=2, description="tables [[planners]]")
    levels: dict[str, list[int]] = Field(description="a table [levels] of lists of whole numbers")


@help_from_docstring
def levels(
    scenario: Annotated[list[str] | None, typer.Argument(show_default="all of the file")] = None,
    file: Path = FILE,
    out: Path = Path("runs/study-suite-levels"),
    workers: WorkersOption = None,
    engine: EngineOption = None,
    threads: ThreadsOption = None,
    format: Format = Format.MARKDOWN,
) -> None:
    """Print the scores of planners at levels of the suite's scenarios, and how much they differ.

    Args:
        scenario: Scenarios of the file.
        file: The planners, and the levels of each scenario.
        out: Folder for the runs.
    """
    use_threads(threads)
    spec = read_file(file, LevelsSpec)
    chosen = {name: numbers for name, numbers in spec.levels.items() if not scenario or name in scenario}
    runs = {
        (name, number): [run for planner in spec.planners for run in planner.load(name, {KNOB: number})]
        for name, numbers in chosen.items()
        for number in numbers
    }
    make_runs([run for each in runs.values() for run in each], out, Sharing(None, workers, engine, threads))
    header = ["scenario", "people", *(planner.planner for planner in spec.planners), "spread"]
    rows, records = [], []
    for (name, number), each in runs.items():
        scores = [float(np.mean(read_episodes(run, out).columns["score"])) for run in each]
        rows.append([name, str(number), *map(SCORE.number, scores), SCORE.number(float(np.std(scores)))])
        records.append({"scenario": name, "people": number, "scores": scores})
    grid = Grid("Levels", header, rows, records, "ll" + "r" * (len(header) - 2))
    note = f"Cases: {', '.join(f'{each.cases} of {each.planner}' for each in spec.planners)}."
    parts = [printed_by("python studies/suite/levels.py"), spec.description, markdown(header, rows), note]
    print_study(records, [grid], "\n\n".join(parts + spec.sources), format)


if __name__ == "__main__":
    main(levels)
