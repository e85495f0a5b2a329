"""Planners that drive the vehicle with a model of pedestrians, and corrections of velocities along walls."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import no_type_check

import numpy as np
from jaxtyping import Float

from crowdbench.core.geometry import toward_goal
from crowdbench.core.types import Observation
from crowdbench.planners.planner import Planner
from crowdbench.sim.episode import stopping_gap
from crowdbench.sim.obstacles import slide
from crowdbench.sim.pedestrians.orca import orca_velocities
from crowdbench.sim.pedestrians.orca_crowd import ORCA_MARGIN, TIME_HORIZON_OBST
from crowdbench.utils.compiled import njit
from crowdbench.utils.errors import require_not_negative


@dataclass(eq=False)
class ORCAPlanner(Planner):
    """Optimal reciprocal collision avoidance (van den Berg et al. 2011), with the parameters of CrowdNav's robot.

    The margin applies only to pedestrians: a margin to walls would close a door that the vehicle fits through.

    Attributes:
        safety_space: Margin that is added to every radius [m].

    Raises:
        InputError: The margin is not a number, 0 or more.
    """

    safety_space: float = 0.0

    def __post_init__(self) -> None:
        require_not_negative("safety_space", self.safety_space)

    def plan(self, obs: Observation) -> Float[np.ndarray, "world 2"]:
        """See `Planner`."""
        vehicle = obs.vehicle
        position, velocity, radius, present = obs.everybody()
        preferred = np.zeros_like(position)
        preferred[:, 0] = toward_goal(vehicle.position, vehicle.local_goal, vehicle.preferred_speed)
        radius = radius + (ORCA_MARGIN + self.safety_space)
        if obs.obstacles.shape[1]:  # the whole margin is added to the others' radii, so that walls have none
            radius[:, 0] -= self.safety_space
            radius[:, 1:] += self.safety_space
        speed = np.broadcast_to(vehicle.preferred_speed[:, None], radius.shape)
        agents, walls = (position, velocity, preferred, radius, speed), obs.obstacles
        moves = np.broadcast_to(np.arange(present.shape[1]) == 0, present.shape)  # the model moves no other agent
        velocities = orca_velocities(
            *agents, time_step=obs.dt, obstacles=walls, time_horizon_obst=TIME_HORIZON_OBST, seen=present, moves=moves
        )
        # Otherwise, a vehicle that cannot reach these velocities in one step could touch walls.
        return along_walls(obs, velocities[:, 0])


GAP = 0.01
"""Smallest gap to walls, in metres."""

CREEP = 1e-4
"""Share of its speed at which a vehicle turns if it must not drive on. A velocity of 0 would have no direction."""


def along_walls(obs: Observation, command: Float[np.ndarray, "world 2"]) -> Float[np.ndarray, "world 2"]:
    """Return commands with which the vehicle goes along walls instead of into them, as pedestrians do in the simulator.

    A vehicle with limited acceleration needs time to stop and to turn. The correction covers this time, too. If the
    vehicle could not stop in front of a wall after the step, it brakes and turns, or brakes straight ahead.

    Args:
        obs: The observation.
        command: Velocities in m/s.

    Returns:
        Velocities in m/s, no faster than the commands; unchanged if no wall is in the way.
    """
    if obs.obstacles.shape[1] == 0:
        return command
    vehicle, dynamics, limit, slower = obs.vehicle, obs.vehicle.dynamics, obs.vehicle.preferred_speed, command.copy()
    deceleration, radius = dynamics.limits[0], vehicle.radius + GAP
    _slide(vehicle.position, radius, obs.obstacles, obs.dt + limit / deceleration, slower)
    if math.isfinite(deceleration):
        ahead = limit[:, None] * np.stack([np.cos(vehicle.heading), np.sin(vehicle.heading)], axis=1)
        for toward in (slower.copy(), ahead):  # if turning is not enough, straight ahead: that was safe before
            after = dynamics.step(vehicle.state, dynamics.follow(vehicle.state, slower, limit, obs.dt), limit, obs.dt)
            _brake(np.array(vehicle.body), deceleration, *after[:3], radius, obs.obstacles, toward, slower)
    return slower


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
def _brake(body, deceleration, position, velocity, heading, radius, obstacles, toward, command):
    """Replace commands after which the vehicle could not stop in front of a wall: slow ones, in directions `toward`."""
    for w in range(len(command)):
        x, y, vx, vy = position[w, 0], position[w, 1], velocity[w, 0], velocity[w, 1]
        if stopping_gap(body, deceleration, x, y, vx, vy, heading[w], radius[w], obstacles[w]) < 0.0:
            command[w, 0], command[w, 1] = CREEP * toward[w, 0], CREEP * toward[w, 1]
