"""Reads a ROS bag (ROS 2 with sqlite3 or MCAP, or ROS 1) as trajectories on one clock and in one frame.

Positions between two messages lie on the straight line between them, if the messages are no farther apart than
`max_gap`. A drive begins where all is known and ends where something is not known any more. Everything else that is
missing or contradictory is an error.
"""

from __future__ import annotations

import functools
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from drive_file import DriveFile
from jaxtyping import Float
from messages import Clock, Message, open_bag, types_of
from pedestrians import place, read_sightings, tracks_of
from PIL import Image
from rosbags.highlevel import AnyReader, AnyReaderError
from transforms import Times, Trajectory, Transforms, compose, frame_name, pose_of

from crowdbench import InputError
from crowdbench.core import norm
from crowdbench.scenario import Polygon, read_obstacles
from crowdbench.utils import describe_error

POSES: dict[str, Callable[[Any], Any]] = {
    "nav_msgs/msg/Odometry": lambda message: message.pose.pose,
    "geometry_msgs/msg/PoseStamped": lambda message: message.pose,
    "geometry_msgs/msg/PoseWithCovarianceStamped": lambda message: message.pose.pose,
}
"""The pose in each type of message that may tell where the robot is."""


@dataclass(frozen=True)
class Bag:
    """The used content of a bag; times are in seconds since its first message.

    Attributes:
        robot: Poses of the robot in the fixed frame.
        people: Positions of each pedestrian in the fixed frame, a trajectory for each uninterrupted track.
        observed: The times of the messages about pedestrians.
        goal: The robot's goal in metres in the fixed frame.
        walls: The corners of the obstacles of its map in metres in the fixed frame; none without `map_topic`.
        notes: Sentences on parts that are left out, on tracks that were split, and on guesses.
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
    store = types_of(drive.message_definitions)
    try:
        with open_bag(path, store) as reader:
            return _read(reader, drive, functools.partial(Clock, reader, store))
    except (AnyReaderError, OSError) as error:
        raise InputError(f"{path} cannot be read as a ROS bag: {describe_error(error)}") from None
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _read(reader: AnyReader, drive: DriveFile, start: Callable[..., Clock]) -> Bag:
    vehicle, people = drive.vehicle, drive.people
    topics = {connection.topic for connection in reader.connections}
    for topic in (vehicle.odometry or drive.tf, people.topic, vehicle.goal_topic, drive.map_topic):
        if topic and topic not in topics:
            raise InputError(f"there is no topic {topic}; the topics are {', '.join(sorted(topics))}")
    clock = start(vehicle.odometry or drive.tf, vehicle.offset if vehicle.odometry else 0.0)
    transforms = clock.transforms(drive.tf)
    found = sorted(clock.messages(people.topic, people.offset), key=lambda message: message.time)
    sightings = read_sightings(found, people)
    local, frame = _robot_in_its_frame(clock, drive, transforms)
    frames = {frame} | {one.frame for message in sightings for one in message}
    begin, end, notes = _known_part(frames, drive, transforms, local.time)
    inside = _within(local.time, begin, end)
    robot = Trajectory(local.time[inside], local.pose[inside])
    if len(robot.time) < 2:
        raise InputError("it has no two poses of the robot")
    poses = transforms.at(frame, _fixed(drive), robot.time, drive.max_gap)
    robot = Trajectory(robot.time, compose(poses, robot.pose))
    observed = np.array([message.time for message in found])
    kept = _within(observed, begin, end)
    there = [those for those, is_kept in zip(sightings, kept, strict=True) if is_kept]
    tracks, splits = tracks_of(place(there, transforms, _fixed(drive), drive.max_gap), people.topic, drive.max_gap)
    goal = _goal(clock.latched(vehicle.goal_topic), drive, transforms)
    maps = clock.latched(drive.map_topic)
    walls = grid_obstacles(maps[-1].content, functools.partial(_place, transforms, maps[-1], drive)) if maps else []
    return Bag(robot, tracks, observed[kept], goal, walls, [*clock.notes, *notes, *splits])


def _fixed(drive: DriveFile) -> str:
    return frame_name(drive.fixed_frame)


def _within(time: Times, begin: float, end: float) -> np.ndarray:
    return (time >= begin - 1e-6) & (time <= end + 1e-6)


def _robot_in_its_frame(clock: Clock, drive: DriveFile, transforms: Transforms) -> tuple[Trajectory, str]:
    """Return the poses of the robot's topic, and their frame; or zeros in the robot's frame, at each transform."""
    vehicle = drive.vehicle
    if not vehicle.odometry:
        time = transforms.times(frame_name(vehicle.frame), _fixed(drive))
        return Trajectory(time, np.zeros((len(time), 3))), frame_name(vehicle.frame)
    found = clock.messages(vehicle.odometry, vehicle.offset)
    for message in found[:1]:
        if message.kind not in POSES:
            raise InputError(f"{vehicle.odometry} has messages {message.kind}, but must have {' or '.join(POSES)}")
    rows = [(message.time, *pose_of(POSES[message.kind](message.content))) for message in found]
    frame = frame_name(found[0].content.header.frame_id) if found else _fixed(drive)
    return Trajectory.of(rows, f"the robot in {vehicle.odometry}"), frame


def _known_part(
    frames: set[str], drive: DriveFile, transforms: Transforms, robot: Times
) -> tuple[float, float, list[str]]:
    """Return the first and the last time in seconds at which all frames are known, and sentences on what is left out.

    Raises InputError if they are never known together.
    """
    known = [transforms.known(frame, _fixed(drive)) for frame in sorted(frames)]
    first, last = max(known, key=lambda part: part.begin), min(known, key=lambda part: part.end)
    if first.begin > last.end:
        raise InputError(
            f"{first.first} begins at {first.begin:.2f} s, after the end of {last.last} at {last.end:.2f} s"
        )
    notes = []
    if len(robot) and first.begin > robot[0] + drive.dt:
        notes.append(f"the drive begins at {first.begin:.2f} s, because {first.first} is not known before")
    if len(robot) and last.end < robot[-1] - drive.dt:
        notes.append(f"the drive ends at {last.end:.2f} s, because {last.last} is not known afterwards")
    return first.begin, last.end, notes


def _place(
    transforms: Transforms, message: Message, drive: DriveFile, pose: tuple[float, float, float]
) -> tuple[float, float, float]:
    """Transform a pose from a message's frame to the fixed frame, at the nearest time at which both are known."""
    frame = frame_name(message.content.header.frame_id)
    known = transforms.known(frame, _fixed(drive))
    time = np.clip(np.array([message.time]), known.begin, known.end)
    x, y, yaw = compose(transforms.at(frame, _fixed(drive), time, drive.max_gap), np.array([pose]))[0].tolist()
    if not np.isfinite((x, y, yaw)).all():
        raise InputError(f"a pose in {message.kind} at {message.time:.2f} s is no number (NaN or infinite)")
    return x, y, yaw


