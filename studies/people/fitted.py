"""Models of pedestrians: a policy with its options, the same one everywhere, or one for each location."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from crowdbench import InputError
from studies.people.simulate import population_options
from studies.people.windows import PLACE

BASELINE = "orca"
"""The shipped policy with which others are compared."""

BLIND = "straight"
"""The policy of people who see nobody."""


class Model(NamedTuple):
    """A pedestrian policy with options, see `simulate`."""

    policy: str
    options: Mapping[str, Any] = {}


Models = Mapping[str, Model]
"""The model of each location."""


def fitted_models(fits: Path, locations: Iterable[str]) -> dict[str, Model]:
    """Return the model of each location that was fitted without it, and without others at the same place.

    Raises InputError if a file is missing, or if it is not one of `fit.py`.
    """
    return {location: _fitted_without(fits, PLACE.get(location, location)) for location in locations}


def _fitted_without(fits: Path, held_out: str) -> Model:
    file = fits / f"{held_out}.json"
    if not file.is_file():
        raise InputError(f"there is no {file}: run studies/people/fit.py with --held-out {held_out}")
    try:
        fit = json.loads(file.read_text())
        return Model(str(fit["policy"]), dict(fit["options"]))
    except (ValueError, KeyError, TypeError):
        raise InputError(f"{file} is no file of studies/people/fit.py: run it with --held-out {held_out}") from None


def with_populations(policy: str, models: Models) -> dict[str, Model]:
    """Return another policy with the population of each model; empty if one of them has none."""
    populations = {name: population_options(*model) for name, model in models.items()}
    return {name: Model(policy, own) for name, own in populations.items()} if all(populations.values()) else {}
