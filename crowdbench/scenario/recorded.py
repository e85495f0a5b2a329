"""Crowds of recorded pedestrians: the time window of each case, and the starts in it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from crowdbench.core import rng
from crowdbench.core.dynamics import reach
from crowdbench.core.geometry import norm
from crowdbench.core.types import Rules, World
from crowdbench.scenario.layouts.placer import CLEARANCE
from crowdbench.scenario.placement import PerAgent, Placement, Position, Trip
from crowdbench.scenario.population import RECORDED, Population, Traits
from crowdbench.scenario.schema import VehicleSpec
from crowdbench.scenario.starts import Case, Start
from crowdbench.scenario.tracks.excerpts import Excerpt, cut_windows, interpolate, recorded_pedestrians, split_windows
from crowdbench.scenario.tracks.recorded_tracks import RecordedTracks
from crowdbench.scenario.tracks.scenes import SceneRecording
from crowdbench.sim.presence import come_and_go
from crowdbench.sim.simulator import PostStepRule
from crowdbench.utils.errors import InputError

Tracked = Float[np.ndarray, "time pedestrian 2"]

MIN_SPEED = 1e-3
"""Smallest preferred speed in m/s, for recorded pedestrians that stood still."""

_SPEED_MARGIN = 1.0 + 1e-9
"""Factor on the largest speed of recorded pedestrians, so that rounding does not slow them down."""

CELL = 0.5
"""Side of a cell in metres. A cell is free if a pedestrian has walked in it or in one of its eight neighbours."""

MAX_EXCESS = 2.0
"""Largest excess in metres of the goal's distance over the requested distance."""

CLEAR_TIME = 1.0
"""Initial time in seconds in which no pedestrian comes near the vehicle's start, because the vehicle is still there."""

MAX_BUSY_SHARE = 0.5
"""Largest share of the time in which a pedestrian covers the goal."""

DRAWS = 20_000
"""Number of pairs of a start and a goal that are tried."""


class FreeSpace:
    """Free space for the vehicle's start and goal in a recorded scene without a map: cells in which pedestrians walked.

    Args:
        tracks: The recording of the scene.
    """

    def __init__(self, tracks: RecordedTracks) -> None:
        points = np.concatenate([_dense(person.position) for person in recorded_pedestrians(tracks)])
        self.origin = points.min(axis=0) - 2.0 * CELL
        x, y = ((points - self.origin) / CELL).astype(np.int64).T
        # One number for each cell, because rows of an array are sorted far more slowly.
        height = y.max() + 1
        self.walked = np.stack(np.divmod(np.unique(x * height + y), height), axis=1)
        around = self.walked[:, None] + [(dx, dy) for dx in (-1, 0, 1) for dy in (-1, 0, 1)]
        self.free = {tuple(cell) for cell in np.unique(around.reshape(-1, 2), axis=0).tolist()}

    def draw(self, stream: np.random.Generator, distance: float, radius: PerAgent, track: Tracked, dt: float) -> Trip:
        """Draw start and goal of the vehicle, with free space on the straight line between them.

        Args:
            stream: The random stream to draw from.
            distance: Their smallest distance in metres.
            radius: Radii in metres, the vehicle's first.
            track: Positions of the pedestrians at each step in metres; NaN for absent pedestrians.
            dt: Length of a step in seconds.

        Raises:
            InputError: There is no room.
        """
        cells = self.walked[stream.integers(len(self.walked), size=(DRAWS, 2))]
        points = self.origin + CELL * (cells + stream.uniform(size=cells.shape))
        far = norm(points[:, 1] - points[:, 0])
        reach = radius[0] + radius[1:]
        soon = track[: int(np.ceil(CLEAR_TIME / dt)) + 1]
        for start, goal in points[(far >= distance) & (far <= distance + MAX_EXCESS)]:
            if self._is_free(start, goal) and not (norm(soon - start) < reach + CLEARANCE).any():
                is_busy = (norm(track - goal) < reach).any(axis=1)
                if is_busy.mean() <= MAX_BUSY_SHARE:
                    return start, goal
        raise InputError(f"the vehicle has no room to start with a goal {distance:g} m away: lower tracks.distance")

    def _is_free(self, start: Position, goal: Position) -> bool:
        along = np.linspace(0.0, 1.0, int(np.ceil(2.0 * math.dist(start, goal) / CELL)) + 1)[:, None]
        cells = ((start + along * (goal - start) - self.origin) / CELL).astype(np.int64)
        return self.free.issuperset(map(tuple, cells.tolist()))


