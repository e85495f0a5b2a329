"""Pedestrian policies of people with habits: who stops and goes, who gives way to nobody, who stands."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from crowdbench import rng
from crowdbench.geometry import toward_goal
from crowdbench.sim.pedestrians import PedestrianPolicy
from crowdbench.sim.routes import goals_on_way
from crowdbench.types import World

HABITS: Mapping[str, float] = {"period": 8.0, "pause": 0.25}
"""What `StopAndGo` adds to the parameters of its policy: a period in seconds, and the share of it that is a pause."""


class StopAndGo(PedestrianPolicy):
    """Moves pedestrians as another policy does, but for pauses, in which they stand where they are.

    Everybody pauses at other times, once in each period.

    Args:
        walk: The other policy, one without a memory.
    """

    def __init__(self, walk: PedestrianPolicy) -> None:
        self.walk = walk
        self.parameters = {**walk.parameters, **HABITS}  # type: ignore[misc]  # those of this object

    def velocities(
        self, world: World, parameters: Mapping[str, Float[np.ndarray, "world agent"]]
    ) -> Float[np.ndarray, "world pedestrian 2"]:
        """See `PedestrianPolicy`. The parameters are those of the other policy, `period` in seconds, and `pause`."""
        start = rng.uniforms(world.key, "stop_and_go", np.zeros_like(world.step), world.person)
        time = (world.step * world.rules.dt)[:, None]
        phase = (time / np.maximum(parameters["period"][:, 1:], world.rules.dt) + start) % 1.0
        pauses = phase < parameters["pause"][:, 1:]
        return np.where(pauses[..., None], 0.0, self.walk.velocities(world, parameters))


class Straight(PedestrianPolicy):
    """Walks to the goal at the preferred speed and gives way to nobody."""

    def velocities(
        self, world: World, parameters: Mapping[str, Float[np.ndarray, "world agent"]]
    ) -> Float[np.ndarray, "world pedestrian 2"]:
        """See `PedestrianPolicy`."""
        return toward_goal(world.position, goals_on_way(world), world.preferred_speed)[:, 1:]


class Standing(PedestrianPolicy):
    """Stands; groups stand in a circle."""

    stands: ClassVar[bool] = True

    def velocities(
        self, world: World, parameters: Mapping[str, Float[np.ndarray, "world agent"]]
    ) -> Float[np.ndarray, "world pedestrian 2"]:
        """See `PedestrianPolicy`."""
        return np.zeros((len(world), world.person.shape[1], 2))
