"""How long the steps take with which a policy is trained: the environments of many worlds."""

from __future__ import annotations

import functools
import importlib.util
import time
from collections.abc import Iterator
from typing import Any

import gymnasium
import numpy as np

from crowdbench.bench.measurement import Measurement
from crowdbench.bench.timing import in_turns
from crowdbench.envs import registration

ROUNDS = 7
SCENARIO = "circle_crossing_5"
OPTIONS: dict[str, Any] = {"reward": "progress", "observation": "goal_frame", "action": "goal_frame", "nearest": 5}


def measure_vec_env(worlds: int = 512, steps: int = 60) -> Iterator[Measurement]:
    """Steps of the vehicle in many worlds: stable-baselines3's VecEnv and Gymnasium's, by turns.

    Nothing is measured where stable-baselines3 is not installed.

    Args:
        worlds: Number of worlds.
        steps: Number of steps of each.
    """
    if importlib.util.find_spec("stable_baselines3") is None:
        return
    works = [functools.partial(work, worlds, steps) for work in (gymnasium_step, stable_baselines_step)]
    gym, own = in_turns(ROUNDS, *works)
    work = f"{worlds} worlds, 5 pedestrians, frame of the goal, per vehicle and step"
    yield Measurement(f"Gymnasium's vector environment, {work}", 1e6 * gym, "us")
    yield Measurement("the same as stable-baselines3's VecEnv", 1e6 * own, "us")


def gymnasium_step(worlds: int, steps: int) -> float:
    """Seconds per vehicle and step of `gymnasium.make_vec`.

    Args:
        worlds: Number of worlds.
        steps: Number of steps of each.
    """
    envs = gymnasium.make_vec(registration.VEHICLE, num_envs=worlds, scenario=SCENARIO, **OPTIONS)
    envs.reset(seed=0)
    actions = np.tile([0.5, 0.1], (worlds, 1))
    begin = time.perf_counter()
    for _ in range(steps):
        envs.step(actions)
    return (time.perf_counter() - begin) / (worlds * steps)


def stable_baselines_step(worlds: int, steps: int) -> float:
    """Seconds per vehicle and step of `CrowdVecEnv`.

    Args:
        worlds: Number of worlds.
        steps: Number of steps of each.
    """
    from crowdbench.envs.stable_baselines import CrowdVecEnv

    envs = CrowdVecEnv(worlds, SCENARIO, **OPTIONS, cases=worlds)
    envs.reset()
    actions = np.tile([0.5, 0.1], (worlds, 1))
    begin = time.perf_counter()
    for _ in range(steps):
        envs.step_async(actions)
        envs.step_wait()
    return (time.perf_counter() - begin) / (worlds * steps)
