"""The command that measures predictors."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from crowdbench.cli.options import JsonOption, SetOption, print_table
from crowdbench.errors import InputError

if TYPE_CHECKING:
    from crowdbench.predict import Predictor
    from crowdbench.prediction_errors import Errors

DataOption = Annotated[
    Path | None, typer.Option(help="A folder of recorded tracks: *.txt with frame, pedestrian, x, y, as ETH/UCY has.")
]

ON_SCENARIO = "A pedestrian counts until it reaches its goal, and the vehicle is not there. Intervals are over cases."
ON_TRACKS = (
    "8 frames are seen and 8 predicted, in all windows with 2 pedestrians or more. Intervals are over pedestrians."
)


def evaluate_predictor(
    predictor: Annotated[str, typer.Argument(help="A name, ./mine.py or ./mine.py:function.")],
    scenario: Annotated[str | None, typer.Option(help="A name or ./mine.toml; circle_crossing_5 if not given.")] = None,
    cases: Annotated[str | None, typer.Option(help="Of the scenario, such as val:100; val:200 if not given.")] = None,
    overrides: SetOption = None,
    data: DataOption = None,
    as_json: JsonOption = False,
) -> None:
    """Measure a predictor's errors, on the crowds of a scenario or on recorded tracks."""
    from crowdbench import catalog
    from crowdbench.console import announce_compilation
    from crowdbench.tables import prediction_table

    announce_compilation()
    name, made = catalog.load_predictor(predictor)
    if data is None:
        about, places = _on_scenario(name, made, scenario or "circle_crossing_5", cases or "val:200", overrides or [])
    else:
        for flag, given in (("--scenario", scenario), ("--cases", cases), ("--set", overrides)):
            if given is not None:
                raise InputError(f"{flag} does not go with --data: give a scenario or recorded tracks")
        about, places = _on_tracks(name, made, data)
    if as_json:
        errors = {place: dataclasses.asdict(found) for place, found in places.items()}
        print(json.dumps({"predictor": name, "privileged": made.privileged, **about, "errors": errors}, indent=2))
    else:
        changed = "".join(f", {key}={value}" for key, value in about.get("overrides", {}).items())
        place = about.get("data") or f"{about['scenario']}{changed}, cases {about['cases']}"
        print_table(prediction_table(f"{name} on {place}", about["dt"], places))
        print("\nADE is the mean error over the steps up to the one named, FDE the error at that step.")
        print(ON_SCENARIO if data is None else ON_TRACKS)


def _on_scenario(
    name: str, predictor: Predictor, scenario: str, cases: str, overrides: list[str]
) -> tuple[dict[str, Any], dict[str, Errors]]:
    from crowdbench import catalog, prediction_errors
    from crowdbench.cases import Cases
    from crowdbench.console import progress

    settings = catalog.assignments(overrides, "--set")
    place, wanted = catalog.load_scenario(scenario, settings), Cases.parse(cases)
    with progress(len(wanted), "cases") as tell:
        found = prediction_errors.on_scenario(name, predictor, place, wanted, tell)
    about = {"scenario": place.name, "overrides": settings, "digest": place.digest, "cases": str(wanted)}
    return about | {"dt": place.rules.dt}, {place.name: found}


def _on_tracks(name: str, predictor: Predictor, data: Path) -> tuple[dict[str, Any], dict[str, Errors]]:
    from crowdbench.predict import tracks
    from crowdbench.prediction_errors import on_tracks

    return {"data": str(data), "dt": tracks.DT}, on_tracks(name, predictor, tracks.read_folder(data))