def _goal(found: list[Message], drive: DriveFile, transforms: Transforms) -> Float[np.ndarray, "2"]:
    """Return the goal of a drive. Raises InputError if its topic has no message, or different goals."""
    topic = drive.vehicle.goal_topic
    if drive.vehicle.goal:
        return np.array(drive.vehicle.goal)
    if not found:
        raise InputError(f"{topic} has no message: give goal in [vehicle]")
    if found[0].kind not in POSES:
        raise InputError(f"{topic} has messages {found[0].kind}, but must have {' or '.join(POSES)}")
    poses = [POSES[one.kind](one.content) for one in found]
    # The orientation of a goal does not count, and is often left out.
    points = [(pose.position.x, pose.position.y, 0.0) for pose in poses]
    goals = np.array([_place(transforms, one, drive, at)[:2] for one, at in zip(found, points, strict=True)])
    for k in np.flatnonzero(norm(goals - goals[0]) > drive.vehicle.goal_tolerance)[:1].tolist():
        raise InputError(f"the goal changes at {found[k].time:.2f} s: cut the bag there, because a case has one goal")
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
        origin = json.dumps(place(pose_of(info.origin)))
        file = Path(folder) / "map.yaml"
        file.write_text(f"image: map.png\nresolution: {info.resolution}\norigin: {origin}\nmode: raw\n")
        return read_obstacles(file)
