"""What a policy is shown: the vehicle and the nearest pedestrians in the frame of the goal.

The frame has its origin at the vehicle and its x axis towards the local goal (`crowdbench.geometry.local_goals`), so
that a policy need not learn what turning the whole scene changes. The pedestrians are the nearest that are seen,
nearest first, so that a crowd of any size has features of the same size.

    vehicle:     distance to the goal, velocity x, velocity y, preferred speed, radius
    pedestrian:  position x, position y, velocity relative to the vehicle x, y, velocity x, y, gap, radius

in metres and m/s. A gap is the distance between two rims.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import no_type_check

import numpy as np
from jaxtyping import Bool, Float, Int

from crowdbench.compiled import njit
from crowdbench.types import Observation

VEHICLE_FEATURES = 5
"""Numbers about the vehicle."""

PEDESTRIAN_FEATURES = 8
"""Numbers about each pedestrian."""

LEAST_DISTANCE = 1e-9
"""Distance in metres to the goal below which the frame of the goal is that of the world."""


@dataclass(frozen=True)
class Features:
    """What a policy is shown.

    Attributes:
        vehicle: About the vehicle.
        pedestrians: About the nearest pedestrians, 0 where there are fewer.
        seen: Which of these pedestrians there are.
        index: Which pedestrian of the observation each of them is; -1 where there is none.
        axis: The direction of the goal, a unit vector along the axes of the world.
    """

    vehicle: Float[np.ndarray, "world features"]
    pedestrians: Float[np.ndarray, "world nearest others"]
    seen: Bool[np.ndarray, "world nearest"]
    index: Int[np.ndarray, "world nearest"]
    axis: Float[np.ndarray, "world 2"]


def features(obs: Observation, nearest: int) -> Features:
    """The features of an observation.

    Args:
        obs: What the vehicle sees.
        nearest: How many pedestrians are shown, at most.

    Returns:
        The features.
    """
    worlds = len(obs)
    found = Features(
        vehicle=np.empty((worlds, VEHICLE_FEATURES)),
        pedestrians=np.zeros((worlds, nearest, PEDESTRIAN_FEATURES)),
        seen=np.zeros((worlds, nearest), bool),
        index=np.full((worlds, nearest), -1),
        axis=np.empty((worlds, 2)),
    )
    vehicle, crowd = obs.vehicle, obs.pedestrians
    _fill(
        vehicle.position,
        vehicle.velocity,
        vehicle.local_goal,
        vehicle.preferred_speed,
        vehicle.radius,
        crowd.position,
        crowd.velocity,
        crowd.radius,
        crowd.seen,
        found.vehicle,
        found.pedestrians,
        found.seen,
        found.index,
        found.axis,
    )
    return found


def histories(obs: Observation, found: Features) -> Float[np.ndarray, "world time nearest 2"]:
    """The last positions of the pedestrians in the frame of the goal, in metres; 0 where there is none.

    Args:
        obs: What the vehicle sees.
        found: Its features.

    Returns:
        From the oldest to the current position, as `Observation.pedestrians.history`.
    """
    if obs.pedestrians.history.shape[2] == 0:
        return np.zeros((len(obs), obs.pedestrians.history.shape[1], found.index.shape[1], 2))
    index = np.maximum(found.index, 0)[:, None, :, None]
    past = np.take_along_axis(obs.pedestrians.history, index, axis=2) - obs.vehicle.position[:, None, None]
    c, s = found.axis[:, None, None, 0], found.axis[:, None, None, 1]
    turned = np.stack([c * past[..., 0] + s * past[..., 1], c * past[..., 1] - s * past[..., 0]], axis=-1)
    return np.where(found.seen[:, None, :, None], turned, 0.0)


def direction(
    position: Float[np.ndarray, "world 2"], goal: Float[np.ndarray, "world 2"]
) -> Float[np.ndarray, "world 2"]:
    """The direction of the goal, a unit vector along the axes of the world, as `features` has it.

    Args:
        position: Positions of vehicles in metres.
        goal: Their goals in metres.
    """
    way = goal - position
    distance = np.sqrt((way**2).sum(axis=1, keepdims=True))
    near = distance > LEAST_DISTANCE
    return np.where(near, way / np.where(near, distance, 1.0), [1.0, 0.0])


def to_world(action: Float[np.ndarray, "world 2"], axis: Float[np.ndarray, "world 2"]) -> Float[np.ndarray, "world 2"]:
    """Turn vectors from the frame of the goal into the axes of the world.

    Args:
        action: Vectors in the frame of the goal.
        axis: The direction of the goal, as `Features` has it.

    Returns:
        The same vectors along the axes of the world.
    """
    x, y = action[:, :1], action[:, 1:]
    return x * axis + y * np.stack([-axis[:, 1], axis[:, 0]], axis=1)


def in_disc(action: Float[np.ndarray, "world 2"], radius: Float[np.ndarray, "world"]) -> Float[np.ndarray, "world 2"]:
    """Actions of a largest length: longer ones are shortened.

    Args:
        action: Vectors.
        radius: The largest length of each.
    """
    length = np.sqrt((action**2).sum(axis=1))
    return action / np.maximum(length / radius, 1.0)[:, None]


@no_type_check
@njit
def _fill(position, velocity, goal, speed, radius, others, motion, radii, seen, own, rows, shown, index, axis):
    """Fill features.

    Args:
        position: `[world, 2]`, of the vehicle, in metres.
        velocity: `[world, 2]`, in m/s.
        goal: `[world, 2]`, in metres.
        speed: `[world]`, its preferred speed in m/s.
        radius: `[world]`, in metres.
        others: `[world, pedestrian, 2]`, positions in metres.
        motion: `[world, pedestrian, 2]`, velocities in m/s.
        radii: `[world, pedestrian]`, in metres.
        seen: `[world, pedestrian]`.
        own: `[world, 5]`, filled.
        rows: `[world, nearest, 8]`, zeros, filled.
        shown: `[world, nearest]`, False, filled.
        index: `[world, nearest]`, -1, filled.
        axis: `[world, 2]`, filled.
    """
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
        # Stable, so that pedestrians at the same distance stand in their own order in any batch.
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
            shown[w, k], index[w, k] = True, p
