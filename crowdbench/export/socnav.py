"""Write episodes as JSON files in the trajectory format of SocNav3 (Bachiller-Burgos et al. 2025, arXiv:2509.01251).

The metric of SocNav3, which was fitted to human ratings, reads this format. No human rated these episodes: the metric
predicts ratings. It also needs a key `context_description`, which the user has to add.

Positions are in metres in the frame of the scenario, angles in radians counter-clockwise from x, speeds in m/s and
rad/s in the same frame. A long vehicle is the rectangle around its discs; its position is the centre. Pedestrians face
in the direction of their last movement, or towards their goal before the first one. The vehicle may arrive with any
heading: the angle of its goal is the direction from its start.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from jaxtyping import Float

from crowdbench.core.dynamics import hull
from crowdbench.core.geometry import norm, wrap_angle
from crowdbench.core.types import Trace
from crowdbench.drawing import extent
from crowdbench.metrics.motion import STANDSTILL
from crowdbench.sim.visibility_graph import edges_of, solids

CELL = 0.25
"""Side of a cell of the occupancy grid in metres."""

ROBOT, PLACE, POSE = ("x", "y", "angle", "speed_x", "speed_y", "speed_a"), ("x", "y"), ("x", "y", "angle")


def write_trajectory(trace: Trace, row: int, path: Path, about: str) -> None:
    """Write the episode in a row of a trace to a file; `about` is the text of its key `metadata`."""
    states, body, dt = slice(trace.steps[row] + 1), trace.rules.body, trace.rules.dt
    position, heading, goal = trace.position[row, states], trace.heading[row, states], trace.goal[row, states, 0]
    radius = float(trace.radius[row, 0, 0])
    centre, _ = hull(body, position[:, 0], heading, np.full(len(heading), radius))
    pose = np.column_stack([centre, heading])
    change = np.diff(pose, axis=0, prepend=pose[:1])
    change[:, 2] = wrap_angle(change[:, 2])
    length = 2.0 * radius + body[-1] - body[0]
    shape = {"type": "circle" if len(body) == 1 else "rectangle", "width": 2.0 * radius, "length": length}
    near, angle = trace.rules.goal_tolerance or radius, math.atan2(*(goal[0] - position[0, 0])[::-1])
    task = {"type": "go-to", "human": None, "angle": angle, "pos_threshold": near, "angle_threshold": math.pi}
    robot = np.concatenate([pose, change / dt], axis=1).tolist()
    people = np.dstack([position[:, 1:], _facing(trace, row)[states]]).tolist()
    sequence = [
        {
            "timestamp": t * dt,
            "robot": {"shape": shape, **dict(zip(ROBOT, robot[t], strict=True))},
            "goal": {**task, **dict(zip(PLACE, goal[t].tolist(), strict=True))},
            "people": [
                {"id": person + 1, **dict(zip(POSE, pose, strict=True))}
                for person, pose in zip(trace.person[row, t].tolist(), people[t], strict=True)
                if math.isfinite(pose[0])
            ],
            "objects": [],
        }
        for t in range(len(position))
    ]
    walls = edges_of(trace.obstacles[row]).reshape(-1, 4).tolist()
    content = {"metadata": about, "grid": _grid(trace, row), "walls": walls, "sequence": sequence}
    path.write_text(json.dumps(content), encoding="utf-8")


def _facing(trace: Trace, row: int) -> Float[np.ndarray, "time pedestrian"]:
    """Return the direction in radians in which each pedestrian last walked, or at first the direction of its goal."""
    velocity, to_goal = trace.velocity[row, :, 1:], (trace.goal - trace.position)[row, :, 1:]
    walks = norm(velocity) >= STANDSTILL
    ahead = np.where(walks[..., None], velocity, to_goal)
    facing = np.arctan2(ahead[..., 1], ahead[..., 0])
    for t in range(1, len(facing)):
        stays = ~walks[t] & (trace.person[row, t] == trace.person[row, t - 1])
        facing[t, stays] = facing[t - 1, stays]
    return facing


def _grid(trace: Trace, row: int) -> dict[str, Any]:
    """Return the occupancy grid of a world, 1 where a cell touches an obstacle, from the largest y downwards."""
    low, high = extent(trace.position[row], trace.goal[row], trace.obstacles[row], 1.0)
    width, height = np.ceil((high - low) / CELL).astype(int).tolist()
    x, y = np.meshgrid(low[0] + CELL * np.arange(width), low[1] + CELL * np.arange(height)[::-1])
    obstacles = shapely.union_all([*solids(trace.obstacles[row]), *shapely.linestrings(edges_of(trace.obstacles[row]))])
    occupied = shapely.intersects(shapely.box(x, y, x + CELL, y + CELL), obstacles)
    numbers = {"width": width, "height": height, "cell_size": CELL, "angle_orig": 0.0}
    return {**numbers, "x_orig": low[0], "y_orig": low[1], "data": occupied.astype(int).tolist()}
