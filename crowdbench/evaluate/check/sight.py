"""How a plug-in is checked where the vehicle does not see everybody."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from crowdbench.evaluate.check.point import Point
from crowdbench.scenario.cases import Cases
from crowdbench.types import HISTORY, Observation

LIMITED = 5
"""The number of cases with limited sight."""

UNEXAMINED = Point("limited sight", None, "not examined: another point is broken")


def few(cases: Cases) -> Cases:
    """The first cases: those that are driven with limited sight."""
    return Cases(cases.split, cases.start, min(cases.start + LIMITED, cases.stop))


def with_nan_hidden(obs: Observation) -> Observation:
    """A copy of an observation with NaN in the rows of all pedestrians that are not seen."""
    crowd = obs.pedestrians
    names = ("position", "velocity", "radius")
    return _with_hidden(obs, {name: np.full_like(getattr(crowd, name), np.nan) for name in (*names, "history")})


def with_people_hidden(obs: Observation) -> Observation:
    """A copy of an observation in which all rows of pedestrians that are not seen are of one who passes the vehicle."""
    crowd = obs.pedestrians
    here, velocity = obs.vehicle.position[:, None] + 1.0, np.broadcast_to(np.array([-1.0, 0.0]), crowd.velocity.shape)
    past = obs.dt * np.arange(1 - HISTORY, 1)[:, None, None]
    return _with_hidden(
        obs,
        {
            "position": here,
            "velocity": velocity,
            "radius": np.full_like(crowd.radius, 0.3),
            "history": here[:, None] + past * velocity[:, None],
            "observed": np.full_like(crowd.observed, HISTORY),
            "age": np.zeros_like(crowd.age),
        },
    )


def _with_hidden(obs: Observation, values: Mapping[str, Any]) -> Observation:
    """A copy of an observation with other values in the rows of the pedestrians that are not seen.

    Args:
        obs: The observation.
        values: By the name of an array of `Pedestrians`, what broadcasts to it.
    """
    crowd, seen = obs.pedestrians, obs.pedestrians.seen
    shown = {
        "position": seen[:, :, None],
        "velocity": seen[:, :, None],
        "radius": seen,
        "history": seen[:, None, :, None],
        "observed": seen,
        "age": seen,
    }
    changed = {name: np.where(shown[name], getattr(crowd, name), value) for name, value in values.items()}
    return dataclasses.replace(obs, pedestrians=dataclasses.replace(crowd, **changed))
