"""The observation `lidar`: a vector of the agent's own numbers and the ranges of a scan, for every agent.

    distance to the goal, direction of the goal as cosine and sine, velocity forwards and to the left, turn rate,
    radius, preferred speed, and a range for each beam

in metres, m/s and rad/s. All directions are relative to the heading, along which the first beam points. The others
follow counter-clockwise. The goal is the local goal (`crowdbench.core.geometry.local_goals`). The scan is that of the
scenario's lidar, or else of `crowdbench.sim.lidar.DEFAULT_LIDAR`. No other number depends on other agents.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from crowdbench.core.arrays import Numbers
from crowdbench.core.types import Observation, World
from crowdbench.networks.features import Vectors, direction, to_goal_frame
from crowdbench.sim.lidar import DEFAULT_LIDAR, headings, scan, scan_of
from crowdbench.sim.routes import goals_on_way
from crowdbench.sim.sensor import observe

OWN_NUMBERS = 8
"""Numbers before the ranges."""


def lidar_features(obs: Observation) -> Float[np.ndarray, "world features"]:
    """Return the vehicles' observations `lidar`, computed from a planner's observation."""
    own = obs.vehicle
    state = own.position, own.local_goal, own.velocity, own.heading, own.angular_speed
    return _join(*state, own.radius, own.preferred_speed, scan_of(obs))


def lidar_features_of_all(world: World) -> Float[np.ndarray, "agent features"]:
    """Return the observation `lidar` of each agent of one world.

    A pedestrian is a disc that moves in any direction. Its heading is that of its velocity.
    """
    agents = world.radius.shape[1]
    distance = scan(world, world.rules.sensor.lidar or DEFAULT_LIDAR, agents)[0]
    turn_rate = np.append(world.angular_speed, np.zeros(agents - 1))
    state = world.position[0], goals_on_way(world)[0], world.velocity[0], headings(world, agents)[0], turn_rate
    features = _join(*state, world.radius[0], world.preferred_speed[0], distance)
    features[0] = lidar_features(observe(world))[0]  # the default lidar scans what the vehicle's sensor detects
    return features


def _join(
    position: Vectors,
    goal: Vectors,
    velocity: Vectors,
    heading: Numbers,
    turn_rate: Numbers,
    radius: Numbers,
    preferred_speed: Numbers,
    distance: Float[np.ndarray, "world beam"],
) -> Float[np.ndarray, "world features"]:
    """Join the numbers of agents and their scans."""
    ahead = np.stack([np.cos(heading), np.sin(heading)], axis=1)
    far = np.sqrt(((goal - position) ** 2).sum(axis=1))
    toward, motion = to_goal_frame(direction(position, goal), ahead), to_goal_frame(velocity, ahead)
    return np.column_stack([far, toward, motion, turn_rate, radius, preferred_speed, distance])
