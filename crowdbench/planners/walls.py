"""Commands of planners that know nothing of obstacles, made to go along walls."""

from __future__ import annotations

import math
from typing import no_type_check

import numpy as np
from jaxtyping import Float

from crowdbench.compiled import njit
from crowdbench.sim.obstacles import slide
from crowdbench.sim.swept import stopping_gap
from crowdbench.types import Observation

GAP = 0.01
"""The gap to walls that is kept, in metres."""

CREEP = 0.01
"""Share of its speed at which a vehicle turns that must not drive on. A velocity of 0 would have no direction."""


def along_walls(obs: Observation, command: Float[np.ndarray, "world 2"]) -> Float[np.ndarray, "world 2"]:
    """Commands with which the vehicle goes along walls instead of into them, as pedestrians do in the simulator.

    A vehicle with limits on its acceleration needs time to stop and to turn. It looks that much farther ahead. Where it
    could not stop in front of a wall after the step, it brakes and turns.

    Args:
        obs: What the planner sees.
        command: Velocities in m/s.

    Returns:
        Velocities in m/s, no faster; the same ones where no wall is in the way.
    """
    if obs.obstacles.shape[1] == 0:
        return command
    kept = command.copy()
    vehicle = obs.vehicle
    time = obs.dt + vehicle.preferred_speed / vehicle.dynamics.limits[0]
    _slide(vehicle.position, vehicle.radius + GAP, obs.obstacles, time, kept)
    if math.isinf(vehicle.dynamics.limits[0]):
        return kept
    dynamics, limit = vehicle.dynamics, vehicle.preferred_speed
    after = dynamics.step(vehicle.state, dynamics.follow(vehicle.state, kept, limit, obs.dt), limit, obs.dt)
    _brake(np.array(vehicle.body), dynamics.limits[0], *after[:3], vehicle.radius + GAP, obs.obstacles, kept)
    return kept


@no_type_check
@njit
def _slide(position, radius, obstacles, time, command):
    """Change the commands; see `along_walls`."""
    for w in range(len(command)):
        x, y = position[w, 0], position[w, 1]
        touched, px, py = slide(x, y, command[w, 0] * time[w], command[w, 1] * time[w], radius[w], obstacles[w])
        if touched:
            command[w, 0], command[w, 1] = (px - x) / time[w], (py - y) / time[w]


@no_type_check
@njit
def _brake(body, deceleration, position, velocity, heading, radius, obstacles, command):
    """Slow commands down after which the vehicle could not stop in front of a wall; their direction is kept."""
    for w in range(len(command)):
        x, y, vx, vy = position[w, 0], position[w, 1], velocity[w, 0], velocity[w, 1]
        if stopping_gap(body, deceleration, x, y, vx, vy, heading[w], radius[w], obstacles[w]) < 0.0:
            command[w, 0], command[w, 1] = CREEP * command[w, 0], CREEP * command[w, 1]
