"""Training of the networks: a vehicle together with its crowd, and a vehicle among ORCA pedestrians."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

SCENARIO = "circle_crossing_5_visible"
VIEW: dict[str, Any] = {"reward": "progress", "observation": "goal_frame", "action": "goal_frame", "nearest": 3}
WORLDS = 16


def train_together(seed: int, minutes: float, vehicle: Path, pedestrians: Path) -> None:
    """Train one network for a vehicle and all pedestrians, and write it for both.

    Args:
        seed: The seed of the network and of the worlds.
        minutes: Minutes of processor time.
        vehicle: The file of the vehicle, in ONNX.
        pedestrians: The file of the pedestrians' weights, in safetensors.
    """
    import supersuit
    from safetensors.torch import save_file

    from crowdbench import export_policy, parallel_env
    from crowdbench.envs import CrowdVecEnv
    from crowdbench.utils import write_whole

    # SuperSuit makes each agent a copy of the same learner; an agent at its goal observes zeros until the episode ends.
    single = supersuit.pettingzoo_env_to_vec_env_v1(supersuit.black_death_v3(parallel_env(SCENARIO, **VIEW)))
    worlds = supersuit.concat_vec_envs_v1(single, WORLDS, num_cpus=1, base_class="stable_baselines3")
    worlds.venv.reset(seed=seed)
    model = _learn(worlds, seed, minutes)
    export_policy(model, vehicle, CrowdVecEnv(1, SCENARIO, **VIEW))
    hidden = model.policy.mlp_extractor.policy_net
    layers = enumerate((hidden[0], hidden[2], model.policy.action_net))
    arrays = {f"{name[0]}{n}": part.detach() for n, layer in layers for name, part in layer.named_parameters()}
    with write_whole(pedestrians) as partial:
        save_file(arrays, partial)


def train_with_orca(minutes: float, vehicle: Path) -> None:
    """Train the network of a vehicle among ORCA pedestrians, see `train_together`."""
    from crowdbench import export_policy
    from crowdbench.envs import CrowdVecEnv

    worlds = CrowdVecEnv(WORLDS * 6, SCENARIO, **VIEW)
    export_policy(_learn(worlds, 0, minutes), vehicle, worlds)


def _learn(worlds: Any, seed: int, minutes: float) -> Any:
    """Train a network by PPO for some minutes of processor time."""
    import torch
    from stable_baselines3 import PPO
    from stable_baselines3.common.utils import set_random_seed

    set_random_seed(seed)
    torch.set_num_threads(1)  # networks this small are faster in one thread
    end = time.process_time() + 60.0 * minutes
    network = {"log_std_init": -0.5, "net_arch": [64, 64]}
    steps = {"n_steps": 64, "batch_size": 1024, "n_epochs": 6, "gamma": 0.97, "learning_rate": 7e-4}
    model = PPO("MlpPolicy", worlds, **steps, policy_kwargs=network, device="cpu")
    return model.learn(10**9, lambda *_: time.process_time() < end)
