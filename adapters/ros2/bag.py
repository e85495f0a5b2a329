"""Reads a ROS bag (ROS 2 with sqlite3 or MCAP, or ROS 1) as trajectories on one clock and in one frame.

Positions between two messages lie on the straight line between them, if the messages are no farther apart than
`max_gap`. Everything else that is missing or contradictory is an error.
"""

from __future__ import annotations

import functools
import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
from drive_file import DriveFile
from jaxtyping import Float
from PIL import Image
from rosbags.highlevel import AnyReader, AnyReaderError
from rosbags.typesys import get_types_from_msg

from crowdbench import InputError
from crowdbench.core import norm
from crowdbench.export import ros_typestore
from crowdbench.scenario import Polygon, read_obstacles
from crowdbench.utils import describe_error

Times = Float[np.ndarray, "message"]
Poses = Float[np.ndarray, "message 3"]
"""x and y in metres, and the yaw in radians."""

LARGEST_OFFSET = 1.0
"""Largest difference in seconds between the clocks of two topics, measured by the recording times of their messages."""

FASTEST = 4.0
"""Speed in m/s above which an identity is assumed to have switched to another pedestrian."""


class Trajectory(NamedTuple):
    """Poses over time.

    Attributes:
        time: Times of messages in seconds, ascending.
        pose: The pose at each time.
    """

    time: Times
    pose: Poses

    def at(self, time: Times, max_gap: float, name: str) -> Poses:
        """Return the poses at some times.

        Args:
            time: The times in seconds.
            max_gap: Largest time in seconds between the two messages around a time.
            name: Name of the moving frame, for errors.

        Raises:
            InputError: There is no message near a time.
        """
        after = np.clip(np.searchsorted(self.time, time - 1e-6), 0, len(self.time) - 1)
        before = np.maximum(after - (np.abs(self.time[after] - time) > 1e-6), 0)
        missing = np.maximum(time - self.time[before], self.time[after] - time)
        missing = np.maximum(missing, self.time[after] - self.time[before])
        for k in np.flatnonzero(missing > max_gap + 1e-6)[:1].tolist():
            raise InputError(
                f"there is no message of {name} for {missing[k]:.2f} s around {time[k]:.2f} s, but {max_gap:g} s "
                "(max_gap) may pass without one"
            )
        span = np.maximum(self.time[after] - self.time[before], 1e-12)
        share = np.clip((time - self.time[before]) / span, 0.0, 1.0)[:, None]
        change = self.pose[after] - self.pose[before]
        change[:, 2] = (change[:, 2] + np.pi) % (2.0 * np.pi) - np.pi
        return self.pose[before] + share * change


@dataclass(frozen=True)
class Bag:
    """The used content of a bag; times are in seconds since its first message.

    Attributes:
        robot: Poses of the robot in the fixed frame.
        people: Positions of each pedestrian in the fixed frame, a trajectory for each uninterrupted track.
        observed: The times of the messages about pedestrians.
        goal: The robot's goal in metres in the fixed frame.
        walls: The corners of the obstacles of its map in metres in the fixed frame; none without `map_topic`.
        notes: Sentences on tracks that were split.
    """

    robot: Trajectory
    people: list[Trajectory]
    observed: Times
    goal: Float[np.ndarray, "2"]
    walls: list[Polygon]
    notes: list[str]


def read_bag(path: Path, drive: DriveFile) -> Bag:
    """Read a bag.

    Args:
        path: The folder of a ROS 2 bag, or a file `.mcap`, `.db3` or `.bag`.
        drive: The content of the topics.

    Raises:
        InputError: The bag cannot be read, a topic, a field or a transform is missing, or clocks differ.
    """
    try:
        return _read(path, drive)
    except (AnyReaderError, OSError) as error:
        raise InputError(f"{path} cannot be read as a ROS bag: {describe_error(error)}") from None
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _read(path: Path, drive: DriveFile) -> Bag:
    store = ros_typestore()
    for name, text in drive.message_definitions.items():
        store.register(get_types_from_msg(text, name))
    vehicle, people = drive.vehicle, drive.people
    with AnyReader([path], default_typestore=store) as reader:
        topics = {connection.topic for connection in reader.connections}
        for topic in (vehicle.odometry, people.topic, vehicle.goal_topic, drive.map_topic):
            if topic and topic not in topics:
                raise InputError(f"there is no topic {topic}; the topics are {', '.join(sorted(topics))}")
        begin = 1e-9 * reader.start_time
        messages = functools.partial(_messages, reader, begin)
        transforms = Transforms.read(drive.fixed_frame, messages)
        found = list(messages(people.topic, people.offset))
        observed = np.array([stamp for stamp, _, _ in found])
        delays = {people.topic: np.median([recorded - stamp for stamp, recorded, _ in found] or [0.0])}
        if vehicle.odometry:
            moves = list(messages(vehicle.odometry, vehicle.offset))
            delays[vehicle.odometry] = np.median([recorded - stamp for stamp, recorded, _ in moves] or [0.0])
            time = np.array([stamp for stamp, _, _ in moves])
            local = Trajectory(time, np.array([_pose(message.pose.pose) for _, _, message in moves]).reshape(-1, 3))
            frame = moves[0][2].header.frame_id if moves else drive.fixed_frame
            robot = Trajectory(time, _compose(transforms.at(frame, time, drive.max_gap), local.pose))
        else:
            time = transforms.times(vehicle.frame)
            robot = Trajectory(time, transforms.at(vehicle.frame, time, drive.max_gap))
        goal = _goal(list(messages(vehicle.goal_topic, 0.0)), drive, transforms)
        maps = list(messages(drive.map_topic, 0.0))
    _check_clocks(delays)
    if len(robot.time) < 2:
        raise InputError("it has no two poses of the robot")
    if (np.diff(robot.time) < 0.0).any() or (np.diff(observed) < 0.0).any():
        raise InputError("the times of its messages go back: record the bag with one clock (use_sim_time)")
    tracks, notes = _tracks(found, drive, transforms)
    walls = grid_obstacles(maps[-1][2], functools.partial(_place, transforms, maps[-1], drive)) if maps else []
    return Bag(robot, tracks, observed, goal, walls, notes)


