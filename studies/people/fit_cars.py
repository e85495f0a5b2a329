"""Choose the clearance to cars of a pedestrian policy on DUT, and score the choice on held-out clips."""

from __future__ import annotations

import dataclasses
import math
import shlex
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer
from jaxtyping import Bool

sys.path.append(str(Path(__file__).parents[2]))

from crowdbench.cli import ThreadsOption, announce_compilation, help_from_docstring, main, progress, use_threads
from crowdbench.plugins import plugin_name
from crowdbench.utils import Format, Grid, markdown, printed_by
from studies.command import print_study
from studies.people.fitted import BASELINE
from studies.people.summary import compare, figures

if TYPE_CHECKING:
    from studies.people.cars import CarWindow
    from studies.people.likelihood import WindowScore

CLEARANCE = "pedestrians.attention.clearance"
CLEARANCES = (0.2, 0.5, 0.7, 0.9, 1.1, 1.3, 1.5)
"""The chosen option, and its tried values in metres."""

Scores = Mapping[float, Sequence["WindowScore"]]
"""By clearance, the score in each window."""

OTHERS: Sequence[tuple[str, float]] = (
    ("pedestrians.attention.ignores", 0.1),
    ("pedestrians.attention.ignores", 0.3),
    ("pedestrians.attention.delay", 0.0),
    ("pedestrians.attention.delay", 0.8),
    ("pedestrians.{policy}.population.inertia", 0.5),
    ("pedestrians.{policy}.neighbor_distance", 3.5),
    ("pedestrians.{policy}.neighbor_distance", 6.0),
)
"""Values of options that are not chosen, whose effects are printed."""

FOLDS = 5
"""Number of parts of the clips. Each part is scored with the choice on the others."""

MOST_STRUCK = 0.02
"""A clearance loses if a larger share of persons is struck."""

NEAREST = 0.1
"""A clearance loses if the mean closest approach is more than this below the recorded one, in metres."""

LOSS = 0.1
"""Loss of the score for each factor of 2 by which too many persons are struck, and for each `NEAREST` too near."""


@help_from_docstring
def fit_cars(
    policy: str, data: Annotated[Path, typer.Option()], threads: ThreadsOption = None, format: Format = Format.MARKDOWN
) -> None:
    """Choose the clearance to cars of a pedestrian policy by folds of the clips of DUT.

    Args:
        policy: A name, ./mine.py or ./mine.py:function.
        data: The folder with the tracks of DUT.
    """
    use_threads(threads)
    announce_compilation()
    from studies.people.cars import read_car_windows
    from studies.people.table import describe

    windows = read_car_windows(data)
    with progress(len(CLEARANCES), "clearances") as report:
        scores = {}
        for clearance in CLEARANCES:
            scores[clearance] = score_with(policy, windows, {CLEARANCE: clearance})
            report(1)
    grids = [_held_out(policy, windows, scores), _all_clips(windows, scores), _effects(policy, windows, scores)]
    tables = [f"## {grid.title}\n\n{markdown(grid.header, grid.rows)}" for grid in grids]
    command = shlex.join(["python", "studies/people/fit_cars.py", policy, "--data", "DIR"])
    page = [printed_by(command), *tables, describe(scores[CLEARANCES[0]])]
    print_study([record for grid in grids for record in grid.records], grids, "\n\n".join(page), format)


def score_with(
    policy: str, windows: Sequence[CarWindow], options: Mapping[str, Any], goal: str = "shown"
) -> list[WindowScore]:
    """Return the score of a policy with options in each window."""
    from studies.people.traffic import score_traffic, simulate_traffic

    return score_traffic(windows, simulate_traffic(policy, windows, options, hidden=goal == "hidden"))


def judge(scores: Sequence[WindowScore]) -> float:
    """Return the score in windows, less the losses for struck persons and for near approaches."""
    found, recorded = figures(scores), sum(each.recorded_closest for each in scores)
    struck = math.log2(max(found["contacts"] / MOST_STRUCK, 1.0))
    below = recorded / sum(each.conflicts for each in scores) - found["closest"]
    return found["v3"] - LOSS * (struck + max(below / NEAREST - 1.0, 0.0))


def choose(scores: Scores, used: Bool[np.ndarray, "window"] | None = None) -> float:
    """Return the clearance that is best in the windows that are used; all are if None."""
    rows = range(len(scores[CLEARANCES[0]])) if used is None else np.flatnonzero(used).tolist()
    return max(scores, key=lambda clearance: judge([scores[clearance][row] for row in rows]))


def choose_by_folds(scores: Scores, windows: Sequence[CarWindow]) -> list[float]:
    """Return the clearance for each window that is best in the clips of other folds."""
    fold = np.unique([each.window.name for each in windows], return_inverse=True)[1] % FOLDS
    chosen = [choose(scores, fold != number) for number in range(FOLDS)]
    return [chosen[number] for number in fold]


def _held_out(policy: str, windows: Sequence[CarWindow], scores: Scores) -> Grid:
    """Return the table of the policy with the clearances of other clips, beside shipped ORCA."""
    from studies.people.table import grid_of, rows_beside, rows_of

    chosen = choose_by_folds(scores, windows)
    hidden = {clearance: score_with(policy, windows, {CLEARANCE: clearance}, "hidden") for clearance in set(chosen)}
    model = {
        goal: [each[clearance][row] for row, clearance in enumerate(chosen)]
        for goal, each in (("shown", scores), ("hidden", hidden))
    }
    baseline = {goal: score_with(BASELINE, windows, {}, goal) for goal in model}
    clips = [each.window.name for each in windows]
    rows = rows_of(policy, model, clips) + rows_beside(model, f"{BASELINE} as shipped", baseline, clips)
    return dataclasses.replace(grid_of(rows), title="Held-out clips")


def _all_clips(windows: Sequence[CarWindow], scores: Scores) -> Grid:
    """Return the table of the clearances on all clips, with the share of windows for which each one is chosen."""
    chosen, clips = choose_by_folds(scores, windows), [each.window.name for each in windows]
    rows = []
    from studies.people.table import grid_of, rows_of

    for clearance, each in scores.items():
        share = chosen.count(clearance) / len(chosen)
        best = ", on all clips" * (clearance == choose(scores))
        rows += rows_of(f"clearance {clearance:g} m, chosen for {share:.0%}{best}", {"shown": each}, clips)
    return dataclasses.replace(grid_of(rows), title="All clips")


def _effects(policy: str, windows: Sequence[CarWindow], scores: Scores) -> Grid:
    """Return the table of the effects of options that are not chosen, on all clips."""
    from studies.people.table import Row, grid_of

    best, clips = choose(scores), [each.window.name for each in windows]
    rows = []
    for name, value in OTHERS:
        key = name.format(policy=plugin_name(policy))
        other = score_with(policy, windows, {CLEARANCE: best, key: value})
        rows.append(Row(f"{key} = {value:g}", "shown", compare(other, scores[best], clips), "+"))
    return dataclasses.replace(grid_of(rows), title="Effects of other options")


if __name__ == "__main__":
    main(fit_cars)
