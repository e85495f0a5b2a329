"""IPPO (de Witt et al. 2020) in PettingZoo: the vehicle learns one network, all pedestrians learn another one.

Needs `pip install 'crowdbench[ppo]' supersuit`. A million steps of agents take X minutes on a core. The vehicle then
reaches X % success on validation cases, among pedestrians that follow ORCA: python examples/ippo.py --out ippo.zip
"""

import argparse

import numpy as np
import supersuit
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.utils import set_random_seed
from torch.nn import Linear, Sequential, Tanh

import crowdbench

SCENARIO, WORLDS, AGENTS = "circle_crossing_5_visible", 16, 6
VIEW = {"observation": "goal_frame", "action": "normalized_goal_frame", "nearest": 5}
PARAMETERS = {"n_steps": 64, "batch_size": 1024, "n_epochs": 6, "gamma": 0.97, "learning_rate": 7e-4}


class TwoNetworks(BaseFeaturesExtractor):
    """A network of the vehicle and one of the pedestrians. An observation ends with the indicator of its agent."""

    def __init__(self, space):
        super().__init__(space, 2 * 64)
        size = space.shape[0] - AGENTS
        self.vehicle = Sequential(Linear(size, 64), Tanh(), Linear(64, 64), Tanh())
        self.pedestrian = Sequential(Linear(size, 64), Tanh(), Linear(64, 64), Tanh())

    def forward(self, seen):
        """Return the features of both networks, zeros for the network of the other agents."""
        numbers, is_vehicle, number = seen.split([seen.shape[1] - AGENTS, 1, AGENTS - 1], dim=1)
        is_pedestrian = number.sum(dim=1, keepdim=True)
        return torch.cat([is_vehicle * self.vehicle(numbers), is_pedestrian * self.pedestrian(numbers)], dim=1)


parser = argparse.ArgumentParser()
parser.add_argument("--steps", type=int, default=1_000_000)
parser.add_argument("--seed", type=int, default=0)
parser.add_argument("--out", default="ippo.zip")
args = parser.parse_args()
set_random_seed(args.seed)
env = supersuit.agent_indicator_v0(crowdbench.parallel_env(SCENARIO, reward="progress", **VIEW))
env = supersuit.pettingzoo_env_to_vec_env_v1(supersuit.black_death_v3(env))  # agents that arrived observe zeros
worlds = supersuit.concat_vec_envs_v1(env, WORLDS, num_cpus=1, base_class="stable_baselines3")
worlds.venv.reset(seed=args.seed)
network = {"features_extractor_class": TwoNetworks, "share_features_extractor": False, "net_arch": []}
model = PPO("MlpPolicy", worlds, **PARAMETERS, policy_kwargs=network, device="cpu").learn(args.steps)
model.save(args.out)
indicator = np.eye(1, AGENTS, dtype=np.float32)
planner = crowdbench.PolicyPlanner(
    lambda seen: model.predict(np.hstack([seen, indicator.repeat(len(seen), axis=0)]), deterministic=True)[0], **VIEW
)
success = crowdbench.run(planner, SCENARIO, "val:200").metrics["success_rate"].mean
print(f"{args.out}: {100 * success:.1f} % success on validation cases")
