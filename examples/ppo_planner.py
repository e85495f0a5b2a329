"""A planner that drives with a policy trained by train_ppo.py.

Do not load files that you do not trust: stable-baselines3 unpickles parts of them.
"""

import numpy as np
from stable_baselines3 import PPO

from crowdbench import Planner, flatten
from crowdbench.geometry import norm


class PPOPlanner(Planner):
    """Drives with a saved policy. The scenario must have as many pedestrians as the one it was trained in."""

    def __init__(self, path):
        self.model = PPO.load(path, device="cpu")

    def plan(self, obs):
        """The policy's mean action, slowed down to the preferred speed."""
        command, _ = self.model.predict(flatten(obs), deterministic=True)
        command = command.astype(np.float64)
        limit = obs.vehicle.preferred_speed
        return command * (limit / np.maximum(norm(command), limit))[:, None]


def planner(path="ppo.zip"):
    """Make the planner. `path` is the file that train_ppo.py has written."""
    return PPOPlanner(path)
