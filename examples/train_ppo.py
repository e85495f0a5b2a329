"""Trains a policy with stable-baselines3's PPO, and exports it: python examples/train_ppo.py --minutes 1 --out ppo.onnx

Then drive it as a planner: crowdbench run --planner ppo.onnx
Needs `pip install 'crowdbench[ppo,onnx]'`. Change algorithm, network or reward as you like. The model is saved every
half a minute beside the policy (ppo.zip), and Ctrl-C exports the policy trained so far. `crowdbench train ppo` trains
the same network by crowdbench's training loop, with a validation curve, checkpoints and a card.
"""

import argparse
import time
from pathlib import Path

import numba
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor

from crowdbench import export_policy
from crowdbench.envs import CrowdVecEnv
from crowdbench.networks import Seen, SetEncoder

NEAREST = 5
"""Largest number of pedestrians in the observation of the policy."""

BETWEEN = 30.0
"""Seconds between checkpoints."""


class CrowdExtractor(BaseFeaturesExtractor):
    """The set encoder of the policies that come with crowdbench."""

    def __init__(self, observation_space):
        encoder = SetEncoder()
        super().__init__(observation_space, encoder.encoded)
        self.encoder = encoder

    def forward(self, observed):
        """Return the encoding of each world's observation."""
        return self.encoder(Seen(observed["vehicle"], observed["pedestrians"], observed["mask"] > 0.5))


NETWORK = {"features_extractor_class": CrowdExtractor, "net_arch": [64], "log_std_init": -0.5}


class Clock:
    """Remaining share of a training.

    Args:
        minutes: Its duration; None if only the number of steps ends it.
    """

    def __init__(self, minutes: float | None):
        self.seconds, self.start = None if minutes is None else 60.0 * minutes, time.monotonic()

    def left(self, steps_left: float) -> float:
        """Return the remaining share of the training: of its time, or else of its steps."""
        return steps_left if self.seconds is None else 1.0 - (time.monotonic() - self.start) / self.seconds

    def learning_rate(self, steps_left: float) -> float:
        """Return the learning rate, which falls to 0."""
        return 7e-4 * max(0.0, self.left(steps_left))


class Checkpoints(BaseCallback):
    """Callback that saves the model periodically, and ends the training when its time is over."""

    def __init__(self, file: Path, clock: Clock):
        super().__init__()
        self.file, self.clock, self.saved = file, clock, time.monotonic()

    def _on_rollout_start(self):
        if time.monotonic() - self.saved > BETWEEN:
            self.model.save(self.file)
            self.saved = time.monotonic()

    def _on_step(self):
        return self.clock.left(1.0) > 0.0


def train(
    steps: int,
    scenario: str,
    seed: int,
    out: Path,
    worlds: int = 128,
    minutes: float | None = None,
    progress_bar: bool = False,
) -> PPO:
    """Train a policy, and export it as an ONNX file.

    Args:
        steps: Number of steps of all worlds together, at most.
        scenario: The scenario's name or file.
        seed: Seed of the network and of the episodes.
        out: The ONNX file; the model is saved beside it.
        worlds: Number of worlds that are simulated at once.
        minutes: Longest duration of the training.
        progress_bar: True to show the progress.
    """
    torch.set_num_threads(1)  # a network this small, and so few worlds, are faster in one thread
    numba.set_num_threads(1)
    env = CrowdVecEnv(worlds, scenario, seed, reward="progress", nearest=NEAREST)
    clock, checkpoint = Clock(minutes), out.with_suffix(".zip")
    model = PPO(
        "MultiInputPolicy",
        env,
        n_steps=64,
        batch_size=1024,
        n_epochs=6,
        gamma=0.97,
        learning_rate=clock.learning_rate,
        policy_kwargs=NETWORK,
        seed=seed,
        device="cpu",
    )
    try:
        model.learn(steps, Checkpoints(checkpoint, clock), progress_bar=progress_bar)
    except KeyboardInterrupt:
        print("interrupted: exporting what has been learned")
    model.save(checkpoint)
    export_policy(model, out, env)
    print(f"wrote {out}")
    return model


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--steps", type=int, default=3_000_000)
    parser.add_argument("--minutes", type=float, help="ends the training before all steps are made")
    parser.add_argument("--scenario", default="circle_crossing_5")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("ppo.onnx"))
    asked = parser.parse_args()
    train(asked.steps, asked.scenario, asked.seed, asked.out, minutes=asked.minutes, progress_bar=asked.minutes is None)
