"""Topics of ROS 2 over DDS (Cyclone DDS), without ROS: types, qualities of service, writers and readers.

Nodes of ROS 2 use topics `rt/NAME` and types `PACKAGE::msg::dds_::TYPE_`. The fields of the messages come from rosbags.
"""

from __future__ import annotations

import functools
import os
from collections.abc import Iterable, Mapping
from dataclasses import field, make_dataclass
from pathlib import Path
from typing import Any

from cyclonedds.core import DDSException, InstanceState, ReadCondition, SampleState, ViewState, WaitSet
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct, types
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration
from rosbags.interfaces import Nodetype

from crowdbench import InputError
from crowdbench.export import ros_typestore
from crowdbench.utils import describe_error

LOOPBACK = Path(__file__).with_name("loopback.xml")
"""Configuration of Cyclone DDS for this machine alone, the default."""

TOPICS: Mapping[str, str] = {
    "clock": "rosgraph_msgs/msg/Clock",
    "odom": "nav_msgs/msg/Odometry",
    "tf": "tf2_msgs/msg/TFMessage",
    "tf_static": "tf2_msgs/msg/TFMessage",
    "people": "people_msgs/msg/People",
    "scan": "sensor_msgs/msg/LaserScan",
    "map": "nav_msgs/msg/OccupancyGrid",
    "goal_pose": "geometry_msgs/msg/PoseStamped",
    "cmd_vel": "geometry_msgs/msg/Twist",
    "crowdbench/state": "std_msgs/msg/String",
}
"""The types of the messages by topic."""

LATCHED = ("tf_static", "map")
"""Topics whose last message is also sent to readers that come later."""

DEPTH = 10
"""Number of messages that a writer and a reader keep."""

_SIZED = {"float32", "float64", "int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64"}


@functools.cache
def ros_type(name: str) -> Any:
    """Return the DDS type of a message, such as `geometry_msgs/msg/Twist`. Its fields are zero or empty by default."""
    _, fields = ros_typestore().fielddefs[name]
    package, kind, base = name.split("/")
    columns = []
    for label, node in fields:
        annotation, make = _annotation(node)
        columns.append((label, annotation, field(default_factory=make)))
    name_in_dds = {"__idl_typename__": f"{package}.{kind}.dds_.{base}_"}
    return make_dataclass(base, columns, bases=(IdlStruct,), namespace=name_in_dds)


def message(name: str, /, **fields: Any) -> Any:
    """Return a message of a type, such as `geometry_msgs/Twist`, with the given fields."""
    return ros_type(name.replace("/", "/msg/"))(**fields)


def _annotation(node: Any) -> tuple[Any, Any]:
    """Return the type of a field for Cyclone DDS, and a function that makes its default value."""
    kind, content = node
    if kind == Nodetype.NAME:
        return (made := ros_type(content)), made
    if kind == Nodetype.BASE:
        plain = {"string": str, "bool": bool}.get(content[0])
        if plain:
            return plain, plain
        number = getattr(types, content[0] if content[0] in _SIZED else "uint8")
        return number, float if content[0].startswith("float") else int
    inner, length = content
    annotation, make = _annotation(inner)
    if kind == Nodetype.ARRAY:
        return types.array[annotation, length], lambda: [make() for _ in range(length)]
    return types.sequence[annotation], list


class Topics:
    """Writers and readers of topics.

    The domain is `ROS_DOMAIN_ID`, as in ROS 2. Without `CYCLONEDDS_URI`, all traffic stays on this machine.

    Args:
        written: The topics to write, of `TOPICS`.
        read: The topics to read.

    Raises:
        InputError: Cyclone DDS cannot use the network, or its configuration is wrong.
    """

    def __init__(self, written: Iterable[str], read: Iterable[str]) -> None:
        os.environ.setdefault("CYCLONEDDS_URI", LOOPBACK.as_uri())
        domain = os.environ.get("ROS_DOMAIN_ID", "0")
        try:
            participant = DomainParticipant(int(domain))
        except (DDSException, ValueError) as error:
            where = f"CYCLONEDDS_URI={os.environ['CYCLONEDDS_URI']} and ROS_DOMAIN_ID={domain}"
            raise InputError(f"Cyclone DDS does not start with {where}: {describe_error(error)}") from None
        self.waits = WaitSet(participant)
        self.writers, self.readers = {}, {}
        for topic in written:
            self.writers[topic] = DataWriter(participant, _dds_topic(participant, topic), qos=_qos(topic))
        for topic in read:
            reader = DataReader(participant, _dds_topic(participant, topic), qos=_qos(topic))
            self.readers[topic] = reader
            self.waits.attach(ReadCondition(reader, ViewState.Any | InstanceState.Any | SampleState.NotRead))

    def write(self, topic: str, content: Any) -> None:
        """Send a message."""
        self.writers[topic].write(content)

    def take(self, topic: str) -> list[Any]:
        """Return the messages that have arrived since the last call, the oldest first."""
        taken = self.readers[topic].take(N=DEPTH)
        return [content for content in taken if isinstance(content, IdlStruct)]

    def wait(self, seconds: float) -> None:
        """Wait until a message arrives, or for some time."""
        self.waits.wait(duration(seconds=max(0.0, seconds)))


def _dds_topic(participant: DomainParticipant, topic: str) -> Topic:
    return Topic(participant, f"rt/{topic}", ros_type(TOPICS[topic]))


def _qos(topic: str) -> Qos:
    """Return the default quality of service of rclpy; latched topics are transient local."""
    kept = Policy.Durability.TransientLocal if topic in LATCHED else Policy.Durability.Volatile
    depth = 1 if topic in LATCHED else DEPTH
    reliable = Policy.Reliability.Reliable(duration(milliseconds=100))
    return Qos(reliable, kept, Policy.History.KeepLast(depth))
