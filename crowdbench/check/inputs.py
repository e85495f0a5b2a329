"""What plug-ins are shown: the worlds of real episodes, with more padding, and with other rows for those unseen."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from crowdbench.core.geometry import toward_goal
from crowdbench.core.types import HISTORY, Observation, Trace, World
from crowdbench.planners.base import Planner
from crowdbench.planners.driver import Driver
from crowdbench.planners.reactive import ORCAPlanner
from crowdbench.runs.rollout import rollout
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.scenario import Scenario
from crowdbench.sim.sight import PADDING

MORE = 3
"""How many absent pedestrians are added."""

LIMITED = 5
"""The number of cases with limited sight."""

_ABSENT: Sequence[tuple[int, Any, str]] = (
    (1, 0, "position velocity origin goal waypoint present since policy seen observed"),
    (1, 1.0, "radius preferred_speed"),
    (1, -1, "person group unseen"),
    (1, np.nan, "route"),
    (1, np.inf, "age"),
    (1, PADDING, "state"),
    (2, 0, "history filled"),
    (2, -1, "sender"),
    (2, np.nan, "track sent"),
)
ABSENT = {name: (axis, value) for axis, value, names in _ABSENT for name in names.split()}
"""The arrays with an entry per agent or pedestrian in `World`, `World.sight` and `Pedestrians`: the axis of the agents,
and the value of an absent one, 0 for False."""


def drive_trial(scenario: Scenario, cases: Cases, privileged: bool = False) -> tuple[Trace, list[Observation]]:
    """Drive through cases in three ways.

    Args:
        scenario: The scenario of the cases.
        cases: The cases.
        privileged: Whether observations show the pedestrians' next velocities.

    Returns:
        The trace, and the observation of each step.

    Raises:
        InputError: The scenario breaks its contract.
    """
    vehicle = _TrialVehicle(privileged)
    trace = rollout(Driver(vehicle, "trial"), scenario, cases)
    return trace, vehicle.observations


class _TrialVehicle(Planner):
    """Avoids pedestrians in every third case, drives straight in another third, and stands in the rest.

    So that all outcomes occur.
    """

    def __init__(self, privileged: bool) -> None:
        self.privileged = privileged
        self.orca = ORCAPlanner()
        self.observations: list[Observation] = []

    def plan(self, obs: Observation) -> Float[np.ndarray, "world 2"]:
        self.observations.append(obs)
        straight = toward_goal(obs.vehicle.position, obs.vehicle.goal, obs.vehicle.preferred_speed)
        return np.choose(obs.row[:, None] % 3, [self.orca.plan(obs), straight, np.zeros_like(straight)])


def first_cases(cases: Cases) -> Cases:
    """The first cases: those that are driven with limited sight."""
    return Cases(cases.split, cases.start, min(cases.start + LIMITED, cases.stop))


def with_more_absent(world: World) -> World:
    """A copy of worlds with more padding."""
    parameters = {
        policy: {name: _pad(array, 1, 0.0) for name, array in table.items()}
        for policy, table in world.parameters.items()
    }
    sight = {name: _pad(array, *ABSENT[name]) for name, array in world.sight.items()}
    return world.replace(parameters=parameters, sight=sight, **_pad_fields(world))


def with_more_unseen(obs: Observation) -> Observation:
    """A copy of an observation with more padding."""
    crowd = dataclasses.replace(obs.pedestrians, **_pad_fields(obs.pedestrians))
    return dataclasses.replace(obs, pedestrians=crowd, future=None if obs.future is None else _pad(obs.future, 1, 0.0))


def _pad_fields(whole: Any) -> dict[str, np.ndarray]:
    """The arrays of a dataclass that have an entry per agent or pedestrian, with more absent ones."""
    arrays = {field.name: getattr(whole, field.name) for field in dataclasses.fields(whole) if field.name in ABSENT}
    return {name: _pad(array, *ABSENT[name]) for name, array in arrays.items() if array is not None}


def _pad(array: np.ndarray, axis: int, value: Any) -> np.ndarray:
    shape = list(array.shape)
    shape[axis] = MORE
    return np.concatenate([array, np.full(shape, value, array.dtype)], axis)


def with_nan_hidden(obs: Observation) -> Observation:
    """A copy of an observation with NaN in the rows of all pedestrians that are not seen."""
    return _with_hidden(obs, position=np.nan, velocity=np.nan, radius=np.nan, history=np.nan)


def with_people_hidden(obs: Observation) -> Observation:
    """A copy of an observation in which all rows of pedestrians that are not seen are of one who passes the vehicle."""
    here = obs.vehicle.position[:, None] + 1.0
    velocity = np.broadcast_to(np.array([-1.0, 0.0]), obs.pedestrians.velocity.shape)
    past = here[:, None] + obs.dt * np.arange(1 - HISTORY, 1)[:, None, None] * velocity[:, None]
    return _with_hidden(obs, position=here, velocity=velocity, radius=0.3, history=past, observed=HISTORY, age=0.0)


def _with_hidden(obs: Observation, **values: Any) -> Observation:
    """A copy of an observation with other values, by array, in the rows of the pedestrians that are not seen."""
    crowd, seen = obs.pedestrians, obs.pedestrians.seen
    masks = {"position": seen[:, :, None], "velocity": seen[:, :, None], "history": seen[:, None, :, None]}
    arrays = {name: np.where(masks.get(name, seen), getattr(crowd, name), value) for name, value in values.items()}
    return dataclasses.replace(obs, pedestrians=dataclasses.replace(crowd, **arrays))
