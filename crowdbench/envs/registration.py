"""Makes the environments known to Gymnasium, without importing the simulator."""

import gymnasium

VEHICLE = "crowdbench/Vehicle-v0"
"""The name under which `gymnasium.make` and `make_vec` know the environment in which the vehicle acts."""


def register() -> None:
    """Register `crowdbench/Vehicle-v0`. The environment itself truncates at the scenario's time limit."""
    gymnasium.register(
        id=VEHICLE,
        entry_point="crowdbench.envs.vehicle:VehicleEnv",
        vector_entry_point="crowdbench.envs.vector:VehicleVectorEnv",
    )
