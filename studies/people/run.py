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
    from studies.people.fitted import Models
    from studies.people.likelihood import WindowScore
    from studies.people.table import Row, Scores


@dataclass(frozen=True)
class Recordings:
    """Recorded windows, and the functions that simulate and score them.

    Attributes:
        windows: The windows of each location.
        simulate: `simulate` or `simulate_traffic`.
        score: `score` or `score_traffic`.
        blocks: The block of each window; None if each window is a block.
    """

    windows: Mapping[str, Sequence[Any]]
    simulate: Callable[..., Any]
    score: Callable[..., Any]
    blocks: Sequence[str] | None

    def score_models(self, models: Models) -> Scores:
        """Return the scores of the model of each location, with the goal shown and with the goal hidden."""
        scores: dict[str, list[WindowScore]] = {"shown": [], "hidden": []}
        for name, windows in self.windows.items():
            for goal, found in scores.items():
                places = self.simulate(models[name].policy, windows, models[name].options, hidden=goal == "hidden")
                found += self.score(windows, places)
        return scores

    def score_policy(self, policy: str, options: Mapping[str, Any] | None = None) -> Scores:
        """Return the scores of the same policy everywhere, see `score_models`."""
        from studies.people.fitted import Model

        return self.score_models(dict.fromkeys(self.windows, Model(policy, options or {})))


@help_from_docstring
def people(
    policy: str,
    data: Annotated[Path, typer.Option()],
    option: list[str] | None = None,
    fits: Path | None = None,
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
        fits: A folder with files of fit.py: each location is scored with the policy and options that were fitted
            without it.
        location: hotel, zara, univ or confirmation; the first three if not given. Repeat it for several.
        cars: Score people near moving cars in the clips of DUT.
        references: Add rows of the recording with noise, resampled motion, blind and random walkers.
    """
    use_threads(threads)
    announce_compilation()
    from studies.people.fitted import BASELINE, BLIND, Model, fitted_models, with_populations
    from studies.people.table import describe, grid_of, rows_beside, rows_of

    options = assignments(option or [], "--option")
    if cars and (location or references or fits):
        raise InputError("--location, --references and --fits go with ETH/UCY: leave them out with --cars")
    if fits and options:
        raise InputError("--fits has its own options: leave --option out")
    recordings = _read_cars(data) if cars else read_people(data, location)
    models: Models = dict.fromkeys(recordings.windows, Model(policy, options))
    if fits:
        models = fitted_models(fits, recordings.windows)
    model = recordings.score_models(models)
    rows = rows_of(f"{policy}, fitted" if fits else policy, model, recordings.blocks)
    if policy != BASELINE or options or fits:
        baseline = recordings.score_policy(BASELINE)
        rows += rows_beside(model, f"{BASELINE} as shipped", baseline, recordings.blocks)
    if blind := with_populations(BLIND, models):
        rows += rows_beside(model, "blind, same population", recordings.score_models(blind), recordings.blocks)
        baseline = recordings.score_models(with_populations(BASELINE, models))
        rows += rows_of(f"{BASELINE}, same population", baseline, recordings.blocks)
    if references:
        rows += _reference_rows(recordings, data)
    grid = grid_of(rows)
    flags = [*_repeat("--option", option), *_repeat("--fits", [str(fits)] if fits else [])]
    flags += _repeat("--location", location)
    flags += [*["--cars"] * cars, *["--references"] * references]
    command = shlex.join(["python", "studies/people/run.py", policy, "--data", "DIR", *flags])
    page = [printed_by(command), markdown(grid.header, grid.rows), describe(model["shown"])]
    print_study(grid.records, [grid], "\n\n".join(page), format)


def _repeat(flag: str, values: Sequence[str] | None) -> list[str]:
    return [text for value in values or [] for text in (flag, value)]


def read_people(data: Path, location: Sequence[str] | None = None) -> Recordings:
    """Return the windows of ETH/UCY at some locations, by default the folds."""
    from studies.people.likelihood import score
    from studies.people.simulate import simulate
    from studies.people.windows import FOLDS, read_windows

    return Recordings(read_windows(data, location or FOLDS), simulate, score, None)


def _read_cars(data: Path) -> Recordings:
    from studies.people.cars import read_car_windows
    from studies.people.traffic import score_traffic, simulate_traffic

    windows = read_car_windows(data)
    blocks = [each.window.name for each in windows]
    return Recordings({"dut": windows}, simulate_traffic, score_traffic, blocks)


def _reference_rows(recordings: Recordings, data: Path) -> list[Row]:
    """Return the rows of references: without a policy they have no goal."""
    from studies.people.fitted import BLIND
    from studies.people.references import random_walkers, recording_with_noise, resampled_motion
    from studies.people.table import rows_of
    from studies.people.windows import FOLDS, PLACE, read_windows

    donors = read_windows(data, FOLDS)
    resampled = []
    for name, windows in recordings.windows.items():
        others = [window for other in FOLDS if other != PLACE.get(name, name) for window in donors[other]]
        resampled += [resampled_motion(window, others) for window in windows]
    everything = [window for windows in recordings.windows.values() for window in windows]
    rollouts = {
        "recording with 5 cm of noise": [recording_with_noise(window) for window in everything],
        "resampled motion": resampled,
        "random": [random_walkers(window) for window in everything],
    }
    scores = {name: recordings.score(everything, places) for name, places in rollouts.items()}
    rows = [row for name, each in scores.items() for row in rows_of(name, {"-": each})]
    return rows + rows_of("blind", recordings.score_policy(BLIND))


if __name__ == "__main__":
    main(people)
