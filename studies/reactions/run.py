"""Rank planners among pedestrians of each type of reaction to the vehicle. Prints README.md beside this file."""

from __future__ import annotations

import dataclasses
import itertools
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

sys.path.append(str(Path(__file__).parents[2]))

from crowdbench import Cases
from crowdbench.cli import ThreadsOption, WorkersOption, help_from_docstring, main, use_threads
from crowdbench.metrics import info_of
from crowdbench.runs import Run, RunSpec
from crowdbench.utils import Format, Grid, Names, markdown, printed_by
from studies.command import EngineOption, ShardOption, Sharing, make_runs, print_study
from studies.folder import load_runs, read_episodes
from studies.orders import agreement, draw_pairs, read_cases, resample_means
from studies.pages import SCORE, read_file
from studies.reactions.tau import estimate_tau, kendall, say_tau
from studies.schema import CasesText, Planners, StudyHead

FILE = Path(__file__).with_name("study.toml")

TYPES = {"avoid": "", "ignore": "ignores", "yield late": "yields_late", "are attracted": "attracted"}
"""The types of reaction, with the share of `[pedestrians.attention]` that is 1; pedestrians in no share avoid it."""

AT_FAULT = "at_fault_rate"
FAULT = info_of(AT_FAULT)

NOTES = " ".join(Path(__file__).with_name("notes.txt").read_text("utf-8").split())
"""The notes below the tables."""


class ReactionsSpec(StudyHead):
    """The TOML file of the study.

    Attributes:
        cases: The cases of each scenario.
        scenarios: The scenarios, in which pedestrians notice the vehicle.
        planners: The planners, all different.
    """

    cases: CasesText
    scenarios: Names
    planners: Planners


@help_from_docstring
def reactions(
    file: Path = FILE,
    cases: Annotated[str | None, typer.Option(show_default="as in the file")] = None,
    out: Path = Path("runs/study-reactions"),
    shard: ShardOption = None,
    workers: WorkersOption = None,
    engine: EngineOption = None,
    threads: ThreadsOption = None,
    format: Format = Format.MARKDOWN,
) -> None:
    """Rank planners among pedestrians that avoid the vehicle, ignore it, yield late, or are attracted by it.

    Args:
        file: The scenarios and planners.
        cases: The cases of each scenario: test:200 (the first 200 test cases), val:20.
        out: Folder for the runs.
    """
    use_threads(threads)
    spec = read_file(file, ReactionsSpec)
    driven = Cases.parse(cases) if cases else spec.cases
    changes = {
        name: {f"pedestrians.attention.{each}": float(each == share) for each in TYPES.values() if each}
        for name, share in TYPES.items()
    }
    specs = {name: RunSpec("", "", driven, overrides=change, record="none") for name, change in changes.items()}
    runs = {
        name: [load_runs(spec.planners, dataclasses.replace(base, scenario=scenario)) for scenario in spec.scenarios]
        for name, base in specs.items()
    }
    make_runs(
        [run for scenarios in runs.values() for each in scenarios for run in each],
        out,
        Sharing(shard, workers, engine, threads),
    )
    scores = {name: resample_means([read_cases(each, out) for each in scenarios]) for name, scenarios in runs.items()}
    fault = {name: np.mean([_at_fault(each, out) for each in scenarios], axis=0) for name, scenarios in runs.items()}
    labels = [run.label for run in runs["avoid"][0]]
    rows = [
        [labels[k], *(f"{SCORE.number(scores[name][0, k])} ({FAULT.amount(fault[name][k])})" for name in TYPES)]
        for k in np.argsort(-scores["avoid"][0], kind="stable").tolist()
    ]
    times, pairs = draw_pairs(len(labels)), []
    for one, other in itertools.combinations(TYPES, 2):
        tau, (same, decided) = kendall(scores[one], scores[other], times), agreement(scores[one], scores[other])
        pairs.append([one, other, say_tau(estimate_tau(tau)), f"{same} of {decided}"])
    grids = [
        Grid("Scores", ["planner", *TYPES], rows),
        Grid("Agreement", ["people", "other people", "tau", "decided pairs that agree"], pairs),
    ]
    command = f"python studies/reactions/run.py{f' --cases {cases}' if cases else ''}"
    tables = [markdown(grid.header, grid.rows) for grid in grids]
    notes = f"Cases {driven} of {', '.join(f'`{name}`' for name in spec.scenarios)}. {NOTES}"
    print_study(grids, grids, "\n\n".join([printed_by(command), spec.description, *tables, notes]), format)


def _at_fault(runs: Sequence[Run], out: Path) -> list[float]:
    """Return the share of the cases in which each of several planners is at fault."""
    return [float(np.mean(read_episodes(run, out).columns[AT_FAULT])) for run in runs]


if __name__ == "__main__":
    main(reactions)
