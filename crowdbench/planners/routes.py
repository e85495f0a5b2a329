"""The vehicle's route and its distance to walls, for planners that sample trajectories."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from crowdbench.core.types import Observation

Points = Float[np.ndarray, "world point 2"]


def distance_to_walls(
    points: Points, obstacles: Float[np.ndarray, "world polygon corner 2"]
) -> Float[np.ndarray, "world point"]:
    """Return the distance of each point to the nearest edge of an obstacle, `[world, point]` in metres.

    Args:
        points: In metres.
        obstacles: Polygons in metres, NaN after the last corner.
    """
    following = np.roll(obstacles, -1, axis=2)
    edge = np.where(np.isnan(following), obstacles[:, :, :1], following) - obstacles
    nearest = np.full(points.shape[:2], np.inf)
    for polygon, corner in np.ndindex(obstacles.shape[1:3]):
        offset, along = points - obstacles[:, polygon, corner, None], edge[:, polygon, corner, None]
        share = (offset * along).sum(axis=2) / np.maximum((along**2).sum(axis=2), 1e-12)
        offset -= np.clip(share, 0.0, 1.0)[..., None] * along
        nearest = np.fmin(nearest, np.sqrt((offset**2).sum(axis=2)))
    return nearest


def along_route(obs: Observation, length: Float[np.ndarray, "world time"]) -> Points:
    """Return the points in metres at given lengths along the vehicle's route through its next waypoints to its goal."""
    vehicle, route = obs.vehicle, obs.vehicle.route
    passed = np.arange(route.shape[1]) < vehicle.waypoint[:, None]
    ahead = np.where(passed[..., None], vehicle.position[:, None], route)
    ahead = np.where(np.isnan(ahead), vehicle.goal[:, None], ahead)
    corner = np.concatenate([vehicle.position[:, None], ahead, vehicle.goal[:, None]], axis=1)
    leg = np.diff(corner, axis=1)
    size = np.linalg.norm(leg, axis=2)
    end = size.cumsum(axis=1)
    number = np.minimum((length[..., None] > end[:, None]).sum(axis=2), leg.shape[1] - 1)
    start, leg = (np.take_along_axis(points, number[..., None], axis=1) for points in (corner, leg))
    size, end = (np.take_along_axis(lengths, number, axis=1) for lengths in (size, end))
    share = np.clip(1.0 - (end - length) / np.maximum(size, 1e-9), 0.0, 1.0)
    return start + share[..., None] * leg
