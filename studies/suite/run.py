"""Print the order of planners on the suite in both tracks of sensing, beside their order on the earlier suite."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from pydantic import Field

sys.path.append(str(Path(__file__).parents[2]))

from crowdbench import Cases, read_suite
from crowdbench.cli import ThreadsOption, WorkersOption, help_from_docstring, main, use_threads
from crowdbench.core import SENSING_TRACKS
from crowdbench.metrics import Estimate, info_of, mean_over_scenarios
from crowdbench.runs import Run
from crowdbench.utils import Format, Grid, markdown, printed_by
from studies.command import EngineOption, Sharing, make_runs, print_study
from studies.folder import read_episodes
from studies.pages import read_file
from studies.schema import StudyHead
from studies.suite.driven import DrivenPlanner

FILE = Path(__file__).with_suffix(".toml")
SCORE = info_of("score")
PARTS = ("success_rate", "at_fault_rate", "score")
"""The metrics of the page."""


class SuiteSpec(StudyHead):
    """The TOML file of the study.

    Attributes:
        earlier: The mean success in % on the earlier suite, by planner.
        planners: The planners.
    """

    earlier: dict[str, float] = Field(description="a table [earlier] of numbers")
    planners: list[DrivenPlanner] = Field(min_length=2, description="tables [[planners]]")


@dataclass(frozen=True)
class Standing:
    """The figures of a planner in a track of sensing.

    Attributes:
        scores: The score in each ranked scenario, and in each other scenario of the suite.
        mean: The mean score over the ranked scenarios.
        success: Share of successes in the ranked scenarios.
        at_fault: Share of their episodes that end in a collision at fault.
    """

    scores: Mapping[str, Estimate]
    mean: Estimate
    success: float
    at_fault: float


@help_from_docstring
def suite(
    planner: Annotated[list[str] | None, typer.Argument(show_default="all of the file")] = None,
    cases: Annotated[str | None, typer.Option(show_default="as in the file")] = None,
    out: Path = Path("runs/study-suite"),
    workers: WorkersOption = None,
    engine: EngineOption = None,
    threads: ThreadsOption = None,
    format: Format = Format.MARKDOWN,
) -> None:
    """Print the order of planners on the suite in both tracks of sensing, beside that on the earlier suite.

    Args:
        planner: Planners of the file.
        cases: The cases of each scenario: val:100, val:20.
        out: Folder for the runs.
    """
    use_threads(threads)
    spec, scenarios = read_file(FILE, SuiteSpec), read_suite()
    chosen = [each for each in spec.planners if not planner or each.planner in planner]
    if cases:
        chosen = [each.model_copy(update={"cases": Cases.parse(cases)}) for each in chosen]
    names = [*scenarios.ranked, *scenarios.stress, *scenarios.held_out]
    runs = {
        (each.planner, track): [each.load(name, {"sensor.track": track}) for name in names]
        for each in chosen
        for track in SENSING_TRACKS
    }
    make_runs([run for each in runs.values() for run in each], out, Sharing(None, workers, engine, threads))
    standings = {place: read_standing(each, len(scenarios.ranked), out) for place, each in runs.items()}
    grids = [order_grid(chosen, spec.earlier, standings)]
    grids += [score_grid(track, chosen, names, standings) for track in SENSING_TRACKS]
    command = f"python studies/suite/run.py{f' --cases {cases}' if cases else ''}"
    parts = [f"{printed_by(command)} Do not edit this page: the command overwrites it.", spec.description]
    for grid in grids:
        parts += [f"## {grid.title}", markdown(grid.header, grid.rows)]
    print_study(grids, grids, "\n\n".join([*parts, *spec.sources]), format)


def read_standing(runs: list[Run], ranked: int, out: Path) -> Standing:
    """Read the figures of a planner in a track.

    Args:
        runs: Its runs in all scenarios of the suite, the ranked ones first.
        ranked: Number of ranked scenarios.
        out: Folder with the runs.
    """
    estimates = [read_episodes(run, out).summary(PARTS) for run in runs]
    scores = {run.scenario.name: each["score"] for run, each in zip(runs, estimates, strict=True)}
    means = [
        mean_over_scenarios(np.full(ranked, 1.0 / ranked), [each[part] for each in estimates[:ranked]])
        for part in PARTS
    ]
    success, at_fault, score = means
    return Standing(scores, score, success.mean, at_fault.mean)


def order_grid(
    planners: list[DrivenPlanner], earlier: Mapping[str, float], standings: Mapping[tuple[str, str], Standing]
) -> Grid:
    """Return the table of the order: places on the earlier suite and in both tracks."""
    columns = [{each.planner: earlier[each.planner] for each in planners}]
    columns += [
        {each.planner: standings[each.planner, track].mean.mean for each in planners} for track in SENSING_TRACKS
    ]
    places = [sorted(column, key=column.__getitem__, reverse=True) for column in columns]
    cases = {each.planner: str(each.cases) for each in planners}
    rows = []
    for name in places[1]:
        perfect, realistic = (standings[name, track] for track in SENSING_TRACKS)
        cells = [f"{earlier[name]:.1f}", SCORE.estimate(perfect.mean), SCORE.estimate(realistic.mean)]
        placed = [f"{1 + place.index(name)}: {cell}" for place, cell in zip(places, cells, strict=True)]
        loss = SCORE.number(perfect.mean.mean - realistic.mean.mean)
        fault = [f"{100 * each.success:.0f} ({100 * each.at_fault:.1f})" for each in (perfect, realistic)]
        rows.append([name, cases[name], *placed, loss, *fault])
    header = ["planner", "cases", "earlier: success, %", *(f"{track}: score" for track in SENSING_TRACKS), "loss"]
    header += [f"{track}: success (at fault), %" for track in SENSING_TRACKS]
    return Grid("Order", header, rows)


def score_grid(
    track: str, planners: list[DrivenPlanner], names: list[str], standings: Mapping[tuple[str, str], Standing]
) -> Grid:
    """Return the scores of planners in each scenario in a track, best planner first."""
    found = {each.planner: standings[each.planner, track] for each in planners}
    rows = []
    for name in sorted(found, key=lambda name: found[name].mean.mean, reverse=True):
        scores = [SCORE.number(found[name].scores[scenario].mean) for scenario in names]
        rows.append([name, SCORE.number(found[name].mean.mean), *scores])
    return Grid(f"Scores with {track} sensing", ["planner", "mean", *names], rows)


if __name__ == "__main__":
    main(suite)
