"""Further input of a recurrent policy: predicted positions of people, walls, and how it moves.

In the same frame of the goal, after the numbers of `crowdbench.networks.features`:

    vehicle:     heading as cosine and sine, turn rate, 1 for a unicycle, 1 for a bicycle, how far its farthest disc is
                 from its position, and of the nearest walls x, y, and 1 where there is one
    pedestrian:  position x, y after each of the next steps, time since it was seen, radius in which it may be

A wall is the nearest point of an edge of an obstacle, in metres, 45 degrees or more from walls that are nearer; the
turn rate is in rad/s, times are in seconds.
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

WALLS = 4
"""Walls that are shown, the nearest ones in directions that differ."""

REACH = 5.0
"""Distance in metres up to which a wall is shown, and the largest age in seconds of what was seen."""

VEHICLE_AHEAD = VEHICLE_FEATURES + 6 + 3 * WALLS
PEDESTRIAN_AHEAD = PEDESTRIAN_FEATURES + 2 * STEPS + 2
"""Numbers about the vehicle, and about each pedestrian."""


def features_ahead(
    obs: Observation, nearest: int, ahead: Positions, walls: Float[np.ndarray, "world wall 2"]
) -> Features:
    """The features of an observation with a prediction.

    Args:
        obs: The observation.
        nearest: How many pedestrians are shown, at most.
        ahead: Where they are predicted to be after each of the next `STEPS` steps, in metres.
        walls: The nearest points of the `WALLS` nearest walls in metres, NaN where there are fewer.
    """
    shown, own = features(obs, nearest), obs.vehicle
    facing = to_goal_frame(np.stack([np.cos(own.heading), np.sin(own.heading)], axis=1), shown.axis)
    near = to_goal_frame(walls - own.position[:, None], shown.axis)
    near = np.concatenate([np.nan_to_num(near), np.isfinite(near[..., :1])], axis=2).reshape(len(obs), -1)
    kind = np.array([isinstance(own.dynamics, Unicycle), isinstance(own.dynamics, Bicycle), reach(own.body)], float)
    vehicle = np.concatenate(
        [shown.vehicle, facing, own.angular_speed[:, None], np.tile(kind, (len(obs), 1)), near], axis=1
    )
    pedestrians = np.zeros((*shown.pedestrians.shape[:2], PEDESTRIAN_AHEAD))
    pedestrians[..., :PEDESTRIAN_FEATURES] = shown.pedestrians
    if obs.pedestrians.seen.shape[1] > 0:
        pedestrians[..., PEDESTRIAN_FEATURES:] = _ahead(obs, shown, ahead)
    return shown._replace(vehicle=vehicle, pedestrians=pedestrians)


def _ahead(obs: Observation, shown: Features, ahead: Positions) -> Float[np.ndarray, "world nearest numbers"]:
    """Return numbers on each shown pedestrian's future and its observation; 0 where there is no pedestrian."""
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
