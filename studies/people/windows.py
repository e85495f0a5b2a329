"""Windows of recorded tracks: history, future, and the persons whose motion is scored. See definition.md."""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from crowdbench import InputError
from crowdbench.core import norm
from crowdbench.scenario import ETH_UCY_DT, FRAME_STEP, RecordedTracks, read_tracks
from studies.people.encounters import NEAR
from studies.people.groups import find_groups

LOCATIONS: Mapping[str, tuple[str, ...]] = {
    "hotel": ("biwi_hotel",),
    "zara": ("crowds_zara01", "crowds_zara02", "crowds_zara03"),
    "univ": ("students003",),
    "confirmation": ("students001", "uni_examples"),
}
"""The recordings by location. `confirmation` has the same place as `univ`, and took no part in the experiment."""

FOLDS = ("hotel", "zara", "univ")
"""The locations that are held out in turn."""

PLACE: Mapping[str, str] = {"confirmation": "univ"}
"""The location with the same place, if there is one."""

HISTORY, FUTURE = 5, 20
"""Frames of history before the start, 2 s, and after it, 8 s."""

BLOCK = 5
"""Frames of a block, 2 s; a person counts if it is present in the first one."""

CONFLICT = 0.6
"""Distance in metres: a predicted approach within it is a conflict."""

BEYOND = 3.0
"""Distance in metres from the end of a person's track to its goal."""

SLOW = 0.1
"""Speed in m/s below which a person has no direction."""

MOST_WINDOWS = 100_000
"""More than the number of windows of any recording."""

Path2 = Float[np.ndarray, "time person 2"]
Vectors = Float[np.ndarray, "person 2"]


@dataclass(frozen=True, eq=False)
class Window:
    """Persons in a window of a recording.

    Attributes:
        name: The recording.
        number: Number of the window among all windows of its recording.
        position: Positions in metres in the frames from `-HISTORY` on, NaN for absent persons.
        group: Number of each person's group.
        scored: True for persons whose motion is scored.
        velocity: In m/s, at the start or, for later persons, at their first frame.
        heading: Unit vectors of the mean velocity in the history.
        speed: Mean speed in the history in m/s; for persons without one, in their first 2 s.
        end: End of each person's track in metres, also after the window.
    """

    name: str
    number: int
    position: Path2
    group: Int[np.ndarray, "person"]
    scored: Bool[np.ndarray, "person"]
    velocity: Vectors
    heading: Vectors
    speed: Float[np.ndarray, "person"]
    end: Vectors

    @property
    def seconds(self) -> float:
        """Duration of the future in seconds."""
        return ETH_UCY_DT * (len(self.future) - 1)

    @property
    def future(self) -> Path2:
        """Positions in metres from the start on."""
        return self.position[HISTORY:]

    @property
    def present(self) -> Bool[np.ndarray, "time person"]:
        """True if a person is present, from the start on."""
        return np.isfinite(self.future[..., 0])

    @property
    def first(self) -> Vectors:
        """Position in metres of each person at the start, or at its first frame after it."""
        people = np.arange(len(self.group))
        return self.future[self.present.argmax(axis=0), people]

    @property
    def strangers(self) -> Bool[np.ndarray, "person person"]:
        """True for pairs of persons of different groups."""
        return self.group[:, None] != self.group

    @property
    def conflict(self) -> Bool[np.ndarray, "person"]:
        """True for scored persons whose start velocity leads within `CONFLICT` of a stranger farther than `NEAR`."""
        apart = self.future[0] - self.future[0][:, None]
        moving = self.velocity - self.velocity[:, None]
        speed2 = (moving**2).sum(axis=-1)
        with np.errstate(invalid="ignore", divide="ignore"):
            when = np.clip(-(apart * moving).sum(axis=-1) / speed2, 0.0, self.seconds)
        closest = norm(apart + np.nan_to_num(when)[..., None] * moving)
        meets = self.strangers & (norm(apart) > NEAR) & (closest < CONFLICT)
        return self.scored & meets.any(axis=1)

    @property
    def case(self) -> int:
        """Number of the window, from which random numbers derive; other recordings have other numbers."""
        return zlib.crc32(self.name.encode()) * MOST_WINDOWS + self.number

    def stream(self, purpose: str) -> np.random.Generator:
        """Return the random stream of the window for a purpose."""
        return np.random.default_rng([self.case, zlib.crc32(purpose.encode())])

    def goals(self, *, hidden: bool) -> Vectors:
        """Return the goal of each person in metres: `BEYOND` the end of its track, or of a straight extrapolation.

        Args:
            hidden: True for the extrapolation of the start velocity, which uses nothing of the future.
        """
        ahead = self.heading * self.speed[:, None] * self.seconds if hidden else self.end - self.first
        length = norm(ahead)[:, None]
        direction = np.where(length > SLOW, ahead / np.maximum(length, SLOW), self.heading)
        return self.first + ahead + BEYOND * direction


