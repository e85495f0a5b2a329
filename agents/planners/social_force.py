"""The social force model (Helbing and Molnár 1995) drives the vehicle, with the paper's parameters for pedestrians.

Differs from the paper where two walls are near each other: there the force of walls follows the width, because the
posts of a door of 1 m would stop a vehicle in front of it.

Helbing and Molnár, "Social force model for pedestrian dynamics", Physical Review E 51, 1995.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from crowdbench import Observation, Planner, along_walls
from crowdbench.sim import SocialForce, Walkers, social_force_velocities
from crowdbench.utils import require_not_negative

WIDTH = 1.28
"""Free width in metres below which the force of walls shrinks: twice the distance at which a wall ahead stops a vehicle
of 1 m/s with the paper's parameters."""

SLOWEST = 1e-9
"""Smallest preferred speed in m/s, by which the model divides."""

SAME_SIDE = 0.5
"""Cosine of the angle below which two walls are seen to be on the same side, such as the walls of a corner."""


@dataclass(eq=False)
class SocialForcePlanner(Planner):
    """The social force model with the parameters of Helbing and Molnár (1995).

    It assumes that the other agents keep their velocities. Differs from the pedestrians' model because it adds no
    fluctuation: a planner's command is not noisy. Where a wall stands in the way it goes along it, as pedestrians do.
    Strength and range of the force of walls shrink with the free width: a narrow passage is like a wide one.

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
        goal = position.copy()
        goal[:, 0] = vehicle.local_goal
        speed = np.broadcast_to(vehicle.preferred_speed[:, None], radius.shape)
        agents = position, velocity, goal, radius + self.safety_space, np.maximum(speed, SLOWEST), present
        moves = np.broadcast_to(np.arange(present.shape[1]) == 0, present.shape)  # the model moves nobody else
        walkers = Walkers(*(array.copy() for array in (*agents, moves, obs.obstacles)))  # the model takes no views
        noise, traits = np.zeros_like(position), wall_traits(obs)
        return along_walls(obs, social_force_velocities(walkers, noise, time_step=obs.dt, parameters=traits)[:, 0])


def wall_traits(obs: Observation) -> dict[str, Float[np.ndarray, "world 1"]]:
    """Return strength and range of the force of walls, as parameters of `social_force_velocities`."""
    share = np.minimum(free_width(obs.vehicle.position, obs.obstacles) / WIDTH, 1.0)[:, None]
    return {name: share * SocialForce.parameters[name] for name in ("wall_strength", "wall_range")}


def free_width(
    position: Float[np.ndarray, "world 2"], obstacles: Float[np.ndarray, "world polygon corner 2"]
) -> Float[np.ndarray, "world"]:
    """Return the smallest distance between the nearest points of two obstacles that are not on the same side.

    Args:
        position: Where vehicles are, `[world, 2]` in metres.
        obstacles: Polygons `[world, polygon, corner, 2]` in metres, NaN beyond the last corner of each.

    Returns:
        In metres, infinite where there are no two.
    """
    if obstacles.shape[1] == 0:
        return np.full(len(position), np.inf)
    first, following = obstacles, np.roll(obstacles, -1, axis=2)
    edge = np.where(np.isnan(following), first[:, :, :1], following) - first
    offset = first - position[:, None, None]
    along = -(offset * edge).sum(axis=3) / np.maximum((edge**2).sum(axis=3), 1e-12)
    offset = offset + np.clip(along, 0.0, 1.0)[..., None] * edge
    distance = np.nan_to_num(np.linalg.norm(offset, axis=3), nan=np.inf)
    nearest = distance.argmin(axis=2)[:, :, None, None]
    offset, distance = np.take_along_axis(offset, nearest, axis=2)[:, :, 0], distance.min(axis=2)
    one, other = offset[:, :, None], offset[:, None]
    are_apart = (one * other).sum(axis=3) < SAME_SIDE * distance[:, :, None] * distance[:, None]
    return np.asarray(np.where(are_apart, np.linalg.norm(one - other, axis=3), np.inf).min(axis=(1, 2)))


def planner(safety_space: float = 0.0) -> SocialForcePlanner:
    """Make the planner.

    Args:
        safety_space: Margin that is added to every radius [m].

    Returns:
        The planner.
    """
    return SocialForcePlanner(float(safety_space))
