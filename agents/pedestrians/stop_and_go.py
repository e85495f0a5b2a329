"""ORCA with pauses: pedestrians that stop and go, for example to look at their phones."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from crowdbench import ORCA, PedestrianPolicy, World
from crowdbench.core import draw_uniforms
from crowdbench.sim import Parameters, Velocities

HABITS: Mapping[str, float] = {"period": 8.0, "pause": 0.25}
"""Parameters in addition to ORCA's: a period in seconds, and the share of it that is a pause."""


class StopAndGo(PedestrianPolicy):
    """ORCA with pauses, in which pedestrians stand.

    Each pedestrian pauses once in each period, with a random phase.
    """

    parameters: ClassVar[Mapping[str, float]] = {**ORCA.parameters, **HABITS}
    walk = ORCA()

    def velocities(self, world: World, parameters: Parameters) -> Velocities:
        """See `PedestrianPolicy`. The parameters are ORCA's, `period` in seconds, and `pause`."""
        start = draw_uniforms(world.key, "stop_and_go", np.zeros_like(world.step), world.person)
        time = (world.step * world.rules.dt)[:, None]
        phase = (time / np.maximum(parameters["period"][:, 1:], world.rules.dt) + start) % 1.0
        pauses = phase < parameters["pause"][:, 1:]
        return np.where(pauses[..., None], 0.0, self.walk.velocities(world, parameters))


def policy() -> StopAndGo:
    """Make the policy. Its parameters are set in the scenario, in `[pedestrians.stop_and_go]`.

    Parameters:
        period: Time from one pause to the next [s].
        pause: Share of the period for which a pedestrian stands [1].
        neighbor_distance: Distance within which a pedestrian avoids others [m].
        max_neighbors: Number of nearest neighbours that a pedestrian avoids [1].
        time_horizon: Time horizon for collisions with other agents: the paper's tau [s].
        safety_space: Margin that is added to every radius [m].
        time_horizon_obst: Time horizon for collisions with obstacles [s].
        line_of_sight: 1 if a pedestrian ignores agents behind obstacles; 0 if it avoids them, as in RVO2 [1].

    Returns:
        The policy.
    """
    return StopAndGo()
