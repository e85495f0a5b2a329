"""Excerpts: time windows of a scene, in steps of a simulation, and their division into splits."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from crowdbench.core.geometry import pad_points
from crowdbench.scenario.tracks.dut import Car
from crowdbench.scenario.tracks.recorded_tracks import RecordedTracks
from crowdbench.scenario.tracks.scenes import SceneRecording

TRAIN_SHARE, VAL_SHARE = 0.4, 0.1
"""Shares of a scene's blocks for training (the first blocks) and for validation (the next blocks)."""

PACE = 0.75
"""The vehicle's goal is the recorded car's position after this share of the window."""

MIN_TRIP = 5.0
"""Smallest distance in metres from a recorded car's start to its goal: slower cars wait or are parked."""

DISCS = 3
"""Number of discs that represent a car that is not the vehicle."""

SPACING = 2.0
"""Distance in metres between waypoints on a recorded path."""

_ROUNDING = 1e-6
"""Tolerance of times in seconds."""

Times = Float[np.ndarray, "time"]
Track = Float[np.ndarray, "time 2"]


@dataclass(frozen=True)
class MovingDisc:
    """A disc that moves: a pedestrian, or a part of a car.

    Attributes:
        time: The times of its positions in seconds.
        position: In metres.
        radius: In metres; NaN for a pedestrian, because recordings contain no radii.
    """

    time: Float[np.ndarray, "row"]
    position: Float[np.ndarray, "row 2"]
    radius: float = math.nan

    def is_there(self, time: Times) -> Bool[np.ndarray, "time"]:
        """Return whether the disc was present at each of these times in seconds."""
        return (time >= self.time[0] - _ROUNDING) & (time <= self.time[-1] + _ROUNDING)

    def at(self, time: Times) -> Track:
        """Return positions by linear interpolation of the recorded ones; NaN before the first and after the
        last.

        Args:
            time: Times in seconds.

        Returns:
            Positions in metres.
        """
        return np.where(self.is_there(time)[:, None], interpolate(time, self.time, self.position), np.nan)


@dataclass(frozen=True)
class CarMotion:
    """Motion of a recorded car that the vehicle replaces.

    Attributes:
        start: Position of its middle at the start in metres.
        goal: Position of its middle after `PACE` of the window in metres.
        heading: Its heading at the start in radians.
        speed: Its speed at the start in m/s.
    """

    start: Float[np.ndarray, "2"]
    goal: Float[np.ndarray, "2"]
    heading: float
    speed: float


@dataclass(frozen=True)
class Excerpt:
    """Time window of a recording, with the data of a case.

    Attributes:
        recording: The name of the recording.
        first: Its start in seconds of the recording's time.
        block: Number of its block in the scene. A block is a single window, or a clip with cars.
        track: Position of each agent at each step in metres; NaN for absent agents.
        velocity: Velocity of each agent in m/s at the first step, from the one before; 0 for agents that come later.
        radius: Radii in metres; NaN for pedestrians.
        goal: End of each agent's track in metres, even if it is after the window.
        route: Waypoints of each agent on the way to its goal, in metres, NaN after the last one.
        mean_speed: Mean speed of each agent on this path in m/s.
        top_speed: Largest speed of each agent in m/s.
        replaced_car: The car that the vehicle replaces; None without cars.
    """

    recording: str
    first: float
    block: int
    track: Float[np.ndarray, "time agent 2"]
    velocity: Float[np.ndarray, "agent 2"]
    radius: Float[np.ndarray, "agent"]
    goal: Float[np.ndarray, "agent 2"]
    route: Float[np.ndarray, "agent waypoint 2"]
    mean_speed: Float[np.ndarray, "agent"]
    top_speed: Float[np.ndarray, "agent"]
    replaced_car: CarMotion | None