def _place(
    transforms: Transforms, found: tuple[float, float, Any], drive: DriveFile, pose: tuple[float, float, float]
) -> tuple[float, float, float]:
    """Transform a pose from a message's frame to the fixed frame, at the time of the message."""
    time, _, message = found
    frame = transforms.at(message.header.frame_id, np.array([time]), drive.max_gap)
    x, y, yaw = _compose(frame, np.array([pose]))[0].tolist()
    return x, y, yaw


def _goal(found: list[tuple[float, float, Any]], drive: DriveFile, transforms: Transforms) -> Float[np.ndarray, "2"]:
    """Return the goal of a drive. Raises InputError if its topic has no message, or different goals."""
    if drive.vehicle.goal:
        return np.array(drive.vehicle.goal)
    goals = np.array([_place(transforms, one, drive, _pose(one[2].pose))[:2] for one in found]).reshape(-1, 2)
    if not len(goals):
        raise InputError(f"{drive.vehicle.goal_topic} has no message: give goal in [vehicle]")
    for k in np.flatnonzero(norm(goals - goals[0]) > drive.vehicle.goal_tolerance)[:1].tolist():
        raise InputError(f"the goal changes at {found[k][0]:.2f} s: cut the bag there, because a case has one goal")
    return goals[-1]


def grid_obstacles(
    message: Any, place: Callable[[tuple[float, float, float]], tuple[float, float, float]]
) -> list[Polygon]:
    """Return the obstacles of a message `nav_msgs/OccupancyGrid`, as for a file `map.yaml`.

    Args:
        message: The message. Cells with an occupancy above 65 % are occupied, unknown ones are not.
        place: Transforms the pose of its lower left corner to the fixed frame.

    Raises:
        InputError: No cell is occupied, or there are too many corners.
    """
    info = message.info
    cells = np.asarray(message.data).reshape(info.height, info.width).astype(np.int8).view(np.uint8)
    with TemporaryDirectory() as folder:
        Image.fromarray(np.ascontiguousarray(cells[::-1])).save(Path(folder) / "map.png")
        origin = json.dumps(place(_pose(info.origin)))
        file = Path(folder) / "map.yaml"
        file.write_text(f"image: map.png\nresolution: {info.resolution}\norigin: {origin}\nmode: raw\n")
        return read_obstacles(file)


def _messages(reader: AnyReader, begin: float, topic: str, offset: float) -> Iterator[tuple[float, float, Any]]:
    """Yield the messages of a topic: stamp and time of recording in seconds since `begin`, and the message."""
    connections = [connection for connection in reader.connections if connection.topic == topic]
    for connection, recorded, raw in reader.messages(connections) if connections else ():
        message = reader.deserialize(raw, connection.msgtype)
        stamp = getattr(getattr(message, "header", None), "stamp", None)
        time = 1e-9 * recorded if stamp is None else stamp.sec + 1e-9 * stamp.nanosec
        yield time - begin + offset, 1e-9 * recorded - begin, message


def _check_clocks(delays: Mapping[str, float]) -> None:
    """Raise InputError if the stamps of two topics come from different clocks."""
    first, last = min(delays, key=delays.__getitem__), max(delays, key=delays.__getitem__)
    if delays[last] - delays[first] > LARGEST_OFFSET:
        raise InputError(
            f"the clock of {last} is {delays[last] - delays[first]:.2f} s behind that of {first}: correct it with "
            f"offset = {delays[last] - delays[first]:.2f} in the table of {last}"
        )


