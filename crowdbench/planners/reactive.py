"""Planners that drive the vehicle with a model of pedestrians."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from crowdbench.geometry import norm, toward_goal
from crowdbench.planners.base import Planner
from crowdbench.planners.walls import along_walls
from crowdbench.sim.orca import orca_velocities
from crowdbench.sim.pedestrians import ORCA_MARGIN, TIME_HORIZON_OBST
from crowdbench.sim.social_force import social_force_velocities
from crowdbench.types import Observation


class Straight(Planner):
    """Drives straight to the next waypoint at the preferred speed, whatever is in the way, and never slows down."""

    def plan(self, obs: Observation) -> Float[np.ndarray, "world 2"]:
        """See `Planner`."""
        vehicle = obs.vehicle
        way = vehicle.local_goal - vehicle.position
        distance = np.maximum(norm(way), 1e-9)
        return way * (vehicle.preferred_speed / distance)[:, None]


class ORCAPlanner(Planner):
    """Optimal reciprocal collision avoidance (van den Berg et al. 2011), with the parameters of CrowdNav's robot.

    Args:
        safety_space: Margin that is added to every radius [m].
    """

    def __init__(self, safety_space: float = 0.0) -> None:
        self.safety_space = safety_space

    def plan(self, obs: Observation) -> Float[np.ndarray, "world 2"]:
        """See `Planner`."""
        vehicle = obs.vehicle
        position, velocity, radius, present = obs.everybody()
        preferred = np.zeros_like(position)
        preferred[:, 0] = toward_goal(vehicle.position, vehicle.local_goal, vehicle.preferred_speed)
        asked = orca_velocities(
            position,
            velocity,
            preferred,
            radius + (ORCA_MARGIN + self.safety_space),
            np.broadcast_to(vehicle.preferred_speed[:, None], radius.shape),
            time_step=obs.dt,
            obstacles=obs.obstacles,
            time_horizon_obst=TIME_HORIZON_OBST,
            seen=present,
            moves=np.broadcast_to(np.arange(radius.shape[1]) == 0, radius.shape),
        )[:, 0]
        # Nothing else keeps a vehicle off walls that cannot take these velocities at once.
        return along_walls(obs, asked)


class SocialForcePlanner(Planner):
    """The social force model with the parameters of Helbing and Molnár (1995).

    It assumes that the other agents keep their velocities. Differs from the pedestrians' model because it adds no
    fluctuation: a planner's command is not noisy. Where a wall stands in the way it goes along it, as pedestrians do.

    Args:
        safety_space: Margin that is added to every radius [m].
    """

    def __init__(self, safety_space: float = 0.0) -> None:
        self.safety_space = safety_space

    def plan(self, obs: Observation) -> Float[np.ndarray, "world 2"]:
        """See `Planner`."""
        vehicle = obs.vehicle
        position, velocity, radius, present = obs.everybody()
        goal = position.copy()
        goal[:, 0] = vehicle.local_goal
        velocity = social_force_velocities(
            position,
            velocity,
            goal,
            radius + self.safety_space,
            np.broadcast_to(vehicle.preferred_speed[:, None], radius.shape),
            np.zeros_like(position),
            time_step=obs.dt,
            obstacles=obs.obstacles,
            seen=present,
            moves=np.broadcast_to(np.arange(radius.shape[1]) == 0, radius.shape),
        )[:, 0]
        return along_walls(obs, velocity)
