"""A crowd that waits in a hall and leaves it through a door, as in the experiment of Seyfried et al. (2009)."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from crowdbench import PedestrianPolicy, World
from crowdbench.scenario import PerAgent, Placement
from crowdbench.sim import crowd_velocities, step_pedestrians
from studies.validity.corridor import spread

NUMBER = 60
"""Number of pedestrians in the hall."""

HALL = 4.0
"""Width of the hall in metres."""

BEFORE = 3.0
"""Distance in metres from the door to the first of the crowd."""

BEHIND = 8.0
"""Distance in metres from the wall with the door to the goals behind it, which lie side by side."""

GONE = 4.0
"""Distance in metres behind the door at which pedestrians are removed, so that they do not block others."""

TIME = 120.0
"""Seconds after which the measurement ends."""

STILL = 20.0
"""A door is blocked if pedestrians wait, and none has passed it for this number of seconds."""


def hall(door: float, waiting: float) -> Callable[..., Placement]:
    """Return a layout of a hall with a door in the middle of one wall, at y = 0.

    Args:
        door: Width of the door in metres.
        waiting: Density of the waiting pedestrians in 1/m^2.

    Returns:
        The layout.
    """

    def layout(rng: np.random.Generator, radius: PerAgent, preferred_speed: PerAgent) -> Placement:
        number = len(radius) - 1
        depth = number / (waiting * HALL)
        back, side = -BEFORE - depth - 0.5, HALL / 2.0
        start = spread(rng, number, radius[1], depth, HALL)[:, ::-1] * [1.0, -1.0] - [0.0, BEFORE]
        corners = [(-side, 0.0), (-side, back), (side, back), (side, 0.0)]
        walls = [[(-side, 0.0), (-door / 2.0, 0.0)], [(door / 2.0, 0.0), (side, 0.0)]]
        walls += [list(pair) for pair in itertools.pairwise(corners)]
        goal = np.stack([2.0 * start[:, 0], np.full(number, BEHIND)], axis=1)
        # The vehicle, which no pedestrian sees, stands at the goals.
        vehicle = np.array([[0.0, BEHIND]])
        return Placement(np.concatenate([vehicle, start]), np.concatenate([vehicle, goal]), obstacles=np.array(walls))

    return layout


@dataclass(frozen=True)
class Passages:
    """Passages of pedestrians through the door.

    Attributes:
        step: The step after which each pedestrian was first behind the door; -1 if it never was.
        dt: Length of a step in seconds.
        steps: Number of steps.
    """

    step: Int[np.ndarray, "world person"]
    dt: float
    steps: int

    @property
    def share(self) -> Float[np.ndarray, "world"]:
        """The share of the pedestrians that have passed."""
        return (self.step >= 0).mean(axis=1)

    @property
    def blocked(self) -> Bool[np.ndarray, "world"]:
        """True if pedestrians wait, and none has passed in the last `STILL` seconds."""
        return (self.share < 1.0) & (self.step.max(axis=1) < self.steps - STILL / self.dt)

    def flow(self) -> Float[np.ndarray, "world"]:
        """Return pedestrians per second from the first passage to the last one, or to the end if some have not passed.

        NaN if none has passed, or all in the same step.
        """
        number = (self.step >= 0).sum(axis=1)
        first = np.where(self.step >= 0, self.step, self.steps).min(axis=1)
        last = np.where(self.share < 1.0, self.steps - 1, self.step.max(axis=1))
        duration = (last - first) * self.dt
        return np.divide(number - 1, duration, out=np.full(len(duration), np.nan), where=duration > 0.0)


def leave(world: World, policies: Mapping[str, PedestrianPolicy]) -> Passages:
    """Let a crowd leave a hall.

    Args:
        world: Its start, see `hall`.
        policies: The policies that move it.

    Returns:
        The passages through the door.
    """
    steps = round(TIME / world.rules.dt)
    passed = np.full(world.person.shape, -1)
    for step in range(steps):
        world = step_pedestrians(world, crowd_velocities(world, policies), None)
        y = world.position[:, 1:, 1]
        passed[(passed < 0) & (y > 0.0)] = step
        gone = np.pad(y > GONE, ((0, 0), (1, 0)))
        world = world.replace(present=world.present & ~gone)
        if not world.present[:, 1:].any():
            break
    return Passages(passed, world.rules.dt, steps)
