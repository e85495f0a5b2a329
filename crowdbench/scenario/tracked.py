"""Crowds of recorded people: which window of time a case is, and who starts where in it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from crowdbench.dynamics import Body
from crowdbench.errors import InputError
from crowdbench.scenario.free_space import FreeSpace
from crowdbench.scenario.people import Traits
from crowdbench.scenario.placement import Placement
from crowdbench.sim.presence import come_and_go
from crowdbench.tracks.excerpts import Excerpt, excerpts, split_excerpts, ways_of
from crowdbench.tracks.scenes import Scene
from crowdbench.types import Rules, World

RECORDED = "recorded"
"""The name of the policy of those who walk as they were recorded."""

SLOWEST = 1e-3
"""Smallest preferred speed in m/s, that of people who stood."""

_ROOM = 1.0 + 1e-9
"""By what the largest speed of recorded people is multiplied, so that rounding does not slow them down."""


@dataclass(frozen=True)
class TrackedCrowd:
    """The people of a scene, as a scenario has them.

    Attributes:
        scene: The name of the scene.
        distance: Smallest distance in metres from the vehicle's start to its goal, where no car gives them.
        windows: The windows by split.
        free_space: The free space of each recording by its name.
        has_cars: Whether the vehicle takes the place of a recorded car, and other cars are there.
    """

    scene: str
    distance: float
    windows: Mapping[str, Sequence[Excerpt]]
    free_space: Mapping[str, FreeSpace]
    has_cars: bool

    @classmethod
    def of(cls, scene: Scene, distance: float, rules: Rules) -> TrackedCrowd:
        """Cut a scene into the windows of a scenario, each as long as an episode that times out.

        Args:
            scene: The scene.
            distance: See there.
            rules: The rules of the scenario.

        Raises:
            InputError: No recording is as long as an episode may be.
        """
        found = excerpts(scene, rules.max_steps, rules.dt)
        if not found:
            raise InputError(
                f"no recording of the scene {scene.name} holds people for the {rules.max_steps * rules.dt:g} s that an "
                "episode may take: lower time_limit"
            )
        has_cars = any(recording.cars for recording in scene.recordings)
        free = {} if has_cars else {each.tracks.name: FreeSpace(ways_of(each.tracks)) for each in scene.recordings}
        return cls(scene.name, distance, split_excerpts(found), free, has_cars)

    @property
    def number(self) -> tuple[int, int]:
        """The smallest and the largest number of people and discs of cars in a window."""
        numbers = [len(window.radius) for window in self._all]
        return min(numbers), max(numbers)

    @property
    def top_speed(self) -> float:
        """The largest speed of anybody in a window, in m/s."""
        return max(SLOWEST, *(_ROOM * float(window.top_speed.max()) for window in self._all))

    @property
    def largest_radius(self) -> float:
        """The largest radius in metres of a disc of a car; 0 where there are no cars."""
        return max(float(np.max(window.radius, initial=0.0, where=window.radius > 0.0)) for window in self._all)

    @property
    def extent(self) -> float:
        """The largest coordinate in metres of anybody, or of their goal."""
        each = (part for window in self._all for part in (window.track, window.goal))
        return max(float(np.nanmax(np.abs(part))) for part in each)

    @property
    def _all(self) -> list[Excerpt]:
        return [window for windows in self.windows.values() for window in windows]

    def most_cases(self, split: str) -> int | None:
        """How many cases a split has at most; None where the windows start again with other draws."""
        return len(self.windows[split]) if self.has_cars and split != "train" else None

    def window(self, split: str, case: int) -> Excerpt:
        """The window of a case: they follow each other, and start again after the last one with other draws.

        Raises InputError where the split has no windows. Where the vehicle takes the place of a car, so that nothing is
        drawn, it has no more cases than windows; only training repeats them.
        """
        windows = self.windows[split]
        most = self.most_cases(split)
        if not windows or (most is not None and case >= most):
            numbers = ", ".join(f"{name}:{len(each)}" for name, each in self.windows.items())
            raise InputError(
                f"there is no case {split}:{case}: the scene {self.scene} has no more windows of time than {numbers}"
            )
        return windows[case % len(windows)]

    def blocks(self, split: str, cases: Int[np.ndarray, "world"]) -> Int[np.ndarray, "world"]:
        """The block of time of each case, of which no two share a moment.

        Args:
            split: The split of the cases.
            cases: Their numbers.
        """
        return np.array([self.window(split, case).block for case in cases.tolist()], np.int64)

    def place(
        self,
        window: Excerpt,
        rng: np.random.Generator,
        radius: Float[np.ndarray, "agent"],
        rules: Rules,
    ) -> Placement:
        """Place the agents of a case.

        Args:
            window: The window of the case.
            rng: The random stream of the case.
            radius: Radii in metres, the vehicle's around its whole body.
            rules: The rules of the scenario.

        Returns:
            Starts and goals, and the recorded ways. Who comes later starts where they come.

        Raises:
            InputError: There is no room for the vehicle.
        """
        if window.driven is None:
            start, goal = self.free_space[window.recording].draw(rng, self.distance, radius, window.track, rules.dt)
        else:
            offset = _middle(rules.body) * np.array([np.cos(window.driven.heading), np.sin(window.driven.heading)])
            start, goal = window.driven.start - offset, window.driven.goal - offset
        people = np.arange(len(window.radius))
        first = np.isfinite(window.track[..., 0]).argmax(axis=0)
        route = np.concatenate([np.full((1, *window.route.shape[1:]), np.nan), window.route])
        return Placement(
            np.concatenate([start[None], window.track[first, people]]),
            np.concatenate([goal[None], window.goal]),
            route,
        )

    def begun(self, world: World, windows: Sequence[Excerpt]) -> World:
        """Worlds as their windows start.

        Args:
            world: Worlds in which all agents of the windows are present and stand.
            windows: The window of each world.

        Returns:
            The worlds with tracks, velocities, and those present who are there at the start.
        """
        track = np.full((len(world), world.rules.max_steps + 1, *world.person.shape[1:], 2), np.nan)
        recorded = np.zeros((*world.person.shape, 2))
        velocity, heading, present = world.velocity.copy(), world.heading.copy(), world.present.copy()
        present[:, 1:] = False
        for w, window in enumerate(windows):
            n = len(window.radius)
            track[w, :, :n], recorded[w, :n] = window.track, window.velocity
            if window.driven is not None:
                heading[w] = window.driven.heading
                speed = min(window.driven.speed, world.preferred_speed[w, 0])
                velocity[w, 0] = speed * np.array([np.cos(heading[w]), np.sin(heading[w])])
        world = come_and_go(
            world.replace(track=track, velocity=velocity, heading=heading, present=present), np.ones(len(world), bool)
        )
        velocity[:, 1:] = np.where(world.present[:, 1:, None], recorded, 0.0)
        return world.replace(velocity=velocity)


def as_recorded(window: Excerpt, traits: Traits, policies: Sequence[str]) -> Traits:
    """Pedestrians with what a window tells of them: their speeds, and which of them are parts of cars.

    Args:
        window: The window.
        traits: What was drawn for each.
        policies: The names of the policies, as `traits.policy` counts them.

    Returns:
        The same with the preferred speeds that tracks need, or the mean ones of those who react. Cars are recorded.
    """
    recorded = policies.index(RECORDED) if RECORDED in policies else -1
    is_car = ~np.isnan(window.radius)
    policy = np.where(is_car, recorded, traits.policy)
    return traits._replace(
        radius=np.where(is_car, window.radius, traits.radius),
        preferred_speed=np.maximum(np.where(policy == recorded, _ROOM * window.top_speed, window.mean_speed), SLOWEST),
        policy=policy,
    )


def _middle(body: Body) -> float:
    """How far the middle of a body is ahead of its position, in metres."""
    return (body[0] + body[-1]) / 2.0