def read_windows(data: Path, locations: Sequence[str] = FOLDS) -> dict[str, list[Window]]:
    """Return the windows of recordings by location.

    Args:
        data: The folder with the tracks of ETH/UCY.
        locations: Names in `LOCATIONS`.

    Raises:
        InputError: There is no such location, or a file is missing or wrong.
    """
    for location in locations:
        if location not in LOCATIONS:
            raise InputError(f"location is {location!r}, but must be one of {', '.join(LOCATIONS)}")
    if not data.is_dir():
        raise InputError(f"there is no folder {data} with the recorded tracks of ETH/UCY")
    return {
        location: [window for name in LOCATIONS[location] for window in cut(read_tracks(data / f"{name}.txt"))]
        for location in locations
    }


def cut(tracks: RecordedTracks, frames: int = FUTURE, every: int = FUTURE) -> list[Window]:
    """Return the windows of a recording, by default with futures that follow each other without a gap.

    Windows without scored persons are left out.

    Args:
        tracks: The recording, annotated every 0.4 s.
        frames: Number of frames of a future.
        every: Frames from the start of a window to that of the next one.
    """
    frame, position = on_grid(tracks)
    group = find_groups(position)
    ends = np.array([path[np.isfinite(path[:, 0])][-1] for path in position.swapaxes(0, 1)])
    windows = []
    for number, start in enumerate(range(HISTORY, len(frame) - frames, every)):
        part = position[start - HISTORY : start + frames + 1]
        near = np.flatnonzero(np.isfinite(part[HISTORY:, :, 0]).any(axis=0))
        window = make_window(tracks.name, number, part[:, near], group[near], ends[near])
        if window.scored.any():
            windows.append(window)
    return windows


def on_grid(tracks: RecordedTracks) -> tuple[Int[np.ndarray, "time"], Path2]:
    """Return all frames of a recording, and positions in them: linear between annotations, NaN outside a track."""
    frame = np.arange(tracks.frame.min(), tracks.frame.max() + 1, FRAME_STEP)
    starts = np.flatnonzero(np.diff(tracks.pedestrian, prepend=-1))
    position = np.full((len(frame), len(starts), 2), np.nan)
    for person, rows in enumerate(np.split(np.arange(len(tracks.frame)), starts[1:])):
        first, last = (tracks.frame[rows[[0, -1]]] - frame[0]) // FRAME_STEP
        at = frame[first : last + 1]
        for axis in (0, 1):
            position[first : last + 1, person, axis] = np.interp(at, tracks.frame[rows], tracks.position[rows, axis])
    return frame, position


def make_window(name: str, number: int, position: Path2, group: Int[np.ndarray, "person"], end: Vectors) -> Window:
    """Return a window, with velocities and speeds from its positions; see the attributes of `Window`."""
    present = np.isfinite(position[..., 0])
    scored = present[: HISTORY + 1 + BLOCK].all(axis=0)
    step = np.diff(position, axis=0) / ETH_UCY_DT
    speeds, known = norm(step), np.isfinite(step[..., 0])
    # The last steps before the start, or the first ones after it for persons without a history.
    has_past = known[:HISTORY].any(axis=0)
    rank = np.where(has_past, 0, np.argmax(known, axis=0))
    rows = np.arange(len(step))[:, None]
    used = known & (rows >= rank) & (rows < np.where(has_past, HISTORY, rank + HISTORY))
    count = np.maximum(used.sum(axis=0), 1)
    mean = np.where(used[..., None], step, 0.0).sum(axis=0) / count[:, None]
    speed = np.where(used, speeds, 0.0).sum(axis=0) / count
    people = np.arange(len(group))
    velocity = np.nan_to_num(step[np.where(has_past, HISTORY - 1, rank), people])
    long = norm(mean)[:, None]
    heading = np.where(long > SLOW, mean / np.maximum(long, SLOW), [1.0, 0.0])
    return Window(name, number, position, group, scored, velocity, heading, speed, end)


def batches(windows: Sequence[Any], most: int) -> Iterator[list[Any]]:
    """Yield windows in batches of at most `most`, in their order."""
    for start in range(0, len(windows), most):
        yield list(windows[start : start + most])
