"""What the values of a command under several predicted futures are together."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from crowdbench.errors import InputError
from crowdbench.planners.lookahead.outlook import Scene


@dataclass(frozen=True)
class Aggregate:
    """How futures become one value: `shown` makes the scene that is valued, `over_modes` one of its modes' values."""

    shown: Callable[[Scene], Scene]
    over_modes: Callable[[Float[np.ndarray, "row mode"]], Float[np.ndarray, "row"]]


def mean_over_modes(values: Float[np.ndarray, "row mode"]) -> Float[np.ndarray, "row"]:
    """Every predicted future counts alike."""
    return values.mean(axis=1)


def worst_over_modes(values: Float[np.ndarray, "row mode"]) -> Float[np.ndarray, "row"]:
    """The future that is worst for the command counts."""
    return values.min(axis=1)


def as_it_is(scene: Scene) -> Scene:
    """Each future by itself."""
    return scene


def as_one_crowd(scene: Scene) -> Scene:
    """The one future in which all pedestrians of all modes walk at once: w_t of Li et al., equation 2."""
    worlds, modes, pedestrians = scene.crowd.shape[:3]
    everybody = (worlds, 1, modes * pedestrians, 2)
    return dataclasses.replace(
        scene,
        crowd=scene.crowd.reshape(everybody),
        next_crowd=scene.next_crowd.reshape(everybody),
        next_velocity=scene.next_velocity.reshape(everybody),
        crowd_radius=np.tile(scene.crowd_radius, modes),
        present=np.tile(scene.present, modes),
    )


def mean_future(scene: Scene) -> Scene:
    """The one future in which everybody is at the mean of the predicted places, with the mean velocity."""
    return dataclasses.replace(
        scene,
        crowd=scene.crowd.mean(axis=1, keepdims=True),
        next_crowd=scene.next_crowd.mean(axis=1, keepdims=True),
        next_velocity=scene.next_velocity.mean(axis=1, keepdims=True),
    )


MEAN = Aggregate(as_it_is, mean_over_modes)

AGGREGATES = {
    "crowd": Aggregate(as_one_crowd, mean_over_modes),
    "mean": MEAN,
    "worst": Aggregate(as_it_is, worst_over_modes),
}
"""By name. `crowd` is the letter of equations 2 to 4 of Li et al., whose value network is given all futures at once."""


def find_aggregate(name: str) -> Aggregate:
    """One of `AGGREGATES`. Raises InputError where there is none of that name."""
    if name not in AGGREGATES:
        raise InputError(f"aggregate is {name!r}, but must be one of {', '.join(AGGREGATES)}")
    return AGGREGATES[name]
