"""Input of a policy: the vehicle and the nearest pedestrians in the frame of the goal.

The frame has its origin at the vehicle and its x axis towards the local goal (`core.geometry.local_goals`), so that the
features do not change when the whole scene is rotated. The pedestrians are the nearest visible ones, nearest first, so
that a crowd of any size has features of the same size.

    vehicle:     distance to the goal, velocity x, velocity y, preferred speed, radius
    pedestrian:  position x, position y, velocity relative to the vehicle x, y, velocity x, y, gap, radius

in metres and m/s. A gap is the distance between two rims.
"""

from __future__ import annotations

from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Bool, Float, Int

from crowdbench.core.types import Observation
from crowdbench.utils.compiled import njit

Vectors = Float[np.ndarray, "world 2"]

VEHICLE_FEATURES = 5
"""Numbers about the vehicle."""

PEDESTRIAN_FEATURES = 8
"""Numbers about each pedestrian."""

LEAST_DISTANCE = 1e-9
"""Distance in metres to the goal below which the frame of the goal is that of the world."""


class Features(NamedTuple):
    """Input of a policy.

    Attributes:
        vehicle: About the vehicle.
        pedestrians: About the nearest pedestrians, 0 in empty rows.
        seen: True for rows with a pedestrian, False for empty rows.
        which: Index of each of these pedestrians in the observation; -1 in empty rows.
        axis: The direction of the goal, a unit vector along the axes of the world.
    """

    vehicle: Float[np.ndarray, "world features"]
    pedestrians: Float[np.ndarray, "world nearest others"]
    seen: Bool[np.ndarray, "world nearest"]
    which: Int[np.ndarray, "world nearest"]
    axis: Vectors


def features(obs: Observation, nearest: int) -> Features:
    """Return the features of an observation.

    Args:
        nearest: Largest number of pedestrians.
    """
    worlds, crowd = len(obs), obs.pedestrians
    filled = Features(
        vehicle=np.empty((worlds, VEHICLE_FEATURES)),
        pedestrians=np.zeros((worlds, nearest, PEDESTRIAN_FEATURES)),
        seen=np.zeros((worlds, nearest), bool),
        which=np.full((worlds, nearest), -1),
        axis=np.empty((worlds, 2)),
    )
    own = obs.vehicle
    # As single arrays: numba takes longer to enter a kernel with tuples of arrays.
    vehicles = own.position, own.velocity, own.local_goal, own.radius, own.preferred_speed
    _fill(*vehicles, crowd.position, crowd.velocity, crowd.radius, crowd.seen, *filled)
    return filled


def histories(obs: Observation, view: Features) -> Float[np.ndarray, "world time nearest 2"]:
    """Return the last positions of the pedestrians in the frame of the goal, in metres; 0 in empty rows.

    Returns:
        From the oldest to the current position, as `Observation.pedestrians.history`.
    """
    if obs.pedestrians.history.shape[2] == 0:
        return np.zeros((len(obs), obs.pedestrians.history.shape[1], view.which.shape[1], 2))
    index = np.maximum(view.which, 0)[:, None, :, None]
    past = np.take_along_axis(obs.pedestrians.history, index, axis=2) - obs.vehicle.position[:, None, None]
    return np.where(view.seen[:, None, :, None], to_goal_frame(past, view.axis), 0.0)


def to_goal_frame(vectors: Float[np.ndarray, "world *k 2"], axis: Vectors) -> Float[np.ndarray, "world *k 2"]:
    """Turn vectors from the axes of the world into the frame of the goal, whose direction is `axis`."""
    each_world = (-1, *[1] * (vectors.ndim - 2))
    cosine, sine = axis[:, 0].reshape(each_world), axis[:, 1].reshape(each_world)
    x, y = vectors[..., 0], vectors[..., 1]
    return np.stack([cosine * x + sine * y, cosine * y - sine * x], axis=-1)


def direction(position: Vectors, goal: Vectors) -> Vectors:
    """Return the direction of the goal, a unit vector along the axes of the world, as in `features`.

    Args:
        position: Positions of vehicles in metres.
        goal: Their goals in metres.
    """
    way = goal - position
    distance = np.sqrt((way**2).sum(axis=1, keepdims=True))
    near = distance > LEAST_DISTANCE
    return np.where(near, way / np.where(near, distance, 1.0), [1.0, 0.0])


def to_world(action: Vectors, axis: Vectors) -> Vectors:
    """Turn vectors from the frame of the goal into the axes of the world.

    Args:
        action: Vectors in the frame of the goal.
        axis: The direction of the goal, as in `Features`.

    Returns:
        The same vectors along the axes of the world.
    """
    x, y = action[:, :1], action[:, 1:]
    return x * axis + y * np.stack([-axis[:, 1], axis[:, 0]], axis=1)


def clip_to_disc(action: Vectors, radius: Float[np.ndarray, "world"]) -> Vectors:
    """Return actions of limited length: longer ones are shortened.

    Args:
        radius: The largest length of each.
    """
    length = np.sqrt((action**2).sum(axis=1))
    return action / np.maximum(length / radius, 1.0)[:, None]


@no_type_check
@njit
def _fill(position, velocity, goal, radius, speed, others, motion, radii, seen, own, rows, visible, index, axis):
    """Fill `own`, `rows`, `visible`, `index` and `axis`, the arrays of `Features`, of vehicles among pedestrians."""
    gap = np.empty(seen.shape[1])
    for w in range(len(own)):
        x, y = goal[w, 0] - position[w, 0], goal[w, 1] - position[w, 1]
        distance = np.sqrt(x * x + y * y)
        c, s = (x / distance, y / distance) if distance > LEAST_DISTANCE else (1.0, 0.0)
        axis[w, 0], axis[w, 1] = c, s
        vx, vy = velocity[w, 0], velocity[w, 1]
        own[w, 0] = distance
        own[w, 1], own[w, 2] = c * vx + s * vy, c * vy - s * vx
        own[w, 3], own[w, 4] = speed[w], radius[w]
        for p in range(len(gap)):
            dx, dy = others[w, p, 0] - position[w, 0], others[w, p, 1] - position[w, 1]
            gap[p] = np.sqrt(dx * dx + dy * dy) - radii[w, p] - radius[w] if seen[w, p] else np.inf
        # Stable, so that pedestrians with the same gap keep their order in any batch.
        order = np.argsort(gap, kind="mergesort")
        for k in range(min(len(order), rows.shape[1])):
            p = order[k]
            if not seen[w, p]:
                break
            row = rows[w, k]
            dx, dy = others[w, p, 0] - position[w, 0], others[w, p, 1] - position[w, 1]
            row[0], row[1] = c * dx + s * dy, c * dy - s * dx
            row[4], row[5] = c * motion[w, p, 0] + s * motion[w, p, 1], c * motion[w, p, 1] - s * motion[w, p, 0]
            row[2], row[3] = row[4] - own[w, 1], row[5] - own[w, 2]
            row[6], row[7] = gap[p], radii[w, p]
            visible[w, k], index[w, k] = True, p
