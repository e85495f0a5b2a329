"""ORCA with pauses: people who stop and go, such as those who look at their phones."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from crowdbench.core import rng
from crowdbench.core.types import World
from crowdbench.sim.pedestrians import ORCA
from crowdbench.sim.pedestrians.base import Parameters, PedestrianPolicy, Velocities

HABITS: Mapping[str, float] = {"period": 8.0, "pause": 0.25}
"""Parameters beside the ones that ORCA has: a period in seconds, and the share of it that is a pause."""


class StopAndGo(PedestrianPolicy):
    """Moves pedestrians as ORCA does, but for pauses, in which they stand where they are.

    Everybody pauses at other times, once in each period.
    """

    parameters: ClassVar[Mapping[str, float]] = {**ORCA.parameters, **HABITS}
    walk = ORCA()

    def velocities(self, world: World, parameters: Parameters) -> Velocities:
        """See `PedestrianPolicy`. The parameters are the ones that ORCA has, `period` in seconds, and `pause`."""
        start = rng.uniforms(world.key, "stop_and_go", np.zeros_like(world.step), world.person)
        time = (world.step * world.rules.dt)[:, None]
        phase = (time / np.maximum(parameters["period"][:, 1:], world.rules.dt) + start) % 1.0
        pauses = phase < parameters["pause"][:, 1:]
        return np.where(pauses[..., None], 0.0, self.walk.velocities(world, parameters))


def policy() -> StopAndGo:
    """Make the policy. Its parameters are set in the scenario, in `[pedestrians.stop_and_go]`.

    Parameters:
        period: Time from one pause to the next [s].
        pause: Share of the period for which a pedestrian stands [1].
        neighbor_distance: Distance within which a pedestrian notices others [m].
        max_neighbors: Number of neighbours, the nearest, that a pedestrian avoids [1].
        time_horizon: How far ahead a pedestrian avoids collisions: the paper's tau [s].
        safety_space: Margin that is added to every radius [m].
        time_horizon_obst: How far ahead a pedestrian avoids collisions with obstacles [s].
        line_of_sight: 1 if a pedestrian avoids only agents that no obstacle hides; 0 as in RVO2, through walls [1].

    Returns:
        The policy.
    """
    return StopAndGo()
