"""Writes episodes as ROS 2 bags, for RViz and Foxglove: `/odom`, `/tf`, `/people` and `/goal` in the frame `map`.

`adapters/ros2` reads such bags, and bags of robots.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from crowdbench.core.types import Trace
from crowdbench.utils.errors import InputError

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

PEOPLE_MSGS = {
    "people_msgs/msg/Person": "string name\ngeometry_msgs/Point position\ngeometry_msgs/Point velocity\n"
    "float64 reliability\nstring[] tagnames\nstring[] tags\n",
    "people_msgs/msg/People": "std_msgs/Header header\npeople_msgs/Person[] people\n",
}
"""The messages of the ROS package people_msgs, by their types."""

FRAME, ROBOT = "map", "base_link"

NANOSECONDS = 10**9


def ros_typestore() -> Typestore:
    """Return the types of messages of the latest ROS 2 and of people_msgs.

    Raises InputError if the extra `ros` is not installed.
    """
    try:
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore
    except ImportError:
        raise InputError("ROS bags need the package rosbags: pip install 'crowdbench[ros]'") from None
    store = get_typestore(Stores.LATEST)
    for name, text in PEOPLE_MSGS.items():
        store.register(get_types_from_msg(text, name))
    return store


def write_bag(trace: Trace, row: int, path: Path) -> None:
    """Write one episode as a bag with MCAP storage, a message of each topic per state.

    Args:
        trace: The trace with the episode.
        row: Its row in the trace.
        path: The folder of the bag, which must not exist.

    Raises:
        InputError: The extra `ros` is not installed.
    """
    store = ros_typestore()
    from rosbags.rosbag2 import StoragePlugin, Writer

    topics = {
        "/odom": "nav_msgs/msg/Odometry",
        "/tf": "tf2_msgs/msg/TFMessage",
        "/people": "people_msgs/msg/People",
        "/goal": "geometry_msgs/msg/PoseStamped",
    }
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = {topic: writer.add_connection(topic, kind, typestore=store) for topic, kind in topics.items()}
        for t in range(int(trace.steps[row]) + 1):
            nanoseconds = round(t * trace.rules.dt * NANOSECONDS)
            for topic, message in _messages(store, trace, row, t, nanoseconds).items():
                writer.write(connections[topic], nanoseconds, store.serialize_cdr(message, topics[topic]))


def _messages(store: Typestore, trace: Trace, row: int, t: int, nanoseconds: int) -> dict[str, Any]:
    """Return the messages of a state by topic."""

    def make(name: str, *fields: Any) -> Any:
        return store.types[name](*fields)

    def point(xy: Iterable[float], kind: str = "Point") -> Any:
        return make(f"geometry_msgs/msg/{kind}", *map(float, xy), 0.0)

    header = make("std_msgs/msg/Header", make("builtin_interfaces/msg/Time", *divmod(nanoseconds, NANOSECONDS)), FRAME)
    position, velocity, heading = trace.position[row, t], trace.velocity[row, t], float(trace.heading[row, t])
    turn = make("geometry_msgs/msg/Quaternion", 0.0, 0.0, math.sin(heading / 2.0), math.cos(heading / 2.0))
    pose = make("geometry_msgs/msg/Pose", point(position[0]), turn)
    cos, sin = math.cos(heading), math.sin(heading)
    forward, left = cos * velocity[0, 0] + sin * velocity[0, 1], cos * velocity[0, 1] - sin * velocity[0, 0]
    twist = make("geometry_msgs/msg/Twist", point((forward, left), "Vector3"), point((0.0, 0.0), "Vector3"))
    moves = make("geometry_msgs/msg/Transform", point(position[0], "Vector3"), turn)
    people = [
        make(
            "people_msgs/msg/Person", str(trace.person[row, t, k]), point(position[1 + k]), point(velocity[1 + k]),
            1.0, [], [],
        )
        for k in np.flatnonzero(trace.present[row, t, 1:]).tolist()
    ]  # fmt: skip
    still = make("geometry_msgs/msg/Quaternion", 0.0, 0.0, 0.0, 1.0)
    goal = make("geometry_msgs/msg/Pose", point(trace.goal[row, t, 0]), still)
    return {
        "/odom": make(
            "nav_msgs/msg/Odometry", header, ROBOT,
            make("geometry_msgs/msg/PoseWithCovariance", pose, np.zeros(36)),
            make("geometry_msgs/msg/TwistWithCovariance", twist, np.zeros(36)),
        ),
        "/tf": make("tf2_msgs/msg/TFMessage", [make("geometry_msgs/msg/TransformStamped", header, ROBOT, moves)]),
        "/people": make("people_msgs/msg/People", header, people),
        "/goal": make("geometry_msgs/msg/PoseStamped", header, goal),
    }  # fmt: skip