class Transforms:
    """The transforms of `/tf` and `/tf_static`, on a plane.

    Args:
        fixed: The frame in which everything is scored.
        links: For each frame its parent, its poses in the parent, and whether the transform is static.
    """

    def __init__(self, fixed: str, links: Mapping[str, tuple[str, Trajectory, bool]]) -> None:
        self.fixed, self.links = fixed, links

    @classmethod
    def read(cls, fixed: str, messages: functools.partial[Iterator[tuple[float, float, Any]]]) -> Transforms:
        """Read all transforms of a bag."""
        samples: dict[tuple[str, str], list[tuple[float, ...]]] = {}
        static = set()
        for topic in ("/tf", "/tf_static"):
            for recorded, _, message in messages(topic, 0.0):
                for one in message.transforms:
                    child = one.child_frame_id
                    stamp = one.header.stamp.sec + 1e-9 * one.header.stamp.nanosec
                    samples.setdefault((child, one.header.frame_id), []).append(
                        (stamp, recorded, *_pose(one.transform, "translation", "rotation"))
                    )
                    static |= {child} if topic == "/tf_static" else set()
        begin = min((rows[0][0] - rows[0][1] for rows in samples.values()), default=0.0)
        links = {}
        for (child, parent), rows in samples.items():
            table = np.array(sorted(rows))
            links[child] = parent, Trajectory(table[:, 0] - begin, table[:, 2:]), child in static
        return cls(fixed, links)

    def times(self, frame: str) -> Times:
        """Return the times of the transforms of a frame."""
        if frame not in self.links:
            raise InputError(f"/tf has no frame {frame!r}; it has {', '.join(sorted(self.links)) or 'none'}")
        return self.links[frame][1].time

    def at(self, frame: str, time: Times, max_gap: float) -> Poses:
        """Return the poses of a frame in the fixed frame.

        Raises:
            InputError: No chain of transforms leads to the fixed frame, or it has a gap.
        """
        pose, here = np.zeros((len(time), 3)), frame
        while here != self.fixed:
            if here not in self.links:
                raise InputError(
                    f"/tf has no transform from {frame!r} to {self.fixed!r} (fixed_frame): it ends at {here!r}"
                )
            parent, link, is_static = self.links[here]
            step = np.repeat(link.pose[-1:], len(time), axis=0) if is_static else link.at(time, max_gap, f"/tf {here}")
            pose, here = _compose(step, pose), parent
        return pose


def _compose(first: Poses, second: Poses) -> Poses:
    """Compose poses: `second` is given in moving frames with the poses `first`."""
    cos, sin = np.cos(first[:, 2]), np.sin(first[:, 2])
    x, y, yaw = second.T
    return np.stack([first[:, 0] + cos * x - sin * y, first[:, 1] + sin * x + cos * y, first[:, 2] + yaw], axis=1)


def _pose(message: Any, position: str = "position", rotation: str = "orientation") -> tuple[float, float, float]:
    """Return x, y and yaw of a message with a position and a quaternion."""
    at, q = getattr(message, position), getattr(message, rotation)
    yaw = np.arctan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z))
    return at.x, at.y, float(yaw)


def _field(message: Any, path: str) -> Any:
    """Return a field by its dotted path. Raises InputError if there is none."""
    for name in path.split("."):
        if not hasattr(message, name):
            fields = ", ".join(name for name in vars(message) if not name.startswith("_"))
            raise InputError(f"a message {type(message).__name__} has no field {path}: its fields are {fields}")
        message = getattr(message, name)
    return message


def _tracks(
    found: list[tuple[float, float, Any]], drive: DriveFile, transforms: Transforms
) -> tuple[list[Trajectory], list[str]]:
    """Return a trajectory for each uninterrupted track of a pedestrian, and sentences on those that were split."""
    people, rows = drive.people, {}
    for time, _, message in found:
        frame = people.frame or _field(message, "header.frame_id")
        for person in _field(message, people.list):
            at = _field(person, people.position)
            rows.setdefault((str(_field(person, people.id)), frame), []).append((time, at.x, at.y, 0.0))
    tracks, notes = [], []
    for (name, frame), samples in rows.items():
        table = np.array(samples)
        time = table[:, 0]
        pose = _compose(transforms.at(frame, time, drive.max_gap), table[:, 1:])
        elapsed, moved = np.diff(time), np.linalg.norm(np.diff(pose[:, :2], axis=0), axis=1)
        is_gap, is_jump = elapsed > drive.max_gap + 1e-6, moved > FASTEST * np.maximum(elapsed, 1e-9)
        for k in np.flatnonzero(is_gap | is_jump).tolist():
            why = f"is not seen for {elapsed[k]:.2f} s" if is_gap[k] else f"jumps by {moved[k]:.2f} m"
            notes.append(f"pedestrian {name} {why} at {time[k]:.2f} s, and counts as somebody else afterwards")
        for part in np.split(np.arange(len(time)), np.flatnonzero(is_gap | is_jump) + 1):
            tracks.append(Trajectory(time[part], pose[part]))
    return tracks, notes
