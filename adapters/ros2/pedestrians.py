"""The tracks of pedestrians in messages of several types."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from drive_file import PeopleTable
from messages import Message
from scipy.optimize import linear_sum_assignment
from transforms import Trajectory, Transforms, compose, frame_name

from crowdbench import InputError

FASTEST = 4.0
"""Speed in m/s above which an identity is assumed to have switched to another pedestrian."""


class Fields(NamedTuple):
    """Names of fields, dotted: the list in a message, and of each pedestrian the position and the identity."""

    list: str
    position: str
    id: str


FIELDS = {
    "people_msgs/msg/People": Fields("people", "position", "name"),
    "geometry_msgs/msg/PoseArray": Fields("poses", "position", ""),
    "spencer_tracking_msgs/msg/TrackedPersons": Fields("tracks", "pose.pose.position", "track_id"),
    "vision_msgs/msg/Detection3DArray": Fields("detections", "bbox.center.position", "id"),
    "visualization_msgs/msg/MarkerArray": Fields("markers", "pose.position", "id"),
}
"""The fields of known types of messages."""

_MARKER_ADDED = 0
"""`visualization_msgs/Marker.ADD`; other actions delete markers."""


class Sighting(NamedTuple):
    """A pedestrian in a message.

    Attributes:
        time: Its time in seconds.
        frame: The frame of the position.
        name: The identity; empty if there is none.
        x: In metres.
        y: In metres.
    """

    time: float
    frame: str
    name: str
    x: float
    y: float


def read_sightings(found: list[Message], table: PeopleTable) -> list[list[Sighting]]:
    """Return the pedestrians in each message.

    Args:
        found: The messages.
        table: The names of the topic and of its fields.

    Raises:
        InputError: A field is missing, or a position is no number.
    """
    return [list(_sightings(message, table)) for message in found]


def _sightings(message: Message, table: PeopleTable) -> Iterator[Sighting]:
    fields = _fields_of(message.kind, table)
    for person in _field(message.content, fields.list):
        if getattr(person, "action", _MARKER_ADDED) != _MARKER_ADDED:
            continue
        at = _field(person, fields.position)
        name = str(_field(person, fields.id)) if fields.id else ""
        if isinstance(namespace := getattr(person, "ns", None), str):  # a marker is known by both
            name = f"{namespace}/{name}"
        if not (math.isfinite(at.x) and math.isfinite(at.y)):
            raise InputError(
                f"a position in {table.topic} is no number (NaN or infinite) at {message.time:.2f} s, of pedestrian "
                f"{name or 'without identity'}: leave this part of the bag out"
            )
        yield Sighting(message.time, _frame_of(person, message.content, table), name, at.x, at.y)


def _fields_of(kind: str, table: PeopleTable) -> Fields:
    """Return the fields of a type of messages: as in the drive file, or else as in a known type."""
    usual = FIELDS.get(kind, Fields("", "", ""))
    fields = Fields(table.list or usual.list, table.position or usual.position, table.id or usual.id)
    if not (fields.list and fields.position):
        raise InputError(
            f"{table.topic} has messages {kind}: give list, position and id in [people], or a topic of a known type: "
            f"{', '.join(FIELDS)}"
        )
    return fields


def _frame_of(person: Any, message: Any, table: PeopleTable) -> str:
    """Return the frame of a position: of the drive file, of the pedestrian's own header, or of the message's header."""
    for header in (getattr(person, "header", None), getattr(message, "header", None)):
        if not table.frame and header is not None and header.frame_id:
            return frame_name(header.frame_id)
    if not table.frame:
        raise InputError(f"messages of {table.topic} name no frame: give frame in [people]")
    return frame_name(table.frame)


def _field(message: Any, path: str) -> Any:
    """Return a field by its dotted path. Raises InputError if there is none."""
    for name in path.split("."):
        if not hasattr(message, name):
            fields = ", ".join(name for name in vars(message) if not name.startswith("_"))
            raise InputError(f"a message {type(message).__name__} has no field {path}: its fields are {fields}")
        message = getattr(message, name)
    return message


def place(sightings: list[list[Sighting]], transforms: Transforms, fixed: str, max_gap: float) -> list[list[Sighting]]:
    """Return pedestrians in the fixed frame.

    Args:
        sightings: The pedestrians in each message.
        transforms: The transforms of the bag.
        fixed: The fixed frame.
        max_gap: Longest time in seconds without a message over which transforms are interpolated.
    """
    everybody = [one for message in sightings for one in message]
    placed: dict[int, Sighting] = {}
    for frame in {one.frame for one in everybody}:
        those = [index for index, one in enumerate(everybody) if one.frame == frame]
        time, x, y = np.array([(everybody[k].time, everybody[k].x, everybody[k].y) for k in those]).T
        poses = compose(transforms.at(frame, fixed, time, max_gap), np.stack([x, y, np.zeros(len(x))], axis=1))
        for index, (at_x, at_y, _) in zip(those, poses.tolist(), strict=True):
            placed[index] = everybody[index]._replace(frame=fixed, x=at_x, y=at_y)
    numbers = iter(range(len(everybody)))
    return [[placed[next(numbers)] for _ in message] for message in sightings]


def tracks_of(sightings: list[list[Sighting]], topic: str, max_gap: float) -> tuple[list[Trajectory], list[str]]:
    """Return a trajectory for each uninterrupted track of a pedestrian, and sentences on guesses and splits.

    Args:
        sightings: The pedestrians in each message, in the fixed frame.
        topic: The topic, for the sentences.
        max_gap: Longest time in seconds for which a pedestrian may be absent in a track.
    """
    notes = []
    named = [[one.name for one in message] for message in sightings]
    if any("" in names or len({*names}) < len(names) for names in named):
        notes.append(f"{topic} does not tell its pedestrians apart: their identities are guessed from their positions")
        sightings = _with_guessed_names(sightings)
    rows: dict[str, list[tuple[float, float, float, float]]] = {}
    for message in sightings:
        for one in message:
            rows.setdefault(one.name, []).append((one.time, one.x, one.y, 0.0))
    tracks = []
    for name, samples in rows.items():
        time, pose = Trajectory.of(samples, f"pedestrian {name} in {topic}")
        elapsed, moved = np.diff(time), np.linalg.norm(np.diff(pose[:, :2], axis=0), axis=1)
        is_gap, is_jump = elapsed > max_gap + 1e-6, moved > FASTEST * np.maximum(elapsed, 1e-9)
        for k in np.flatnonzero(is_gap | is_jump).tolist():
            why = f"is not seen for {elapsed[k]:.2f} s" if is_gap[k] else f"jumps by {moved[k]:.2f} m"
            notes.append(f"pedestrian {name} {why} at {time[k]:.2f} s, and counts as somebody else afterwards")
        for part in np.split(np.arange(len(time)), np.flatnonzero(is_gap | is_jump) + 1):
            tracks.append(Trajectory(time[part], pose[part]))
    return tracks, notes


def _with_guessed_names(sightings: list[list[Sighting]]) -> list[list[Sighting]]:
    """Return pedestrians with numbers as names: each keeps that of the nearest one in the message before.

    The sum of the distances is least, and no distance is above `FASTEST` times the time between the messages.
    """
    guessed: list[list[Sighting]] = []
    before: list[Sighting] = []
    number = 0
    for message in sorted(sightings, key=lambda one: one[0].time if one else -math.inf):
        names = {}
        if before and message:
            away = np.linalg.norm(_points(message)[:, None] - _points(before), axis=2)
            reach = FASTEST * (message[0].time - before[0].time)
            for here, there in zip(*linear_sum_assignment(np.minimum(away, reach + 1.0)), strict=True):
                if away[here, there] <= reach:
                    names[here] = before[there].name
        for k in range(len(message)):
            if k not in names:
                number += 1
                names[k] = str(number)
        before = [one._replace(name=names[k]) for k, one in enumerate(message)]
        guessed.append(before)
    return guessed


def _points(message: list[Sighting]) -> np.ndarray:
    return np.array([(one.x, one.y) for one in message])