def _dense(path: Float[np.ndarray, "row 2"]) -> Float[np.ndarray, "point 2"]:
    """Return a path with added points, so that neighbouring points are at most half a cell apart."""
    if len(path) < 2:
        return path
    parts = np.maximum(np.ceil(norm(np.diff(path, axis=0)) / (CELL / 2.0)).astype(np.int64), 1)
    number = np.repeat(parts, parts)
    within = np.arange(len(number)) - np.repeat(np.cumsum(parts) - parts, parts)
    at = np.repeat(np.arange(len(parts)), parts) + within / number
    return np.concatenate([interpolate(at, np.arange(len(path), dtype=np.float64), path), path[-1:]])


@dataclass(frozen=True)
class TrackedCrowd:
    """The recorded crowd of a scenario.

    Attributes:
        scene: The name of the scene.
        distance: Smallest distance in metres from the vehicle's start to its goal; unused if cars are recorded.
        windows: The windows by split.
        free_space: The free space of each recording by its name.
        has_cars: True if the scene has cars: the vehicle replaces one of them, and the others drive as recorded.
    """

    scene: str
    distance: float
    windows: Mapping[str, Sequence[Excerpt]]
    free_space: Mapping[str, FreeSpace]
    has_cars: bool

    @classmethod
    def of(cls, scene: str, recordings: Sequence[SceneRecording], distance: float, rules: Rules) -> TrackedCrowd:
        """Cut a scene into the windows of a scenario, each as long as an episode that times out.

        Args:
            scene: The name of the scene.
            recordings: Its recordings.
            distance: Smallest distance in metres from the vehicle's start to its goal; unused if cars are recorded.
            rules: The rules of the scenario.

        Raises:
            InputError: No recording with pedestrians is as long as the longest episode.
        """
        windows = cut_windows(recordings, rules.max_steps, rules.dt)
        if not windows:
            raise InputError(
                f"no recording of the scene {scene} holds people for the {rules.max_steps * rules.dt:g} s that an "
                "episode may take: lower time_limit"
            )
        has_cars = any(recording.cars for recording in recordings)
        free = {recording.tracks.name: FreeSpace(recording.tracks) for recording in recordings if not has_cars}
        return cls(scene, distance, split_windows(windows), free, has_cars)

    @property
    def number(self) -> tuple[int, int]:
        """The smallest and the largest number of pedestrians and discs of cars in a window."""
        numbers = [len(window.radius) for window in self._all]
        return min(numbers), max(numbers)

    @property
    def top_speed(self) -> float:
        """The largest speed of a pedestrian or car in all windows, in m/s."""
        return max(MIN_SPEED, *(_SPEED_MARGIN * float(window.top_speed.max()) for window in self._all))

    @property
    def largest_radius(self) -> float:
        """The largest radius in metres of a disc of a car; 0 without cars."""
        return max(float(np.max(window.radius, initial=0.0, where=window.radius > 0.0)) for window in self._all)

    @property
    def extent(self) -> float:
        """The largest absolute coordinate in metres of all positions and goals."""
        return max(float(np.nanmax(np.abs(points))) for window in self._all for points in (window.track, window.goal))

    @property
    def _all(self) -> list[Excerpt]:
        return [window for windows in self.windows.values() for window in windows]

    def most_cases(self, split: str) -> int | None:
        """Return the number of cases of a split; None if the windows are repeated with other random draws."""
        return len(self.windows[split]) if self.has_cars and split != "train" else None

    def window(self, split: str, case: int) -> Excerpt:
        """Return the window of a case. After the last window, cases repeat the windows with other random draws.

        Raises InputError if the split has no such case. If the vehicle replaces a car, nothing is drawn: then only the
        training split repeats windows.
        """
        windows = self.windows[split]
        most = self.most_cases(split)
        if not windows or (most is not None and case >= most):
            numbers = ", ".join(f"{name}:{len(excerpts)}" for name, excerpts in self.windows.items())
            raise InputError(
                f"there is no case {split}/{case}: the scene {self.scene} has no more windows of time than {numbers}"
            )
        return windows[case % len(windows)]

    def blocks(self, split: str, cases: Int[np.ndarray, "world"]) -> Int[np.ndarray, "world"]:
        """Return the block of recorded time of each case. Different blocks do not overlap.

        Args:
            split: The split of the cases.
            cases: Their numbers.
        """
        return np.array([self.window(split, case).block for case in cases.tolist()], np.int64)

    def start(self, case: Case, crowd: Population, vehicle: VehicleSpec, rules: Rules) -> Start:
        """Draw the start of a case, see `LayoutStarts`. Later pedestrians start at their first recorded position."""
        window = self.window(case.split, case.number)
        traits = crowd.draw(rng.generator(case.key, "crowd"), len(window.radius), window.mean_speed)
        traits = _with_recorded_traits(window, traits, list(crowd.parameters))
        radius = np.append(vehicle.radius + reach(rules.body), traits.radius)
        with case.location.named():
            placement = self._place(window, rng.generator(case.key, "places"), radius, rules)
        return Start(traits, placement, np.full(len(window.radius), -1))

    def post_step_rule(self, crowd: Population) -> PostStepRule:
        """Return the rule by which pedestrians appear and disappear as recorded."""
        return come_and_go

    def _place(self, window: Excerpt, stream: np.random.Generator, radius: PerAgent, rules: Rules) -> Placement:
        """Return starts, goals and recorded paths. Raises InputError if there is no room for the vehicle."""
        if window.replaced_car is None:
            start, goal = self.free_space[window.recording].draw(stream, self.distance, radius, window.track, rules.dt)
        else:
            middle = (rules.body[0] + rules.body[-1]) / 2.0  # offset of the body from the position
            offset = middle * np.array([np.cos(window.replaced_car.heading), np.sin(window.replaced_car.heading)])
            start, goal = window.replaced_car.start - offset, window.replaced_car.goal - offset
        people = np.arange(len(window.radius))
        first = np.isfinite(window.track[..., 0]).argmax(axis=0)
        route = np.concatenate([np.full((1, *window.route.shape[1:]), np.nan), window.route])
        starts, goals = np.vstack([start, window.track[first, people]]), np.vstack([goal, window.goal])
        return Placement(starts, goals, route)

    def complete(self, world: World, cases: Sequence[Case], starts: Sequence[Start]) -> World:
        """Return the worlds with tracks, velocities, and the agents that are present at the start."""
        windows = [self.window(case.split, case.number) for case in cases]
        track = np.full((len(world), world.rules.max_steps + 1, *world.person.shape[1:], 2), np.nan)
        recorded = np.zeros((*world.person.shape, 2))
        velocity, heading, present = world.velocity.copy(), world.heading.copy(), world.present.copy()
        present[:, 1:] = False
        for w, window in enumerate(windows):
            n = len(window.radius)
            track[w, :, :n], recorded[w, :n] = window.track, window.velocity
            if window.replaced_car is not None:
                heading[w] = window.replaced_car.heading
                speed = min(window.replaced_car.speed, world.preferred_speed[w, 0])
                velocity[w, 0] = speed * np.array([np.cos(heading[w]), np.sin(heading[w])])
        world = world.replace(track=track, velocity=velocity, heading=heading, present=present)
        world = come_and_go(world, np.ones(len(world), bool))
        velocity[:, 1:] = np.where(world.present[:, 1:, None], recorded, 0.0)
        return world.replace(velocity=velocity)


def _with_recorded_traits(window: Excerpt, traits: Traits, policies: Sequence[str]) -> Traits:
    """Return pedestrians with their recorded speeds; discs of cars get their radius and the policy `recorded`.

    Pedestrians with the policy `recorded` get their largest speed, which their track needs, others keep theirs.
    `policies` are the names of the policies that `traits.policy` indexes.
    """
    recorded = policies.index(RECORDED) if RECORDED in policies else -1
    is_car = ~np.isnan(window.radius)
    policy = np.where(is_car, recorded, traits.policy)
    speed = np.maximum(
        np.where(policy == recorded, _SPEED_MARGIN * window.top_speed, traits.preferred_speed), MIN_SPEED
    )
    return traits._replace(radius=np.where(is_car, window.radius, traits.radius), preferred_speed=speed, policy=policy)
