"""Base class of the dynamics of a vehicle, and the grids of commands that a lookahead chooses from."""

from __future__ import annotations

import abc
import math
from collections.abc import Mapping
from functools import cached_property
from typing import ClassVar, NamedTuple, no_type_check

import numpy as np
from jaxtyping import Bool, Float

from crowdbench.core.arrays import Numbers, Vectors
from crowdbench.core.dynamics.kernels import HOLONOMIC, SPEED_TOLERANCE, Motion, drive
from crowdbench.utils.compiled import njit
from crowdbench.utils.errors import InputError, is_number

Choices = Float[np.ndarray, "world action 2"]
"""Several commands or velocities per vehicle."""


class State(NamedTuple):
    """Motion state of vehicles.

    Attributes:
        position: In metres. For a bicycle, the middle of the rear axle.
        velocity: At the end of the last step, in m/s.
        heading: Direction in which it faces, in radians.
        angular_speed: Turn rate in the last step, in rad/s.
    """

    position: Vectors
    velocity: Vectors
    heading: Numbers
    angular_speed: Numbers

    @property
    def speed(self) -> Numbers:
        """The velocity along the heading, in m/s."""
        along: np.ndarray = self.velocity[..., 0] * np.cos(self.heading) + self.velocity[..., 1] * np.sin(self.heading)
        return along


class Dynamics(abc.ABC):
    """Dynamics of a vehicle. A command is two numbers, constant during a step.

    Attributes:
        name: Its name in scenarios.
        code: Code of its formulas in `crowdbench.core.dynamics.kernels.drive`.
        bounds: The names of its limits, in the order of `limits` in that function, with their largest values.

    Raises:
        InputError: A limit is neither its default nor above 0, or larger than its bound.
    """

    name: ClassVar[str]
    code: ClassVar[int]
    bounds: ClassVar[Mapping[str, float]]

    def __post_init__(self) -> None:
        for name, most in self.bounds.items():
            limit, default = getattr(self, name), getattr(type(self), name)
            if not (is_number(limit) and (0.0 < limit <= most or limit == default)):
                right = "a number above 0" if most == math.inf else f"a number above 0, and {most:g} at most"
                raise InputError(f"{name} is {limit!r}, but must be {right}")

    @cached_property
    def limits(self) -> Float[np.ndarray, "4"]:
        """Its limits as an argument of kernels; unused entries are 0."""
        limits = np.zeros(4)
        limits[: len(self.bounds)] = [getattr(self, name) for name in self.bounds]
        return limits

    @abc.abstractmethod
    def space(self, max_speed: Numbers) -> tuple[Vectors, Vectors]:
        """Return the lowest and the highest value of each number of a command, in its unit; `max_speed` is in m/s."""

    @abc.abstractmethod
    def commands(self, state: State, max_speed: Float[np.ndarray, "world"], dt: float) -> Choices:
        """Return the commands that a one-step lookahead chooses from.

        Args:
            state: The vehicles before the step.
            max_speed: In m/s.
            dt: Duration of the step in seconds.
        """

    @abc.abstractmethod
    def follow(self, state: State, velocity: Vectors, max_speed: Numbers, dt: float) -> Vectors:
        """Return the commands with which vehicles approach desired velocities as closely as their limits allow.

        Args:
            state: The vehicles before the step.
            velocity: The desired velocities in m/s.
            max_speed: In m/s.
            dt: Duration of the step in seconds.
        """

    @abc.abstractmethod
    def broken_limit(self, command: Float[np.ndarray, "2"], max_speed: float) -> str:
        """Describe the limit that a command exceeds.

        Args:
            command: A command that is not within the limits.
            max_speed: In m/s.

        Returns:
            The command and the limit, as the predicate of a sentence.
        """

    def is_within(self, command: Vectors, max_speed: Numbers) -> Bool[np.ndarray, "*batch"]:
        """Return whether commands are within the limits, apart from rounding errors. Accelerations are limited in
        `step`.

        Args:
            max_speed: In m/s.
        """
        low, high = self.space(max_speed)
        slack = SPEED_TOLERANCE * high
        within = (low - slack <= command) & (command <= high + slack)
        return within[..., 0] & within[..., 1]

    def velocities(self, state: State, commands: Choices, max_speed: Float[np.ndarray, "world"], dt: float) -> Choices:
        """Return the velocities of vehicles after a step, for each of several commands.

        Args:
            state: The vehicles before the step.
            commands: The commands of each vehicle, within the limits.
            max_speed: In m/s.
            dt: Duration of the step in seconds.

        Returns:
            Velocities in m/s.
        """
        if self.code == HOLONOMIC and self.limits[0] == math.inf:
            return commands
        actions = commands.shape[1]
        each = State(*(np.repeat(array[:, None], actions, axis=1) for array in state))
        return self.step(each, commands, np.repeat(max_speed[:, None], actions, axis=1), dt).velocity

    def step(self, state: State, command: Vectors, max_speed: Numbers, dt: float) -> State:
        """Return the vehicles after a step, within their limits.

        Args:
            state: The vehicles before it.
            max_speed: In m/s.
            dt: Duration of the step in seconds.
        """
        before = State(*map(np.ascontiguousarray, state))
        after = State(*(np.empty(np.shape(each)) for each in state))
        command, max_speed = np.ascontiguousarray(command), np.ascontiguousarray(max_speed)
        _step(self.code, self.limits, before, command, max_speed, dt, after)
        return after


