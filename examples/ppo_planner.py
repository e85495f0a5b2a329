"""A policy that stable-baselines3's PPO has learned, as a planner (see train_ppo.py).

stable-baselines3 unpickles parts of such a file: load none that you do not trust.
"""

import numpy as np
from stable_baselines3 import PPO

from crowdbench import Planner, flatten
from crowdbench.geometry import norm


class PPOPlanner(Planner):
    """Drives with a saved policy, in scenarios with as many pedestrians as it has learned with."""

    def __init__(self, path):
        self.model = PPO.load(path, device="cpu")

    def plan(self, obs):
        """The policy's mean action, slowed down to the preferred speed."""
        command, _ = self.model.predict(flatten(obs), deterministic=True)
        command = command.astype(np.float64)
        limit = obs.vehicle.preferred_speed
        return command * (limit / np.maximum(norm(command), limit))[:, None]


def planner(path="ppo.zip"):
    """`path` is the file that train_ppo.py has saved."""
    return PPOPlanner(path)
