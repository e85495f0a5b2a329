"""IPPO (de Witt et al. 2020) in PettingZoo: one network of the vehicle, one of all pedestrians: python examples/ippo.py

Needs `pip install '.[ppo]' supersuit`. It prints the vehicle's success among pedestrians that have learned.
"""

import argparse

import numpy as np
import supersuit
from stable_baselines3 import PPO
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.utils import set_random_seed
from torch import cat
from torch.nn import Linear, Sequential, Tanh

import crowdbench

SCENARIO, WORLDS, AGENTS, CASES = "circle_crossing_5_visible", 16, 6, 200
VIEW = {"observation": "goal_frame", "action": "normalized_goal_frame", "nearest": 5}
PARAMETERS = {"n_steps": 64, "batch_size": 1024, "n_epochs": 6, "gamma": 0.97, "learning_rate": 7e-4}


class TwoNetworks(BaseFeaturesExtractor):
    """A network of the vehicle and one of the pedestrians. An observation ends with the indicator of its agent."""

    def __init__(self, space):
        super().__init__(space, 2 * 64)
        size = space.shape[0] - AGENTS
        self.vehicle, self.pedestrian = (Sequential(Linear(size, 64), Tanh(), Linear(64, 64), Tanh()) for _ in range(2))

    def forward(self, seen):
        """Return the features of both networks, zeros for the network of the other agents."""
        numbers, is_vehicle, number = seen.split([seen.shape[1] - AGENTS, 1, AGENTS - 1], dim=1)
        is_pedestrian = number.sum(dim=1, keepdim=True)
        return cat([is_vehicle * self.vehicle(numbers), is_pedestrian * self.pedestrian(numbers)], dim=1)


parser = argparse.ArgumentParser()
parser.add_argument("--steps", type=int, default=1_000_000)
parser.add_argument("--seed", type=int, default=0)
parser.add_argument("--out", default="ippo.zip")
args = parser.parse_args()
set_random_seed(args.seed)
env = supersuit.agent_indicator_v0(crowdbench.parallel_env(SCENARIO, reward="progress", **VIEW))
worlds = supersuit.pettingzoo_env_to_vec_env_v1(supersuit.black_death_v3(env))  # agents that arrived observe zeros
worlds = supersuit.concat_vec_envs_v1(worlds, WORLDS, num_cpus=1, base_class="stable_baselines3")
worlds.venv.reset(seed=args.seed)
network = {"features_extractor_class": TwoNetworks, "share_features_extractor": False, "net_arch": []}
network["log_std_init"] = -0.5
model = PPO("MlpPolicy", worlds, **PARAMETERS, policy_kwargs=network, device="cpu").learn(args.steps)
model.save(args.out)

arrived = 0
for case in range(CASES):
    seen, _ = env.reset(options={"case": f"val/{case}"})
    while env.agents:
        actions, _ = model.predict(np.array([seen[agent] for agent in env.agents]), deterministic=True)
        seen, _, _, _, infos = env.step(dict(zip(env.agents, actions, strict=True)))
    arrived += infos["vehicle"]["is_success"]
print(f"{args.out}: {100 * arrived / CASES:.1f} % success on validation cases")
