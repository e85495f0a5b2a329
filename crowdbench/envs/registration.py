"""Register the environment of one vehicle with Gymnasium."""

import gymnasium

VEHICLE = "crowdbench/Vehicle-v0"
"""The id of the environment for `gymnasium.make` and `gymnasium.make_vec`."""


def register() -> None:
    """Register `crowdbench/Vehicle-v0`, without `max_episode_steps`: it truncates at the scenario's time limit.

    Nothing of the simulator is imported yet.
    """
    gymnasium.register(
        id=VEHICLE,
        entry_point="crowdbench.envs.vehicle:VehicleEnv",
        vector_entry_point="crowdbench.envs.vector:VehicleVectorEnv",
    )
