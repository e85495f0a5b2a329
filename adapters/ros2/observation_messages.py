"""Messages of ROS 2 for the observation of one world.

The frame `odom` equals `map`: localisation is exact.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable
from typing import Any

import numpy as np
from jaxtyping import Float
from PIL import Image, ImageDraw
from topics import message

from crowdbench import Observation, Rules
from crowdbench.core import Pedestrians

FRAME, ODOM, ROBOT = "map", "odom", "base_link"

SECOND = 10**9
"""Nanoseconds in a second."""

RADIUS = "radius"
"""The tag of `people_msgs/Person` with the radius of a pedestrian in metres."""

RESOLUTION, MARGIN = 0.05, 1.0
"""Length of a cell of `/map`, and free space around its obstacles, in metres."""


def stamp_of(nanoseconds: int) -> Any:
    """Return a time as a message."""
    sec, nanosec = divmod(nanoseconds, SECOND)
    return message("builtin_interfaces/Time", sec=sec, nanosec=nanosec)


def nanoseconds_of(stamp: Any) -> int:
    """Return a time from a message in nanoseconds."""
    return stamp.sec * SECOND + stamp.nanosec


def _header(now: int, frame: str) -> Any:
    return message("std_msgs/Header", stamp=stamp_of(now), frame_id=frame)


def _point(xy: Float[np.ndarray, "2"], kind: str = "Point") -> Any:
    return message(f"geometry_msgs/{kind}", x=float(xy[0]), y=float(xy[1]))


def _rotation(yaw: float) -> Any:
    return message("geometry_msgs/Quaternion", z=math.sin(yaw / 2.0), w=math.cos(yaw / 2.0))


def _pose(xy: Float[np.ndarray, "2"], yaw: float) -> Any:
    return message("geometry_msgs/Pose", position=_point(xy), orientation=_rotation(yaw))


def clock_message(now: int) -> Any:
    """Return a time as a message for `/clock`."""
    return message("rosgraph_msgs/Clock", clock=stamp_of(now))


def transform_message(now: int, parent: str, child: str, xy: Float[np.ndarray, "2"], yaw: float) -> Any:
    """Return the pose of a frame in its parent as a message for `/tf`."""
    transform = message("geometry_msgs/Transform", translation=_point(xy, "Vector3"), rotation=_rotation(yaw))
    link = message(
        "geometry_msgs/TransformStamped", header=_header(now, parent), child_frame_id=child, transform=transform
    )
    return message("tf2_msgs/TFMessage", transforms=[link])


def observation_messages(obs: Observation, names: list[str], now: int) -> dict[str, Any]:
    """Return the messages of an observation of one world by topic.

    Args:
        obs: The observation.
        names: The names of the pedestrians that are seen.
        now: The time in nanoseconds.
    """
    vehicle = obs.vehicle
    heading, turn = float(vehicle.heading[0]), float(vehicle.angular_speed[0])
    velocity = message("geometry_msgs/Vector3", **dict(zip("xy", turned(vehicle.velocity[0], -heading), strict=True)))
    twist = message("geometry_msgs/Twist", linear=velocity, angular=message("geometry_msgs/Vector3", z=turn))
    moving = {
        "header": _header(now, ODOM),
        "child_frame_id": ROBOT,
        "pose": message("geometry_msgs/PoseWithCovariance", pose=_pose(vehicle.position[0], heading)),
        "twist": message("geometry_msgs/TwistWithCovariance", twist=twist),
    }
    messages = {
        "clock": clock_message(now),
        "tf": transform_message(now, ODOM, ROBOT, vehicle.position[0], heading),
        "people": _people(obs.pedestrians, names, now),
        "odom": message("nav_msgs/Odometry", **moving),
    }
    if obs.lidar is not None:
        messages["scan"] = _scan(obs, now)
    return messages


def turned(xy: Iterable[float], angle: float) -> tuple[float, float]:
    """Return a vector that is rotated by an angle."""
    cos, sin = math.cos(angle), math.sin(angle)
    x, y = map(float, xy)
    return cos * x - sin * y, sin * x + cos * y


def goal_message(obs: Observation, now: int) -> Any:
    """Return the vehicle's goal as a message for `/goal_pose`."""
    return message("geometry_msgs/PoseStamped", header=_header(now, FRAME), pose=_pose(obs.vehicle.goal[0], 0.0))


