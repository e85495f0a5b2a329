"""A planner that drives with a policy trained by train_ppo.py."""

import numpy as np
from safetensors.torch import load_file
from stable_baselines3.common.policies import MultiInputActorCriticPolicy
from train_ppo import NEAREST, NETWORK

from crowdbench import Planner, load_scenario
from crowdbench.envs.views import View


class PPOPlanner(Planner):
    """Drives with the mean action of a saved policy."""

    def __init__(self, path, scenario):
        self.view = View(load_scenario(scenario), "dict", "goal_frame", NEAREST)
        spaces = self.view.observation_space, self.view.action_space
        self.policy = MultiInputActorCriticPolicy(*spaces, lambda _: 0.0, **NETWORK)
        self.policy.load_state_dict(load_file(path))

    def plan(self, obs):
        """The velocity that the policy asks for, slowed down to the preferred speed."""
        action, _ = self.policy.predict(self.view.encode(obs), deterministic=True)
        command = self.view.commands(obs.vehicle.position, obs.vehicle.local_goal, action.astype(np.float64))
        limit = obs.vehicle.preferred_speed
        return command * (limit / np.maximum(np.hypot(*command.T), limit))[:, None]


def planner(path="ppo.safetensors", scenario="circle_crossing_5"):
    """Make the planner. `path` is the file that train_ppo.py has written, `scenario` the one that it trained in."""
    return PPOPlanner(path, scenario)