def cut_windows(recordings: Sequence[SceneRecording], steps: int, dt: float) -> list[Excerpt]:
    """Return the windows of a scene that contain pedestrians, in order.

    Without cars, windows follow each other without a gap. With cars, a window starts when a car appears, and
    others follow it until the car disappears. No window extends beyond the recording.

    Args:
        recordings: The recordings of the scene.
        steps: The number of steps of a window.
        dt: The length of a step in seconds.

    Returns:
        The excerpts in the order of the recordings and of time.
    """
    excerpts: list[Excerpt] = []
    for recording in recordings:
        pedestrians = list(recorded_pedestrians(recording.tracks))
        first_times = np.array([disc.time[0] for disc in pedestrians])
        last_times = np.array([disc.time[-1] for disc in pedestrians])
        of_recording: list[Excerpt] = []
        first_block = excerpts[-1].block + 1 if excerpts else 0
        for first, car, replaced_car in _windows(recording, steps, dt):
            times = first + dt * np.arange(-1, steps + 1)
            near = (first_times <= times[-1] + dt) & (last_times >= times[0])
            people = [pedestrians[i] for i in np.flatnonzero(near) if pedestrians[i].is_there(times[1:]).any()]
            others = [disc for other in recording.cars if other is not car for disc in car_discs(other)]
            others = [disc for disc in others if disc.is_there(times[1:]).any()]
            if people:
                block = first_block + (len(of_recording) if car is None else 0)
                of_recording.append(cut_excerpt(recording.tracks.name, block, times, [*people, *others], replaced_car))
        excerpts += of_recording
    return excerpts


def split_windows(excerpts: Sequence[Excerpt]) -> Mapping[str, list[Excerpt]]:
    """Split windows in time: the first blocks are for training, the next ones for validation, the last half for tests.

    Args:
        excerpts: The windows of a scene, as `cut_windows` returns them.

    Returns:
        The windows by split.
    """
    blocks = excerpts[-1].block + 1 if excerpts else 0
    train, val = math.floor(TRAIN_SHARE * blocks), math.floor((TRAIN_SHARE + VAL_SHARE) * blocks)
    return {
        "train": [excerpt for excerpt in excerpts if excerpt.block < train],
        "val": [excerpt for excerpt in excerpts if train <= excerpt.block < val],
        "test": [excerpt for excerpt in excerpts if excerpt.block >= val],
    }


def recorded_pedestrians(tracks: RecordedTracks) -> Iterator[MovingDisc]:
    """Yield the pedestrians of a recording."""
    bounds = np.flatnonzero(np.diff(tracks.pedestrian)) + 1
    yield from map(MovingDisc, np.split(tracks.seconds, bounds), np.split(tracks.position, bounds))


def car_discs(car: Car) -> Iterator[MovingDisc]:
    """Yield a car as discs of half its width, one after the other along its axis."""
    direction = np.stack([np.cos(car.heading), np.sin(car.heading)], axis=1)
    reach = (car.length - car.width) / 2.0
    for ahead in np.linspace(-reach, reach, DISCS):
        yield MovingDisc(car.time, car.position + ahead * direction, car.width / 2.0)


def _windows(recording: SceneRecording, steps: int, dt: float) -> list[tuple[float, Car | None, CarMotion | None]]:
    """Return the start time in seconds of each window, in order of time, and the car that the vehicle replaces in it,
    if any."""
    time, length = recording.tracks.seconds, steps * dt
    start, end = float(time.min()), float(time.max())
    if not recording.cars:
        number = math.floor((end - start) / length + _ROUNDING)
        # Not all of them: a wrong time would make billions of empty windows.
        near = {
            index
            for person in recorded_pedestrians(recording.tracks)
            for index in range(
                math.floor((person.time[0] - start) / length) - 1, math.floor((person.time[-1] - start) / length) + 2
            )
        }
        return [(start + index * length, None, None) for index in sorted(near) if 0 <= index < number]
    end = max(end, *(float(car.time[-1]) for car in recording.cars))
    windows: list[tuple[float, Car | None, CarMotion | None]] = []
    for car in recording.cars:
        for index in itertools.count():
            first = float(car.time[0]) + index * length
            if first >= car.time[-1] or first + length > end + _ROUNDING:
                break
            replaced_car = _follow_car(car, first, first + PACE * steps * dt)
            if math.dist(replaced_car.start, replaced_car.goal) >= MIN_TRIP:
                windows.append((first, car, replaced_car))
    return sorted(windows, key=lambda window: window[0])


