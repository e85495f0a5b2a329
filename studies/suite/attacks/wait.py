"""Waits for an empty scene: it stands while a pedestrian is near its way, now or soon, and then drives straight."""

import numpy as np

from crowdbench import Observation, Planner

SOON = 0.5
"""Time in seconds between the tested moments."""


class Waiting(Planner):
    """Drives straight to the goal while nobody is in its way.

    Args:
        clearance: Smallest gap in metres between the way and pedestrians at constant velocity.
        ahead: Seconds for which the vehicle looks ahead.
    """

    def __init__(self, clearance: float, ahead: float) -> None:
        self.clearance, self.ahead = clearance, ahead

    def plan(self, obs: Observation) -> np.ndarray:
        """Return velocities `[world, 2]` in m/s."""
        vehicle, people = obs.vehicle, obs.pedestrians
        to_goal = vehicle.local_goal - vehicle.position
        distance = np.linalg.norm(to_goal, axis=1)
        straight = to_goal * (vehicle.preferred_speed / np.maximum(distance, 1e-9))[:, None]
        is_free = np.ones(len(distance), bool)
        for later in np.arange(0.0, self.ahead + SOON / 2, SOON):
            there = vehicle.position + straight * np.minimum(later, distance / vehicle.preferred_speed)[:, None]
            offset = people.position + later * people.velocity - there[:, None]
            gap = np.linalg.norm(offset, axis=2) - people.radius - vehicle.radius[:, None]
            is_free &= ~((gap < self.clearance) & people.seen).any(axis=1)
        return np.where(is_free[:, None], straight, 0.0)


def planner(clearance: float = 0.1, ahead: float = 2.0) -> Waiting:
    """Make the planner; see `Waiting`."""
    return Waiting(clearance, ahead)
