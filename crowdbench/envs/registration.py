"""Register the environments with Gymnasium and PettingZoo. Nothing of the simulator is imported yet."""

from __future__ import annotations

from typing import Any

import gymnasium
import pettingzoo

VEHICLE = "crowdbench/Vehicle-v0"
"""The id of the environment for `gymnasium.make` and `gymnasium.make_vec`."""

CROWD = "crowdbench/crowd-v0"
"""The id of the environment for `pettingzoo.make`."""


def register() -> None:
    """Register `crowdbench/Vehicle-v0` and `crowdbench/crowd-v0`, which truncate at the scenario's time limit."""
    gymnasium.register(
        id=VEHICLE,
        entry_point="crowdbench.envs.vehicle:VehicleEnv",
        vector_entry_point="crowdbench.envs.vector:VehicleVectorEnv",
    )
    pettingzoo.register("parallel", CROWD, f"{__name__}:make_parallel")
    pettingzoo.register("aec", CROWD, f"{__name__}:make_aec")


def make_parallel(max_cycles: int | None = None, **arguments: Any) -> pettingzoo.ParallelEnv:
    """Make a `parallel_env`. PettingZoo's name of `max_episode_steps` is `max_cycles`."""
    from crowdbench.envs.parallel import parallel_env

    return parallel_env(**{"max_episode_steps": max_cycles, **arguments})


def make_aec(max_cycles: int | None = None, **arguments: Any) -> pettingzoo.AECEnv:
    """Make a `parallel_env` in which agents act one after the other; every agent of the step must act."""
    from pettingzoo.utils import parallel_to_aec

    return parallel_to_aec(make_parallel(max_cycles, **arguments))
