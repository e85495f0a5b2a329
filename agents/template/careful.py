"""Careful: drives straight to the goal, and slowly where a pedestrian is near."""

import numpy as np

from crowdbench import Planner


class Careful(Planner):
    """Keeps a slow speed near pedestrians."""

    def __init__(self, near, slow):
        self.near = near
        self.slow = slow

    def plan(self, obs):  # -> [world, 2], m/s
        """Return the velocity for each world."""
        to_goal = obs.vehicle.local_goal - obs.vehicle.position
        distance = np.linalg.norm(obs.pedestrians.position - obs.vehicle.position[:, None], axis=2)
        near = ((distance < self.near) & obs.pedestrians.seen).any(axis=1)
        speed = obs.vehicle.preferred_speed * np.where(near, self.slow, 1.0)
        return to_goal * (speed / np.linalg.norm(to_goal, axis=1))[:, None]


def planner(near: float = 1.5, slow: float = 0.3):
    """Make the planner.

    Args:
        near: Distance in metres below which a pedestrian is near.
        slow: Share of the preferred speed that is kept then.
    """
    return Careful(near, slow)
