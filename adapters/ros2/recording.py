"""Records the messages of a drive as a ROS 2 bag, for `score_bags.py`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from observation_messages import nanoseconds_of
from rosbags.rosbag2 import StoragePlugin, Writer, WriterError
from topics import TOPICS

from crowdbench import InputError
from crowdbench.export import ros_typestore
from crowdbench.utils import describe_error

RECORDED = ("odom", "people", "tf", "tf_static", "goal_pose", "map", "scan")


class Recording:
    """A bag with the messages that commands were computed from, at the times of the odometry.

    Args:
        path: The folder of the bag, which must not exist.

    Raises:
        InputError: The folder exists, or cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self.written: dict[str, Any] = {}
        try:
            self.writer = Writer(path, version=9, storage_plugin=StoragePlugin.MCAP)
            self.writer.open()
        except (WriterError, OSError) as error:
            raise InputError(f"{path} cannot be written as a bag: {describe_error(error)}") from None

    def __enter__(self) -> Recording:
        store = ros_typestore()
        self.connections = {
            topic: self.writer.add_connection(f"/{topic}", TOPICS[topic], typestore=store)
            for topic in (*RECORDED, "cmd_vel")
        }
        return self

    def __exit__(self, *error: object) -> None:
        self.writer.close()

    def add(self, latest: Mapping[str, Any], twist: Any) -> None:
        """Add a command, and the messages that are new since the last one.

        Args:
            latest: The last message of each topic.
            twist: The command.
        """
        if "odom" not in latest:
            return
        now = nanoseconds_of(latest["odom"].header.stamp)
        for topic in RECORDED:
            if topic in latest and latest[topic] is not self.written.get(topic):
                self.written[topic] = latest[topic]
                self.writer.write(self.connections[topic], now, latest[topic].serialize())
        self.writer.write(self.connections["cmd_vel"], now, twist.serialize())
