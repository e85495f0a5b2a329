"""Messages of a bag on one clock: the stamps of their headers, shifted to seconds since the start of the recording."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.typesys import get_types_from_msg
from rosbags.typesys.store import Typestore
from transforms import LARGEST_OFFSET, Transforms

from crowdbench import InputError
from crowdbench.export import ros_typestore

FUTURE = 5.0
"""Seconds by which transforms may be stamped before or after the other messages: localisation stamps its own up to a
second ahead."""


NANOSECONDS = 10**9


class Message(NamedTuple):
    """A message of a topic.

    Attributes:
        time: Its time in seconds since the start of the recording.
        content: The message.
        kind: Its type, such as `nav_msgs/msg/Odometry`.
    """

    time: float
    content: Any
    kind: str


class _Raw(NamedTuple):
    """A message before clocks are compared: the time of its recording and its stamp in seconds, NaN without one."""

    recorded: float
    stamp: float
    content: Any
    kind: str


def open_bag(path: Path, store: Typestore) -> AnyReader:
    """Return the reader of a bag.

    Args:
        path: A folder, also without its `metadata.yaml`, or a file `.mcap`, `.db3` or `.bag`.
        store: Types of messages that the bag does not define.
    """
    paths = [path]
    if path.is_dir() and not (path / "metadata.yaml").exists():
        paths = sorted(part for part in path.iterdir() if part.suffix in (".mcap", ".db3", ".bag"))
        if not paths:
            raise InputError("there is no file .mcap, .db3 or .bag in this folder")
    return AnyReader(paths, default_typestore=store)


def types_of(definitions: dict[str, str]) -> Typestore:
    """Return the types of messages of ROS 2 and of people_msgs, and further ones.

    Args:
        definitions: Texts of further definitions by the name of the type.
    """
    store = ros_typestore()
    for name, text in definitions.items():
        store.register(get_types_from_msg(text, name))
    return store


class Clock:
    """The messages of a bag, with times in seconds since the start of the recording.

    Stamps may be on another clock than the recording (use_sim_time): they are shifted by the median difference for the
    robot's topic. Messages of a topic without stamps, or with no stamp but 0, have the time of their
    recording.

    Attributes:
        notes: Sentences on topics without stamps.

    Args:
        reader: The open bag.
        store: Types of messages that the bag does not define.
        reference: The topic whose stamps set the clock.
        offset: Added to the stamps of this topic in seconds.
    """

    def __init__(self, reader: AnyReader, store: Typestore, reference: str, offset: float) -> None:
        self.notes: list[str] = []
        self._reader, self._begin, self._reference = reader, reader.start_time, reference
        known = reader.typestore.fielddefs
        reader.typestore.register({name: fields for name, fields in store.fielddefs.items() if name not in known})
        delays = [one.recorded - one.stamp for one in self._read(reference, offset)]
        self._delay = self._median(delays) or 0.0

    def messages(self, topic: str, offset: float = 0.0) -> list[Message]:
        """Return the messages of a topic in the order of their recording.

        Args:
            topic: The topic.
            offset: Added to its stamps in seconds.

        Raises:
            InputError: Its stamps come from another clock.
        """
        found = self._read(topic, offset)
        behind = self._behind([one.recorded - one.stamp for one in found])
        if abs(behind) > LARGEST_OFFSET:
            other, late = (self._reference, topic) if behind > 0.0 else (topic, self._reference)
            raise InputError(
                f"the clock of {late} is {abs(behind):.2f} s behind that of {other}: correct it with offset = "
                f"{abs(behind):.2f} in the table of {late}"
            )
        if len(found) > 1 and math.isnan(found[0].stamp):
            self.notes.append(f"messages of {topic} have no stamps: the times of their recording count")
        return [
            Message(one.recorded if math.isnan(one.stamp) else one.stamp + self._delay, one.content, one.kind)
            for one in found
        ]

    def latched(self, topic: str) -> list[Message]:
        """Return the messages of a topic at the times of their recording: maps and goals may have old stamps."""
        return [Message(one.recorded, one.content, one.kind) for one in self._read(topic, 0.0)]

    def transforms(self, topic: str) -> Transforms:
        """Return the transforms of a topic, and of the topic of static transforms beside it."""
        moving = []
        for one in self._read(topic, 0.0):
            moving += [(one.recorded, self._seconds(_stamp_of(each)), each) for each in one.content.transforms]
        behind = self._behind([recorded - stamp for recorded, stamp, _ in moving])
        if abs(behind) > FUTURE:
            raise InputError(
                f"the clock of {topic} differs by {abs(behind):.2f} s from that of {self._reference}: record the bag "
                "with one clock (use_sim_time)"
            )
        timed = [(stamp + self._delay, each) for _, stamp, each in moving]
        static = [each for one in self._read(f"{topic}_static", 0.0) for each in one.content.transforms]
        return Transforms.of(topic, timed, static)

    def _read(self, topic: str, offset: float) -> list[_Raw]:
        """Return the messages of a topic in the order of their recording."""
        connections = [connection for connection in self._reader.connections if connection.topic == topic]
        found = []
        for connection, recorded, raw in self._reader.messages(connections) if connections else ():
            try:
                content = self._reader.deserialize(raw, connection.msgtype)
            except KeyError:
                kind = connection.msgtype
                raise InputError(
                    f'nothing defines {kind} of {topic}: name its file, messages = ["{kind}.msg"]'
                ) from None
            found.append((recorded, _stamp_of(content), content, connection.msgtype))
        has_stamps = any(stamp for _, stamp, _, _ in found)
        return [
            _Raw(self._seconds(recorded), self._seconds(stamp) + offset if has_stamps else math.nan, content, kind)
            for recorded, stamp, content, kind in found
        ]

    def _seconds(self, nanoseconds: int) -> float:
        """Return seconds since the start of the recording: of integers, because a float is exact to 0.2 us only."""
        return 1e-9 * (nanoseconds - self._begin)

    def _behind(self, delays: list[float]) -> float:
        """Return by how many seconds stamps are behind the stamps of the reference; 0 without stamps."""
        delay = self._median(delays)
        return 0.0 if delay is None else delay - self._delay

    @staticmethod
    def _median(delays: list[float]) -> float | None:
        """Return the median time in seconds from stamp to recording; None without stamps."""
        known = [delay for delay in delays if not math.isnan(delay)]
        return float(np.median(known)) if known else None


def _stamp_of(message: Any) -> int:
    """Return the stamp of a message in nanoseconds, 0 if it has none.

    A message without a header has the stamp of the first marker or transform in it.
    """
    parts = getattr(message, "markers", None) or getattr(message, "transforms", None)
    stamp = getattr(getattr(parts[0] if parts else message, "header", None), "stamp", None)
    return 0 if stamp is None else stamp.sec * NANOSECONDS + stamp.nanosec
