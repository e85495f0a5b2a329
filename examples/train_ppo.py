"""Trains a policy with stable-baselines3's PPO: python examples/train_ppo.py --out ppo.safetensors

Then drive it as a planner: crowdbench run --planner examples/ppo_planner.py --option path=ppo.safetensors
Needs `pip install 'crowdbench[ppo]'`. Change algorithm, network or reward as you like. `crowdbench train ppo` trains
the same network by a loop of its own, with a validation curve, checkpoints and a card.
"""

import argparse
from pathlib import Path

import numba
import torch
from safetensors.torch import save_file
from stable_baselines3 import PPO
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor

from crowdbench.envs.stable_baselines import CrowdVecEnv
from crowdbench.networks.policy import Seen, SetEncoder

NEAREST = 5
"""How many pedestrians the policy sees, at most."""


class CrowdExtractor(BaseFeaturesExtractor):
    """The set encoder of the policies that come with crowdbench."""

    def __init__(self, observation_space):
        encoder = SetEncoder()
        super().__init__(observation_space, encoder.encoded)
        self.encoder = encoder

    def forward(self, observed):
        """The code of what each world shows."""
        return self.encoder(Seen(observed["vehicle"], observed["pedestrians"], observed["mask"] > 0.5))


NETWORK = {"features_extractor_class": CrowdExtractor, "net_arch": [64], "log_std_init": -0.5}


def train(steps: int, scenario: str, seed: int, worlds: int = 128, progress_bar: bool = False) -> PPO:
    """Train a policy.

    Args:
        steps: Number of steps of all worlds together.
        scenario: The scenario's name or file.
        seed: Seed of the network and of the episodes.
        worlds: Number of worlds that are simulated at once.
        progress_bar: Whether to show the progress.
    """
    torch.set_num_threads(1)  # a network this small, and so few worlds, are faster in one thread
    numba.set_num_threads(1)
    env = CrowdVecEnv(worlds, scenario, seed, reward="progress", nearest=NEAREST)
    model = PPO(
        "MultiInputPolicy",
        env,
        n_steps=64,
        batch_size=1024,
        n_epochs=6,
        gamma=0.97,
        learning_rate=lambda left: 7e-4 * left,
        policy_kwargs=NETWORK,
        seed=seed,
        device="cpu",
    )
    return model.learn(steps, progress_bar=progress_bar)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--steps", type=int, default=3_000_000)
    parser.add_argument("--scenario", default="circle_crossing_5")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("ppo.safetensors"))
    asked = parser.parse_args()
    policy = train(asked.steps, asked.scenario, asked.seed, progress_bar=True).policy
    save_file({name: tensor.clone() for name, tensor in policy.state_dict().items()}, asked.out)
