"""The scenarios that a network is trained and validated in."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from crowdbench.catalog import load_scenario
from crowdbench.errors import InputError
from crowdbench.scenario.scenario import Scenario
from crowdbench.train.method import Request


def places(request: Request, validation: Sequence[str]) -> tuple[Scenario, list[Scenario]]:
    """Load the scenarios of a training.

    Args:
        request: What is asked for.
        validation: The scenarios that choose the checkpoint, by name or path; none for the one to train in.

    Returns:
        The scenario to train in, and those to validate in.

    Raises:
        InputError: There is no such scenario, the folder of recorded tracks does not go with them, or one of them has
            too few cases.
    """
    data = None if request.data is None else Path(request.data)
    scenario = load_scenario(request.scenario, request.overrides, data=data)
    validated = [load_scenario(name, data=data) for name in validation] or [scenario]
    tracked = [(place, place.tracks) for place in (scenario, *validated) if place.tracks]
    if not tracked:
        scenario.check_data(data)
    for place, tracks in tracked:
        if tracks.has_cars:
            raise InputError(
                f"{place.name} has a case for each window of time with a car in the scene {tracks.scene}, too few to "
                "train, validate and measure a network in: use another scenario, such as eth_reactive"
            )
    return scenario, validated
