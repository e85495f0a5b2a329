"""The messages between crowdbench and a planner in a separate process.

A message is a header, `kind` (uint32) and `size` (uint64), and `size` bytes. All numbers are little-endian. The process
reads messages from its standard input and writes an answer to each to its standard output. `docs/isolation.md` has a
client in C++.
"""

from __future__ import annotations

import dataclasses
import enum
import functools
import json
import math
import struct
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from crowdbench.core.dynamics import DYNAMICS, Actuation, Body, Dynamics
from crowdbench.core.types import Observation, Pedestrians, Sensor, Vehicle

VERSION = 1
"""Version of the format, which `START` and its answer name."""

LARGEST = 2**31
"""Bytes of the largest message."""


class MessageKind(enum.IntEnum):
    """Kind of a message."""

    START = 1
    """JSON: `version`, `planner` (a name or a path) and `options`. The first message. Its answer is `READY`."""
    RESET = 2
    """int64: the number of worlds of the batch that starts. Its answer is `READY`, without content."""
    OBSERVATION = 3
    """A file in the format of safetensors. Its answer is `COMMANDS`.

    The arrays have their names in `Observation`, such as `vehicle.position`. The metadata, each a text in JSON, are
    `steps` (the number of steps to decide), `dt`, the vehicle's `dynamics`, `actuation`, `goal_tolerance` and
    `body`, and `sensor`.
    """
    READY = 11
    """After `START`, JSON: `version`, `privileged`, `facts` (texts by name), perhaps `raw`, `native`: see `Planner`."""
    COMMANDS = 12
    """float64 `[world, time, 2]`: velocities in m/s for the requested steps, or native commands, see `native`."""
    FAILED = 13
    """JSON instead of any answer: `how` (see `FailureKind`), `what`, a text, and optionally `row`, a world."""


class FailureKind(enum.StrEnum):
    """Kind of failure of a planner."""

    REFUSED = enum.auto()
    """The planner cannot be constructed, or reports an error itself: `what` is the whole sentence."""
    FAULTY = enum.auto()
    """The planner raises an exception, or returns no valid commands: `what` follows the planner's name."""
    ONE_STEP = enum.auto()
    """The planner decides one step at a time, and several were requested."""


DTYPES = {"<f8": "F64", "<i8": "I64", "<u8": "U64", "|b1": "BOOL"}
"""The types of the arrays in an observation, as safetensors names them."""

Layout = tuple[tuple[str, str, tuple[int, ...]], ...]
"""Name, type and shape of each array."""

_HEADER = struct.Struct("<IQ")
_LENGTH = struct.Struct("<Q")


ReadInto = Callable[[memoryview], int | None]
"""Reads the available bytes, and returns their number; 0 at the end."""


class ProtocolError(Exception):
    """Raised if the other side closed the pipe or sent an invalid message. The text follows the planner's name."""


def send(write: Callable[[memoryview], int | None], kind: MessageKind, *parts: bytes | memoryview) -> None:
    """Write a message.

    Args:
        write: Writes as many bytes as possible, and returns their number, as the method of a raw file does.
        parts: Its content, in pieces.

    Raises:
        ProtocolError: The other side does not read it.
    """
    try:
        for part in (_HEADER.pack(kind, sum(map(len, parts))), *parts):
            left = memoryview(part)
            while len(left):
                left = left[write(left) or 0 :]
    except OSError as error:
        raise ProtocolError(f"reads no messages ({error.strerror})") from None


def receive(readinto: ReadInto) -> tuple[MessageKind, bytearray]:
    """Read a message.

    Args:
        readinto: Reads from the other side.

    Raises:
        ProtocolError: The pipe ends, or contains no valid message.
    """
    number, size = _HEADER.unpack(_read(readinto, _HEADER.size))
    if number not in set(MessageKind) or size > LARGEST:
        raise ProtocolError(f"sent a message of kind {number} and {size} bytes, which is none of the format")
    return MessageKind(number), _read(readinto, size)


def _read(readinto: ReadInto, size: int) -> bytearray:
    content = bytearray(size)
    left = memoryview(content)
    while len(left):
        count = readinto(left)
        if not count:
            raise ProtocolError("closed the pipe")
        left = left[count:]
    return content


def to_json(content: Mapping[str, Any]) -> bytes:
    """Return the content of a message that is JSON."""
    return json.dumps(content).encode()


def from_json(content: bytearray) -> dict[str, Any]:
    """Return the JSON object in a message. Raises ProtocolError if the message is no JSON object."""
    try:
        value = json.loads(content)
    except (ValueError, RecursionError) as error:
        raise ProtocolError(f"sent no valid JSON ({error})") from None
    if not isinstance(value, dict):
        raise ProtocolError("sent JSON that is no object")
    return value


