"""The messages between crowdbench and a planner in a process of its own.

A message is a header, `kind` (uint32) and `size` (uint64), and `size` bytes. All numbers are little-endian, all arrays
are in C order without padding between them. The process reads messages from its standard input and writes an answer to
each to its standard output. `docs/isolation.md` has a client in C++.
"""

from __future__ import annotations

import dataclasses
import enum
import json
import math
import struct
from collections.abc import Callable, Iterator, Mapping
from operator import attrgetter
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from crowdbench.core.dynamics import DISC, DYNAMICS, FREE
from crowdbench.core.types import HISTORY, SHEET, Observation, Pedestrians, Sensor, Vehicle

VERSION = 1
"""Version of the format, which `START` and its answer name."""

LARGEST = 2**31
"""Bytes of the largest message."""


class Kind(enum.IntEnum):
    """What a message says."""

    START = 1
    """JSON: `version`, `planner` (a name or a path) and `options`. The first message. Its answer is `READY`."""
    RESET = 2
    """int64: the number of worlds of the batch that starts. Its answer is `READY`, without content."""
    OBSERVATION = 3
    """An observation and for how many steps to decide: see `DIMENSIONS` and `ARRAYS`. Its answer is `COMMANDS`."""
    READY = 11
    """After `START`, JSON: `version`, `privileged`, perhaps `native` (see `Planner`) and `facts` (texts by name)."""
    COMMANDS = 12
    """float64 `[world, time, 2]`: velocities in m/s for the steps that were asked for, or commands, see `native`."""
    FAILED = 13
    """JSON in the place of any answer: `how` (see `How`) and `what`, a text; perhaps `row`, the world that it is in."""


class How(enum.StrEnum):
    """In which way a planner fails."""

    REFUSED = enum.auto()
    """It cannot be made, or says itself what is wrong: `what` is the whole sentence."""
    FAULTY = enum.auto()
    """It raises, or answers something else than commands: `what` comes after the planner's name."""
    ONE_STEP = enum.auto()
    """It decides one step at a time and was asked for several."""


_HEADER = struct.Struct("<IQ")

DIMENSIONS = (
    "steps",
    "world",
    "pedestrian",
    "waypoint",
    "polygon",
    "corner",
    "future",
    "dynamics",
    "limit",
    "tolerance",
    "disc",
    "filled",
    "beam",
)
"""An observation begins with these int64 numbers.

`steps` is for how many steps to decide. `future` is 1 where that array follows, which it does for privileged planners
only. `dynamics` is the index of the vehicle's dynamics in `DYNAMICS`. `filled` is the length of the history, or 0 where
none of it is ever filled in.
"""

_SIZES = struct.Struct(f"<{len(DIMENSIONS)}q")

ARRAYS: Mapping[str, tuple[str, tuple[str | int, ...]]] = {
    "dt": ("<f8", ()),
    "row": ("<i8", ("world",)),
    "noise_key": ("<u8", ("world",)),
    "step": ("<i8", ("world",)),
    "vehicle.position": ("<f8", ("world", 2)),
    "vehicle.velocity": ("<f8", ("world", 2)),
    "vehicle.heading": ("<f8", ("world",)),
    "vehicle.angular_speed": ("<f8", ("world",)),
    "vehicle.goal": ("<f8", ("world", 2)),
    "vehicle.route": ("<f8", ("world", "waypoint", 2)),
    "vehicle.waypoint": ("<i8", ("world",)),
    "vehicle.radius": ("<f8", ("world",)),
    "vehicle.preferred_speed": ("<f8", ("world",)),
    "pedestrians.position": ("<f8", ("world", "pedestrian", 2)),
    "pedestrians.velocity": ("<f8", ("world", "pedestrian", 2)),
    "pedestrians.radius": ("<f8", ("world", "pedestrian")),
    "pedestrians.history": ("<f8", ("world", HISTORY, "pedestrian", 2)),
    "pedestrians.age": ("<f8", ("world", "pedestrian")),
    "pedestrians.observed": ("<i8", ("world", "pedestrian")),
    "obstacles": ("<f8", ("world", "polygon", "corner", 2)),
    "future": ("<f8", ("world", "pedestrian", 2)),
    "vehicle.dynamics": ("<f8", ("limit",)),
    "vehicle.goal_tolerance": ("<f8", ("tolerance",)),
    "vehicle.body": ("<f8", ("disc",)),
    "lidar": ("<f8", ("world", "beam")),
    "sensor": ("<f8", (SHEET,)),
    "pedestrians.seen": ("|u1", ("world", "pedestrian")),
    "pedestrians.filled": ("|u1", ("world", "filled", "pedestrian")),
}
"""Then follow these arrays, by their names in `Observation`, with their type and their shape.

`vehicle.dynamics` has the limits in the order of the fields of the class. It, `vehicle.goal_tolerance` and
`vehicle.body` are empty where they are those of a holonomic disc. `sensor` is `Sensor.numbers()`. `lidar` and
`pedestrians.filled` are empty where an observation has none.
"""


Write = Callable[[memoryview], int | None]
"""Writes as much as goes, and returns how much, as the method of a raw file does."""

ReadInto = Callable[[memoryview], int | None]
"""Reads as much as is there, and returns how much; 0 at the end."""


class Broken(Exception):
    """The other side has closed the pipe, or sent what is no message. The message is what comes after its name."""


def send(write: Write, kind: Kind, *parts: bytes | memoryview) -> None:
    """Write a message.

    Args:
        write: Writes to the other side.
        kind: What it says.
        parts: Its content, in pieces.

    Raises:
        Broken: Nobody reads it.
    """
    try:
        for part in (_HEADER.pack(kind, sum(map(len, parts))), *parts):
            left = memoryview(part)
            while len(left):
                left = left[write(left) or 0 :]
    except OSError as error:
        raise Broken(f"reads no messages ({error.strerror})") from None


