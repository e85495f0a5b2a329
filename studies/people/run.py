"""Score a pedestrian policy by its likeness to recorded people, as definition.md says."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

sys.path.append(str(Path(__file__).parents[2]))

from crowdbench import InputError
from crowdbench.cli import ThreadsOption, announce_compilation, assignments, help_from_docstring, main, use_threads
from crowdbench.utils import Format, markdown, printed_by
from studies.command import print_study

if TYPE_CHECKING:
    from studies.people.table import Row, Scores

BASELINE = "orca"
"""The shipped policy with which others are compared."""

BLIND = "straight"
"""The policy of people who see nobody."""


@dataclass(frozen=True)
class Recordings:
    """Recorded windows, and the functions that simulate and score them.

    Attributes:
        windows: The windows.
        simulate: `simulate` or `simulate_traffic`.
        score: `score` or `score_traffic`.
        blocks: The block of each window; None if each window is a block.
    """

    windows: Sequence[Any]
    simulate: Callable[..., Any]
    score: Callable[..., Any]
    blocks: Sequence[str] | None

    def score_policy(self, policy: str, options: Mapping[str, Any]) -> Scores:
        """Return the scores of a policy with the goal shown and with the goal hidden."""
        rollouts = {
            goal: self.simulate(policy, self.windows, options, hidden=goal == "hidden") for goal in ("shown", "hidden")
        }
        return {goal: self.score(self.windows, places) for goal, places in rollouts.items()}


@help_from_docstring
def people(
    policy: str,
    data: Annotated[Path, typer.Option()],
    option: list[str] | None = None,
    location: list[str] | None = None,
    cars: bool = False,
    references: bool = False,
    threads: ThreadsOption = None,
    format: Format = Format.MARKDOWN,
) -> None:
    """Score a pedestrian policy by the likelihood of recorded people among its rollouts.

    Args:
        policy: A name, ./mine.py or ./mine.py:function.
        data: The folder with the tracks of ETH/UCY, or of DUT with --cars.
        option: A parameter of the policy, time_horizon=2, or a key of the scenario, pedestrians.radius=0.18. Repeat it
            for several.
        location: hotel, zara, univ or confirmation; the first three if not given. Repeat it for several.
        cars: Score people near moving cars in the clips of DUT.
        references: Add rows of the recording with noise, resampled motion, blind and random walkers.
    """
    use_threads(threads)
    announce_compilation()
    from studies.people.simulate import population_options
    from studies.people.table import describe, grid_of, rows_beside, rows_of

    options = assignments(option or [], "--option")
    if cars and (location or references):
        raise InputError("--location and --references go with the tracks of ETH/UCY: leave them out with --cars")
    recordings = _read_cars(data) if cars else read_people(data, location)
    model = recordings.score_policy(policy, options)
    rows = rows_of(policy, model, recordings.blocks)
    if policy != BASELINE or options:
        baseline = recordings.score_policy(BASELINE, {})
        rows += rows_beside(model, f"{BASELINE} as shipped", baseline, recordings.blocks)
    if population := population_options(policy, options):
        blind = recordings.score_policy(BLIND, population)
        rows += rows_beside(model, "blind, same population", blind, recordings.blocks)
        baseline = recordings.score_policy(BASELINE, population)
        rows += rows_of(f"{BASELINE}, same population", baseline, recordings.blocks)
    if references:
        rows += _reference_rows(recordings, data, location)
    grid = grid_of(rows)
    flags = [*_repeat("--option", option), *_repeat("--location", location)]
    flags += [*["--cars"] * cars, *["--references"] * references]
    command = shlex.join(["python", "studies/people/run.py", policy, "--data", "DIR", *flags])
    page = [printed_by(command), markdown(grid.header, grid.rows), describe(model["shown"])]
    print_study(grid.records, [grid], "\n\n".join(page), format)


def _repeat(flag: str, values: Sequence[str] | None) -> list[str]:
    return [text for value in values or [] for text in (flag, value)]


def read_people(data: Path, location: Sequence[str] | None = None) -> Recordings:
    """Return the windows of ETH/UCY at some locations, by default those of the folds."""
    from studies.people.likelihood import score
    from studies.people.simulate import simulate
    from studies.people.windows import FOLDS, read_windows

    windows = [window for each in read_windows(data, location or FOLDS).values() for window in each]
    return Recordings(windows, simulate, score, None)


def _read_cars(data: Path) -> Recordings:
    from studies.people.cars import read_car_windows
    from studies.people.traffic import score_traffic, simulate_traffic

    windows = read_car_windows(data)
    return Recordings(windows, simulate_traffic, score_traffic, [each.window.name for each in windows])


def _reference_rows(recordings: Recordings, data: Path, location: Sequence[str] | None) -> list[Row]:
    """Return the rows of references: without a policy they have no goal."""
    from studies.people.references import random_walkers, recording_with_noise, resampled_motion
    from studies.people.table import rows_of
    from studies.people.windows import FOLDS, PLACE, read_windows

    donors = read_windows(data, FOLDS)
    resampled = []
    for name, windows in read_windows(data, location or FOLDS).items():
        others = [window for other in FOLDS if other != PLACE.get(name, name) for window in donors[other]]
        resampled += [resampled_motion(window, others) for window in windows]
    rollouts = {
        "recording with 5 cm of noise": [recording_with_noise(window) for window in recordings.windows],
        "resampled motion": resampled,
        "random": [random_walkers(window) for window in recordings.windows],
    }
    scores = {name: recordings.score(recordings.windows, places) for name, places in rollouts.items()}
    rows = [row for name, each in scores.items() for row in rows_of(name, {"-": each})]
    return rows + rows_of("blind", recordings.score_policy(BLIND, {}))


if __name__ == "__main__":
    main(people)
