"""The rewards of the environments by name, for the training of policies. Scores never depend on them.

A reward is a function of a step that returns one number per world. To add a reward, write a file with a function
`reward(step)` and pass its path to an environment: `reward="./mine.py"`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from crowdbench.core.geometry import norm
from crowdbench.core.reward import reward
from crowdbench.core.types import Outcome, World
from crowdbench.metrics.score import close_seconds
from crowdbench.plugins.kind import Kind
from crowdbench.sim.pedestrians.policy import moment_of
from crowdbench.sim.routes import goals_on_way
from crowdbench.utils.errors import InputError, plugin_errors, takes_arguments
from crowdbench.utils.resources import plugin_in_time

PROGRESS = 0.2
"""Reward of `progress` per metre that the vehicle comes closer to its goal."""

COLLISION = -0.5
"""Reward of `progress` for a collision."""

SECOND = 0.06
"""Reward of `scored`, times -1, per second, and per second close to a pedestrian."""


@dataclass(frozen=True)
class Step:
    """A step of many worlds, the argument of a reward.

    Attributes:
        before: The worlds before the step. Agent 0 is the vehicle.
        after: The worlds after it.
        outcome: The `Outcome` of the step.
        gap: The smallest distance in metres between the rims of the vehicle and a pedestrian during the step; infinite
            without pedestrians.
    """

    before: World
    after: World
    outcome: Int[np.ndarray, "world"]
    gap: Float[np.ndarray, "world"]

    def __len__(self) -> int:
        return len(self.gap)

    def take(self, rows: Int[np.ndarray, "row"]) -> Step:
        """Return the step of the worlds in the given rows."""
        return Step(self.before.take(rows), self.after.take(rows), self.outcome[rows], self.gap[rows])

    @property
    def dt(self) -> float:
        """The length of the step in seconds."""
        return self.after.rules.dt

    @property
    def progress(self) -> Float[np.ndarray, "world"]:
        """Decrease of the vehicle's distance to its goal along its route, in metres."""
        return _distance_left(self.before) - _distance_left(self.after)

    @property
    def ended(self) -> Bool[np.ndarray, "world"]:
        """True for worlds whose episode ended in the step."""
        return self.outcome != Outcome.RUNNING

    @property
    def collided(self) -> Bool[np.ndarray, "world"]:
        """True for worlds in which the step ended in a collision, with a pedestrian or an obstacle."""
        return np.isin(self.outcome, (Outcome.COLLISION, Outcome.WALL_COLLISION))


def _distance_left(world: World) -> Float[np.ndarray, "world"]:
    """Return the vehicle's distance in metres to its local goal, see `crowdbench.core.geometry.local_goals`."""
    return norm(goals_on_way(world)[:, 0] - world.position[:, 0])


Reward = Callable[[Step], Float[np.ndarray, "world"]]


def crowdnav(step: Step) -> Float[np.ndarray, "world"]:
    """Return the reward of CrowdNav (Chen et al. 2019, equation 3), which is also used to evaluate planners."""
    return reward(step.outcome, step.gap, step.dt)


def progress(step: Step) -> Float[np.ndarray, "world"]:
    """Return CrowdNav's reward with 0.2 for every metre closer to the goal, and -0.5 for a collision.

    CrowdNav's reward gives no information on progress to the goal, which an untrained policy never reaches.
    """
    return np.where(step.collided, COLLISION, crowdnav(step)) + PROGRESS * step.progress


def safe_progress(step: Step) -> Float[np.ndarray, "world"]:
    """Return the reward `progress` with -3 for a collision and a penalty for changes of velocity.

    The penalty for a collision is three times the reward for the goal (twice in CrowdNav++, Liu et al. 2023). The
    penalty for a change of velocity is 0.02 times its square, with velocities in m/s.
    """
    change = step.after.velocity[:, 0] - step.before.velocity[:, 0]
    return np.where(step.collided, -3.0, crowdnav(step)) + PROGRESS * step.progress - 0.02 * (change**2).sum(axis=1)


