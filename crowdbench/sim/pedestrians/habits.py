"""Pedestrian policies of people with habits: who stops and goes, gives way to nobody, stands, or walks as recorded."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from crowdbench.core import rng
from crowdbench.core.geometry import toward_goal
from crowdbench.core.types import World
from crowdbench.sim.pedestrians.base import Parameters, PedestrianPolicy, Velocities
from crowdbench.sim.presence import track_at
from crowdbench.sim.routes import goals_on_way

HABITS: Mapping[str, float] = {"period": 8.0, "pause": 0.25}
"""Parameters that `StopAndGo` adds to its policy: a period in seconds, and the share of it that is a pause."""


class StopAndGo(PedestrianPolicy):
    """Moves pedestrians as another policy does, but for pauses, in which they stand where they are.

    Everybody pauses at other times, once in each period.

    Args:
        walk: The other policy, one without a memory.
    """

    def __init__(self, walk: PedestrianPolicy) -> None:
        self.walk = walk
        self.parameters = {**walk.parameters, **HABITS}  # type: ignore[misc]  # parameters of this object

    def velocities(self, world: World, parameters: Parameters) -> Velocities:
        """See `PedestrianPolicy`. The parameters are the other policy's, `period` in seconds, and `pause`."""
        start = rng.uniforms(world.key, "stop_and_go", np.zeros_like(world.step), world.person)
        time = (world.step * world.rules.dt)[:, None]
        phase = (time / np.maximum(parameters["period"][:, 1:], world.rules.dt) + start) % 1.0
        pauses = phase < parameters["pause"][:, 1:]
        return np.where(pauses[..., None], 0.0, self.walk.velocities(world, parameters))


class Straight(PedestrianPolicy):
    """Walks to the goal at the preferred speed and gives way to nobody."""

    def velocities(self, world: World, parameters: Parameters) -> Velocities:
        """See `PedestrianPolicy`."""
        return toward_goal(world.position, goals_on_way(world), world.preferred_speed)[:, 1:]


class Standing(PedestrianPolicy):
    """Stands; groups stand in a circle."""

    stands: ClassVar[bool] = True

    def velocities(self, world: World, parameters: Parameters) -> Velocities:
        """See `PedestrianPolicy`."""
        return np.zeros((len(world), world.person.shape[1], 2))


class Recorded(PedestrianPolicy):
    """Walks as recorded people walked, whatever happens around: they react to nobody."""

    def velocities(self, world: World, parameters: Parameters) -> Velocities:
        """See `PedestrianPolicy`: to where they were at the next step; 0 where they were not there any more."""
        ahead = track_at(world, world.step + 1) - world.position[:, 1:]
        return np.where(np.isnan(ahead), 0.0, ahead / world.rules.dt)