def _follow_car(car: Car, first: float, end: float) -> CarMotion:
    """Return the motion of a car from one time to another in seconds, or to its last recorded time."""
    middle = MovingDisc(car.time, car.position)
    start, goal = middle.at(np.array([first, min(end, float(car.time[-1]))]))
    # Over a quarter of a second: the difference of two frames is mostly noise.
    soon = min(first + 0.25, float(car.time[-1]))
    offset = middle.at(np.array([soon]))[0] - start
    speed = float(np.hypot(*offset)) / (soon - first) if soon > first else 0.0
    return CarMotion(start, goal, float(np.interp(first, car.time, car.heading)), speed)


def cut_excerpt(
    name: str,
    block: int,
    times: Float[np.ndarray, "states"],
    discs: Sequence[MovingDisc],
    replaced_car: CarMotion | None,
) -> Excerpt:
    """Cut a window.

    Args:
        name: The name of the recording.
        block: The number of its block in the scene.
        times: The times of its steps in seconds, preceded by the time of the step before the first one.
        discs: The pedestrians and discs of cars that are present at one of its steps or more.
        replaced_car: The car that the vehicle replaces, if any.
    """
    dt = times[1] - times[0]
    track = np.stack([disc.at(times) for disc in discs], axis=1)
    paths = [_path(disc, at[1:], times[1:]) for disc, at in zip(discs, track.swapaxes(0, 1), strict=True)]
    moves = np.diff(track[1:], axis=0)
    # Difference to the step before, or to the step after for agents that appear at the first step.
    before, after = track[1] - track[0], track[2] - track[1]
    velocity = np.nan_to_num(np.where(np.isfinite(before), before, after)) / dt
    top = np.nanmax(np.hypot(moves[..., 0], moves[..., 1]), axis=0, initial=0.0) / dt
    return Excerpt(
        recording=name,
        first=float(times[1]),
        block=block,
        track=track[1:],
        velocity=velocity,
        radius=np.array([disc.radius for disc in discs]),
        goal=np.stack([disc.position[-1] for disc in discs]),
        route=pad_points([waypoints for waypoints, _ in paths]),
        mean_speed=np.array([speed for _, speed in paths]),
        top_speed=np.maximum(top, np.hypot(*velocity.T)),
        replaced_car=replaced_car,
    )


def _path(disc: MovingDisc, track: Track, times: Times) -> tuple[Float[np.ndarray, "waypoint 2"], float]:
    """Return waypoints from the first step in which a disc is present to the end of its track, and its mean speed in
    m/s.

    `track` contains its positions in metres at the `times` of the steps in seconds.
    """
    first = int(np.isfinite(track[:, 0]).argmax())
    later = disc.time > times[first]
    points = np.concatenate([track[first][None], disc.position[later]])
    lengths = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    duration = disc.time[-1] - times[first]
    marks = np.arange(SPACING, lengths[-1] - SPACING / 2.0, SPACING)
    return interpolate(marks, lengths, points), float(lengths[-1] / duration) if duration > _ROUNDING else 0.0


def interpolate(at: Times, known: Float[np.ndarray, "row"], position: Float[np.ndarray, "row 2"]) -> Track:
    """Return positions in metres at times, or lengths of path, by interpolation between `known` ones."""
    return np.stack([np.interp(at, known, position[:, axis]) for axis in (0, 1)], axis=1)