def observation_parts(obs: Observation, steps: int) -> Iterator[bytes | memoryview]:
    """Yield the content of an `OBSERVATION` in pieces.

    Args:
        obs: The observation. Its logs are not sent.
        steps: The number of steps that the planner must decide.
    """
    parts: dict[str, Any] = {"": obs, "vehicle.": obs.vehicle, "pedestrians.": obs.pedestrians}
    arrays = []
    for prefix, part in parts.items():
        for name, value in vars(part).items():
            if isinstance(value, np.ndarray):
                arrays.append((prefix + name, np.ascontiguousarray(value)))
    arrays.sort(key=lambda pair: -pair[1].itemsize)  # so that all numbers are aligned
    layout = tuple((name, array.dtype.str, array.shape) for name, array in arrays)
    vehicle = obs.vehicle
    constants = vehicle.dynamics, vehicle.actuation, vehicle.goal_tolerance, vehicle.body
    yield _observation_header(layout, steps, obs.dt, *constants, obs.sensor)
    for _, array in arrays:
        yield array.reshape(-1).view(np.uint8).data


@functools.lru_cache(maxsize=256)
def _observation_header(
    layout: Layout,
    steps: int,
    dt: float,
    dynamics: Dynamics,
    actuation: Actuation,
    goal_tolerance: float | None,
    body: Body,
    sensor: Sensor,
) -> bytes:
    """Return the header of the safetensors file. It rarely changes, and writing it takes longer than the arrays."""
    limits = {name: limit for name, limit in dataclasses.asdict(dynamics).items() if math.isfinite(limit)}  # type: ignore[call-overload]
    constants = {
        "steps": steps,
        "dt": dt,
        "dynamics": {"name": dynamics.name, **limits},
        "actuation": actuation,
        "goal_tolerance": goal_tolerance,
        "body": body,
        "sensor": sensor.complete(),
    }
    header: dict[str, Any] = {"__metadata__": {name: json.dumps(value) for name, value in constants.items()}}
    end = 0
    for name, dtype, shape in layout:
        start, end = end, end + np.dtype(dtype).itemsize * math.prod(shape)
        header[name] = {"dtype": DTYPES[dtype], "shape": shape, "data_offsets": [start, end]}
    text = to_json(header)
    text += b" " * (-len(text) % 8)
    return _LENGTH.pack(len(text)) + text


def read_observation(content: bytearray) -> tuple[Observation, int]:
    """Read an `OBSERVATION`.

    Returns:
        The observation, and the number of steps to decide.
    """
    (length,) = _LENGTH.unpack_from(content)
    start = _LENGTH.size + length
    layout, steps, top, vehicle = _read_observation_header(bytes(content[_LENGTH.size : start]))
    parts: dict[str, dict[str, Any]] = {"": {}, "vehicle": {}, "pedestrians": {}}
    for name, dtype, shape in layout:
        part, _, field = name.rpartition(".")
        array = np.frombuffer(content, dtype, math.prod(shape), start).reshape(shape)
        start += array.nbytes
        parts[part][field] = array
    pedestrians = Pedestrians(**parts["pedestrians"])
    return Observation(Vehicle(**parts["vehicle"], **vehicle), pedestrians, **parts[""], **top), steps


@functools.lru_cache(maxsize=256)
def _read_observation_header(text: bytes) -> tuple[Layout, int, dict[str, Any], dict[str, Any]]:
    """Return the arrays in their order, the number of steps, and the constants of an observation and of its vehicle."""
    header = json.loads(text)
    constants = {name: json.loads(value) for name, value in header.pop("__metadata__").items()}
    dtypes = {name: dtype for dtype, name in DTYPES.items()}
    layout = tuple((name, dtypes[entry["dtype"]], tuple(entry["shape"])) for name, entry in header.items())
    limits = constants["dynamics"]
    vehicle = {
        "dynamics": DYNAMICS[limits.pop("name")](**limits),
        "actuation": Actuation(*constants["actuation"]),
        "goal_tolerance": constants["goal_tolerance"],
        "body": tuple(constants["body"]),
    }
    top = {"dt": constants["dt"], "sensor": Sensor.model_validate(constants["sensor"])}
    return layout, constants["steps"], top, vehicle


def read_commands(content: bytearray, worlds: int, steps: int) -> Float[np.ndarray, "world time 2"]:
    """Return the commands of a message `COMMANDS`.

    Args:
        worlds: Number of worlds that it must have commands for.

    Returns:
        Velocities in m/s, or commands of a native planner.

    Raises:
        ProtocolError: It has another size.
    """
    if len(content) != worlds * steps * 16:
        raise ProtocolError(f"sent {len(content)} bytes for commands, but {worlds * steps * 16} were asked for")
    return np.frombuffer(content, "<f8").reshape(worlds, steps, 2)
