"""Further input of a recurrent policy: predicted positions of pedestrians, waypoints, walls, and the vehicle's motion.

In the same frame of the goal, after the numbers of `crowdbench.networks.features`:

    vehicle:     heading as cosine and sine, turn rate, 1 for a unicycle, 1 for a bicycle, distance of its farthest disc
                 from its position, the next two waypoints x, y, and the distances to walls along `RAYS` rays
    pedestrian:  position x, y after each of the next steps, time since it was seen, radius of its possible positions

in metres, seconds and rad/s. The goal replaces a missing waypoint. The first ray lies along the x axis, the others
follow counter-clockwise; a ray that meets no wall is `REACH` long.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from crowdbench.core.dynamics import Bicycle, Unicycle, reach
from crowdbench.core.types import Observation
from crowdbench.networks.features import PEDESTRIAN_FEATURES, VEHICLE_FEATURES, Features, features, to_goal_frame

Positions = Float[np.ndarray, "world time pedestrian 2"]

STEPS = 5
"""Predicted steps (Liu et al. 2023)."""

RAYS = 24
"""Rays along which the distance to walls is shown."""

REACH = 5.0
"""Length of a ray in metres, and the largest age of a measurement in seconds."""

MOTION = 6
"""Numbers about the motion of the vehicle."""

VEHICLE_AHEAD = VEHICLE_FEATURES + MOTION + 4 + RAYS
PEDESTRIAN_AHEAD = PEDESTRIAN_FEATURES + 2 * STEPS + 2
"""Numbers about the vehicle, and about each pedestrian."""


def features_ahead(obs: Observation, nearest: int, ahead: Positions, walls: Float[np.ndarray, "world ray"]) -> Features:
    """Return the features of an observation with a prediction.

    Args:
        nearest: Largest number of pedestrians that are shown.
        ahead: Predicted positions after each of the next `STEPS` steps, in metres.
        walls: Distances in metres along `RAYS` rays, the first towards the goal.
    """
    shown = features(obs, nearest)
    vehicle = np.concatenate([shown.vehicle, motion(obs, shown.axis), walls], axis=1)
    pedestrians = np.zeros((*shown.pedestrians.shape[:2], PEDESTRIAN_AHEAD))
    pedestrians[..., :PEDESTRIAN_FEATURES] = shown.pedestrians
    if obs.pedestrians.seen.shape[1] > 0:
        pedestrians[..., PEDESTRIAN_FEATURES:] = _ahead(obs, shown, ahead)
    return shown._replace(vehicle=vehicle, pedestrians=pedestrians)


def motion(obs: Observation, axis: Float[np.ndarray, "world 2"]) -> Float[np.ndarray, "world numbers"]:
    """Return the motion of the vehicle, its type, and its next two waypoints, in the frame of the goal."""
    own = obs.vehicle
    facing = to_goal_frame(np.stack([np.cos(own.heading), np.sin(own.heading)], axis=1), axis)
    kind = np.array([isinstance(own.dynamics, Unicycle), isinstance(own.dynamics, Bicycle), reach(own.body)], float)
    way = np.concatenate([own.route, np.repeat(own.goal[:, None], 2, axis=1)], axis=1)
    way = np.where(np.isnan(way), own.goal[:, None], way)
    following = np.minimum(own.waypoint[:, None] + np.arange(2), way.shape[1] - 1)
    near = np.take_along_axis(way, following[..., None], axis=1) - own.position[:, None]
    numbers = facing, own.angular_speed[:, None], np.tile(kind, (len(obs), 1)), to_goal_frame(near, axis)
    return np.concatenate([part.reshape(len(obs), -1) for part in numbers], axis=1)


def _ahead(obs: Observation, shown: Features, ahead: Positions) -> Float[np.ndarray, "world nearest numbers"]:
    """Return the predicted positions of each shown pedestrian, with age and uncertainty; 0 in empty rows."""
    which, crowd = np.maximum(shown.which, 0), obs.pedestrians
    position = np.take_along_axis(ahead, which[:, None, :, None], axis=2).swapaxes(1, 2)
    position = to_goal_frame(position - obs.vehicle.position[:, None, None], shown.axis).reshape(*which.shape, -1)
    age = np.minimum(np.take_along_axis(crowd.age, which, axis=1), REACH)
    radius = np.zeros_like(age)
    if crowd.deviation is not None:
        deviation = np.take_along_axis(crowd.deviation, which[..., None], axis=1)
        radius = np.hypot(deviation[..., 0], STEPS * obs.dt * deviation[..., 1])
    numbers = np.concatenate([position, age[..., None], radius[..., None]], axis=2)
    return np.where(shown.seen[..., None], numbers, 0.0)
