"""What every dynamics of a vehicle is."""

from __future__ import annotations

import abc
import math
from typing import ClassVar, NamedTuple, no_type_check

import numpy as np
from jaxtyping import Bool, Float

from crowdbench.compiled import njit
from crowdbench.dynamics.motion import HOLONOMIC, SPEED_TOLERANCE, drive


class State(NamedTuple):
    """How vehicles move.

    Attributes:
        position: In metres. Of a bicycle, the middle of the rear axle.
        velocity: At the end of the last step, in m/s.
        heading: Direction in which it faces, in radians.
        angular_speed: Turn rate in the last step, in rad/s.
    """

    position: Float[np.ndarray, "*batch 2"]
    velocity: Float[np.ndarray, "*batch 2"]
    heading: Float[np.ndarray, "*batch"]
    angular_speed: Float[np.ndarray, "*batch"]

    @property
    def speed(self) -> Float[np.ndarray, "*batch"]:
        """The velocity along the heading, in m/s."""
        along: np.ndarray = self.velocity[..., 0] * np.cos(self.heading) + self.velocity[..., 1] * np.sin(self.heading)
        return along


class Dynamics(abc.ABC):
    """How a vehicle moves. A command is two numbers, constant during a step.

    Attributes:
        name: Its name in scenarios.
        code: Which formulas `crowdbench.dynamics.motion.drive` takes.
        limits: Its limits as that function takes them.
    """

    name: ClassVar[str]
    code: ClassVar[int]

    @property
    @abc.abstractmethod
    def limits(self) -> Float[np.ndarray, "3"]:
        """See the class."""

    @abc.abstractmethod
    def space(
        self, max_speed: Float[np.ndarray, "*batch"]
    ) -> tuple[Float[np.ndarray, "*batch 2"], Float[np.ndarray, "*batch 2"]]:
        """The lowest and the highest value of each number of a command, in its unit; `max_speed` is in m/s."""

    @abc.abstractmethod
    def commands(
        self, state: State, max_speed: Float[np.ndarray, "world"], dt: float
    ) -> Float[np.ndarray, "world action 2"]:
        """The commands that a one-step lookahead chooses from.

        Args:
            state: The vehicles before the step.
            max_speed: In m/s.
            dt: Duration of the step in seconds.
        """

    @abc.abstractmethod
    def follow(
        self, state: State, velocity: Float[np.ndarray, "*batch 2"], max_speed: Float[np.ndarray, "*batch"], dt: float
    ) -> Float[np.ndarray, "*batch 2"]:
        """The commands by which vehicles take wanted velocities as far as they can.

        Args:
            state: The vehicles before the step.
            velocity: The wanted velocities in m/s.
            max_speed: In m/s.
            dt: Duration of the step in seconds.
        """

    @abc.abstractmethod
    def broken_limit(self, command: Float[np.ndarray, "2"], max_speed: float) -> str:
        """What is wrong with a command.

        Args:
            command: One that is not within the limits.
            max_speed: In m/s.

        Returns:
            What it asks for and what the limit is, as the predicate of a sentence.
        """

    def is_within(
        self, command: Float[np.ndarray, "*batch 2"], max_speed: Float[np.ndarray, "*batch"]
    ) -> Bool[np.ndarray, "*batch"]:
        """Whether commands are within the limits, but for rounding; accelerations are limited in the step itself.

        Args:
            command: Finite commands.
            max_speed: In m/s.
        """
        low, high = self.space(max_speed)
        slack = SPEED_TOLERANCE * high
        within = (low - slack <= command) & (command <= high + slack)
        return within[..., 0] & within[..., 1]

    def velocities(
        self,
        state: State,
        commands: Float[np.ndarray, "world action 2"],
        max_speed: Float[np.ndarray, "world"],
        dt: float,
    ) -> Float[np.ndarray, "world action 2"]:
        """The velocities that vehicles have after a step under each of some commands.

        Args:
            state: The vehicles before the step.
            commands: The commands of each vehicle, within the limits.
            max_speed: In m/s.
            dt: Duration of the step in seconds.

        Returns:
            In m/s.
        """
        if self.code == HOLONOMIC and self.limits[0] == math.inf:
            return commands
        actions = commands.shape[1]
        each = State(*(np.repeat(array[:, None], actions, axis=1) for array in state))
        return self.step(each, commands, np.repeat(max_speed[:, None], actions, axis=1), dt).velocity

    def step(
        self, state: State, command: Float[np.ndarray, "*batch 2"], max_speed: Float[np.ndarray, "*batch"], dt: float
    ) -> State:
        """Vehicles after a step; the limits are enforced.

        Args:
            state: The vehicles before it.
            command: Their commands.
            max_speed: In m/s.
            dt: Duration of the step in seconds.
        """
        after = State(*(np.empty(np.shape(each)) for each in state))
        given = [np.ascontiguousarray(each) for each in (*state, command, max_speed)]
        _step(self.code, self.limits, *given, dt, *after)
        return after


@no_type_check
@njit(nogil=True)
def _step(
    code,
    limits,
    position,
    velocity,
    heading,
    angular_speed,
    command,
    max_speed,
    dt,
    new_position,
    new_velocity,
    new_heading,
    new_angular_speed,
):
    """See `Dynamics.step`; fills the last four."""
    position, velocity, command = position.reshape(-1, 2), velocity.reshape(-1, 2), command.reshape(-1, 2)
    heading, angular_speed, max_speed = heading.reshape(-1), angular_speed.reshape(-1), max_speed.reshape(-1)
    new_position, new_velocity = new_position.reshape(-1, 2), new_velocity.reshape(-1, 2)
    new_heading, new_angular_speed = new_heading.reshape(-1), new_angular_speed.reshape(-1)
    for i in range(len(heading)):
        (
            new_position[i, 0],
            new_position[i, 1],
            new_velocity[i, 0],
            new_velocity[i, 1],
            new_heading[i],
            new_angular_speed[i],
        ) = drive(
            code,
            limits,
            position[i, 0],
            position[i, 1],
            velocity[i, 0],
            velocity[i, 1],
            heading[i],
            angular_speed[i],
            command[i, 0],
            command[i, 1],
            max_speed[i],
            dt,
        )
