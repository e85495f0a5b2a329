"""Print the ranks of planners on the suite in both tracks of sensing, beside their order on the earlier suite."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from pydantic import Field

sys.path.append(str(Path(__file__).parents[2]))

from crowdbench import Cases, InputError, read_suite
from crowdbench.cli import ThreadsOption, WorkersOption, help_from_docstring, main, use_threads
from crowdbench.core import SENSING_TRACKS
from crowdbench.metrics import info_of
from crowdbench.runs import Run
from crowdbench.utils import Format, Grid, Text, markdown, printed_by
from studies.command import EngineOption, Sharing, make_runs, print_study
from studies.pages import read_file
from studies.schema import CasesText, StudyHead
from studies.suite.driven import DrivenPlanner
from studies.suite.rank import order, order_texts, rank_grid
from studies.suite.standing import Standing

FILE = Path(__file__).with_suffix(".toml")
SCORE = info_of("score")

PERFECT, REALISTIC = SENSING_TRACKS


class SuiteSpec(StudyHead):
    """The TOML file of the study.

    Attributes:
        crowd: The other crowd: a pedestrian policy by scenario; `others` for all other scenarios.
        crowd_cases: The cases of each scenario in that crowd, with perfect sensing.
        earlier: The mean success in % on the earlier suite, by planner.
        reasons: Why planners have another place than there.
        planners: The planners.
    """

    crowd: dict[str, str] = Field(description="a table [crowd] of pedestrian policies")
    crowd_cases: CasesText
    earlier: dict[str, float] = Field(description="a table [earlier] of numbers")
    reasons: list[Text] = Field(description="a list of texts")
    planners: list[DrivenPlanner] = Field(min_length=2, description="tables [[planners]]")


Runs = list[list[Run]]
"""Runs by scenario and network."""


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
    """Print the ranks of planners on the suite in both tracks of sensing, and among other pedestrians.

    Args:
        planner: Planners of the file.
        cases: The cases of each scenario: val:100, val:20.
        out: Folder for the runs.
    """
    use_threads(threads)
    spec, scenarios = read_file(FILE, SuiteSpec), read_suite()
    known = {each.name: each for each in spec.planners}
    if unknown := set(planner or []) - known.keys():
        raise InputError(f"the study has no planner {min(unknown)}: it has {', '.join(known)}")
    chosen = {name: known[name] for name in planner or known}
    if cases:
        chosen = change_cases(chosen, Cases.parse(cases))
    names = [*scenarios.ranked, *scenarios.stress, *scenarios.held_out]
    tracks = {track: load_track(chosen, names, track) for track in SENSING_TRACKS}
    crowd_cases = Cases.parse(cases) if cases else spec.crowd_cases
    crowd = load_crowd(change_cases(chosen, crowd_cases), scenarios.ranked, spec.crowd)
    make_runs(flat([*tracks.values(), crowd]), out, Sharing(None, workers, engine, threads))
    standings = {track: read_standings(runs, out) for track, runs in tracks.items()}
    ranked = {track: read_standings(runs, out, len(scenarios.ranked)) for track, runs in tracks.items()}
    others = {PERFECT: read_standings(crowd, out), REALISTIC: {}}
    policy = spec.crowd["others"]
    grids, parts = (
        [],
        [printed_by(f"python studies/suite/run.py{f' --cases {cases}' if cases else ''}"), spec.description],
    )
    for track in SENSING_TRACKS:
        grids.append(rank_grid(f"Ranks with {track} sensing", ranked[track], others[track], policy))
        parts += [f"## {grids[-1].title}", markdown(grids[-1].header, grids[-1].rows), *order_texts(ranked[track])]
    grids.append(order_grid(ranked, spec.earlier))
    parts += [f"## {grids[-1].title}", markdown(grids[-1].header, grids[-1].rows), *spec.reasons]
    for track in SENSING_TRACKS:
        added = [parts_grid(track, ranked[track]), score_grid(track, standings[track], ranked[track], names)]
        parts += [text for grid in added for text in (f"## {grid.title}", markdown(grid.header, grid.rows))]
        grids += added
    print_study(grids, grids, "\n\n".join([*parts, *spec.sources]), format)


def change_cases(planners: Mapping[str, DrivenPlanner], cases: Cases) -> dict[str, DrivenPlanner]:
    """Return the planners with other cases."""
    return {name: each.model_copy(update={"cases": cases}) for name, each in planners.items()}


def load_track(planners: Mapping[str, DrivenPlanner], scenarios: Sequence[str], track: str) -> dict[str, Runs]:
    """Load the runs of planners in scenarios with a track of sensing."""
    return {
        name: [each.load(scenario, {"sensor.track": track}) for scenario in scenarios]
        for name, each in planners.items()
    }


def load_crowd(
    planners: Mapping[str, DrivenPlanner], scenarios: Sequence[str], crowd: Mapping[str, str]
) -> dict[str, Runs]:
    """Load the runs of planners with perfect sensing among other pedestrians, see `SuiteSpec`."""
    return {
        name: [
            each.load(scenario, {"sensor.track": PERFECT}, crowd.get(scenario, crowd["others"]))
            for scenario in scenarios
        ]
        for name, each in planners.items()
    }


def flat(runs: Sequence[Mapping[str, Runs]]) -> list[Run]:
    """Return all runs in one list."""
    return [run for group in runs for of_planner in group.values() for networks in of_planner for run in networks]


def read_standings(runs: Mapping[str, Runs], out: Path, scenarios: int | None = None) -> dict[str, Standing]:
    """Read the standings of planners, in the first scenarios or in all."""
    return {name: Standing.read(of_planner[:scenarios], out) for name, of_planner in runs.items()}


def order_grid(ranked: Mapping[str, Mapping[str, Standing]], earlier: Mapping[str, float]) -> Grid:
    """Return the table of the order: places on the earlier suite and in both tracks.

    Args:
        ranked: The standings in the ranked scenarios by track and planner.
        crowd_cases: The cases of each scenario in that crowd, with perfect sensing.
        earlier: The mean success in % on the earlier suite, by planner.
    """
    perfect, realistic = (ranked[track] for track in SENSING_TRACKS)
    named = [name for name in order(perfect) if name in earlier]
    places = [
        sorted(named, key=lambda name: -earlier[name]),
        *([name for name in order(track) if name in earlier] for track in (perfect, realistic)),
    ]
    rows = []
    for name in named:
        means = [track[name].score.mean() for track in (perfect, realistic)]
        cells = [f"{earlier[name]:.1f}", *map(SCORE.number, means)]
        placed = [f"{1 + place.index(name)}: {cell}" for place, cell in zip(places, cells, strict=True)]
        rows.append([name, *placed, SCORE.number(means[0] - means[1])])
    header = ["planner", "earlier: success, %", *(f"{track}: score" for track in SENSING_TRACKS), "loss"]
    return Grid("Order beside the earlier suite", header, rows)


def parts_grid(track: str, ranked: Mapping[str, Standing]) -> Grid:
    """Return the parts of the score of each planner in a track: means over the ranked scenarios."""
    rows = []
    for name in order(ranked):
        each = ranked[name]
        shares = [100.0 * part.mean() for part in (each.success, each.at_fault, each.timeout)]
        times = [np.nanmean(part / each.t_empty, axis=(0, 2)).mean() for part in (each.time, each.close)]
        rows.append([name, f"{shares[0]:.0f}", *(f"{share:.1f}" for share in shares[1:]), *(f"{t:.2f}" for t in times)])
    header = ["planner", "success, %", "at fault, %", "time-outs, %", "T / T_empty", "t_close / T_empty"]
    return Grid(f"Parts of the score with {track} sensing", header, rows)


def score_grid(
    track: str, standings: Mapping[str, Standing], ranked: Mapping[str, Standing], names: Sequence[str]
) -> Grid:
    """Return the scores of planners in each scenario in a track, best planner first.

    Args:
        track: The track of sensing.
        standings: The standings in all scenarios.
        ranked: The standings in the ranked scenarios.
        names: All scenarios.
    """
    rows = []
    for name in order(ranked):
        scores = standings[name].score.mean(axis=(0, 2))
        rows.append([name, SCORE.number(ranked[name].score.mean()), *map(SCORE.number, scores)])
    return Grid(f"Scores with {track} sensing", ["planner", "mean", *names], rows)


if __name__ == "__main__":
    main(suite)
