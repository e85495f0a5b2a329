"""ORCA (van den Berg et al. 2011) as the pedestrians of CrowdNav++ follow it: with a margin, and goals at 1 m/s.

Liu et al., "Intention Aware Robot Crowd Navigation with Attention-Based Interaction Graph", ICRA 2023, and their code.
"""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from crowdbench.core.types import World
from crowdbench.sim.pedestrians import ORCA
from crowdbench.sim.pedestrians.base import Parameters, PedestrianPolicy, Velocities
from crowdbench.sim.pedestrians.orca_crowd import orca_pedestrians


class ORCAPlus(PedestrianPolicy):
    """ORCA as the pedestrians of CrowdNav++ follow it (Liu et al. 2023): with a margin, towards the goal at 1 m/s."""

    parameters: ClassVar[Mapping[str, float]] = {**ORCA.parameters, "max_neighbors": 1000, "safety_space": 0.15}

    def velocities(self, world: World, parameters: Parameters) -> Velocities:
        """See `PedestrianPolicy`. The velocity towards the goal is 1 m/s fast, whatever the preferred speed is."""
        return orca_pedestrians(world, parameters, np.ones_like(world.preferred_speed))


def policy() -> ORCAPlus:
    """Make the policy. Its parameters are set in the scenario, in `[pedestrians.orca_plus]`.

    The velocity that leads to the goal is 1 m/s fast and slower in the last metre, whatever the preferred speed is. The
    preferred speed is the largest.

    Parameters:
        neighbor_distance: Distance within which a pedestrian notices others [m].
        max_neighbors: Number of neighbours, the nearest, that a pedestrian avoids; all by default [1].
        time_horizon: How far ahead a pedestrian avoids collisions: the paper's tau [s].
        safety_space: Margin that is added to every radius [m].
        time_horizon_obst: How far ahead a pedestrian avoids collisions with obstacles [s].
        line_of_sight: 1 if a pedestrian avoids only agents that no obstacle hides; 0 as in RVO2, through walls [1].

    Returns:
        The policy.
    """
    return ORCAPlus()
