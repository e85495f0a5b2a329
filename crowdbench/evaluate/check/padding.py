"""Worlds and observations with more pedestrians that are not there: they must not change an answer."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from crowdbench.sim.sight import PADDING
from crowdbench.types import Observation, World

MORE = 3
"""How many absent pedestrians are added."""

_AGENTS: Mapping[str, tuple[int, Any]] = {
    "position": (1, 0.0),
    "velocity": (1, 0.0),
    "origin": (1, 0.0),
    "goal": (1, 0.0),
    "route": (1, np.nan),
    "waypoint": (1, 0),
    "radius": (1, 1.0),
    "preferred_speed": (1, 1.0),
    "present": (1, False),
    "person": (1, -1),
    "since": (1, 0),
    "track": (2, np.nan),
    "group": (1, -1),
    "history": (2, 0.0),
    "policy": (1, 0),
}
"""The arrays of a world with an entry per agent or pedestrian: its axis, and the value of an absent one."""

_PEDESTRIANS: Mapping[str, tuple[int, Any]] = {
    "position": (1, 0.0),
    "velocity": (1, 0.0),
    "radius": (1, 1.0),
    "seen": (1, False),
    "history": (2, 0.0),
    "observed": (1, 0),
    "age": (1, np.inf),
    "filled": (2, False),
}
"""The same for what is observed of pedestrians."""

_SIGHT: Mapping[str, tuple[int, Any]] = {
    "sent": (2, np.nan),
    "sender": (2, -1),
    "person": (1, -1),
    "state": (1, PADDING),
    "unseen": (1, -1),
    "observed": (1, 0),
    "history": (2, 0.0),
    "filled": (2, False),
}
"""The same for `World.sight`."""


def with_more_absent(world: World) -> World:
    """A copy of worlds with more padding."""
    parameters = {
        policy: {name: _longer(array, 1, 0.0) for name, array in table.items()}
        for policy, table in world.parameters.items()
    }
    arrays = {name: _longer(getattr(world, name), *entry) for name, entry in _AGENTS.items()}
    sight = {name: _longer(array, *_SIGHT[name]) for name, array in world.sight.items()}
    return world.replace(parameters=parameters, sight=sight, **arrays)


def with_more_unseen(obs: Observation) -> Observation:
    """A copy of an observation with more padding."""
    seen = {name: getattr(obs.pedestrians, name) for name in _PEDESTRIANS}
    crowd = {name: _longer(array, *_PEDESTRIANS[name]) for name, array in seen.items() if array is not None}
    future = None if obs.future is None else _longer(obs.future, 1, 0.0)
    return dataclasses.replace(obs, pedestrians=dataclasses.replace(obs.pedestrians, **crowd), future=future)


def _longer(array: np.ndarray, axis: int, value: Any) -> np.ndarray:
    shape = list(array.shape)
    shape[axis] = MORE
    return np.concatenate([array, np.full(shape, value, array.dtype)], axis)