def scored(step: Step) -> Float[np.ndarray, "world"]:
    """Return the reward `safe_progress`, less 0.06 per second and per second close to pedestrians, as in the score.

    The score counts a second close to a pedestrian as a second of travel time (`crowdbench.metrics.score`).
    """
    moments = step.before, step.after
    is_there = np.stack([world.present[..., None] for world in moments], axis=1)
    position = np.where(is_there, np.stack([world.position for world in moments], axis=1), np.nan)
    velocity, heading, radius, person = (
        np.stack([getattr(world, name) for world in moments], axis=1)
        for name in ("velocity", "heading", "radius", "person")
    )
    close = close_seconds(position, velocity, heading, radius, person, np.ones(len(step), np.int64), step.after.rules)
    return safe_progress(step) - SECOND * (step.dt + close)


def crowdnav_plus(step: Step) -> Float[np.ndarray, "world"]:
    """Return the reward of CrowdNav++ (Liu et al. 2023, equations 3 to 5), with the values of its code.

    It is 10 for the goal and -20 for a collision. Otherwise it is 2 per metre of progress, or 10 (gap - 0.25 m) per
    second if the gap is below 0.25 m. A penalty -20 / 2^(k+1) is added if a pedestrian at constant velocity would touch
    the vehicle at its present position after k steps, k = 1 to 5. Only the largest penalty counts.
    """
    closer = np.where(step.gap < 0.25, 10.0 * (step.gap - 0.25) * step.dt, 2.0 * step.progress)
    paid = np.select([step.collided, step.outcome == Outcome.SUCCESS, step.ended], [-20.0, 10.0, 0.0], closer)
    return paid + _predicted_contact(step.after)


def _predicted_contact(world: World) -> Float[np.ndarray, "world"]:
    """Return the penalty of `crowdnav_plus` for the first of the next five steps in which a pedestrian would touch the
    vehicle."""
    ahead = np.arange(1, 6)
    position = world.position[:, None, 1:] + world.rules.dt * ahead[:, None, None] * world.velocity[:, None, 1:]
    apart = norm(position - world.position[:, None, :1]) - world.radius[:, None, 1:] - world.radius[:, None, :1]
    touches = ((apart < 0.0) & world.present[:, None, 1:]).any(axis=2)
    return np.where(touches, -20.0 / 2.0 ** (ahead + 1), 0.0).min(axis=1)


REWARDS = Kind(
    "reward",
    "reward",
    {
        "crowdnav": crowdnav,
        "progress": progress,
        "safe_progress": safe_progress,
        "scored": scored,
        "crowdnav_plus": crowdnav_plus,
    },
)


@dataclass(frozen=True)
class CheckedReward:
    """A reward whose return values are checked.

    Attributes:
        name: Its name.
        reward: The reward.
    """

    name: str
    reward: Reward

    def __call__(self, step: Step) -> Float[np.ndarray, "world"]:
        """Return the reward of a step. Raises InputError if the reward raises, or does not return one finite number per
        world."""
        limited = plugin_errors if self.name in REWARDS.functions else plugin_in_time
        with limited(f"reward {self.name} raised", f" ({moment_of(step.before)})"):
            values = np.asarray(self.reward(step))
        if values.shape != step.gap.shape or values.dtype.kind not in "bfiu":
            raise InputError(
                f"reward {self.name} gave shape {list(values.shape)} of {values.dtype}, but must give one number per "
                f"world, [{len(step.gap)}]"
            )
        # A sum is finite only if all its terms are, and takes half the time of a test of each.
        if not math.isfinite(values.sum()) and not np.isfinite(values).all():
            row = int(np.flatnonzero(~np.isfinite(values))[0])
            where = f"world {row}, case {step.before.case[row]}, step {step.before.step[row]}"
            raise InputError(f"reward {self.name} is {values[row]} in {where}, but must be finite")
        return values.astype(np.float64, copy=False)


def load_reward(spec: str | Reward) -> CheckedReward:
    """Find a reward.

    Args:
        spec: The name of a built-in reward, `file.py`, whose function is `reward`, `file.py:function`, or a function.

    Raises:
        InputError: There is no such reward.
    """
    if not callable(spec) and not isinstance(spec, str):
        raise InputError(f"reward is {spec!r}, but must be a name, the path of a file as a text, or a function")
    name, function = (getattr(spec, "__name__", "reward"), spec) if callable(spec) else REWARDS.find(spec)
    if not takes_arguments(function, 1):
        raise InputError(f"reward {name} must be a function of one argument, the step")
    return CheckedReward(name, function)
