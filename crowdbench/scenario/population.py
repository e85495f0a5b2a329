"""Who walks: how many pedestrians, what is drawn of each of them, and what they do where they arrive."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from crowdbench.scenario.clear_space import ClearSpace

ARRIVALS = ("walk_on", "stop", "leave", "new_goal", "respawn", "back_and_forth")
"""What a pedestrian does that has reached its goal:

- `walk_on`: keep walking to it, as in CrowdNav,
- `stop`: stand where it is from then on,
- `leave`: be gone,
- `new_goal`: walk to another goal,
- `respawn`: make room for somebody else who comes in at another place, as in CrowdNav++,
- `back_and_forth`: walk back to where it came from, and so on.
"""

RECORDED = "recorded"
"""The name of the policy of those who walk as they were recorded."""

GOES_ON = ("new_goal", "respawn", "back_and_forth")
"""After these somebody walks on to another goal."""


@dataclass(frozen=True)
class Quantity:
    """A parameter of pedestrians: one value for all, or a value per pedestrian.

    Values per pedestrian have a truncated Gaussian distribution, or a uniform one.

    Attributes:
        mean: The value, or the mean of the distribution before it is truncated, in the unit of the parameter.
        std: Standard deviation of the Gaussian; 0 for one value, None for the uniform distribution.
        low: Smallest value: what a Gaussian draws below it is drawn again.
        high: Largest value.
        whole: Whether values are rounded to whole numbers.
    """

    mean: float
    std: float | None = 0.0
    low: float = -np.inf
    high: float = np.inf
    whole: bool = False

    def draw(self, generator: np.random.Generator, n: int) -> Float[np.ndarray, "{n}"]:
        """Draw a value for each of n pedestrians."""
        values = np.full(n, self.mean)
        if self.std is None:
            values = generator.uniform(self.low, self.high, n)
        elif self.std > 0.0:
            outside = np.ones(n, bool)
            while outside.any():
                values[outside] = generator.normal(self.mean, self.std, outside.sum())
                outside = (values < self.low) | (values > self.high)
        return np.rint(values) if self.whole else values


class Traits(NamedTuple):
    """What some pedestrians are like.

    Attributes:
        radius: In metres.
        preferred_speed: In m/s.
        policy: The policy that moves each, as an index.
        parameters: By policy and name, the parameters of the policies.
    """

    radius: Float[np.ndarray, "pedestrian"]
    preferred_speed: Float[np.ndarray, "pedestrian"]
    policy: Int[np.ndarray, "pedestrian"]
    parameters: Mapping[str, Mapping[str, Float[np.ndarray, "pedestrian"]]]

    def alike(self, first: Int[np.ndarray, "pedestrian"]) -> Traits:
        """The same pedestrians, each with the speed and the policy of the first one in its group."""
        return self._replace(preferred_speed=self.preferred_speed[first], policy=self.policy[first])


class GoalChange(NamedTuple):
    """How pedestrians change their goals on the way.

    Attributes:
        every: At the steps that are multiples of this number,
        chance: each pedestrian takes another goal with this probability.
    """

    every: int
    chance: float


@dataclass(frozen=True)
class Crowd:
    """The pedestrians of a scenario.

    Attributes:
        number: The smallest and the largest number of them.
        radius: Radii in metres.
        preferred_speed: Preferred and largest speeds in m/s; of recorded people the largest of all.
        shares: By policy, the share of the pedestrians that follow it.
        standing: The policies whose pedestrians stand, by name.
        parameters: By policy and name, the parameters of the policies.
        groups: By size, the share of the groups that are so large; empty where all walk alone.
        arrival: What becomes of those who arrive, one of `ARRIVALS`.
        goal_change: How they change their goals on the way, if they do.
        clear_space: The space around the vehicle in which nobody starts or comes in, if there is one.
    """

    number: tuple[int, int]
    radius: Quantity
    preferred_speed: Quantity
    shares: Mapping[str, float]
    standing: Collection[str]
    parameters: Mapping[str, Mapping[str, Quantity]]
    groups: Mapping[int, float]
    arrival: str
    goal_change: GoalChange | None
    clear_space: ClearSpace | None = None

    @property
    def stands(self) -> Bool[np.ndarray, "policy"]:
        """Whether the pedestrians of each policy stand. Recorded cars have a policy that nobody is drawn for."""
        return np.array([name in self.standing for name in self.parameters])

    def walking(self) -> Crowd:
        """Those who walk: who replace others that have arrived."""
        shares = {name: 0.0 if name in self.standing else share for name, share in self.shares.items()}
        total = sum(shares.values())
        if total in (0.0, 1.0):  # then nobody arrives, or everybody walks
            return self
        return dataclasses.replace(self, shares={name: share / total for name, share in shares.items()})

    def draw(self, stream: np.random.Generator, n: int | None = None) -> Traits:
        """Draw n pedestrians from a random stream; without n as many as a case has, whose number is drawn first."""
        if n is None:
            n = int(stream.integers(self.number[0], self.number[1] + 1))
        radius, speed = self.radius.draw(stream, n), self.preferred_speed.draw(stream, n)
        policy = stream.choice(len(self.shares), n, p=list(self.shares.values()))
        parameters = {
            name: {parameter: quantity.draw(stream, n) for parameter, quantity in table.items()}
            for name, table in self.parameters.items()
        }
        return Traits(radius, speed, policy, parameters)
