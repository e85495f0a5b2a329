"""ORCA (van den Berg et al. 2011) as in CrowdNav++: with a safety margin, and a speed of 1 m/s towards the goal.

Liu et al., "Intention Aware Robot Crowd Navigation with Attention-Based Interaction Graph", ICRA 2023, and their code.
"""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from crowdbench import ORCA, PedestrianPolicy, World
from crowdbench.sim import Parameters, Velocities, orca_pedestrians


class ORCAPlus(PedestrianPolicy):
    """ORCA as in CrowdNav++ (Liu et al. 2023): with a safety margin, and a speed of 1 m/s towards the goal."""

    parameters: ClassVar[Mapping[str, float]] = {**ORCA.parameters, "max_neighbors": 1000, "safety_space": 0.15}

    def velocities(self, world: World, parameters: Parameters) -> Velocities:
        """See `PedestrianPolicy`. The desired speed is 1 m/s for every preferred speed."""
        return orca_pedestrians(world, parameters, np.ones_like(world.preferred_speed))


def policy() -> ORCAPlus:
    """Make the policy. Its parameters are set in the scenario, in `[pedestrians.orca_plus]`.

    The desired speed towards the goal is 1 m/s, less over the last metre, and does not depend on the preferred speed.
    The preferred speed is the speed limit.

    Parameters:
        neighbor_distance: Distance within which a pedestrian avoids others [m].
        max_neighbors: Number of nearest neighbours that a pedestrian avoids; all by default [1].
        time_horizon: Time horizon for collisions with other agents: the paper's tau [s].
        safety_space: Margin that is added to every radius [m].
        time_horizon_obst: Time horizon for collisions with obstacles [s].
        line_of_sight: 1 if a pedestrian ignores agents behind obstacles; 0 if it avoids them, as in RVO2 [1].

    Returns:
        The policy.
    """
    return ORCAPlus()