def state_message(obs: Observation, start: int, now: int, lockstep: bool) -> Any:
    """Return everything else that a planner observes, as JSON for `/crowdbench/state`.

    Args:
        obs: The observation.
        start: The time in nanoseconds at which the case started.
        now: The time in nanoseconds.
        lockstep: True if the simulator waits for each command.
    """
    vehicle = obs.vehicle
    rules = Rules(
        dt=obs.dt,
        dynamics=vehicle.dynamics,
        actuation=vehicle.actuation,
        goal_tolerance=vehicle.goal_tolerance,
        body=vehicle.body,
        sensor=obs.sensor,
    )
    route = vehicle.route[0]
    state = {
        "stamp": now,
        "start": start,
        "step": int(obs.step[0]),
        "lockstep": lockstep,
        "map": bool(np.isfinite(obs.obstacles).any()),
        "noise_key": int(obs.noise_key[0]),
        "rules": rules.to_table(),
        "radius": float(vehicle.radius[0]),
        "preferred_speed": float(vehicle.preferred_speed[0]),
        "route": route[np.isfinite(route[:, 0])].tolist(),
        "waypoint": int(vehicle.waypoint[0]),
    }
    return message("std_msgs/String", data=json.dumps(state))


def _people(crowd: Pedestrians, names: list[str], now: int) -> Any:
    people = [
        message(
            "people_msgs/Person",
            name=name,
            position=_point(crowd.position[0, k]),
            velocity=_point(crowd.velocity[0, k]),
            reliability=float(crowd.age[0, k] == 0.0),
            tagnames=[RADIUS],
            tags=[repr(float(crowd.radius[0, k]))],
        )
        for name, k in zip(names, np.flatnonzero(crowd.seen[0]).tolist(), strict=True)
    ]
    return message("people_msgs/People", header=_header(now, FRAME), people=people)


def _scan(obs: Observation, now: int) -> Any:
    """Return a scan counter-clockwise from the heading. A beam that meets nothing is infinite."""
    assert obs.lidar is not None
    assert obs.sensor.lidar is not None
    far, step = obs.sensor.lidar.range, 2.0 * math.pi / obs.lidar.shape[1]
    return message(
        "sensor_msgs/LaserScan",
        header=_header(now, ROBOT),
        angle_max=2.0 * math.pi - step,
        angle_increment=step,
        scan_time=obs.dt,
        range_max=far,
        ranges=np.where(obs.lidar[0] < far, obs.lidar[0], math.inf).tolist(),
    )


def map_message(obstacles: Float[np.ndarray, "polygon corner 2"], now: int) -> Any:
    """Return obstacles as a grid for `/map`: 100 in a cell with an obstacle, 0 elsewhere."""
    polygons = [corners[np.isfinite(corners[:, 0])] for corners in obstacles]
    polygons = [corners for corners in polygons if len(corners)]
    points = np.concatenate(polygons)
    low = points.min(axis=0) - MARGIN
    width, height = np.ceil((points.max(axis=0) + MARGIN - low) / RESOLUTION).astype(int).tolist()
    image = Image.new("L", (width, height))
    draw = ImageDraw.Draw(image)
    for corners in polygons:
        cells = [tuple(cell) for cell in np.floor((corners - low) / RESOLUTION).tolist()]
        if len(cells) > 2:
            draw.polygon(cells, fill=100, outline=100)
        else:
            draw.line(cells, fill=100)
    info = message("nav_msgs/MapMetaData", resolution=RESOLUTION, width=width, height=height, origin=_pose(low, 0.0))
    return message("nav_msgs/OccupancyGrid", header=_header(now, FRAME), info=info, data=list(image.getdata()))
