"""Who walks: the quantities that differ between pedestrians, and what is drawn of each of them."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int


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
        """Draw values.

        Args:
            generator: The random stream to draw from.
            n: Number of pedestrians.

        Returns:
            A value per pedestrian.
        """
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

    def of(self, one: int) -> Traits:
        """What one of them is like, as a crowd of one."""
        only = slice(one, one + 1)
        parameters = {
            name: {parameter: values[only] for parameter, values in table.items()}
            for name, table in self.parameters.items()
        }
        return Traits(self.radius[only], self.preferred_speed[only], self.policy[only], parameters)

    def alike(self, first: Int[np.ndarray, "pedestrian"]) -> Traits:
        """The same pedestrians, each with the speed and the policy of the first one in its group."""
        return self._replace(preferred_speed=self.preferred_speed[first], policy=self.policy[first])


@dataclass(frozen=True)
class Kinds:
    """What pedestrians there may be.

    Attributes:
        radius: Radii in metres.
        preferred_speed: Preferred and largest speeds in m/s.
        shares: By policy, the share of the pedestrians that follow it.
        standing: The policies whose pedestrians stand, by name.
        parameters: By policy and name, the parameters of the policies.
    """

    radius: Quantity
    preferred_speed: Quantity
    shares: Mapping[str, float]
    standing: Collection[str]
    parameters: Mapping[str, Mapping[str, Quantity]]

    @property
    def stands(self) -> Bool[np.ndarray, "policy"]:
        """Whether the pedestrians of each policy stand. Recorded cars have a policy that nobody is drawn for."""
        return np.array([name in self.standing for name in self.parameters])

    def walking(self) -> Kinds:
        """Those who walk: who replace others that have arrived."""
        shares = {name: 0.0 if name in self.standing else share for name, share in self.shares.items()}
        total = sum(shares.values())
        if total in (0.0, 1.0):  # then nobody arrives, or everybody walks
            return self
        return dataclasses.replace(self, shares={name: share / total for name, share in shares.items()})

    def draw(self, crowd: np.random.Generator, n: int) -> Traits:
        """Draw pedestrians.

        Args:
            crowd: The random stream to draw from.
            n: How many.
        """
        radius, speed = self.radius.draw(crowd, n), self.preferred_speed.draw(crowd, n)
        policy = crowd.choice(len(self.shares), n, p=list(self.shares.values()))
        parameters = {
            name: {parameter: quantity.draw(crowd, n) for parameter, quantity in table.items()}
            for name, table in self.parameters.items()
        }
        return Traits(radius, speed, policy, parameters)