def receive(readinto: ReadInto) -> tuple[Kind, bytearray]:
    """Read a message.

    Args:
        readinto: Reads from the other side.

    Returns:
        What it says, and its content.

    Raises:
        Broken: The pipe ends, or holds something else.
    """
    number, size = _HEADER.unpack(_read(readinto, _HEADER.size))
    if number not in set(Kind) or size > LARGEST:
        raise Broken(f"sent a message of kind {number} and {size} bytes, which is none of the format")
    return Kind(number), _read(readinto, size)


def _read(readinto: ReadInto, size: int) -> bytearray:
    content = bytearray(size)
    left = memoryview(content)
    while len(left):
        count = readinto(left)
        if not count:
            raise Broken("closed the pipe")
        left = left[count:]
    return content


def to_json(content: Mapping[str, Any]) -> bytes:
    """The content of a message that is JSON."""
    return json.dumps(content).encode()


def from_json(content: bytearray) -> dict[str, Any]:
    """What JSON in a message says. Raises Broken where it is no JSON object."""
    try:
        value = json.loads(content)
    except (ValueError, RecursionError) as error:
        raise Broken(f"sent no valid JSON ({error})") from None
    if not isinstance(value, dict):
        raise Broken("sent JSON that is no object")
    return value


def observation_parts(obs: Observation, steps: int) -> Iterator[bytes | memoryview]:
    """The content of an `OBSERVATION` in pieces.

    Args:
        obs: The observation. What is logged in it is not sent.
        steps: For how many steps the planner is to decide.
    """
    values = {name: attrgetter(name)(obs) for name in ARRAYS} | _constants(obs)
    values = {name: value for name, value in values.items() if value is not None}
    sizes = dict.fromkeys(DIMENSIONS, 0)
    for name, value in values.items():
        lengths = zip(ARRAYS[name][1], np.shape(value), strict=True)
        sizes |= {axis: length for axis, length in lengths if isinstance(axis, str)}
    index = list(DYNAMICS).index(obs.vehicle.dynamics.name)
    sizes |= {"steps": steps, "future": int(obs.future is not None), "dynamics": index}
    yield _SIZES.pack(*(sizes[name] for name in DIMENSIONS))
    for name, value in values.items():
        yield array_bytes(value, ARRAYS[name][0])


def _constants(obs: Observation) -> dict[str, tuple[float, ...]]:
    """What is the same in each world, by names as in `ARRAYS`."""
    vehicle = obs.vehicle
    dynamics, tolerance = vehicle.dynamics, vehicle.goal_tolerance
    return {
        "vehicle.dynamics": () if dynamics == FREE else dataclasses.astuple(dynamics),  # type: ignore[call-overload]
        "vehicle.goal_tolerance": () if tolerance is None else (tolerance,),
        "vehicle.body": () if vehicle.body == DISC else vehicle.body,
        "sensor": obs.sensor.numbers(),
    }


def read_observation(content: bytearray) -> tuple[Observation, int]:
    """What an `OBSERVATION` says.

    Args:
        content: The content of the message.

    Returns:
        The observation, and for how many steps to decide.
    """
    sizes = dict(zip(DIMENSIONS, _SIZES.unpack_from(content), strict=True))
    offset = _SIZES.size
    parts: dict[str, dict[str, Any]] = {"": {}, "vehicle": {}, "pedestrians": {}}
    for name, (dtype, shape) in ARRAYS.items():
        if name == "future" and not sizes["future"]:
            continue
        lengths = [sizes[axis] if isinstance(axis, str) else axis for axis in shape]
        array = np.frombuffer(content, dtype, math.prod(lengths), offset).reshape(lengths)
        offset += array.nbytes
        part, _, field = name.rpartition(".")
        parts[part][field] = array
    top, vehicle, pedestrians = parts.values()
    top["dt"] = float(top["dt"])
    top["sensor"] = Sensor.of_numbers(top["sensor"].tolist())
    top["lidar"] = top["lidar"] if sizes["beam"] else None
    vehicle["dynamics"] = list(DYNAMICS.values())[sizes["dynamics"]](*vehicle["dynamics"].tolist())
    vehicle["goal_tolerance"] = next(iter(vehicle["goal_tolerance"].tolist()), None)
    vehicle["body"] = tuple(vehicle["body"].tolist()) or DISC
    pedestrians["seen"] = pedestrians["seen"].view(bool)
    pedestrians["filled"] = pedestrians["filled"].view(bool) if sizes["filled"] else None
    return Observation(Vehicle(**vehicle), Pedestrians(**pedestrians), **top), sizes["steps"]


def array_bytes(values: ArrayLike, dtype: str = "<f8") -> memoryview:
    """Numbers as messages hold them; the content of `COMMANDS` is that of the commands."""
    return np.ascontiguousarray(values, dtype).reshape(-1).view(np.uint8).data


def read_commands(content: bytearray, worlds: int, steps: int) -> Float[np.ndarray, "world time 2"]:
    """What `COMMANDS` says.

    Args:
        content: The content of the message.
        worlds: Number of worlds that it must have commands for.
        steps: Number of steps.

    Returns:
        Velocities in m/s, or commands of a native planner.

    Raises:
        Broken: It has another size.
    """
    if len(content) != worlds * steps * 16:
        raise Broken(f"sent {len(content)} bytes for commands, but {worlds * steps * 16} were asked for")
    return np.frombuffer(content, "<f8").reshape(worlds, steps, 2)
