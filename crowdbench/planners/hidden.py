"""A virtual pedestrian at the first occluded point of the route, without any information on real pedestrians."""

from __future__ import annotations

import dataclasses
import math
from typing import no_type_check

import numpy as np

from crowdbench.core.types import Observation
from crowdbench.planners.scene import Crowd, Scene
from crowdbench.sim.lines_of_sight import is_hidden
from crowdbench.utils.compiled import njit

RADIUS = 0.3
"""Radius of the virtual pedestrian in metres, and its largest distance from the route."""

UNTRACKED = 2
"""Steps in which a pedestrian comes out of hiding before a tracker shows it."""

SPEED = 1.2
"""Speed of the virtual pedestrian in m/s in these steps."""

STEP = 0.1
"""Distance in metres between the points of the route that are checked."""


def hidden_scene(obs: Observation, scene: Scene) -> Scene | None:
    """Return the scene with a virtual pedestrian that may be hidden, and without other pedestrians.

    The pedestrian stands at the first point of the route where walls would hide it from the vehicle. It occupies a disc
    that extends `RADIUS` beyond its own disc, and farther with a detector, whose tracks begin late. Worlds in which the
    whole route is visible have no pedestrian.

    Args:
        obs: The present observation.
        scene: The scene with the visible pedestrians.

    Returns:
        The scene; None without walls, or if the vehicle's sensor sees through them.
    """
    if not obs.sensor.occlusion or obs.obstacles.shape[1] == 0:
        return None
    vehicle, worlds = obs.vehicle, len(obs)
    point, exists = np.zeros((worlds, 2)), np.zeros((worlds, 1), np.bool_)
    arrays = vehicle.position, vehicle.goal, vehicle.route, vehicle.waypoint, obs.obstacles
    _find_hidden(*map(np.ascontiguousarray, arrays), point, exists)
    steps = scene.crowd.position.shape[2]
    position = np.ascontiguousarray(np.broadcast_to(point[:, None, None, None], (worlds, 1, steps, 1, 2)))
    radius = 2.0 * RADIUS if obs.sensor.detector is None else 2.0 * RADIUS + UNTRACKED * obs.dt * SPEED
    crowd = Crowd(position, np.zeros((worlds, 1, 1, 2)), np.full((worlds, 1), radius), exists)
    return dataclasses.replace(scene, crowd=crowd)


@no_type_check
@njit(error_model="numpy")
def _find_hidden(position, goal, route, waypoint, obstacles, point, exists):
    """Fill in the first point on the route of each vehicle where a pedestrian would be hidden, if there is one."""
    pair, radius, present = np.empty((2, 2)), np.full(2, RADIUS), np.ones(2, np.bool_)
    for w in range(len(position)):
        x, y, k, ends = position[w, 0], position[w, 1], waypoint[w], False
        pair[0, 0], pair[0, 1] = x, y
        while not (ends or exists[w, 0]):
            ends = k == route.shape[1] or math.isnan(route[w, k, 0])
            to_x, to_y = (goal[w, 0], goal[w, 1]) if ends else (route[w, k, 0], route[w, k, 1])
            number = math.ceil(math.hypot(to_x - x, to_y - y) / STEP)
            for i in range(1, number + 1):
                pair[1, 0], pair[1, 1] = x + i / number * (to_x - x), y + i / number * (to_y - y)
                if is_hidden(1, pair, radius, present, obstacles[w]):
                    point[w, 0], point[w, 1], exists[w, 0] = pair[1, 0], pair[1, 1], True
                    break
            x, y, k = to_x, to_y, k + 1
