"""The three dynamics that a vehicle can have, each with its limits."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import ClassVar

import numpy as np
from jaxtyping import Bool, Float

from crowdbench.core.arrays import Numbers, Vectors
from crowdbench.core.dynamics.dynamics import (
    Choices,
    Dynamics,
    State,
    speeds_and_headings,
    speeds_and_turns,
)
from crowdbench.core.dynamics.kernels import BICYCLE, HOLONOMIC, SPEED_TOLERANCE, UNICYCLE
from crowdbench.core.geometry import norm, wrap_angle

CREEP = 0.3
"""Share of the desired speed at which a bicycle turns towards a goal beside it or behind it."""


@dataclass(frozen=True)
class Holonomic(Dynamics):
    """Vehicle that moves in any direction. A command is a velocity, vx and vy in m/s.

    Attributes:
        max_acceleration: Largest change of velocity, per second [m/s^2].

    Raises:
        InputError: The limit is not positive.
    """

    name = "holonomic"
    code = HOLONOMIC
    bounds: ClassVar = {"max_acceleration": math.inf}

    max_acceleration: float = math.inf

    def space(self, max_speed: Numbers) -> tuple[Vectors, Vectors]:
        """See `Dynamics`. At the corners of this space the speed is above `max_speed`; `step` limits it."""
        high = np.stack([max_speed, max_speed], axis=-1)
        return -high, high

    def commands(self, state: State, max_speed: Float[np.ndarray, "world"], dt: float) -> Choices:
        """See `Dynamics` and `speeds_and_headings`."""
        return speeds_and_headings(max_speed)

    def follow(self, state: State, velocity: Vectors, max_speed: Numbers, dt: float) -> Vectors:
        """See `Dynamics`: the velocities themselves."""
        return velocity

    def is_within(self, command: Vectors, max_speed: Numbers) -> Bool[np.ndarray, "*batch"]:
        """See `Dynamics`."""
        within: np.ndarray = norm(command) <= max_speed * (1 + SPEED_TOLERANCE)
        return within

    def broken_limit(self, command: Float[np.ndarray, "2"], max_speed: float) -> str:
        """See `Dynamics`."""
        return f"asked for {math.hypot(*command):.6g} m/s, but the vehicle's maximum is {max_speed:g} m/s"


class _OnWheels(Dynamics):
    """Vehicle that drives along its heading. A command is a speed and a turn; `limits[1]` limits the turn."""

    broken_turn: ClassVar[str]
    """Format of the text of `broken_limit` for the second number of a command and its limit."""

    max_acceleration: float
    max_reverse_speed: float

    def space(self, max_speed: Numbers) -> tuple[Vectors, Vectors]:
        """See `Dynamics`."""
        turn = np.full(np.shape(max_speed), self.limits[1])
        return np.stack([self._slowest(max_speed), -turn], axis=-1), np.stack([max_speed, turn], axis=-1)

    def broken_limit(self, command: Float[np.ndarray, "2"], max_speed: float) -> str:
        """See `Dynamics`."""
        slowest = 0.0 - min(self.max_reverse_speed, max_speed)
        if slowest * (1 + SPEED_TOLERANCE) <= command[0] <= max_speed * (1 + SPEED_TOLERANCE):
            return self.broken_turn.format(command[1], self.limits[1])
        return f"asked for {command[0]:.6g} m/s, but the vehicle's speeds are {slowest:g} to {max_speed:g} m/s"

    def _slowest(self, max_speed: Numbers) -> Numbers:
        """Return the lowest speed in m/s: negative, if the vehicle drives backwards."""
        return 0.0 - np.minimum(self.max_reverse_speed, max_speed)

    def _reachable(self, state: State, max_speed: Numbers, dt: float) -> tuple[Numbers, Numbers]:
        """Return the lowest and the highest speed in m/s that a vehicle can have after a step."""
        speed, change, slowest = state.speed, self.max_acceleration * dt, self._slowest(max_speed)
        return np.clip(speed - change, slowest, max_speed), np.clip(speed + change, slowest, max_speed)

    def _toward(self, state: State, velocity: Vectors) -> tuple[Numbers, Numbers]:
        """Return the turn with which vehicles face a velocity, or face away from it and drive backwards.

        A vehicle drives backwards at a velocity behind it that is not above its `max_reverse_speed`. It turns around
        for a faster one.

        Args:
            state: The vehicles.
            velocity: The desired velocities in m/s.

        Returns:
            The angle of the turn in radians, and the sign of the speed.
        """
        angle = wrap_angle(np.arctan2(velocity[..., 1], velocity[..., 0]) - state.heading)
        angle = np.where(norm(velocity) > 0.0, angle, 0.0)
        is_back = (np.abs(angle) > np.pi / 2.0) & (norm(velocity) <= self.max_reverse_speed)
        return np.where(is_back, wrap_angle(angle - np.pi), angle), np.where(is_back, -1.0, 1.0)


@dataclass(frozen=True)
class Unicycle(_OnWheels):
    """Vehicle that drives along its heading and turns, also on the spot.

    A command is a speed in m/s and a turn rate in rad/s.

    Attributes:
        max_acceleration: Largest change of speed, per second [m/s^2].
        max_angular_speed: Largest turn rate [rad/s].
        max_angular_acceleration: Largest change of turn rate, per second [rad/s^2].
        max_reverse_speed: Largest speed backwards, at most the preferred speed; 0 if it drives forwards only [m/s].

    Raises:
        InputError: A limit is not positive, or the turn rate is not limited.
    """

    name = "unicycle"
    code = UNICYCLE
    bounds: ClassVar = {
        "max_acceleration": math.inf,
        "max_angular_speed": 1e3,
        "max_angular_acceleration": math.inf,
        "max_reverse_speed": math.inf,
    }
    broken_turn = "asked for {:.6g} rad/s, but its max_angular_speed is {:g} rad/s"

    max_acceleration: float = 2.0
    max_angular_speed: float = 2.0
    max_angular_acceleration: float = 6.0
    max_reverse_speed: float = 0.0

    def commands(self, state: State, max_speed: Float[np.ndarray, "world"], dt: float) -> Choices:
        """See `Dynamics` and `speeds_and_turns`."""
        change, limit = self.max_angular_acceleration * dt, self.max_angular_speed
        turns = [np.clip(state.angular_speed + sign * change, -limit, limit) for sign in (-1, 1)]
        return speeds_and_turns(*self._reachable(state, max_speed, dt), *turns)

    def follow(self, state: State, velocity: Vectors, max_speed: Numbers, dt: float) -> Vectors:
        """See `Dynamics`: the part of the velocity along the heading, and a turn towards its direction.

        With an angle d from the heading to the velocity u, the speed is |u| max(0, cos d): a vehicle whose goal is
        behind it turns on the spot, or drives backwards, see `max_reverse_speed`. The turn rate is d / dt, or a smaller
        one that allows the vehicle to stop at d.
        """
        angle, sign = self._toward(state, velocity)
        speed = np.minimum(norm(velocity) * np.maximum(np.cos(angle), 0.0), max_speed)
        rate = _rate_for(np.abs(angle), self.max_angular_acceleration, dt)
        return np.stack([sign * speed, np.copysign(np.minimum(rate, self.max_angular_speed), angle)], axis=-1)


@dataclass(frozen=True)
class Bicycle(_OnWheels):
    """Vehicle that drives along its heading and steers, as a car does.

    A command is a speed in m/s and a steering angle in rad.

    The kinematic bicycle: the middle of the rear axle moves along the heading, which turns by speed tan(steering angle)
    / wheelbase.

    Attributes:
        wheelbase: Distance between the axles [m].
        max_steering: Largest steering angle, below pi / 2 [rad].
        max_acceleration: Largest change of speed, per second [m/s^2].
        max_reverse_speed: Largest speed backwards, at most the preferred speed; 0 if it drives forwards only [m/s].

    Raises:
        InputError: A limit is not positive, or above its bound.
    """

    name = "bicycle"
    code = BICYCLE
    bounds: ClassVar = {
        "max_acceleration": math.inf,
        "max_steering": 1.5,
        "wheelbase": 100.0,
        "max_reverse_speed": math.inf,
    }
    broken_turn = "asked to steer by {:.6g} rad, but its max_steering is {:g} rad"

    wheelbase: float = 2.7
    max_steering: float = 0.6
    max_acceleration: float = 2.0
    max_reverse_speed: float = 0.0

    def commands(self, state: State, max_speed: Float[np.ndarray, "world"], dt: float) -> Choices:
        """See `Dynamics` and `speeds_and_turns`."""
        steering = np.full(len(max_speed), self.max_steering)
        return speeds_and_turns(*self._reachable(state, max_speed, dt), -steering, steering)

    def follow(self, state: State, velocity: Vectors, max_speed: Numbers, dt: float) -> Vectors:
        """See `Dynamics`: a steering angle towards the velocity, and a speed that falls with the angle to it.

        With an angle d from the heading to the velocity u, the speed is |u| max(cos d, 0.3): a vehicle that cannot turn
        on the spot must drive on if its goal is behind it, or backwards, see `max_reverse_speed`. A vehicle that drives
        forwards only does not reach a goal inside its smallest turning circle.
        """
        angle, sign = self._toward(state, velocity)
        speed = sign * np.minimum(norm(velocity) * np.maximum(np.cos(angle), CREEP), max_speed)
        next_speed = np.clip(speed, *self._reachable(state, max_speed, dt))
        turn = np.where(next_speed < 0.0, -angle, angle)
        steering = np.arctan2(turn / dt * self.wheelbase, np.abs(next_speed))
        return np.stack([speed, np.clip(steering, -self.max_steering, self.max_steering)], axis=-1)


def _rate_for(angle: Numbers, acceleration: float, dt: float) -> Numbers:
    """Return the largest turn rate from which a vehicle that slows down from step to step stops after an angle.

    Args:
        angle: In rad, 0 or more.
        acceleration: Largest change of the turn rate, in rad/s^2.
        dt: Duration of a step in seconds.

    Returns:
        Turn rates in rad/s. In each of the next n steps they fall by `acceleration * dt`.
    """
    if acceleration == math.inf:
        return angle / dt
    change = acceleration * dt * dt
    n = np.floor((np.sqrt(1.0 + 8.0 * angle / change) - 1.0) / 2.0)
    return (angle + change * n * (n + 1.0) / 2.0) / ((n + 1.0) * dt)


FREE = Holonomic()
"""The dynamics of a vehicle without limits."""

DYNAMICS: Mapping[str, type[Holonomic] | type[Unicycle] | type[Bicycle]] = MappingProxyType(
    {each.name: each for each in (Holonomic, Unicycle, Bicycle)}
)
"""The dynamics by their names in scenarios."""
