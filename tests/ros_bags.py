"""Bags of a robot that drives past a pedestrian, and their messages."""

import sys
from pathlib import Path

import numpy as np
from rosbags import rosbag2

from crowdbench.export.rosbag import NANOSECONDS, ros_typestore

FOLDER = Path(__file__).parents[1] / "adapters" / "ros2"
sys.path.append(str(FOLDER))

from drive import trace_of as trace_of  # noqa: E402
from drive_file import read_drive_file  # noqa: E402

STORE = ros_typestore()
TOPICS = {
    "/odom": "nav_msgs/msg/Odometry",
    "/goal_pose": "geometry_msgs/msg/PoseStamped",
    "/map": "nav_msgs/msg/OccupancyGrid",
    "/people": "people_msgs/msg/People",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/tf_static": "tf2_msgs/msg/TFMessage",
}


def make(kind, *fields):
    return STORE.types[kind](*fields)


def header(seconds, frame="map"):
    return make(
        "std_msgs/msg/Header",
        make("builtin_interfaces/msg/Time", *divmod(round(seconds * NANOSECONDS), NANOSECONDS)),
        frame,
    )


def pose(x, y, yaw=0.0, kind="Pose"):
    turn = make("geometry_msgs/msg/Quaternion", 0.0, 0.0, np.sin(yaw / 2), np.cos(yaw / 2))
    point = make("geometry_msgs/msg/Point" if kind == "Pose" else "geometry_msgs/msg/Vector3", x, y, 0.0)
    return make(f"geometry_msgs/msg/{kind}", point, turn)


def odometry(seconds, x, y, frame="map"):
    twist = make("geometry_msgs/msg/Twist", *(make("geometry_msgs/msg/Vector3", 0.0, 0.0, 0.0) for _ in range(2)))
    return make(
        "nav_msgs/msg/Odometry",
        header(seconds, frame),
        "base_link",
        make("geometry_msgs/msg/PoseWithCovariance", pose(x, y), np.zeros(36)),
        make("geometry_msgs/msg/TwistWithCovariance", twist, np.zeros(36)),
    )


def people(seconds, *positions, frame="map"):
    point = "geometry_msgs/msg/Point"
    persons = [
        make("people_msgs/msg/Person", name, make(point, x, y, 0.0), make(point, 0.0, 0.0, 0.0), 1.0, [], [])
        for name, x, y in positions
    ]
    return make("people_msgs/msg/People", header(seconds, frame), persons)


def transform(seconds, parent, child, x, y, yaw):
    moved = make("geometry_msgs/msg/TransformStamped", header(seconds, parent), child, pose(x, y, yaw, "Transform"))
    return make("tf2_msgs/msg/TFMessage", [moved])


def bag_of(path, messages, storage="SQLITE3", compression=None):
    """Write a bag of (topic, seconds at which it is recorded, message)."""
    writer = rosbag2.Writer(path, version=9, storage_plugin=rosbag2.StoragePlugin[storage])
    if compression:
        writer.set_compression(rosbag2.CompressionMode[compression], rosbag2.CompressionFormat.ZSTD)
    with writer:
        topics = {
            topic: writer.add_connection(topic, TOPICS[topic], typestore=STORE)
            for topic in dict.fromkeys(topic for topic, _, _ in messages)
        }
        for topic, seconds, message in messages:
            raw = STORE.serialize_cdr(message, TOPICS[topic])
            writer.write(topics[topic], round((seconds + 100.0) * NANOSECONDS), raw)
    return path


def straight(seconds=4.0, frame="map", late=0.0, times=None):
    """A robot at 1 m/s along the x axis, and a pedestrian who stands 2 m beside it."""
    times = np.arange(0.0, seconds + 1e-9, 0.1) if times is None else times
    messages = []
    for t in times.tolist():
        messages.append(("/odom", t, odometry(t + 100.0, t, 0.0, frame)))
        messages.append(("/people", t, people(t + 100.0 - late, ("a", 2.0, 2.0))))
    return messages


VEHICLE = '[vehicle]\nodometry = "/odom"\ngoal = [4.0, 0.0]\n'


def drive_file(folder, bags, more=""):
    file = folder / "drive.toml"
    names = ", ".join(f'"{bag}"' for bag in bags)
    file.write_text(f'planner = "robot"\nbags = [{names}]\ndt = 0.25\n{more}')
    return read_drive_file(file)


def goal_pose(seconds, x, y, frame="map"):
    return make("geometry_msgs/msg/PoseStamped", header(seconds + 100.0, frame), pose(x, y))


def grid(cells, size, origin, frame="map"):
    # Each cell is made of 64, because outlines are simplified by the size of a cell.
    cells, resolution = np.kron(cells, np.ones((8, 8))), size / 8
    info = make(
        "nav_msgs/msg/MapMetaData",
        make("builtin_interfaces/msg/Time", 0, 0),
        resolution,
        cells.shape[1],
        cells.shape[0],
        origin,
    )
    return make("nav_msgs/msg/OccupancyGrid", header(100.0, frame), info, cells.astype(np.int8).reshape(-1))
