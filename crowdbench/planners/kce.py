"""KCE, kinematic constraints and action-space exploration (Li et al. 2020, sections III-D and III-E).

Li, Shan, Narula, Worrall and Nebot, "Socially Aware Crowd Navigation with Multimodal Pedestrian Trajectory Prediction
for Autonomous Vehicles", IEEE ITSC 2020, arXiv:2011.11191. Their action a_t is the command, a velocity. The change of
velocity, |a_t - a_{t-1}|, is the length of the difference between a command and the vehicle's velocity before the step.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from crowdbench.core.dynamics import Holonomic
from crowdbench.core.geometry import norm
from crowdbench.core.types import DISCOMFORT_GAP, Outcome
from crowdbench.planners.scene import Commands, Scene, Velocities
from crowdbench.utils.errors import is_number, require, require_count, require_not_negative, require_positive

Outcomes = Int[np.ndarray, "row mode"]
PerFuture = Float[np.ndarray, "row mode"]
PerCommand = Float[np.ndarray, "row"]
Shaping = Callable[[Outcomes, PerFuture, PerCommand], PerFuture]
"""Reward of a change of velocity in a step: see `ChangeCost`."""

ROUNDING = 1e-9
"""Tolerance of limits for rounding, in m/s or, for products of speeds, in m^2/s^2."""


@dataclass(frozen=True)
class Limits:
    """Limits of the commands that the vehicle can follow (equations 5 and 6), which bound speed and heading separately.

    A vehicle that stands still has no heading: it may start in any direction, and stop from any. The defaults are the
    paper's limits (section V-A, experiment 3).

    Attributes:
        max_acceleration: Largest change of speed, per second [m/s^2].
        max_turn: Largest change of heading in a step, pi at most [rad].
        max_velocity_change: Largest change of velocity in a step, which is not in the paper. It has no effect from
            twice the preferred speed on [m/s].

    Raises:
        InputError: A limit is not positive, or `max_turn` is above pi.
    """

    max_acceleration: float = 6.4
    max_turn: float = math.radians(120.0)
    max_velocity_change: float = math.inf

    def __post_init__(self) -> None:
        for name, limit in vars(self).items():
            require(name, limit, is_number(limit) and limit > 0.0, "a number above 0")
        require("max_turn", self.max_turn, self.max_turn <= math.pi, "pi at most")

    def allow(self, velocity: Velocities, commands: Commands, dt: float) -> Bool[np.ndarray, "world action"]:
        """Return which commands the vehicle can follow.

        Args:
            velocity: The vehicle's velocity before the step, in m/s.
            commands: Velocities in m/s.
            dt: Duration of the step in seconds.

        Returns:
            True for each command within all limits.
        """
        velocity = velocity[:, None]
        before, after = norm(velocity), norm(commands)
        # The cosine of the turn times both speeds: it is no bound if one of them is 0.
        along = (velocity * commands).sum(axis=-1)
        return (
            (np.abs(after - before) <= self.max_acceleration * dt + ROUNDING)
            & (along >= before * after * math.cos(self.max_turn) - ROUNDING)
            & (norm(commands - velocity) <= self.max_velocity_change + ROUNDING)
        )

    def brake(self, velocity: Velocities, dt: float) -> Velocities:
        """Return the velocity after braking as hard as the limits allow: zero if that is possible.

        It keeps its heading, and so it is always within the limits.

        Args:
            velocity: The vehicle's velocity before the step, in m/s.
            dt: Duration of the step in seconds.

        Returns:
            The velocity in m/s.
        """
        speed = norm(velocity)
        slower = np.maximum(speed - min(self.max_acceleration * dt, self.max_velocity_change), 0.0)
        share = np.divide(slower, speed, out=np.zeros_like(speed), where=speed > 0.0)
        return share[:, None] * velocity


@dataclass(frozen=True)
class ChangeCost:
    """A cost of every change of velocity.

    Differs from equation 8, which ignores large changes if no pedestrian is near: see `PrintedShaping`. The cost is per
    m/s of change, so that the cost of a path does not depend on the time step.

    Attributes:
        cost: Cost of a change of velocity by 1 m/s, in units of the reward [s/m].

    Raises:
        InputError: The cost is negative.
    """

    cost: float

    def __post_init__(self) -> None:
        require_not_negative("cost", self.cost)

    def __call__(self, outcome: Outcomes, gap: PerFuture, change: PerCommand) -> PerFuture:
        """Return the addition to the rewards of steps.

        Args:
            outcome: How each step ends, an `Outcome`.
            gap: The smallest distance to a pedestrian's rim during the step, in m.
            change: The change of velocity, in m/s.

        Returns:
            The addition for each step in each mode.
        """
        return np.broadcast_to(-self.cost * change[:, None], outcome.shape)


@dataclass(frozen=True)
class PrintedShaping:
    """Equation 8 as printed: `threshold` - |a_t - a_{t-1}|, added on collision, in discomfort and at the goal.

    The rest of the reward, equation 7, is `core.reward.reward`. Differs from equation 7 in discomfort because the paper
    prints -0.1 - d_min/2, which would penalize a larger gap more. As in CrowdNav (Chen et al. 2019), its source, the
    term is (d_min - 0.2) / 2 = -0.1 + d_min/2, times dt.

    Use it with care: a collision costs 0.25, and thresholds and changes of velocity are not small in comparison. With a
    threshold above 0.025, staying in discomfort can increase the reward, and above 0.25 a collision can, if the
    velocity is constant. With a threshold below 0, waiting beside the goal can have a larger reward than arriving. With
    any threshold, a swerve near a pedestrian can cost more than a collision.

    Attributes:
        threshold: The change of velocity above which the addition is negative [m/s].

    Raises:
        InputError: The threshold is not a number.
    """

    threshold: float

    def __post_init__(self) -> None:
        require("threshold", self.threshold, is_number(self.threshold), "a number")

    def __call__(self, outcome: Outcomes, gap: PerFuture, change: PerCommand) -> PerFuture:
        """See `ChangeCost`."""
        acts = (outcome != Outcome.RUNNING) | (gap < DISCOMFORT_GAP)
        return np.where(acts, self.threshold - change[:, None], 0.0)


@dataclass(frozen=True)
class Exploration:
    """Finer commands around a command a: a plus and minus m `epsilon`, m = 0 to `n` (equation 9).

    Speed and heading are varied separately, which gives (2n + 1)^2 commands, including a. For a wheeled vehicle, these
    are speed and turn rate, or speed and steering angle. The paper gives no values; the defaults are ours.

    Attributes:
        epsilon: Distance from one speed, and from one heading, to the next [m/s and rad].
        n: Number of finer speeds, and of finer headings, on either side of the command [1].

    Raises:
        InputError: `epsilon` is not positive, or `n` is not a whole number above 0.
    """

    epsilon: float = 0.1
    n: int = 2

    def __post_init__(self) -> None:
        require_positive("epsilon", self.epsilon)
        require_count("n", self.n)

    def __call__(self, scene: Scene, command: Velocities) -> Commands:
        """Return the commands around one command for each world.

        If the command is zero, the headings are around the vehicle's heading, or, if it stands still, around the
        direction of its local goal.

        Args:
            scene: The vehicles before the step.
            command: The command to refine.

        Returns:
            Commands, at speeds from 0 to the preferred speed.
        """
        offset = self.epsilon * np.arange(-self.n, self.n + 1)
        vehicle = scene.vehicle
        if not isinstance(vehicle.dynamics, Holonomic):
            low, high = vehicle.dynamics.space(vehicle.preferred_speed)
            finer = np.stack(np.meshgrid(offset, offset, indexing="ij"), axis=-1).reshape(-1, 2)
            return np.clip(command[:, None] + finer, low[:, None], high[:, None])
        limit = vehicle.preferred_speed[:, None]
        speed = np.clip(norm(command)[:, None] + offset, 0.0, limit)
        moving = np.where(norm(command)[:, None] > 0.0, command, vehicle.velocity)
        ahead = np.where(norm(moving)[:, None] > 0.0, moving, vehicle.local_goal - vehicle.position)
        heading = np.arctan2(ahead[:, 1], ahead[:, 0])[:, None] + offset
        direction = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
        return (speed[:, :, None, None] * direction[:, None]).reshape(len(command), -1, 2)
