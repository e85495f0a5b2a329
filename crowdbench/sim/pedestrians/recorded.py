"""The pedestrian policy that replays recorded pedestrians."""

from __future__ import annotations

import numpy as np

from crowdbench.core.types import World
from crowdbench.sim.pedestrians.policy import Parameters, PedestrianPolicy, Velocities
from crowdbench.sim.presence import track_at


class Recorded(PedestrianPolicy):
    """Replay of recorded pedestrians, which do not react to other agents."""

    def velocities(self, world: World, parameters: Parameters) -> Velocities:
        """See `PedestrianPolicy`: velocities to the recorded positions of the next step; 0 if there are none."""
        ahead = track_at(world, world.step + 1) - world.position[:, 1:]
        return np.where(np.isnan(ahead), 0.0, ahead / world.rules.dt)