@no_type_check
@njit(nogil=True)
def _step(code, limits, before, command, max_speed, dt, after):
    """See `Dynamics.step`; fills `after`."""
    position, velocity, command = before.position.reshape(-1, 2), before.velocity.reshape(-1, 2), command.reshape(-1, 2)
    heading, turn_rate, max_speed = before.heading.reshape(-1), before.angular_speed.reshape(-1), max_speed.reshape(-1)
    new_position, new_velocity = after.position.reshape(-1, 2), after.velocity.reshape(-1, 2)
    new_heading, new_angular_speed = after.heading.reshape(-1), after.angular_speed.reshape(-1)
    for i in range(len(heading)):
        now = Motion(position[i, 0], position[i, 1], velocity[i, 0], velocity[i, 1], heading[i], turn_rate[i])
        then = drive(code, limits, now, (command[i, 0], command[i, 1]), max_speed[i], dt)
        new_position[i, 0], new_position[i, 1], new_velocity[i, 0], new_velocity[i, 1] = then[:4]
        new_heading[i], new_angular_speed[i] = then.heading, then.turn_rate


GRID_SPEEDS = 5
GRID_HEADINGS = 16

REACHABLE_SPEEDS = 6
REACHABLE_TURNS = 13
"""An odd number, so that one of them is straight ahead."""


def speeds_and_headings(preferred_speed: Float[np.ndarray, "world"]) -> Choices:
    """Return CrowdNav's 81 commands (Chen et al. 2019): standing still, and 5 speeds in each of 16 headings.

    The speeds are preferred_speed (exp(k / 5) - 1) / (e - 1), k = 1 to 5. The headings start along the x axis.

    Args:
        preferred_speed: In m/s.

    Returns:
        Commands in m/s.
    """
    speed = np.expm1(np.arange(1, GRID_SPEEDS + 1) / GRID_SPEEDS) / np.expm1(1.0)
    heading = np.arange(GRID_HEADINGS) * (2.0 * np.pi / GRID_HEADINGS)
    direction = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    moving = (speed[:, None, None] * direction).reshape(-1, 2)
    return preferred_speed[:, None, None] * np.concatenate([np.zeros((1, 2)), moving])


def speeds_and_turns(slowest: Numbers, fastest: Numbers, right: Numbers, left: Numbers) -> Choices:
    """Return 78 commands: 6 speeds and 13 turns, evenly spaced over the range that is reachable in the step.

    Args:
        slowest: The lowest speed in m/s.
        fastest: The highest one.
        right: The lowest turn rate in rad/s, or steering angle in rad.
        left: The highest one.

    Returns:
        All combinations of speeds and turns. The turn nearest to straight ahead is straight ahead if it is reachable.
    """
    speed = np.linspace(slowest, fastest, REACHABLE_SPEEDS, axis=1)
    turns = np.linspace(right, left, REACHABLE_TURNS, axis=1)
    world, straightest = np.arange(len(turns)), np.abs(turns).argmin(axis=1)
    turns[world, straightest] = np.clip(0.0, right, left)
    return np.stack(np.broadcast_arrays(speed[:, :, None], turns[:, None]), axis=-1).reshape(len(turns), -1, 2)
