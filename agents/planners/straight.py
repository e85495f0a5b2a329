"""Straight to the next waypoint at preferred speed, never slowing: the floor that every planner should beat."""

import numpy as np

from crowdbench import Observation, Planner
from crowdbench.core import norm


class Straight(Planner):
    """Drives straight to the next waypoint at the preferred speed, whatever is in the way, and never slows down."""

    def plan(self, obs: Observation) -> np.ndarray:
        """See `Planner`."""
        vehicle = obs.vehicle
        offset = vehicle.local_goal - vehicle.position
        return offset * (vehicle.preferred_speed / np.maximum(norm(offset), 1e-9))[:, None]


def planner() -> Straight:
    """Make the planner."""
    return Straight()
