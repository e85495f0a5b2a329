"""Vehicle and pedestrians learn together, with one network for all: python examples/learn_together.py

Needs `pip install 'crowdbench[ppo]' supersuit`. SuperSuit makes one environment of stable-baselines3 of all agents of
several PettingZoo worlds, so that PPO sees each agent as one more copy of the same learner. All of them are paid for
coming closer to their goals, and pay for touching each other.
"""

import argparse

import numpy as np
import supersuit
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.utils import set_random_seed

from crowdbench import parallel_env

WORLDS = 16


def everybody(scenario):
    """One world in which all agents act. Agents see the three nearest others."""
    return parallel_env(scenario, reward="progress", observation="goal_frame", action="goal_frame", nearest=3)


def train(steps, scenario, seed, progress_bar=False):
    """Train one network for all agents.

    Args:
        steps: Steps of all agents of all worlds together.
        scenario: The scenario's name or file.
        seed: Seed of the network and of the episodes.
        progress_bar: Whether to show the progress.
    """
    torch.set_num_threads(1)  # networks this small are faster in one thread
    set_random_seed(seed)  # these worlds take no seed from PPO
    # An agent that is at its goal sees zeros until the episode of its world is over.
    single = supersuit.pettingzoo_env_to_vec_env_v1(supersuit.black_death_v3(everybody(scenario)))
    worlds = supersuit.concat_vec_envs_v1(single, WORLDS, num_cpus=1, base_class="stable_baselines3")
    worlds.venv.reset(seed=seed)
    model = PPO(
        "MlpPolicy", worlds, n_steps=64, batch_size=1024, n_epochs=6, gamma=0.97, learning_rate=7e-4,
        policy_kwargs={"log_std_init": -0.5, "net_arch": [128, 128]}, device="cpu",
    )  # fmt: skip
    return model.learn(steps, progress_bar=progress_bar)


def drive(model, scenario, cases=50):
    """The share of vehicles that arrive, and of agents that touch nobody, in validation cases."""
    world = everybody(scenario)
    arrived, clean = [], []
    for case in range(cases):
        seen, _ = world.reset(options={"case": f"val/{case}"})
        touched = dict.fromkeys(world.agents, False)
        while world.agents:
            agents = world.agents
            actions, _ = model.predict(np.stack([seen[agent] for agent in agents]), deterministic=True)
            seen, _, _, _, infos = world.step(dict(zip(agents, actions, strict=True)))
            for agent, info in infos.items():
                touched[agent] |= info["outcome"] == "collision"
        arrived.append(infos["vehicle"]["outcome"] == "success")
        clean += [not each for each in touched.values()]
    return np.mean(arrived), np.mean(clean)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--steps", type=int, default=500_000)
    parser.add_argument("--scenario", default="circle_crossing_5_visible")
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    for steps in (0, asked.steps):
        arrived, clean = drive(train(steps, asked.scenario, asked.seed, steps > 0), asked.scenario)
        print(
            f"after {steps} steps, {100 * arrived:.0f} % of vehicles arrive, {100 * clean:.0f} % of agents touch nobody"
        )
