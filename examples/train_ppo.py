"""Trains stable-baselines3's PPO to drive the vehicle: python examples/train_ppo.py --steps 200000 --out ppo.zip

Then drive it as a planner: crowdbench run --planner examples/ppo_planner.py --option path=ppo.zip
"""

import argparse
from pathlib import Path

import gymnasium
import numpy as np
import torch
from stable_baselines3 import PPO

import crowdbench  # registers crowdbench/Vehicle-v0
from crowdbench.reward import discount

gymnasium.register_envs(crowdbench)


def train(steps: int, scenario: str, seed: int, rollout: int = 2048) -> PPO:
    """Train a policy.

    Args:
        steps: Number of steps of the environment.
        scenario: The scenario's name or file.
        seed: Seed of the network and of the episodes.
        rollout: Number of steps between two updates.
    """
    torch.set_num_threads(1)  # networks this small are faster in one thread
    env = gymnasium.make("crowdbench/Vehicle-v0", scenario=scenario)
    loaded = env.unwrapped.scenario
    gamma = float(discount(np.array([loaded.vehicle_speed]), loaded.rules.dt)[0])
    model = PPO("MlpPolicy", env, n_steps=rollout, gamma=gamma, seed=seed, device="cpu")
    return model.learn(steps)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--steps", type=int, default=200_000)
    parser.add_argument("--scenario", default="circle_crossing_5")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("ppo.zip"))
    arguments = parser.parse_args()
    train(arguments.steps, arguments.scenario, arguments.seed).save(arguments.out)
