"""The pedestrian policy of people who walk as they were recorded."""

from __future__ import annotations

import numpy as np

from crowdbench.core.types import World
from crowdbench.sim.pedestrians.base import Parameters, PedestrianPolicy, Velocities
from crowdbench.sim.presence import track_at


class Recorded(PedestrianPolicy):
    """Walks as recorded people walked, whatever happens around: they react to nobody."""

    def velocities(self, world: World, parameters: Parameters) -> Velocities:
        """See `PedestrianPolicy`: to where they were at the next step; 0 where they were not there any more."""
        ahead = track_at(world, world.step + 1) - world.position[:, 1:]
        return np.where(np.isnan(ahead), 0.0, ahead / world.rules.dt)
