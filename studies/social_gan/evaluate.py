"""Measure the errors of predictors, as in README.md beside this file."""

from __future__ import annotations

import dataclasses
import json
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

sys.path.append(str(Path(__file__).parents[2]))

from crowdbench import InputError
from crowdbench.cli import announce_compilation, assignments, help_from_docstring, main, print_table, progress
from crowdbench.utils import Grid
from studies.social_gan.horizons import HORIZON, MOST_AHEAD

if TYPE_CHECKING:
    from crowdbench import Predictor
    from studies.social_gan.prediction_errors import Errors

    Measure = Callable[[str, Predictor], dict[str, Errors]]

MEASURES = "ADE is the mean error over the steps up to the horizon, FDE the error at the horizon."
MODES = (
    "best of 1: the first mode. best of n together: the mode that is best for the whole crowd or window.\n"
    "best of n each: the best mode of each pedestrian. Compare best-of-20 only with best-of-20."
)
ON_SCENARIO = "Errors are measured without a vehicle, until each pedestrian reaches its goal or is gone."
ON_TRACKS = "8 frames are observed, in all windows with 2 pedestrians or more."


@help_from_docstring
def evaluate_predictor(
    predictors: list[str],
    option: list[str] | None = None,
    scenario: str | None = None,
    cases: str | None = None,
    overrides: list[str] | None = None,
    data: Path | None = None,
    ahead: Annotated[int, typer.Option(min=1, max=MOST_AHEAD)] = HORIZON,
    as_json: bool = False,
) -> None:
    """Measure the errors of predictors on the crowds of a scenario or on recorded tracks.

    Args:
        predictors: Names, ./mine.py or ./mine.py:function.
        scenario: A name or ./mine.toml; circle_crossing_5 if not given.
        cases: Cases of the scenario, such as val:100; val:200 if not given.
        data: A folder of recorded tracks to measure on: *.txt with frame, pedestrian, x, y, as in ETH/UCY. With
            --scenario, the folder that its table [tracks] needs.
        ahead: Number of predicted steps.
    """
    announce_compilation()
    options = assignments(option or [], "--option")
    loaded = _load_predictors(predictors, options)
    if data is None or scenario is not None:
        about, measure = _on_scenario(scenario or "circle_crossing_5", cases or "val:200", overrides or [], data, ahead)
    else:
        for flag, value in (("--cases", cases), ("--set", overrides)):
            if value is not None:
                raise InputError(f"{flag} goes with --scenario only: without it, the tracks in {data} are measured on")
        about, measure = _on_tracks(data, ahead)
    errors = {name: measure(name, predictor) for name, predictor in loaded.items()}
    if not as_json:
        _print_errors(about, options, errors)
        return
    results = {}
    for name, predictor in loaded.items():
        by_dataset = {dataset: dataclasses.asdict(each) for dataset, each in errors[name].items()}
        results[name] = {"options": options, "privileged": predictor.privileged, "errors": by_dataset}
    print(json.dumps(about | {"predictors": results}, indent=2))


def _load_predictors(specs: list[str], options: Mapping[str, Any]) -> dict[str, Predictor]:
    from crowdbench import load_predictor
    from crowdbench.plugins import plugin_name

    if options and len(specs) > 1:
        raise InputError(f"--option does not go with {len(specs)} predictors: give one, or a file that sets its own")
    predictors: dict[str, Predictor] = {}
    for spec in specs:
        name, predictor = plugin_name(spec), load_predictor(spec, options)
        if name in predictors:
            raise InputError(f"two predictors are called {name}: rename one, or name another function")
        predictors[name] = predictor
    return predictors


def _on_scenario(
    scenario: str, cases: str, overrides: list[str], data: Path | None, ahead: int
) -> tuple[dict[str, Any], Measure]:
    from crowdbench import Cases, load_scenario
    from studies.social_gan import prediction_errors

    settings = assignments(overrides, "--set")
    loaded, driven = load_scenario(scenario, settings, data=data), Cases.parse(cases)
    loaded.check_data(data)

    def measure(name: str, predictor: Predictor) -> dict[str, Errors]:
        with progress(len(driven)) as tell:
            return {loaded.name: prediction_errors.on_scenario(name, predictor, loaded, driven, ahead, tell)}

    about = {"scenario": loaded.name, "overrides": settings, "digest": loaded.digest, "cases": str(driven)}
    about["clusters"] = "blocks of recorded time" if loaded.tracks else "cases"
    return about | {"dt": loaded.rules.dt, "ahead": ahead}, measure


def _on_tracks(data: Path, ahead: int) -> tuple[dict[str, Any], Measure]:
    from crowdbench.scenario import ETH_UCY_DT
    from studies.social_gan.prediction_errors import on_tracks
    from studies.social_gan.recordings import read_folder
    from studies.social_gan.recordings import scenes as scenes_of

    recordings = read_folder(data)

    def measure(name: str, predictor: Predictor) -> dict[str, Errors]:
        scenes = len(scenes_of(recordings))
        with progress(scenes, f"of {scenes} scenes") as tell:
            return on_tracks(name, predictor, recordings, ahead, tell)

    return {"data": str(data), "dt": ETH_UCY_DT, "ahead": ahead}, measure


def _print_errors(
    about: Mapping[str, Any], options: Mapping[str, Any], found: Mapping[str, Mapping[str, Errors]]
) -> None:
    """Print ADE / FDE in metres of each predictor in each scene or at several horizons, with explanations."""
    from crowdbench.results import planner_label

    recorded, ahead = "data" in about, about["ahead"]
    changed = "".join(f", {key}={value}" for key, value in about.get("overrides", {}).items())
    where = about["data"] if recorded else f"{about['scenario']}{changed}, cases {about['cases']}"
    steps = sorted({1, (ahead + 1) // 2, ahead})
    horizons = {f"{n} {'step' if n == 1 else 'steps'}": (about.get("scenario", ""), n) for n in steps}
    columns = {scene: (scene, ahead) for scene in next(iter(found.values()))} if recorded else horizons
    rows, notes = [], [MEASURES, ON_TRACKS if recorded else ON_SCENARIO]
    for name, measured in found.items():
        curves = {dataset: errors.choices() for dataset, errors in measured.items()}
        for row, choice in enumerate(curves[next(iter(curves))]):
            chosen = [(curves[dataset][choice], n - 1) for dataset, n in columns.values()]
            cells = (f"{one.ade[at].mean:.3f} / {one.fde[at].mean:.3f}" for one, at in chosen)
            rows.append((planner_label(name, options) if row == 0 else "", choice, *cells))
    if any(errors.modes > 1 for measured in found.values() for errors in measured.values()):
        notes.insert(1, MODES)
    title = f"ADE / FDE in metres, {ahead} steps of {about['dt']} s ahead, on {where}"
    header = ("predictor", "", *columns)
    print_table(Grid(title, header, rows, align="ll".ljust(len(header), "r")))
    print("", *notes, sep="\n")


if __name__ == "__main__":
    main(evaluate_predictor)
