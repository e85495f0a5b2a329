"""How a command's values under several predicted futures become one value."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from crowdbench.planners.scene import Crowd, Scene
from crowdbench.utils.errors import require


@dataclass(frozen=True)
class Aggregate:
    """How a command's values under several futures become one.

    Attributes:
        arrange: Makes the scene whose modes are valued one by one.
        combine: Makes one value of the values `[row, mode]` of its modes; called with `axis=1`.
    """

    arrange: Callable[[Scene], Scene]
    combine: Callable[..., Float[np.ndarray, "row"]]


def separate_futures(scene: Scene) -> Scene:
    """The scene as it is, each future by itself."""
    return scene


def one_crowd(scene: Scene) -> Scene:
    """The scene with a single future, in which the pedestrians of all futures walk at once.

    It is the predicted state of Li et al. 2020, equation 2, which holds every future of every pedestrian.
    """
    crowd = scene.crowd
    worlds, modes, times, pedestrians = crowd.position.shape[:4]
    position = crowd.position.swapaxes(1, 2).reshape(worlds, 1, times, modes * pedestrians, 2)
    velocity = crowd.velocity.reshape(worlds, 1, modes * pedestrians, 2)
    everybody = Crowd(position, velocity, np.tile(crowd.radius, modes), np.tile(crowd.present, modes))
    return dataclasses.replace(scene, crowd=everybody)


def mean_future(scene: Scene) -> Scene:
    """The scene with a single future: everybody at the mean of the predicted positions, with the mean velocity."""
    position, velocity = (each.mean(axis=1, keepdims=True) for each in scene.crowd[:2])
    return dataclasses.replace(scene, crowd=scene.crowd._replace(position=position, velocity=velocity))


MEAN = Aggregate(separate_futures, np.mean)

AGGREGATES = {"crowd": Aggregate(one_crowd, np.mean), "mean": MEAN, "worst": Aggregate(separate_futures, np.min)}
"""By name. `crowd` is the literal reading of equations 2 to 4 of Li et al. 2020: all futures in one joint state."""


def find_aggregate(name: str) -> Aggregate:
    """One of `AGGREGATES`. Raises InputError where none has that name."""
    require("aggregate", name, name in AGGREGATES, f"one of {', '.join(AGGREGATES)}")
    return AGGREGATES[name]
