"""Windows of recorded tracks with cars (DUT), and features of persons near moving cars. See definition.md."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from crowdbench import InputError
from crowdbench.core import norm
from crowdbench.scenario import ETH_UCY_DT, FRAME_STEP, Car, RecordedTracks, known_files, read_clip
from studies.people.encounters import Places
from studies.people.windows import HISTORY, Window, cut
from studies.social_gan.windows import resample

FRAMES, EVERY = 15, 7
"""Frames of a window's future, 6 s, and from one start to the next, 2.8 s: clips are short, and windows overlap."""

VEHICLES = "_traj_veh_filtered.csv"
"""End of the name of the file with a clip's cars."""

DISCS = 3
"""Number of discs of half its width that represent a car."""

MOVING = 0.5
"""Speed in m/s from which a car moves."""

NEAR_CAR = 2.0
"""Distance in metres from a person's rim to that of a moving car: a predicted approach within it is near."""

RADIUS = 0.2
"""Assumed radius in metres of recorded persons."""


@dataclass(frozen=True, eq=False)
class Discs:
    """Discs of the cars of a window, from the start on.

    Attributes:
        position: Centres in metres; NaN for absent cars.
        radius: In metres.
        moving: True in the steps in which the car moves.
    """

    position: Float[np.ndarray, "time disc 2"]
    radius: Float[np.ndarray, "disc"]
    moving: Bool[np.ndarray, "step disc"]


@dataclass(frozen=True, eq=False)
class CarWindow:
    """A window with cars.

    Attributes:
        window: Its persons.
        start: Time of its start in seconds of the recording.
        cars: The cars that are present in its future; the first one is the car that moves nearest to a scored person.
    """

    window: Window
    start: float
    cars: Sequence[Car]

    def times(self, dt: float) -> Float[np.ndarray, "moment"]:
        """Return times in seconds of the recording, from the start to the end of the window."""
        return self.start + dt * np.arange(round(self.window.seconds / dt) + 1)

    @property
    def discs(self) -> Discs:
        """The discs of all cars."""
        return discs_of(self.cars, self.times(ETH_UCY_DT))

    @property
    def near(self) -> Bool[np.ndarray, "person"]:
        """True for scored persons whose rim would come within `NEAR_CAR` of a moving car, at the start velocities."""
        discs, window = self.discs, self.window
        ahead = ETH_UCY_DT * np.arange(len(discs.position))[:, None, None]
        places = window.first + ahead * window.velocity
        cars = discs.position[0] + ahead * (discs.position[1] - discs.position[0]) / ETH_UCY_DT
        moving = np.broadcast_to(discs.moving[0], discs.moving.shape)
        predicted = Discs(cars, discs.radius, moving)
        return window.scored & (rim_distance(places[None], predicted)[0] < NEAR_CAR)


def read_car_windows(data: Path) -> list[CarWindow]:
    """Return the windows of DUT in which a car moves and a person is scored.

    Args:
        data: The folder with the clips.

    Raises:
        InputError: A file is missing or wrong.
    """
    if not data.is_dir():
        raise InputError(f"there is no folder {data} with the recorded tracks of DUT")
    clips = sorted(name.removesuffix(VEHICLES) for name in known_files("dut") if name.endswith(VEHICLES))
    return [window for clip in clips for window in cut_with_cars(*read_clip(data, clip))]


def cut_with_cars(tracks: RecordedTracks, cars: Sequence[Car]) -> list[CarWindow]:
    """Return the windows of a clip in which a car moves."""
    coarse = resample(tracks, ETH_UCY_DT)
    first = coarse.frame.min() / FRAME_STEP * ETH_UCY_DT
    found = []
    for window in cut(coarse, FRAMES, EVERY):
        start = first + ETH_UCY_DT * (HISTORY + window.number * EVERY)
        each = CarWindow(window, start, [])
        here = [car for car in cars if np.isfinite(pose(car, each.times(ETH_UCY_DT))[1]).any()]
        distance = [_nearest(each, car) for car in here]
        if np.isfinite(distance).any():
            found.append(CarWindow(window, start, [here[i] for i in np.argsort(distance, kind="stable")]))
    return found


def _nearest(window: CarWindow, car: Car) -> float:
    """Return the least distance in metres of a moving car to a scored person; infinite if it never moves."""
    distance = rim_distance(window.window.future[None], discs_of([car], window.times(ETH_UCY_DT)))
    return float(distance[0, window.window.scored].min())


def pose(car: Car, times: Float[np.ndarray, "moment"]) -> tuple[np.ndarray, np.ndarray]:
    """Return positions in metres and headings in radians of a car; NaN while it is absent."""
    here = (times >= car.time[0] - 1e-6) & (times <= car.time[-1] + 1e-6)
    values = [np.where(here, np.interp(times, car.time, each), np.nan) for each in (*car.position.T, car.heading)]
    return np.stack(values[:2], axis=-1), values[2]


def discs_of(cars: Sequence[Car], times: Float[np.ndarray, "moment"]) -> Discs:
    """Return the discs of cars at times in seconds."""
    positions, radii = [np.empty((len(times), 0, 2))], [np.empty(0)]
    for car in cars:
        position, heading = pose(car, times)
        reach = (car.length - car.width) / 2.0
        ahead = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
        positions.append(position[:, None] + np.linspace(-reach, reach, DISCS)[:, None] * ahead[:, None])
        radii.append(np.full(DISCS, car.width / 2.0))
    position = np.concatenate(positions, axis=1)
    speed = norm(np.diff(position, axis=0)) / np.diff(times)[:, None]
    return Discs(position, np.concatenate(radii), speed > MOVING)


def rim_distance(places: Places, discs: Discs) -> Float[np.ndarray, "rollout person"]:
    """Return the least distance in metres of each person's rim to that of a moving car; infinite without one.

    Between frames, motion is straight. Negative distances are overlaps.
    """
    begin, motion = _relative(places, discs)
    with np.errstate(invalid="ignore", divide="ignore"):
        share = np.clip(-(begin * motion).sum(axis=-1) / (motion**2).sum(axis=-1), 0.0, 1.0)
    distance = norm(begin + np.nan_to_num(share)[..., None] * motion) - discs.radius - RADIUS
    counts = np.isfinite(distance) & discs.moving[:, None]
    return np.where(counts, distance, np.inf).min(axis=(1, 3), initial=np.inf)


def time_to_collision(places: Places, discs: Discs) -> Float[np.ndarray, "rollout person"]:
    """Return the least time in seconds to a collision of each person with a moving car, at the velocities of a step.

    0 if they overlap, infinite if no collision is ahead.
    """
    begin, motion = _relative(places, discs)
    velocity, reach = motion / ETH_UCY_DT, discs.radius + RADIUS
    a, b, c = (velocity**2).sum(axis=-1), (begin * velocity).sum(axis=-1), (begin**2).sum(axis=-1) - reach**2
    with np.errstate(invalid="ignore", divide="ignore"):
        time = (-b - np.sqrt(b * b - a * c)) / a
    time = np.where(c <= 0.0, 0.0, np.where((b < 0.0) & np.isfinite(time), time, np.inf))
    counts = np.isfinite(begin[..., 0]) & np.isfinite(motion[..., 0]) & discs.moving[:, None]
    return np.where(counts, time, np.inf).min(axis=(1, 3), initial=np.inf)


def _relative(places: Places, discs: Discs) -> tuple[np.ndarray, np.ndarray]:
    """Return vectors from cars to persons at the begin of each step in metres, and their changes in the step."""
    apart = places[:, :, :, None] - discs.position[:, None]
    return apart[:, :-1], np.diff(apart, axis=1)
