"""Commands of planners that know nothing of obstacles, made to go along walls."""

from __future__ import annotations

from typing import no_type_check

import numpy as np
from jaxtyping import Float

from crowdbench.compiled import njit
from crowdbench.sim.obstacles import slide
from crowdbench.types import Observation

GAP = 0.01
"""The gap to walls that is kept, in metres."""


def along_walls(obs: Observation, command: Float[np.ndarray, "world 2"]) -> Float[np.ndarray, "world 2"]:
    """Commands with which the vehicle goes along walls instead of into them, as pedestrians do in the simulator.

    Args:
        obs: What the planner sees.
        command: Velocities in m/s.

    Returns:
        Velocities in m/s, no faster; the same ones where no wall is in the way.
    """
    if obs.obstacles.shape[1] == 0:
        return command
    kept = command.copy()
    _slide(obs.vehicle.position, obs.vehicle.radius + GAP, obs.obstacles, obs.dt, kept)
    return kept


@no_type_check
@njit
def _slide(position, radius, obstacles, dt, command):
    """Change the commands; see `along_walls`."""
    for w in range(len(command)):
        x, y = position[w, 0], position[w, 1]
        touched, px, py = slide(x, y, command[w, 0] * dt, command[w, 1] * dt, radius[w], obstacles[w])
        if touched:
            command[w, 0], command[w, 1] = (px - x) / dt, (py - y) / dt
