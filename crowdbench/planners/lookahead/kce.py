"""KCE, kinematic constraints and action-space exploration: sections III-C and III-D of Li et al.

A command is a velocity, and its change is |a_t - a_{t-1}|, the length of the difference to the vehicle's velocity.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from crowdbench.errors import InputError
from crowdbench.geometry import norm
from crowdbench.planners.lookahead.outlook import Scene
from crowdbench.toml_section import is_integer, is_number
from crowdbench.types import DISCOMFORT_GAP, Outcome

ROUNDING = 1e-9
"""What a command may be beyond a limit, in m/s or, where speeds are multiplied, m^2/s^2."""


@dataclass(frozen=True)
class Limits:
    """Which commands the vehicle can follow: equations 5 and 6, which bound speed and heading by themselves.

    The speed changes by at most `max_acceleration` (m/s^2) times dt and the heading by at most `max_turn` (rad, up
    to pi) in a step. Standing still has no heading, so that it may follow any and any may follow it. Not in the
    paper is a bound on the change of velocity, `max_velocity_change` (m/s in a step). Raises InputError where one is
    not positive.
    """

    max_acceleration: float = 6.4
    max_turn: float = math.radians(120.0)
    max_velocity_change: float = math.inf

    def __post_init__(self) -> None:
        for name, limit in vars(self).items():
            _check(name, limit, is_number(limit) and limit > 0.0, "a number above 0")
        _check("max_turn", self.max_turn, self.max_turn <= math.pi, "pi at most")

    def allow(self, scene: Scene, commands: Float[np.ndarray, "world action 2"]) -> Bool[np.ndarray, "world action"]:
        """Whether the vehicle can follow each command, in m/s, with its velocity before the step."""
        velocity = scene.velocity[:, None]
        before, after = norm(velocity), norm(commands)
        # The cosine of the turn times both speeds: it bounds nothing where one of them is 0.
        along = (velocity * commands).sum(axis=-1)
        return (
            (np.abs(after - before) <= self.max_acceleration * scene.dt + ROUNDING)
            & (along >= before * after * math.cos(self.max_turn) - ROUNDING)
            & (norm(commands - velocity) <= self.max_velocity_change + ROUNDING)
        )

    def brake(self, scene: Scene) -> Float[np.ndarray, "world 2"]:
        """The velocity, in m/s, after braking as hard as is allowed, which always is: standing still, if possible."""
        speed = norm(scene.velocity)
        slower = np.maximum(speed - min(self.max_acceleration * scene.dt, self.max_velocity_change), 0.0)
        share = np.divide(slower, speed, out=np.zeros_like(speed), where=speed > 0.0)
        return share[:, None] * scene.velocity


@dataclass(frozen=True)
class PrintedShaping:
    """Equation 8 to the letter: f = `threshold` - |a_t - a_{t-1}| (m/s) on collision, in discomfort and at the goal.

    What else equation 8 has is `crowdbench.reward.reward`. There it prints -0.1 - d_min/2, which would punish a
    larger gap more; CrowdNav, where it comes from, has (d_min - 0.2) / 2 = -0.1 + d_min/2, times dt, and so have we.

    To be used with care: a collision costs 0.25, beside which neither threshold nor changes are small. Above 0.025 it
    pays to stay in discomfort and above 0.25 to collide, as long as the velocity is kept; below 0, arriving is worth
    less than waiting beside the goal. In between, too, swerving near a pedestrian costs more than hitting them.
    """

    threshold: float

    def __post_init__(self) -> None:
        _check("threshold", self.threshold, is_number(self.threshold), "a number")

    def __call__(
        self, outcome: Int[np.ndarray, "row mode"], gap: Float[np.ndarray, "row mode"], change: Float[np.ndarray, "row"]
    ) -> Float[np.ndarray, "row mode"]:
        """What is added to the rewards of steps with these outcomes, gaps (m) and changes of velocity (m/s)."""
        acts = (outcome != Outcome.RUNNING) | (gap < DISCOMFORT_GAP)
        return np.where(acts, self.threshold - change[:, None], 0.0)


@dataclass(frozen=True)
class ChangeCost:
    """Differs from equation 8, because that is blind to hard changes where nobody is near: each has its `cost`.

    It is per m/s of change, so that a way costs the same whatever dt is.
    """

    cost: float

    def __post_init__(self) -> None:
        _check("cost", self.cost, is_number(self.cost) and self.cost >= 0.0, "a number, 0 or more")

    def __call__(
        self, outcome: Int[np.ndarray, "row mode"], gap: Float[np.ndarray, "row mode"], change: Float[np.ndarray, "row"]
    ) -> Float[np.ndarray, "row mode"]:
        """See `PrintedShaping`."""
        return np.broadcast_to(-self.cost * change[:, None], outcome.shape)


@dataclass(frozen=True)
class Exploration:
    """The refined set of equation 9 around a command a: a plus and minus m `epsilon`, m = 0 to `n`.

    Speed (m/s) and heading (rad) are refined by themselves, which gives (2n + 1)^2 commands, a among them. Raises
    InputError where `epsilon` is not positive or `n` no number to count with.
    """

    epsilon: float
    n: int

    def __post_init__(self) -> None:
        _check("epsilon", self.epsilon, is_number(self.epsilon) and self.epsilon > 0.0, "a number above 0")
        _check("n", self.n, is_integer(self.n) and self.n >= 1, "a whole number, 1 or more")

    def __call__(self, scene: Scene, command: Float[np.ndarray, "world 2"]) -> Float[np.ndarray, "world action 2"]:
        """The commands around one for each world, in m/s, at speeds from 0 to the preferred one.

        Around standing still they head where the vehicle does, and if it stands, for its goal.
        """
        offset = self.epsilon * np.arange(-self.n, self.n + 1)
        limit = scene.preferred_speed[:, None]
        speed = np.clip(norm(command)[:, None] + offset, 0.0, limit)
        moving = np.where(norm(command)[:, None] > 0.0, command, scene.velocity)
        ahead = np.where(norm(moving)[:, None] > 0.0, moving, scene.goal - scene.position)
        heading = np.arctan2(ahead[:, 1], ahead[:, 0])[:, None] + offset
        direction = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
        return (speed[:, :, None, None] * direction[:, None]).reshape(len(command), -1, 2)


def _check(name: str, value: object, good: bool, right: str) -> None:
    if not good:
        raise InputError(f"{name} is {value!r}, but must be {right}")
