"""Score a pedestrian policy by its likeness to recorded people, as definition.md says."""

from __future__ import annotations

import math
import shlex
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

sys.path.append(str(Path(__file__).parents[2]))

from crowdbench.cli import ThreadsOption, announce_compilation, assignments, help_from_docstring, main, use_threads
from crowdbench.utils import Format, Grid, markdown, printed_by
from studies.command import print_study

if TYPE_CHECKING:
    from studies.people.likelihood import WindowScore
    from studies.people.summary import Figure
    from studies.people.windows import Window

BASELINE = "orca"
"""The shipped policy with which others are compared."""

BLIND = "straight"
"""The policy of people who see nobody."""

HEADER = ("model", "goal", "v3", "motion", "path", "encounter", "new contacts", "ratio to recorded", "closest [m]")

Scores = dict[str, list["WindowScore"]]
"""By goal, `shown` or `hidden`, the score in each window."""


@help_from_docstring
def people(
    policy: str,
    data: Annotated[Path, typer.Option()],
    option: list[str] | None = None,
    location: list[str] | None = None,
    references: bool = False,
    threads: ThreadsOption = None,
    format: Format = Format.MARKDOWN,
) -> None:
    """Score a pedestrian policy by the likelihood of recorded people among its rollouts.

    Args:
        policy: A name, ./mine.py or ./mine.py:function.
        data: The folder with the tracks of ETH/UCY.
        option: A parameter of the policy, time_horizon=2, or a key of the scenario, pedestrians.radius=0.18. Repeat it
            for several.
        location: hotel, zara, univ or confirmation; the first three if not given. Repeat it for several.
        references: Add rows of the recording with noise, resampled motion, blind and random walkers.
    """
    use_threads(threads)
    announce_compilation()
    from studies.people.simulate import population_options
    from studies.people.windows import FOLDS, read_windows

    options = assignments(option or [], "--option")
    by_location = read_windows(data, location or FOLDS)
    windows = [window for each in by_location.values() for window in each]
    model = _score_policy(policy, windows, options)
    rows = _rows(policy, model)
    if policy != BASELINE or options:
        rows += _beside(model, f"{BASELINE} as shipped", _score_policy(BASELINE, windows, {}))
    if population := population_options(policy, options):
        rows += _beside(model, "blind, same population", _score_policy(BLIND, windows, population))
    if references:
        rows += _reference_rows(by_location, data)
    grid = Grid("People", list(HEADER), rows)
    changed = [*_repeat("--option", option), *_repeat("--location", location), *["--references"] * references]
    command = shlex.join(["python", "studies/people/run.py", policy, "--data", "DIR", *changed])
    page = [printed_by(command), markdown(grid.header, grid.rows), _describe(windows)]
    print_study([grid], [grid], "\n\n".join(page), format)


def _repeat(flag: str, values: Sequence[str] | None) -> list[str]:
    return [text for value in values or [] for text in (flag, value)]


def _describe(windows: Sequence[Window]) -> str:
    """Return the numbers of windows and persons in a sentence."""
    persons, conflict = (sum(int(getattr(each, name).sum()) for each in windows) for name in ("scored", "conflict"))
    return f"{len(windows)} windows, {persons} persons, {conflict} of them in conflict. 95 % intervals over windows."


def _score_policy(policy: str, windows: Sequence[Window], options: Mapping[str, Any]) -> Scores:
    """Return the scores of a policy with the goal shown and with the goal hidden."""
    from studies.people.likelihood import score
    from studies.people.simulate import simulate

    goals = {"shown": False, "hidden": True}
    return {goal: score(windows, simulate(policy, windows, options, hidden=hidden)) for goal, hidden in goals.items()}


def _reference_rows(by_location: Mapping[str, Sequence[Window]], data: Path) -> list[list[str]]:
    """Return the rows of references: those without a policy have no goal."""
    from studies.people.likelihood import score
    from studies.people.references import random_walkers, recording_with_noise, resampled_motion
    from studies.people.windows import FOLDS, PLACE, read_windows

    windows = [window for each in by_location.values() for window in each]
    donors = read_windows(data, FOLDS)
    resampled = []
    for location, each in by_location.items():
        others = [window for other in FOLDS if other != PLACE.get(location, location) for window in donors[other]]
        resampled += [resampled_motion(window, others) for window in each]
    rollouts = {
        "recording with 5 cm of noise": map(recording_with_noise, windows),
        "resampled motion": resampled,
        "random": map(random_walkers, windows),
    }
    rows = [row for name, places in rollouts.items() for row in _rows(name, {"-": score(windows, list(places))})]
    return rows + _rows("blind", _score_policy(BLIND, windows, {}))


def _rows(name: str, model: Scores) -> list[list[str]]:
    """Return the rows of a model, one for each goal."""
    from studies.people.summary import summarize

    return [_row(name, goal, summarize(scores)) for goal, scores in model.items()]


def _beside(model: Scores, name: str, other: Scores) -> list[list[str]]:
    """Return the rows of another model, and of the difference of a model to it."""
    from studies.people.summary import compare

    differences = [_row(f"difference to {name}", goal, compare(model[goal], other[goal]), "+") for goal in model]
    return _rows(name, other) + differences


def _row(model: str, goal: str, figures: Mapping[str, Figure], sign: str = "-") -> list[str]:
    """Return the row of a model.

    Args:
        model: Its name.
        goal: `shown`, `hidden` or none.
        figures: Its figures, or differences.
        sign: `+` to show the sign of positive numbers.
    """
    cells = []
    for name, figure in figures.items():
        if math.isnan(figure.value):
            cells.append("-")
            continue
        factor, digits = (100.0, f"{sign}.1f") if name == "contacts" else (1.0, f"{sign}.3f")
        value, low, high = (format(factor * number, digits) for number in figure)
        cells.append(f"{value} ({low} to {high}){' %' * (name == 'contacts')}")
    return [model, goal, *cells]


if __name__ == "__main__":
    main(people)
