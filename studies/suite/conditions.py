"""Test the conditions that the suite must meet, in both tracks of sensing; `conditions.md` explains them."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer
from pydantic import Field

sys.path.append(str(Path(__file__).parents[2]))

from crowdbench import Cases, read_suite
from crowdbench.cli import ThreadsOption, WorkersOption, help_from_docstring, main, use_threads
from crowdbench.core import SENSING_TRACKS
from crowdbench.utils import Format, Grid, markdown, printed_by
from studies.command import EngineOption, Sharing, make_runs, print_study
from studies.pages import read_file
from studies.schema import StudyHead
from studies.suite.checks import AttackSpec, best_grid, check_attack, check_track, correlation_grid
from studies.suite.driven import DrivenPlanner
from studies.suite.rank import order_texts, rank_grid
from studies.suite.run import PERFECT, change_cases, flat, load_track, read_standings

FILE = Path(__file__).with_suffix(".toml")


class ConditionsSpec(StudyHead):
    """The TOML file of the conditions.

    Attributes:
        planners: The planners.
        aside: Planners that are driven for attacks alone, with perfect sensing.
        attacks: The attacks.
    """

    planners: list[DrivenPlanner] = Field(min_length=2, description="tables [[planners]]")
    aside: list[DrivenPlanner] = Field(description="tables [[aside]]")
    attacks: list[AttackSpec] = Field(description="tables [[attacks]]")


@help_from_docstring
def conditions(
    cases: Annotated[str | None, typer.Option(show_default="as in the file")] = None,
    out: Path = Path("runs/study-suite-conditions"),
    workers: WorkersOption = None,
    engine: EngineOption = None,
    threads: ThreadsOption = None,
    format: Format = Format.MARKDOWN,
) -> None:
    """Print which conditions the suite meets, in both tracks of sensing.

    Args:
        cases: Cases of each scenario, if other cases are driven than the file has: val:4.
        out: Folder for the runs.
    """
    use_threads(threads)
    spec, names = read_file(FILE, ConditionsSpec), read_suite().ranked
    planners, aside = ({each.name: each for each in group} for group in (spec.planners, spec.aside))
    if cases:
        planners, aside = (change_cases(group, Cases.parse(cases)) for group in (planners, aside))
    runs = {track: load_track(planners, names, track) for track in SENSING_TRACKS}
    runs_aside = load_track(aside, names, PERFECT)
    make_runs(flat([*runs.values(), runs_aside]), out, Sharing(None, workers, engine, threads))
    grids, texts = [], []
    for track in SENSING_TRACKS:
        standings = read_standings(runs[track], out)
        everybody = standings | (read_standings(runs_aside, out) if track == PERFECT else {})
        results = check_track(standings, names)
        if track == PERFECT:
            results += [check_attack(attack, standings, everybody) for attack in spec.attacks]
        rows = [[each.condition, each.figure, "holds" if each.holds else "**missed**"] for each in results]
        ranked = rank_grid(f"Ranks with {track} sensing", everybody, {}, "")
        grids += [Grid(f"Conditions with {track} sensing", ["condition", "figure", ""], rows), ranked]
        grids += [best_grid(track, standings, names), correlation_grid(track, standings, names)]
        texts += [[], order_texts(everybody), [], []]
    command = f"python studies/suite/conditions.py{f' --cases {cases}' if cases else ''}"
    parts = [printed_by(command), spec.description]
    for grid, text in zip(grids, texts, strict=True):
        parts += [f"## {grid.title}", markdown(grid.header, grid.rows), *text]
    print_study(grids, grids, "\n\n".join([*parts, *spec.sources]), format)


if __name__ == "__main__":
    main(conditions)
